"""Observer FMU of a bundle, with golden ticks computed independently of its binary."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from firmware_py.errors import InputError
from firmware_py.inference.bundle import Manifest, write_manifest
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
from firmware_py.inference.predictor import OnnxPredictor
from fmu.fmu_builder import build_fmu
from fmu.fmu_models import PLANT, PREDICTOR, FmuParts
from models.plant.step_model import StepModel, names

Array = NDArray[np.float64]
OBSERVER = "observer.fmu"


class ModelEstimator:
    """`DeformationEstimator` on the interpreted model: the reference for the compiled FMU.

    Parameters
    ----------
    model : StepModel
        Observer.
    wanted : sequence of str
        Its outputs that the predictor takes.

    Raises
    ------
    InputError
        If the model lacks one.
    """

    waits_for_fresh: ClassVar[bool] = True

    def __init__(self, model: StepModel, wanted: Sequence[str] = ()) -> None:
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
        """Return to the state before the first sample."""
        self._state: Array | None = None

    def update(self, angle_rad: Array, current_a: Array, step_s: float) -> Estimate:
        """Take one sample; see `DeformationEstimator.update`.

        Parameters
        ----------
        angle_rad, current_a : ndarray, shape (dof,)
            Measured sample.
        step_s : float
            Time since the last sample.
        """
        model, p = self._model, self._parameters
        u = np.concatenate([angle_rad, current_a])
        before = np.asarray(model.initial(u, p)).ravel() if self._state is None else self._state
        self._state = model.advance(before, u, p, step_s)
        y = np.asarray(model.output(self._state, u, p)).ravel()
        di, payload_kg, *signals = y[self._rows]
        return Estimate(float(di), float(payload_kg), np.array(signals))


def add_observer(bundle: Path, manifest: Manifest, parts: FmuParts) -> Path:
    """Build the observer FMU into a bundle and make it the bundle's estimator.

    The golden ticks keep their motion. Their expected outputs are recomputed by the interpreted
    model, so the replay on the robot tests the binary. The manifest is replaced last, atomically.

    Parameters
    ----------
    bundle : Path
        Directory of the bundle.
    manifest : Manifest
        Manifest of that bundle.
    parts : FmuParts
        Parts of an observer FMU.

    Returns
    -------
    Path
        The FMU.

    Raises
    ------
    InputError
        If the bundle holds no golden ticks, or the FMU does not reproduce them; if
        `parts` has no plant, or one whose observer lacks what the predictor wants.
    """
    plant = parts.required_plant()
    if plant.sha256() != manifest.plant_sha256:
        print(
            f"{bundle}: the predictor was trained with the observer of another plant; train it "
            "again with this plant for the best accuracy",
            file=sys.stderr,
        )
    reference = parts._replace(predictor=None).model()
    motion = read_golden(bundle / GOLDEN, parts.dof)
    predictor = OnnxPredictor(bundle / PREDICTOR, parts.dof)
    golden = record_golden(
        ModelEstimator(reference, predictor.wanted), predictor,
        motion.angle_rad, motion.current_a, motion.step_s,
    )  # fmt: skip
    scratch = build_fmu(
        parts.model(),
        bundle / f".{OBSERVER}",
        description=parts.description(),
        resources=parts.resources(),
        derivatives=False,  # the robot needs none
    )
    with FmuInstance(scratch) as fmu:
        estimator = ObserverEstimator(fmu, parts.dof, predictor.wanted)
        verify(golden, estimator, predictor, bundle / OBSERVER)
        if parts.predictor:
            _verify_compiled(golden, scratch, (estimator, predictor))
    scratch.replace(bundle / OBSERVER)
    write_golden(bundle / GOLDEN, golden)
    plant.write(bundle / PLANT)
    renewed = {
        "estimator": "observer", "plant_sha256": plant.sha256(),
        "servo_gains": plant.provenance.servo_gains[: parts.dof],
    }  # fmt: skip
    write_manifest(bundle, msgspec.structs.replace(manifest, **renewed))
    return bundle / OBSERVER


def _verify_compiled(
    golden: Golden, path: Path, reference: tuple[ObserverEstimator, OnnxPredictor]
) -> None:
    """Compare the predictor in an observer's library with onnxruntime on the golden ticks."""
    dof = golden.angle_rad.shape[1]
    with FmuInstance(path) as fmu:
        compiled = CompiledObserver(fmu, dof)
        verify(golden, compiled, compiled, path)
        verify_equal(golden, reference, (compiled, compiled), path)
