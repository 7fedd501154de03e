"""Observer FMU of a bundle, with golden ticks that are computed independently of its binary."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import ClassVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from firmware_py.core.errors import InputError
from firmware_py.inference.compiled_observer import CompiledObserver
from firmware_py.inference.estimator import Estimate, ObserverEstimator
from firmware_py.inference.fmu_instance import FmuInstance
from firmware_py.inference.golden import (
    GOLDEN,
    Golden,
    read_golden,
    record_golden,
    verify,
    verify_equal,
    write_golden,
)
from firmware_py.inference.manifest import Manifest, read_bundle_files, write_manifest
from firmware_py.inference.predictor import OnnxPredictor, Predictor
from fmu.fmu_builder import build_fmu
from fmu.fmu_models import PLANT, PREDICTOR, read_parts
from fmu.packaging import HOST
from models.bundle.plant import compare_with_bundle
from models.plant.step_model import StepModel, names
from models.predictor.document import Latency, measure_latency, read_predictors, write_predictors

Array = NDArray[np.float64]
OBSERVER = "observer.fmu"


class ModelEstimator:
    """`DeformationEstimator` that runs the interpreted model, as reference for the compiled FMU."""

    waits_for_fresh: ClassVar[bool] = True

    def __init__(self, model: StepModel, wanted: Sequence[str]) -> None:
        self._model, self._parameters = model, model.parameter_values()
        outputs = names(model.outputs)
        for name in wanted:
            if name not in outputs:
                raise InputError(
                    f"plant of {model.name}", f"has no output {name}, which the predictor wants",
                    "train the bundle again with this plant",
                )  # fmt: skip
        self._rows = [outputs.index(name) for name in ("di", "payload_kg", *wanted)]
        self.reset()

    def reset(self) -> None:
        self._state: Array | None = None

    def update(self, angle_rad: Array, current_a: Array, step_s: float) -> Estimate:
        """Update the estimate with one sample; see `DeformationEstimator.update`.

        Shapes: `angle_rad`, `current_a` (dof,).
        """
        model, p = self._model, self._parameters
        u = np.zeros(len(model.inputs))  # an age, if any, stays zero
        u[: 2 * len(angle_rad)] = *angle_rad, *current_a
        before = np.asarray(model.initial(u, p)).ravel() if self._state is None else self._state
        self._state = model.advance(before, u, p, step_s)
        y = np.asarray(model.output(self._state, u, p)).ravel()
        di, payload_kg, *signals = y[self._rows]
        return Estimate(float(di), float(payload_kg), np.array(signals))


def add_observer(
    bundle: Path | str,
    *,
    plant: Path | str | None = None,
    platforms: Sequence[str] = (HOST,),
    report: Callable[[str], None] = lambda text: None,
) -> None:
    """Build the observer FMU into a bundle and make it the bundle's estimator.

    The golden ticks keep their motion. The interpreted model recomputes their expected outputs, so
    the replay on the robot tests the binary. The manifest is replaced last, atomically.

    Parameters
    ----------
    bundle : Path or str
        Directory of the bundle.
    plant : Path or str, optional
        Plant of the observer; by default the bundle's.
    platforms : sequence of str
        Platforms to compile for. They include this machine's, because the golden ticks run here.
    report : callable
        Called with a phrase when the next part of the work begins.

    Raises
    ------
    InputError
        If the bundle or the plant cannot be read, or they are of different links.

    Examples
    --------
    >>> import dropstitch, shutil
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as scratch:
    ...     bundle = shutil.copytree("docs/notebooks/bundle_1dof", f"{scratch}/bundle")
    ...     dropstitch.add_observer(bundle)
    ...     dropstitch.ModelBundle.load(bundle).manifest.estimator
    'observer'
    """
    bundle = Path(bundle)
    known = read_bundle_files(bundle)
    manifest = known.manifest
    parts = read_parts("observer", manifest.dof, bundle, Path(plant) if plant else None)
    if plant:
        compare_with_bundle(parts.required_plant(), plant, known, "this FMU")
    robot_plant = parts.required_plant().for_robot()
    if manifest.plant_sha256 != robot_plant.sha256():
        print(
            f"{bundle}: the predictor was trained with the observer of another plant; train it "
            "again with this plant for the best accuracy",
            file=sys.stderr,
        )
    predictor = OnnxPredictor(bundle / PREDICTOR, parts.dof)
    motion = read_golden(bundle / GOLDEN, parts.dof)
    report("composing the model")
    model = parts.model()
    report("computing the golden ticks")
    golden = record_golden(
        ModelEstimator(parts.plant_model(), predictor.wanted), predictor,
        motion.angle_rad, motion.current_a, motion.step_s,
    )  # fmt: skip
    scratch = build_fmu(
        model,
        bundle / f".{OBSERVER}",
        description=parts.description(),
        files=parts.resources(),
        platforms=platforms,
        derivatives=False,  # the robot needs none
        report=report,
    )
    runtimes = _verify(golden, scratch, predictor)
    scratch.replace(bundle / OBSERVER)
    write_golden(bundle / GOLDEN, golden)
    robot_plant.write(bundle / PLANT)
    _add_runtimes(bundle, manifest, runtimes)
    renewed = {
        "estimator": "observer", "plant_sha256": robot_plant.sha256(),
        "servo_gains": robot_plant.provenance.servo_gains[: parts.dof],
    }  # fmt: skip
    write_manifest(bundle, msgspec.structs.replace(manifest, **renewed))


def _verify(golden: Golden, path: Path, predictor: OnnxPredictor) -> dict[str, Latency]:
    """Verify each runtime of a new observer on the golden ticks; return their latencies."""
    dof = golden.angle_rad.shape[1]
    with FmuInstance(path) as fmu, FmuInstance(path) as other:
        estimator = ObserverEstimator(fmu, dof, predictor.wanted)
        compiled = CompiledObserver(other, dof)
        verify(golden, estimator, predictor, path)
        verify(golden, compiled, compiled, path)
        verify_equal(golden, (estimator, predictor), (compiled, compiled), path)
        return {
            "onnx": _latency(golden, estimator, predictor),
            "compiled": _latency(golden, compiled, compiled),
        }


def _latency(golden: Golden, estimator: ObserverEstimator, predictor: Predictor) -> Latency:
    """Latency of observer and predictor together, from the sample to the prediction interval."""
    angle_rad, current_a = golden.angle_rad[-1], golden.current_a[-1]

    def answer() -> None:
        estimate = estimator.update(angle_rad, current_a, golden.step_s)
        predictor.predict(angle_rad, current_a, estimate.di, estimate.signals)

    latency = measure_latency(answer)
    estimator.reset()
    return latency


def _add_runtimes(bundle: Path, manifest: Manifest, runtimes: dict[str, Latency]) -> None:
    """Add the latencies to the bundle's comparison of predictors and its model card, if any."""
    path = bundle / "predictors.json"
    if not path.is_file():
        return
    from models.bundle.model_card import write_model_card  # loads scikit-learn

    document = msgspec.structs.replace(read_predictors(path), runtimes=runtimes)
    write_predictors(path, document)
    write_model_card(bundle, manifest, document)
