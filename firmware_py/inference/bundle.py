"""Bundle: the directory with everything that the robot needs to predict.

::

    manifest.json     contents, units, ranges, hashes of every other file
    predictor.onnx    features -> tip_m, in_range, half_width_m; the best of the candidates
    polynomial.onnx   the same by the paper's polynomial, for a robot without the observer
    lagged.onnx       lagged regressor of DI (the fallback estimator)
    observer.fmu      plant observer of DI (added by `python -m fmu build --unit observer`)
    plant.json        the plant that the observer was built from
    study.json        the paper's tables on these trials
    predictors.json   the candidates compared, and why this one was chosen
    golden.npz        ticks that the robot replays before it moves
    MODEL_CARD.md     description for people

`models.study.bundle_export` and `fmu.fmu_builder` write it; the robot reads it and refuses
files that do not match.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import msgspec

from firmware_py.errors import InputError
from firmware_py.inference.estimator import DeformationEstimator, ObserverEstimator, load_estimator
from firmware_py.inference.golden import GOLDEN, read_golden, verify
from firmware_py.inference.predictor import OnnxPredictor

__all__ = ["Manifest", "ModelBundle", "Quantity", "read_manifest", "write_manifest"]

SCHEMA: Final = 1
MANIFEST: Final = "manifest.json"
PREDICTOR: Final = "predictor.onnx"
POLYNOMIAL: Final = "polynomial.onnx"


class Quantity(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Feature or output of the predictor.

    Attributes
    ----------
    name : str
        Name of the signal.
    unit : str
        SI unit; "1" for none.
    minimum, maximum : float
        Range in the training data.
    """

    name: str
    unit: str
    minimum: float
    maximum: float


