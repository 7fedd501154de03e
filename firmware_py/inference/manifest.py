"""Manifest of a bundle: contents with units and ranges, its own hash and that of every file."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import msgspec

from firmware_py.bus.servo_models import ServoGains
from firmware_py.core.documents import check_version
from firmware_py.core.errors import InputError
from firmware_py.core.input_files import FileContent, content_of, decode_json
from firmware_py.core.output_files import replacing
from firmware_py.inference.bundle_signature import SIGNATURE, BundleSignature, check_signature

SCHEMA: Final = 1
MANIFEST: Final = "manifest.json"
PLANT: Final = "plant.json"
FILES: Final = frozenset(
    {
        "predictor.onnx", "polynomial.onnx", "lagged.onnx", "observer.fmu", PLANT,
        "study.json", "predictors.json", "golden.npz", "MODEL_CARD.md",
    }
)  # fmt: skip
"""Files that a manifest may name; no other file of the directory is read."""
_OWN_HASH: Final = "content_sha256"
_MAKE: Final = "make the bundle anew with 'dropstitch train'"
_MOST_DOF: Final = 2
_PERIOD_S: Final = (1e-3, 1.0)
"""Range of the period, as in robot.toml."""
_MOST_LAG_TICKS: Final = 1000
_MOST_LAGS: Final = 100
_MOST_DEGREE: Final = 20
_LARGEST_GAIN: Final = 0xFFFF
"""Largest value of a register of two bytes."""
_LARGEST: Final = 1e6
"""Largest magnitude of a range or a metric, in SI units. [assumed]"""


class Quantity(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    name: str
    unit: str  # SI unit; "1" for none
    minimum: float  # Range in the training data
    maximum: float


class Manifest(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    schema: int = SCHEMA
    dof: int
    period_s: float  # Control period of the training data
    # Degree of the paper's polynomial, chosen by cross-validation on the training trials
    degree: int
    estimator: str  # Source of the DI on the robot: "observer", "lagged" or "none"
    features: tuple[Quantity, ...]  # In the order of the graph's input columns and output rows
    outputs: tuple[Quantity, ...]
    lag_ticks: tuple[int, ...]  # Ages of the samples that the lagged estimator uses
    training_data_sha256: str  # Hash of the training trials
    plant_sha256: str  # Hash of the plant
    libraries: dict[str, str]  # Versions of the libraries by name
    metrics: dict[str, float]  # Errors on held-out trials by name, which ends in the SI unit
    files: dict[str, str]  # SHA-256 by file name
    # Candidate in `predictor.onnx`; empty if the bundle has the paper's polynomial alone
    predictor: str = ""
    # Gains of the servos with which the plant was identified, by joint; empty if unknown. A robot
    # whose servos have other gains is refused.
    servo_gains: tuple[ServoGains, ...] = ()
    content_sha256: str = ""  # Hash of all other fields; empty until the manifest is written


@dataclass(frozen=True)
class BundleFiles:
    """Files of a bundle in memory, whose hashes agree with the manifest."""

    directory: Path  # Origin
    manifest: Manifest
    manifest_sha256: str  # Hash of `manifest.json`
    signature: BundleSignature | None  # By a trusted key; None if no signature was required
    contents: Mapping[str, FileContent]  # Every file that the manifest names

    def file(self, name: str) -> FileContent:
        if name not in self.contents:
            raise InputError(
                self.directory / MANIFEST, f"names no {name}", "copy or train the bundle again"
            )
        return self.contents[name]

    def plant(self) -> dict[str, Any]:
        """Decode `plant.json`; empty if the bundle has none, or if it is no JSON object."""
        if PLANT not in self.contents:
            return {}
        path, data = self.contents[PLANT]
        plant = decode_json(path, data, "copy or train the bundle again")
        return plant if isinstance(plant, dict) else {}


def read_bundle_files(directory: Path | str, trusted: Sequence[str] = ()) -> BundleFiles:
    """Read every file of a bundle once and compare it with the manifest.

    `trusted`: public keys of which one must have signed the manifest; empty skips this check.
    """
    directory = Path(directory)
    path = directory / MANIFEST
    raw = content_of(
        path, "copy the whole bundle here; 'dropstitch train' makes one, in a checkout"
    )
    signature = check_signature(raw, directory / SIGNATURE, trusted) if trusted else None
    manifest = _decoded(raw.data, path)
    for wrong in _out_of_bounds(manifest):
        raise InputError(path, wrong, "copy or train the bundle again")
    contents = {}
    for name, expected in manifest.files.items():
        contents[name] = content = content_of(directory / name)
        if content.sha256 != expected:
            raise InputError(
                content.path, "does not match the hash in manifest.json",
                "copy or train the bundle again",
            )  # fmt: skip
    return BundleFiles(directory, manifest, raw.sha256, signature, contents)


def _decoded(data: bytes, path: Path) -> Manifest:
    """Decode a manifest; refuse a damaged one and one of another version."""
    try:
        document = msgspec.json.decode(data)
        actual = content_sha256(document) if isinstance(document, dict) else ""
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError, ValueError) as error:
        raise InputError(path, f"is damaged ({error})", "copy the bundle again") from None
    if isinstance(document, dict):
        check_version(path, document, SCHEMA, _MAKE)
        if _OWN_HASH not in document:
            raise InputError(path, f"has no {_OWN_HASH}, as every bundle of this release", _MAKE)
        if document[_OWN_HASH] != actual:
            raise InputError(
                path, f"does not match the hash of its own content ({_OWN_HASH})",
                "copy the bundle again",
            )  # fmt: skip
        document.pop("coefficients", None)  # bundles of 0.3.0 list those of the polynomial
    try:
        return msgspec.convert(document, Manifest)
    except (msgspec.ValidationError, RecursionError) as error:
        raise InputError(path, str(error), "copy the bundle again, or " + _MAKE) from None


def content_sha256(document: dict[str, Any]) -> str:
    """Return the hash of a manifest's fields, independent of their order and layout."""
    content = {name: value for name, value in document.items() if name != _OWN_HASH}
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def _out_of_bounds(manifest: Manifest) -> Iterator[str]:
    """Yield a description of each value that no manifest of this project has."""
    low_s, high_s = _PERIOD_S
    if unknown := sorted(set(manifest.files) - FILES):
        yield f"names {unknown[0]!r}, which is no file of a bundle"
    if not 1 <= manifest.dof <= _MOST_DOF:
        yield f"dof is {manifest.dof}, outside 1 to {_MOST_DOF}"
    if not low_s <= manifest.period_s <= high_s:
        yield f"period_s is {manifest.period_s}, outside {low_s:g} to {high_s:g}"
    if not 0 <= manifest.degree <= _MOST_DEGREE:
        yield f"degree is {manifest.degree}, outside 0 to {_MOST_DEGREE}"
    lags = manifest.lag_ticks
    if len(lags) > _MOST_LAGS or not all(0 <= lag <= _MOST_LAG_TICKS for lag in lags):
        yield f"lag_ticks are not up to {_MOST_LAGS} ages of 0 to {_MOST_LAG_TICKS} ticks"
    if manifest.estimator == "lagged" and not lags:
        yield "lag_ticks is empty, which the lagged estimator needs"
    if len(manifest.servo_gains) not in (0, manifest.dof):
        yield f"servo_gains are of {len(manifest.servo_gains)} joints, dof is {manifest.dof}"
    for gains in manifest.servo_gains:
        if not all(0 <= raw <= _LARGEST_GAIN for raw in gains.registers().values()):
            yield f"a gain of servo_gains is outside 0 to {_LARGEST_GAIN}"
    for quantity in (*manifest.features, *manifest.outputs):
        if not -_LARGEST <= quantity.minimum <= quantity.maximum <= _LARGEST:
            low, high = quantity.minimum, quantity.maximum
            yield f"the range of {quantity.name!r} is {low:g} to {high:g}"
    for name, value in manifest.metrics.items():
        if not abs(value) <= _LARGEST:
            yield f"the metric {name!r} is {value:g}"


def write_manifest(directory: Path, manifest: Manifest) -> None:
    """Replace `manifest.json` atomically, with the hashes of its content and of the other files.

    A signature of the old manifest is removed.
    """
    files = {
        name: content_of(directory / name).sha256
        for name in sorted(FILES)
        if (directory / name).is_file()
    }
    with replacing(directory / MANIFEST) as scratch:
        scratch.write_bytes(manifest_bytes(msgspec.structs.replace(manifest, files=files)))
        (directory / SIGNATURE).unlink(missing_ok=True)


def manifest_bytes(manifest: Manifest) -> bytes:
    """Return the content of `manifest.json`, with the hash of its other fields."""
    digest = content_sha256(msgspec.json.decode(msgspec.json.encode(manifest)))
    manifest = msgspec.structs.replace(manifest, content_sha256=digest)
    return msgspec.json.format(msgspec.json.encode(manifest), indent=1)
