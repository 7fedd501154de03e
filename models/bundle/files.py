"""Bundle on disk: ONNX graphs, parity gate, golden ticks, manifest and model card.

An old bundle is replaced file by file, its manifest last: until then a reader detects that a hash
differs. Other files in the directory stay.
"""

from __future__ import annotations

import contextlib
import importlib.metadata
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
import onnx

from firmware_py.core.errors import DropstitchError, InputError
from firmware_py.core.input_files import read_json, resolved
from firmware_py.core.signals import feature_names, tip_names, unit_of
from firmware_py.inference.bundle import POLYNOMIAL, PREDICTOR
from firmware_py.inference.bundle_signature import SIGNATURE
from firmware_py.inference.estimator import LaggedEstimator
from firmware_py.inference.golden import GOLDEN, record_golden, write_golden
from firmware_py.inference.manifest import FILES, MANIFEST, Manifest, Quantity, write_manifest
from firmware_py.inference.predictor import InputRange, OnnxGraph, OnnxPredictor
from models.bundle.model_card import write_model_card
from models.plant.plant import Plant
from models.predictor.document import PredictorsDocument, summary_of, write_predictors
from models.predictor.fallback import LAG_TICKS, Fallback
from models.predictor.guarded_tip import GuardedTip
from models.predictor.onnx_graphs import OUTPUTS, Array, to_onnx
from models.predictor.polynomials import GuardedPredictor
from models.predictor.training import TipTraining
from models.study.document import StudyDocument, write_study

BUNDLE_FILES: Final = (*sorted(FILES), SIGNATURE, MANIFEST)
"""Files that a bundle may have, in the order in which they are replaced."""
_KEYS: Final = frozenset({"training_data_sha256", "plant_sha256", "files"})
"""Keys that the manifest of a bundle has in every version, and no other manifest has."""


def check_bundle_directory(directory: Path) -> None:
    """Refuse a directory that is not empty and holds no bundle."""
    if not directory.exists() or (directory.is_dir() and not any(directory.iterdir())):
        return
    try:
        manifest = read_json(directory / MANIFEST, "train the bundle again")
    except InputError:
        manifest = None
    if not isinstance(manifest, dict) or not manifest.keys() >= _KEYS:
        raise InputError(directory, "exists and is not a bundle", "choose another --out")


@contextlib.contextmanager
def replaced_bundle(directory: Path) -> Iterator[Path]:
    """Empty directory whose files replace those of an old bundle if the body succeeds."""
    check_bundle_directory(directory)
    directory = resolved(directory)
    directory.parent.mkdir(parents=True, exist_ok=True)
    place = directory if directory.exists() else directory.parent  # on the same file system
    with tempfile.TemporaryDirectory(
        prefix=f".{directory.name}.", dir=place, ignore_cleanup_errors=True
    ) as scratch:
        fresh = Path(scratch) / "bundle"  # only the scratch directory is closed to other users
        fresh.mkdir()
        yield fresh
        if not directory.exists():
            fresh.rename(directory)
            return
        for name in BUNDLE_FILES:
            if (fresh / name).exists():
                (fresh / name).replace(directory / name)
            else:
                (directory / name).unlink(missing_ok=True)


GATE_POINTS: Final = 10_000  # Points of the parity gate
GATE_M: Final = 1e-9
"""Largest difference at the parity gate: rounding of float64 gives up to 3e-14 m
(docs/sources.md, "ONNX")."""
GOLDEN_TICKS: Final = 256  # Golden ticks after the rest rows: one cycle of the study's motion
LIBRARIES: Final = ("numpy", "scikit-learn", "onnx", "onnxruntime", "casadi")
"""Libraries whose versions the manifest records."""


class ParityError(DropstitchError):
    """The outputs of the graph differ from scikit-learn's; no bundle was written."""