class Manifest(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Contents of `manifest.json`.

    Attributes
    ----------
    dof : int
        Number of joints.
    period_s : float
        Control period of the training data.
    features, outputs : tuple of Quantity
        In the order of the graph's input columns and output rows.
    estimator : str
        Source of the DI on the robot: "observer", "lagged" or "none".
    degree : int
        Degree of the paper's polynomial, chosen by cross-validation on the training trials.
    predictor : str
        Candidate that `predictor.onnx` holds; empty for the paper's polynomial alone.
    lag_ticks : tuple of int
        Ages of the samples that the lagged estimator uses.
    training_data_sha256, plant_sha256 : str
        Hashes of the training trials and of the plant.
    libraries : dict
        Versions of the libraries, by name.
    metrics : dict
        Errors on held-out trials by name, SI units in the names.
    coefficients : dict
        Coefficients per output by monomial (like "angle_1_rad^2 di"); for people only.
    files : dict
        SHA-256 by file name.
    """

    schema: int = SCHEMA
    dof: int
    period_s: float
    degree: int
    estimator: str
    features: tuple[Quantity, ...]
    outputs: tuple[Quantity, ...]
    lag_ticks: tuple[int, ...]
    training_data_sha256: str
    plant_sha256: str
    libraries: dict[str, str]
    metrics: dict[str, float]
    coefficients: dict[str, tuple[float, ...]]
    files: dict[str, str]
    predictor: str = ""


def sha256_of(path: Path) -> str:
    """Return the SHA-256 of a file, in hexadecimal."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def read_manifest(directory: Path | str) -> Manifest:
    """Read `manifest.json` and verify the hash of every file that it names.

    Parameters
    ----------
    directory : Path or str
        The bundle.

    Raises
    ------
    InputError
        If the directory or a file is missing, damaged, of another schema or does not match.
    """
    directory = Path(directory)
    path = directory / MANIFEST
    try:
        manifest = msgspec.json.decode(path.read_bytes(), type=Manifest)
    except FileNotFoundError:
        raise InputError(
            path, "is missing", "make a bundle with 'python -m models train'"
        ) from None
    except msgspec.DecodeError as error:  # also what is valid JSON of another form
        raise InputError(path, str(error), "train the bundle again with this version") from None
    if manifest.schema != SCHEMA:
        raise InputError(
            path, f"schema is {manifest.schema}", f"this version reads schema {SCHEMA}"
        )
    for name, expected in manifest.files.items():
        file = directory / name
        if not file.is_file():
            raise InputError(file, "is missing", "copy the whole bundle directory")
        if sha256_of(file) != expected:
            raise InputError(
                file, "does not match the hash in manifest.json", "copy or train the bundle again"
            )
    return manifest


def write_manifest(directory: Path, manifest: Manifest) -> None:
    """Replace `manifest.json` atomically, with the hashes of every other file of the directory.

    Parameters
    ----------
    directory : Path
        The bundle.
    manifest : Manifest
        Manifest to write; its `files` are replaced.
    """
    files = {
        p.name: sha256_of(p)
        for p in sorted(directory.iterdir())
        if p.is_file() and p.name != MANIFEST and not p.name.startswith(".")
    }
    manifest = msgspec.structs.replace(manifest, files=files)
    scratch = directory / f".{MANIFEST}"
    scratch.write_bytes(msgspec.json.format(msgspec.json.encode(manifest), indent=1))
    scratch.replace(directory / MANIFEST)


def load_predictor(directory: Path, manifest: Manifest) -> OnnxPredictor:
    """Load the predictor that the estimator of a bundle can serve.

    Parameters
    ----------
    directory : Path
        The bundle.
    manifest : Manifest
        Its manifest.

    Raises
    ------
    InputError
        If a file cannot be used, or the predictor needs the observer and the bundle has neither
        that nor a polynomial.
    """
    predictor = OnnxPredictor(directory / PREDICTOR, manifest.dof)
    if manifest.estimator == "observer" or not predictor.wanted:
        return predictor
    if POLYNOMIAL not in manifest.files:
        raise InputError(
            directory / PREDICTOR, f"needs {predictor.wanted[0]} of an observer that is missing",
            "add it with 'python -m fmu build --unit observer'",
        )  # fmt: skip
    return OnnxPredictor(directory / POLYNOMIAL, manifest.dof)


@dataclass(frozen=True)
class ModelBundle:
    """Bundle that was verified and is ready to predict.

    Attributes
    ----------
    directory : Path
        Directory that it was loaded from.
    manifest : Manifest
        Contents of `manifest.json`.
    estimator : DeformationEstimator
        Estimator that the manifest names, reset.
    predictor : OnnxPredictor
        Predictor from `predictor.onnx`; from `polynomial.onnx` where the estimator does not know
        what that one wants.
    """

    directory: Path
    manifest: Manifest
    estimator: DeformationEstimator
    predictor: OnnxPredictor

    def assume_payload(self, payload_kg: float | None) -> None:
        """Give the payload to an estimator that uses it; others are not changed.

        Parameters
        ----------
        payload_kg : float or None
            Mass at the tip; None has it estimated.

        Raises
        ------
        InputError
            If the observer refuses the value.
        """
        if isinstance(self.estimator, ObserverEstimator):
            self.estimator.assume_payload(payload_kg)

    @classmethod
    def load(cls, directory: Path | str) -> ModelBundle:
        """Verify every hash, load, and replay the golden ticks.

        Parameters
        ----------
        directory : Path or str
            The bundle.

        Raises
        ------
        InputError
            If a file is missing or damaged, or the results on this machine differ from those on the
            machine that made the bundle.
        """
        directory = Path(directory)
        manifest = read_manifest(directory)
        for name in (PREDICTOR, GOLDEN):
            if name not in manifest.files:
                raise InputError(directory / MANIFEST, f"names no {name}", "train the bundle again")
        predictor = load_predictor(directory, manifest)
        estimator = load_estimator(
            manifest.estimator, directory, manifest.dof, manifest.lag_ticks, predictor.wanted
        )
        golden = read_golden(directory / GOLDEN, manifest.dof)
        verify(golden, estimator, predictor, directory / GOLDEN)
        return cls(directory, manifest, estimator, predictor)
