"""Bundle: the directory with everything that the robot needs to predict.

::

    manifest.json     contents, units, ranges, hashes of every other file
    predictor.onnx    features -> tip_m, in_range, half_width_m; the robot's predictor
    polynomial.onnx   the same with the paper's polynomial, for a robot without the observer
    lagged.onnx       lagged regressor of DI (the fallback estimator)
    observer.fmu      plant observer of DI (added by `dropstitch fmu build --unit observer`)
    plant.json        the plant that the observer was built from
    predictors.json   tests of the predictor, and of the candidates it was compared with
    study.json        the paper's tables on these trials (`dropstitch train --study`)
    golden.npz        ticks that the robot replays before it moves
    MODEL_CARD.md     description of the models
    manifest.sig      signature of the manifest, if `dropstitch sign` was used

`models.bundle.files` and `fmu.fmu_builder` write it; the robot reads each file once and
refuses a mismatch. `observer.fmu` is a native library: **whoever makes a bundle decides what
runs on the robot PC**.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from numpy.typing import ArrayLike

from firmware_py.core.errors import InputError
from firmware_py.core.input_files import FileContent
from firmware_py.inference.batch_prediction import Predictions, predict_rows, predict_run
from firmware_py.inference.bundle_signature import BundleSignature
from firmware_py.inference.compiled_observer import CompiledObserver, Runtime
from firmware_py.inference.estimator import (
    DeformationEstimator,
    LaggedEstimator,
    ObserverEstimator,
    load_estimator,
)
from firmware_py.inference.fmu_instance import FmuInstance
from firmware_py.inference.golden import GOLDEN, Golden, read_golden, verify, verify_equal
from firmware_py.inference.manifest import (
    BundleFiles,
    Manifest,
    read_bundle_files,
)
from firmware_py.inference.predictor import InputRange, OnnxPredictor

PREDICTOR: Final = "predictor.onnx"
POLYNOMIAL: Final = "polynomial.onnx"
OBSERVER: Final = "observer.fmu"


def read_manifest(directory: Path | str) -> Manifest:
    """Read `manifest.json` and verify the hash of every file that it names."""
    return read_bundle_files(directory).manifest


def load_predictor(files: BundleFiles) -> OnnxPredictor:
    """Load the predictor whose inputs the bundle's estimator provides."""
    manifest = files.manifest
    predictor = OnnxPredictor(files.file(PREDICTOR), manifest.dof)
    if manifest.estimator == "observer" or not predictor.wanted:
        return predictor
    if POLYNOMIAL not in files.contents:
        raise InputError(
            files.directory / PREDICTOR,
            f"needs {predictor.wanted[0]} of an observer that is missing",
            "add it in a checkout ('dropstitch fmu build --unit observer'), copy the bundle again",
        )
    return OnnxPredictor(files.file(POLYNOMIAL), manifest.dof)


