"""Directory of a bundle on disk: its replacement, and the check before it.

An old bundle is replaced file by file, its manifest last: until then a reader detects that a hash
differs. Other files in the directory are kept.

Bundle export of a study: ONNX graphs, parity gate, manifest, golden ticks, model card.
"""

from __future__ import annotations

import contextlib
import importlib.metadata
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
import onnx

from firmware_py.errors import DropstitchError, InputError
from firmware_py.files.input_files import read_json
from firmware_py.inference.bundle import POLYNOMIAL, PREDICTOR
from firmware_py.inference.bundle_signature import SIGNATURE
from firmware_py.inference.estimator import LaggedEstimator
from firmware_py.inference.golden import GOLDEN, record_golden, write_golden
from firmware_py.inference.manifest import FILES, MANIFEST, Manifest, Quantity, write_manifest
from firmware_py.inference.predictor import OnnxPredictor
from firmware_py.signals import feature_names, tip_names, unit_of
from models.bundle.model_card import model_card
from models.plant.plant import Plant
from models.predictor.document import write_predictors
from models.predictor.guarded_tip import GuardedTip
from models.predictor.lagged import LAG_TICKS
from models.predictor.onnx_graphs import to_onnx
from models.predictor.polynomials import Array, GuardedPredictor, Polynomial
from models.predictor.training import TipTraining
from models.study.document import StudyDocument, write_study
from models.study.study import Study

BUNDLE_FILES: Final = (*sorted(FILES), SIGNATURE, MANIFEST)
"""Files that a bundle may have, in the order in which they are replaced."""

_KEYS: Final = frozenset({"training_data_sha256", "plant_sha256", "files"})
"""Keys that the manifest of a bundle has in every version, and no other manifest has."""


def check_bundle_directory(directory: Path) -> None:
    """Refuse a directory that is not empty and holds no bundle."""
    occupied = directory.exists() and (not directory.is_dir() or any(directory.iterdir()))
    if occupied and not _holds_bundle(directory):
        raise InputError(directory, "exists and is not a bundle", "choose another --out")


def _holds_bundle(directory: Path) -> bool:
    try:
        manifest = read_json(directory / MANIFEST, "train the bundle again")
    except InputError:
        return False
    return isinstance(manifest, dict) and manifest.keys() >= _KEYS


@contextlib.contextmanager
def replaced_bundle(directory: Path) -> Iterator[Path]:
    """Directory to write a bundle to; it replaces an old one if the body succeeds.

    If the body fails, nothing changes. Yields an empty directory on the same file system, which
    only this process uses.
    """
    check_bundle_directory(directory)
    directory = directory.resolve()
    directory.parent.mkdir(parents=True, exist_ok=True)
    place = directory if directory.exists() and not _is_beside(directory) else directory.parent
    with tempfile.TemporaryDirectory(
        prefix=f".{directory.name}.", dir=place, ignore_cleanup_errors=True
    ) as scratch:
        fresh = Path(scratch) / "bundle"  # only the scratch directory is closed to other users
        fresh.mkdir()
        yield fresh
        if directory.exists():
            _replace_files(fresh, directory)
        else:
            fresh.rename(directory)


def _is_beside(directory: Path) -> bool:
    """Whether files next to a directory can be moved into it, because it is not a mount."""
    parent = directory.parent
    return os.access(parent, os.W_OK) and parent.stat().st_dev == directory.stat().st_dev


def _replace_files(fresh: Path, directory: Path) -> None:
    """Replace the files of a bundle, and remove those that the new one lacks."""
    for name in BUNDLE_FILES:
        if (fresh / name).exists():
            (fresh / name).replace(directory / name)
        else:
            (directory / name).unlink(missing_ok=True)


GATE_POINTS: Final = 10_000
"""Points of the parity gate."""
GATE_M: Final = 1e-9
"""Largest difference at the parity gate: rounding of float64 gives up to 3e-14 m
(docs/sources.md, "ONNX")."""
GOLDEN_TICKS: Final = 256
"""Golden ticks after the rest rows: one cycle of the study's motion."""
LIBRARIES: Final = ("numpy", "scikit-learn", "skl2onnx", "onnx", "onnxruntime", "casadi")
"""Libraries whose versions the manifest records."""


class ParityError(DropstitchError):
    """The outputs of the graph differ from scikit-learn's; no bundle was written."""


