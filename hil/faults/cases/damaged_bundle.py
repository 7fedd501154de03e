"""Damages of a bundle that a robot must refuse before it switches the torque on."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Final

import msgspec
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from firmware_py.inference.bundle import PREDICTOR, read_manifest
from firmware_py.inference.bundle_signature import key_text
from firmware_py.inference.golden import GOLDEN, Golden, read_golden, write_golden
from firmware_py.inference.manifest import MANIFEST, manifest_bytes, write_manifest
from models.commands.sign import sign_bundle

_OFF: Final = 1e-6
"""Error of the golden tip, in m. Another processor or library explains only 1e-9."""


def _change_a_byte(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)


def _changed_file(bundle: Path) -> tuple[str, ...]:
    _change_a_byte(bundle / PREDICTOR)
    return ()


def _unnamed_file(bundle: Path) -> tuple[str, ...]:
    """Remove the predictor from the manifest, then change it: no hash reveals the change."""
    manifest = read_manifest(bundle)
    files = {name: sha256 for name, sha256 in manifest.files.items() if name != PREDICTOR}
    manifest = msgspec.structs.replace(manifest, files=files)
    (bundle / MANIFEST).write_bytes(manifest_bytes(manifest))
    _change_a_byte(bundle / PREDICTOR)
    return ()


def _file_outside(bundle: Path) -> tuple[str, ...]:
    manifest = read_manifest(bundle)
    files = manifest.files | {"../ticks.mcap": "0" * 64}
    manifest = msgspec.structs.replace(manifest, files=files)
    (bundle / MANIFEST).write_bytes(manifest_bytes(manifest))
    return ()


def _replace_golden(bundle: Path, change: Callable[[Golden], Golden]) -> tuple[str, ...]:
    """Replace the golden ticks, with a manifest whose hashes match."""
    manifest = read_manifest(bundle)
    write_golden(bundle / GOLDEN, change(read_golden(bundle / GOLDEN, manifest.dof)))
    write_manifest(bundle, manifest)
    return ()


def _other_golden(bundle: Path) -> tuple[str, ...]:
    return _replace_golden(bundle, lambda golden: golden._replace(tip_m=golden.tip_m + _OFF))


def _idle_golden(bundle: Path) -> tuple[str, ...]:
    return _replace_golden(bundle, lambda golden: golden._replace(angle_rad=0.0 * golden.angle_rad))


def _unsigned(bundle: Path) -> tuple[str, ...]:
    return (_public(Ed25519PrivateKey.generate()),)


def _foreign_signature(bundle: Path) -> tuple[str, ...]:
    sign_bundle(bundle, Ed25519PrivateKey.generate())
    return (_public(Ed25519PrivateKey.generate()),)


def _changed_after_signature(bundle: Path) -> tuple[str, ...]:
    trusted = sign_bundle(bundle, Ed25519PrivateKey.generate())
    manifest = msgspec.structs.replace(read_manifest(bundle), training_data_sha256="0" * 64)
    (bundle / MANIFEST).write_bytes(msgspec.json.encode(manifest))
    return (trusted,)


def _public(key: Ed25519PrivateKey) -> str:
    return key_text(key.public_key().public_bytes_raw())


BUNDLE_DAMAGES: Final[dict[str, Callable[[Path], tuple[str, ...]]]] = {
    "changed file": _changed_file,
    "unnamed file": _unnamed_file,
    "file outside": _file_outside,
    "other golden ticks": _other_golden,
    "golden ticks at rest": _idle_golden,
    "unsigned": _unsigned,
    "foreign signature": _foreign_signature,
    "changed after the signature": _changed_after_signature,
}
"""Functions that damage a bundle and return the public keys for `[trust]` in the configuration."""