@dataclass(frozen=True, repr=False)
class ModelBundle:
    """Verified bundle, ready to predict; load one with `ModelBundle.load`.

    Attributes
    ----------
    directory : Path
        Directory of the bundle.
    manifest : Manifest
        Contents of `manifest.json`.
    estimator : DeformationEstimator
        Estimator that the manifest names, reset.
    predictor : OnnxPredictor or CompiledObserver
        Predictor from `predictor.onnx`; from `polynomial.onnx` if the estimator does not provide
        the inputs of the former. With the runtime "compiled", the estimator itself.
    manifest_sha256 : str
        Hash of the loaded `manifest.json`.
    signature : BundleSignature or None
        Signature by a trusted key; None if none was required.
    memoryless : FileContent or None
        Graph that predicts from angle, current and DI alone; None if the bundle has none.
    ranges : tuple of InputRange
        Ranges of the predictor's inputs, from its graph.
    plant : mapping of str to object
        Contents of `plant.json`; empty if the bundle has none.

    Examples
    --------
    >>> import dropstitch
    >>> bundle = dropstitch.ModelBundle.load("docs/notebooks/bundle_1dof")
    >>> bundle
    <ModelBundle docs/notebooks/bundle_1dof: 1 joint, every 17 ms, lagged estimator, onnx runtime>
    >>> bundle.predict_many([0.0, 0.1], [0.0, 0.2]).tip_m.shape
    (2, 3)
    """

    directory: Path
    manifest: Manifest
    estimator: DeformationEstimator
    predictor: OnnxPredictor | CompiledObserver
    manifest_sha256: str = ""
    signature: BundleSignature | None = None
    memoryless: FileContent | None = None
    ranges: tuple[InputRange, ...] = ()
    plant: Mapping[str, Any] = field(default_factory=dict)

    def __repr__(self) -> str:
        manifest = self.manifest
        return (
            f"<ModelBundle {self.directory}: {manifest.dof} joint{'s' * (manifest.dof > 1)}, "
            f"every {1e3 * manifest.period_s:g} ms, {manifest.estimator} estimator, "
            f"{self.runtime} runtime>"
        )

    @property
    def runtime(self) -> Runtime:
        """What evaluates the predictor: onnxruntime, or the observer's compiled library."""
        return "compiled" if isinstance(self.predictor, CompiledObserver) else "onnx"

    @property
    def signal_names(self) -> tuple[str, ...]:
        """Names of the estimator's further signals (`Estimate.signals`), in order."""
        predictor = self.predictor
        if isinstance(predictor, CompiledObserver):
            return predictor.signal_names
        return predictor.wanted

    def assume_payload(self, payload_kg: float | None) -> None:
        """Set the payload of an estimator that uses it; other estimators are not changed.

        Parameters
        ----------
        payload_kg : float or None
            Mass at the tip in kg; None estimates it.

        Raises
        ------
        InputError
            If the observer refuses the value.
        """
        if isinstance(self.estimator, ObserverEstimator):
            self.estimator.assume_payload(payload_kg)

    def predict_many(
        self,
        angle_rad: ArrayLike,
        current_a: ArrayLike,
        di: ArrayLike | None = None,
        *,
        step_s: float | None = None,
    ) -> Predictions:
        """Predict for arrays of measurements.

        Without `di` the rows are one run: the bundle's estimator tracks it from rest, as on the
        robot. With `di` every row is predicted independently, with the paper's polynomial.

        Parameters
        ----------
        angle_rad, current_a : array_like, shape (n, dof), or (n,) for one joint
            Measured angles in rad and currents in A; positive current accelerates its joint towards
            positive angles.
        di : array_like, shape (n,) or (), optional
            Deformation Index, dimensionless.
        step_s : float, optional
            Time between two rows of a run in s; by default the period of the bundle.

        Returns
        -------
        Predictions
            Arrays of n rows, which no later call overwrites.

        Raises
        ------
        InputError
            If an array has another shape, the estimator is not valid at this period, or the bundle
            has no predictor that needs only angle, current and `di`.
        """
        dof = self.manifest.dof
        if di is None:
            period_s = self.manifest.period_s
            step_s = period_s if step_s is None else step_s
            if isinstance(self.estimator, LaggedEstimator) and not math.isclose(step_s, period_s):
                raise InputError(
                    "step_s", f"is {step_s}, the lagged estimator was trained at {period_s}",
                    "resample, or use a bundle with the observer",
                )  # fmt: skip
            return predict_run(self.estimator, self.predictor, angle_rad, current_a, step_s, dof)
        if self.memoryless is None:
            raise InputError(
                self.directory, "has no predictor from angle, current and DI alone",
                "leave di out, or train the bundle again",
            )  # fmt: skip
        return predict_rows(OnnxPredictor(self.memoryless, dof), angle_rad, current_a, di, dof)

    @classmethod
    def load(
        cls, directory: Path | str, trusted: Sequence[str] = (), runtime: Runtime | None = None
    ) -> ModelBundle:
        """Read every file once, verify signature and hashes, load, and replay the golden ticks.

        Parameters
        ----------
        directory : Path or str
            Directory of the bundle.
        trusted : sequence of str, optional
            Public keys of which one must have signed the bundle; empty skips this check.
        runtime : {"onnx", "compiled"}, optional
            What evaluates the predictor. The default is the compiled one if the observer has it,
            which is faster, warm and cold (docs/predictor/choice.md); its results for the golden
            ticks are first compared with those of onnxruntime.

        Returns
        -------
        ModelBundle
            The bundle, with its estimator reset.

        Raises
        ------
        InputError
            If a file is missing or damaged, no trusted key has signed the bundle, the results on
            this machine differ from those on the machine that made it, or the bundle has no such
            runtime.
        """
        files = read_bundle_files(directory, trusted)
        manifest = files.manifest
        golden = read_golden(files.file(GOLDEN), manifest.dof)
        predictor = load_predictor(files)
        estimator = load_estimator(
            manifest.estimator, files.file, manifest.dof, manifest.lag_ticks, predictor.wanted
        )
        verify(golden, estimator, predictor, files.directory / GOLDEN)
        compiled = None
        if runtime != "onnx":
            compiled = _compiled(files, golden, (estimator, predictor), required=bool(runtime))
        return cls(
            files.directory, manifest, compiled or estimator, compiled or predictor,
            files.manifest_sha256, files.signature,
            files.contents.get(POLYNOMIAL) or (None if predictor.wanted else files.file(PREDICTOR)),
            predictor.ranges, files.plant(),
        )  # fmt: skip


def _compiled(
    files: BundleFiles,
    golden: Golden,
    reference: tuple[DeformationEstimator, OnnxPredictor],
    required: bool,
) -> CompiledObserver | None:
    """Load the observer's compiled predictor and verify it; None if there is none."""
    dof, where = files.manifest.dof, files.directory / OBSERVER
    if files.manifest.estimator != "observer":
        if required:
            raise InputError(
                files.directory, "has no observer, so it has no compiled predictor",
                "add it in a checkout ('dropstitch fmu build --unit observer'), copy it again",
            )  # fmt: skip
        return None
    fmu = FmuInstance(files.file(OBSERVER))
    if not required and not CompiledObserver.offered_by(fmu):
        fmu.close()
        return None
    compiled = CompiledObserver(fmu, dof)
    verify(golden, compiled, compiled, where)
    verify_equal(golden, reference, (compiled, compiled), where)
    return compiled