def write_bundle(
    directory: Path, study: Study, plant: Plant, tip: TipTraining | None = None
) -> dict[str, float]:
    """Write the bundle of a study, complete or not at all.

    Its estimator is the lagged regressor, until `dropstitch fmu build --unit observer` adds the
    observer that the predictor was trained with. The same study gives the same bytes. The files of
    an old bundle in `directory` are replaced, others are kept; a directory of anything else is
    refused.

    `tip`: the robot's predictor. With it the study's polynomial is the fallback for a robot without
    the observer; otherwise the polynomial is the robot's predictor.

    Returns the largest differences at the parity gate: `tip_m`, `half_width_m`.
    """
    with replaced_bundle(directory) as fresh:
        return _fill(fresh, study, plant, tip)


def _fill(directory: Path, study: Study, plant: Plant, tip: TipTraining | None) -> dict[str, float]:
    document, dof = study.document, study.document.dof
    features = study.training.features("observer")
    manifest = _manifest(study, plant)
    predictor_path, lagged_path = directory / PREDICTOR, directory / "lagged.onnx"
    polynomial_path = directory / (POLYNOMIAL if tip else PREDICTOR)
    facts = _facts(manifest) | {"degree": manifest.degree}
    onnx.save(to_onnx(study.predictor, features.shape[1], metadata=facts), polynomial_path)
    parity = check_parity(polynomial_path, study.predictor, features, dof)
    if tip:
        manifest = _with_tip(manifest, tip)
        facts = _facts(manifest) | {"predictor": manifest.predictor}
        onnx.save(to_onnx(tip.predictor, len(tip.rows.names), metadata=facts), predictor_path)
        parity = check_parity(predictor_path, tip.predictor, tip.rows.inputs, dof)
        write_predictors(directory / "predictors.json", tip.document)
    lag_facts = {"lag_ticks": list(LAG_TICKS), "period_s": manifest.period_s, "dof": dof}
    lagged = to_onnx(study.lagged.graph(), study.lagged.inputs, "lagged", lag_facts)
    onnx.save(lagged, lagged_path)

    plant.for_robot().write(directory / "plant.json")
    write_study(directory / "study.json", document)
    heaviest = max(study.training.trials, key=lambda t: t.meta.payload_kg)
    ticks = slice(0, heaviest.meta.rest_samples + GOLDEN_TICKS)
    golden = record_golden(
        LaggedEstimator(lagged_path, LAG_TICKS, dof),
        OnnxPredictor(polynomial_path, dof),
        heaviest.angle_rad[ticks],
        heaviest.current_a[ticks],
        heaviest.step_s,
    )
    write_golden(directory / GOLDEN, golden)
    (directory / "MODEL_CARD.md").write_text(
        model_card(manifest, document, tip.document if tip else None),
        encoding="utf-8",
        newline="\n",
    )
    write_manifest(directory, manifest)
    return parity


def _facts(manifest: Manifest) -> dict[str, Any]:
    """Facts that a graph stores about itself."""
    return {
        "features": _described(manifest.features),
        "outputs": _described(manifest.outputs),
        "in_range": "1 where the prediction may be trusted, else 0 (also where an input is NaN)",
        "half_width_m": "half width of the 95 % prediction interval, world x, y, z, in m",
        "dof": manifest.dof,
        "period_s": manifest.period_s,
        "training_data_sha256": manifest.training_data_sha256,
    }


def _with_tip(manifest: Manifest, tip: TipTraining) -> Manifest:
    """Manifest of a bundle whose predictor was chosen among candidates."""
    chosen = tip.document.candidates[tip.document.chosen]
    metrics = {"predictor_left_out_mean_euclidean_distance_m": chosen.nested.mean_m}
    for name, parts in chosen.tests.items():
        metrics[f"predictor_{name}_mean_euclidean_distance_m"] = parts["all"].mean_m
        metrics[f"predictor_{name}_interval_coverage"] = parts["all"].coverage
        metrics[f"predictor_{name}_interval_coverage_least_axis"] = parts["all"].coverage_least
    return msgspec.structs.replace(
        manifest,
        features=_quantities(tip.rows.names, tip.predictor.lower, tip.predictor.upper),
        metrics=manifest.metrics | metrics,
        predictor=tip.document.chosen,
    )