def write_bundle(
    directory: Path,
    plant: Plant,
    fallback: Fallback,
    tip: TipTraining | None = None,
    study: StudyDocument | None = None,
) -> dict[str, float]:
    """Write a bundle, complete or not at all; the same results give the same bytes.

    Its estimator is the lagged regressor, until `dropstitch fmu build --unit observer` adds the
    observer that the predictor was trained with. Without `tip` the fallback's polynomial is the
    robot's predictor, too. Returns the largest differences at the parity gate.
    """
    with replaced_bundle(directory) as fresh:
        manifest = _manifest(plant, fallback, tip, study)
        box, names = fallback.predictor.polynomial, feature_names(manifest.dof)
        ranges = list(map(InputRange, names, box.lower.tolist(), box.upper.tolist()))
        polynomial = fresh / (POLYNOMIAL if tip else PREDICTOR)
        facts = _facts(manifest, ranges) | {"degree": manifest.degree}
        onnx.save(to_onnx(fallback.predictor.write_graph, len(names), facts), polynomial)
        features = fallback.samples.features("observer")
        parity = check_parity(polynomial, fallback.predictor, features)
        if tip:
            facts = _facts(manifest, tip.predictor.ranges()) | {"predictor": manifest.predictor}
            graph = to_onnx(tip.predictor.write_graph, len(tip.rows.names), facts)
            onnx.save(graph, fresh / PREDICTOR)
            parity = check_parity(fresh / PREDICTOR, tip.predictor, tip.rows.inputs)
            write_predictors(fresh / "predictors.json", tip.document)
        if study:
            write_study(fresh / "study.json", study)
        plant.for_robot().write(fresh / "plant.json")
        facts = {"lag_ticks": list(LAG_TICKS), "period_s": manifest.period_s, "dof": manifest.dof}
        width = len(fallback.lagged.lower)
        graph = to_onnx(fallback.write_lagged, width, facts, "lagged", {"di": 1})
        onnx.save(graph, fresh / "lagged.onnx")
        lagged = LaggedEstimator(fresh / "lagged.onnx", LAG_TICKS, manifest.dof)
        _write_golden(fresh / GOLDEN, fallback, lagged, OnnxPredictor(polynomial, manifest.dof))
        write_model_card(fresh, manifest, tip.document if tip else None)
        write_manifest(fresh, manifest)
        return parity


def _write_golden(
    path: Path, fallback: Fallback, estimator: LaggedEstimator, predictor: OnnxPredictor
) -> None:
    """Write the golden ticks: the start of the run with the heaviest payload."""
    heaviest = max(fallback.samples.trials, key=lambda t: t.meta.payload_kg)
    ticks = slice(0, heaviest.meta.rest_samples + GOLDEN_TICKS)
    golden = record_golden(
        estimator, predictor, heaviest.angle_rad[ticks], heaviest.current_a[ticks], heaviest.step_s
    )
    write_golden(path, golden)


def check_parity(
    path: Path, predictor: GuardedPredictor | GuardedTip, features: Array
) -> dict[str, float]:
    """Compare the graph with scikit-learn on 10,000 points of the training hull.

    A point of the hull is a random convex combination of n + 1 training rows, with n the number of
    features. Returns the largest absolute difference of `tip_m` and `half_width_m`, in m.
    """
    rng = np.random.default_rng(0)
    corners = rng.integers(len(features), size=(GATE_POINTS, features.shape[1] + 1))
    weights = rng.dirichlet(np.ones(corners.shape[1]), size=GATE_POINTS)
    points = np.einsum("kc,kcn->kn", weights, features[corners])
    graph, answers = OnnxGraph(path, features.shape[1], tuple(OUTPUTS.items())), []
    for point in points:
        graph.row[:] = point
        graph.run()
        answers.append(np.concatenate(graph.results))
    tip_m, in_range, half_width_m = np.split(np.array(answers), [3, 4], axis=1)
    worst = {
        "tip_m": float(np.abs(tip_m - predictor.predict(points)).max()),
        "half_width_m": float(np.abs(half_width_m - predictor.half_width(points)).max()),
    }
    alike = np.array_equal(in_range[:, 0] > 0.5, predictor.in_range(points))
    if max(worst.values()) > GATE_M or not alike:
        raise ParityError(
            f"the graph differs from scikit-learn by {worst['tip_m']:.1e} m (tip) and "
            f"{worst['half_width_m']:.1e} m (half width), more than {GATE_M:g} m: no bundle written"
        )
    return worst


def _manifest(
    plant: Plant, fallback: Fallback, tip: TipTraining | None, study: StudyDocument | None
) -> Manifest:
    samples, box = fallback.samples, fallback.predictor.polynomial
    data = summary_of(samples.trials)
    dof = samples.trials[0].meta.dof
    return Manifest(
        dof=dof,
        period_s=data.step_s,
        degree=fallback.degree,
        estimator="lagged",
        features=_quantities(tip.rows.names, tip.predictor.lower, tip.predictor.upper)
        if tip
        else _quantities(feature_names(dof), box.lower, box.upper),
        outputs=_quantities(tip_names(), samples.tip_m.min(axis=0), samples.tip_m.max(axis=0)),
        lag_ticks=LAG_TICKS,
        training_data_sha256=data.sha256,
        plant_sha256=plant.for_robot().sha256(),
        libraries={name: importlib.metadata.version(name) for name in LIBRARIES},
        metrics=(_study_metrics(study) if study else {})
        | (_tip_metrics(tip.document) if tip else {}),
        predictor=tip.document.chosen if tip else "",
        servo_gains=plant.provenance.servo_gains[:dof],
        files={},
    )


def _quantities(names: Sequence[str], low: Array, high: Array) -> tuple[Quantity, ...]:
    return tuple(
        Quantity(name, unit_of(name) or "1", float(a), float(b))
        for name, a, b in zip(names, low, high, strict=True)
    )


def _facts(manifest: Manifest, ranges: Sequence[InputRange]) -> dict[str, Any]:
    """Facts that a predictor's graph stores about itself."""
    return {
        "features": [
            {"name": r.name, "unit": unit_of(r.name) or "1"} | msgspec.to_builtins(r)
            for r in ranges
        ],
        "outputs": msgspec.to_builtins(manifest.outputs),
        "in_range": "1 where the prediction may be trusted, else 0 (also where an input is NaN)",
        "half_width_m": "half width of the 95 % prediction interval, world x, y, z, in m",
        "dof": manifest.dof,
        "period_s": manifest.period_s,
        "training_data_sha256": manifest.training_data_sha256,
    }


def _tip_metrics(document: PredictorsDocument) -> dict[str, float]:
    """Errors and coverage of the robot's predictor, by test."""
    chosen = document.candidates[document.chosen]
    metrics = {"predictor_left_out_mean_euclidean_distance_m": chosen.nested.mean_m}
    for name, parts in chosen.tests.items():
        metrics |= {
            f"predictor_{name}_mean_euclidean_distance_m": parts["all"].mean_m,
            f"predictor_{name}_interval_coverage": parts["all"].coverage,
            f"predictor_{name}_interval_coverage_least_axis": parts["all"].coverage_least,
        }
    return metrics


def _study_metrics(study: StudyDocument) -> dict[str, float]:
    """Held-out figures of the fallback, by test."""
    degree = str(study.chosen_degree)
    metrics: dict[str, float] = {}
    for name, table in study.mean_euclidean_distance_m.items():
        pooled, deployed = table["pooled"], study.deployed[name]
        metrics |= {
            f"{name}_mean_euclidean_distance_m": deployed.mean_euclidean_distance_m,
            f"{name}_with_true_di_m": pooled["with_di"][degree],
            f"{name}_without_di_m": pooled["without_di"][degree],
            f"{name}_r2_di": study.estimators[name]["observer"].r2_di,
            f"{name}_interval_coverage": deployed.interval_coverage_mean,
        }
    return metrics