def check_parity(
    path: Path, predictor: GuardedPredictor | GuardedTip, features: Array, dof: int
) -> dict[str, float]:
    """Compare the graph with scikit-learn on 10,000 points of the training hull.

    A point of the hull is a random convex combination of n + 1 training rows, with n the number of
    features. Returns the largest absolute difference of `tip_m` and `half_width_m`, in m.

    Shapes: `features` (rows, n).
    """
    rng = np.random.default_rng(0)
    corners = rng.integers(len(features), size=(GATE_POINTS, features.shape[1] + 1))
    weights = rng.dirichlet(np.ones(corners.shape[1]), size=GATE_POINTS)
    points = np.einsum("kc,kcn->kn", weights, features[corners])
    graph = OnnxPredictor(path, dof)
    tip_m, half_width_m = np.empty((GATE_POINTS, 3)), np.empty((GATE_POINTS, 3))
    in_range = np.empty(GATE_POINTS, dtype=bool)
    for k, point in enumerate(points):
        measured, observed = point[: 2 * dof + 1], point[2 * dof + 1 :]
        age_s, signals = observed[:1].sum(), observed[1:]
        answer = graph.predict(measured[:dof], measured[dof:-1], measured[-1], signals, age_s)
        tip_m[k], half_width_m[k], in_range[k] = answer.tip_m, answer.half_width_m, answer.in_range
    worst = {
        "tip_m": float(np.abs(tip_m - predictor.predict(points)).max()),
        "half_width_m": float(np.abs(half_width_m - predictor.half_width(points)).max()),
    }
    if max(worst.values()) > GATE_M or not np.array_equal(in_range, predictor.in_range(points)):
        raise ParityError(
            f"the graph differs from scikit-learn by {worst['tip_m']:.1e} m (tip) and "
            f"{worst['half_width_m']:.1e} m (half width), more than {GATE_M:g} m: no bundle written"
        )
    return worst


def _manifest(study: Study, plant: Plant) -> Manifest:
    document, predictor = study.document, study.predictor
    names = feature_names(document.dof)
    tips_m = study.training.tip_m
    return Manifest(
        dof=document.dof,
        period_s=document.training.step_s,
        degree=document.chosen_degree,
        estimator="lagged",
        features=_quantities(names, predictor.lower, predictor.upper),
        outputs=_quantities(tip_names(), tips_m.min(axis=0), tips_m.max(axis=0)),
        lag_ticks=LAG_TICKS,
        training_data_sha256=document.training.sha256,
        plant_sha256=plant.for_robot().sha256(),
        libraries={name: importlib.metadata.version(name) for name in LIBRARIES},
        metrics=_metrics(document),
        coefficients=_coefficients(Polynomial.of(predictor.pipeline), names),
        servo_gains=plant.provenance.servo_gains[: document.dof],
        files={},
    )


def _quantities(names: tuple[str, ...], low: Array, high: Array) -> tuple[Quantity, ...]:
    return tuple(
        Quantity(name, unit_of(name) or "1", float(a), float(b))
        for name, a, b in zip(names, low, high, strict=True)
    )


def _described(quantities: tuple[Quantity, ...]) -> list[dict[str, str | float]]:
    return [
        {"name": q.name, "unit": q.unit, "minimum": q.minimum, "maximum": q.maximum}
        for q in quantities
    ]


def _metrics(document: StudyDocument) -> dict[str, float]:
    """Held-out figures of the deployed predictor, by test."""
    degree = str(document.chosen_degree)
    metrics = {}
    for name, table in document.mean_euclidean_distance_m.items():
        pooled = table["pooled"]
        deployed = document.deployed[name]
        metrics[f"{name}_mean_euclidean_distance_m"] = deployed.mean_euclidean_distance_m
        metrics[f"{name}_with_true_di_m"] = pooled["with_di"][degree]
        metrics[f"{name}_without_di_m"] = pooled["without_di"][degree]
        metrics[f"{name}_r2_di"] = document.estimators[name]["observer"].r2_di
        metrics[f"{name}_interval_coverage"] = deployed.interval_coverage_mean
    return metrics


def _coefficients(polynomial: Polynomial, names: tuple[str, ...]) -> dict[str, tuple[float, ...]]:
    """β of the paper's equations 2 and 3 in SI units, by monomial."""
    return {
        monomial(exponents, names): tuple(float(v) for v in beta)
        for exponents, beta in polynomial.in_si_units().items()
    }


def monomial(exponents: tuple[int, ...], names: tuple[str, ...]) -> str:
    """Monomial of features as text, like "1" or "angle_1_rad^2 di"."""
    factors = [
        name if power == 1 else f"{name}^{power}"
        for name, power in zip(names, exponents, strict=True)
        if power
    ]
    return " ".join(factors) or "1"
