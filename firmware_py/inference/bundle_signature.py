"""Signature of a bundle: Ed25519 over its manifest, which holds the hash of every other file.

A private key is a PEM file (`openssl genpkey -algorithm ed25519`) or one of OpenSSH (`ssh-keygen -t
ed25519`); a public key is written `ed25519:` and its 32 bytes in base64 (RFC 8032, RFC 4648).
"""

from __future__ import annotations

import base64
import binascii
from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar, Final

import msgspec

from firmware_py.documents import Document, check_version
from firmware_py.errors import InputError
from firmware_py.inference.file_content import FileContent, content_of

__all__ = ["BundleSignature", "TrustConfig", "check_signature", "key_bytes", "signed_message"]

SIGNATURE: Final = "manifest.sig"
_PREFIX: Final = "ed25519:"
_KEY_BYTES: Final = 32
_CONTEXT: Final = b"dropstitch bundle manifest 1\n"
"""Prefix of the signed message, so that no signature of other data is valid for a bundle."""
_SIGN: Final = "sign it with 'dropstitch sign'"


class TrustConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Table `[trust]` of `robot.toml`."""

    # Public keys of which one must have signed the bundle; empty accepts unsigned bundles
    keys: tuple[str, ...] = ()


class BundleSignature(Document, frozen=True, kw_only=True):
    """Contents of `manifest.sig`."""

    MADE_BY: ClassVar[str] = "dropstitch sign"

    key: str  # Public key: `ed25519:` and 32 bytes in base64
    signature: str  # Signature: 64 bytes in base64


def signed_message(manifest: FileContent) -> bytes:
    """Return the bytes that the signature of a bundle covers."""
    return _CONTEXT + manifest.data


def key_text(raw: bytes) -> str:
    """Return the text of a public key, as in robot.toml."""
    return _PREFIX + base64.b64encode(raw).decode()


def key_bytes(text: str, where: Path | str) -> bytes:
    """Return the 32 bytes of a public key."""
    raw = _decoded(text.removeprefix(_PREFIX))
    if not text.startswith(_PREFIX) or len(raw) != _KEY_BYTES:
        raise InputError(
            where, f"{text!r} is no public key",
            "give ed25519: and 44 characters, as 'dropstitch sign' prints them",
        )  # fmt: skip
    return raw


def _decoded(text: str) -> bytes:
    try:
        return base64.b64decode(text, validate=True)
    except (binascii.Error, ValueError):
        return b""


def check_signature(manifest: FileContent, path: Path, trusted: Sequence[str]) -> str:
    """Return the trusted key that has signed a manifest, or refuse the manifest."""
    try:
        from cryptography.exceptions import InvalidSignature
        from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
    except ImportError:
        raise InputError(
            "[trust] keys", "needs the package cryptography to check signatures",
            "pip install 'dropstitch[trust]'",
        ) from None  # fmt: skip
    if not path.exists():
        raise InputError(
            path.parent, "is not signed, and [trust] keys are given", f"{_SIGN} and one of them"
        )
    try:
        signature = msgspec.json.decode(content_of(path, _SIGN).data, type=BundleSignature)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise InputError(path, f"is no signature ({error})", f"{_SIGN} again") from None
    check_version(path, {"schema": signature.schema}, BundleSignature.VERSION, f"{_SIGN} again")
    if signature.key not in trusted:
        raise InputError(
            path, f"is by the key {signature.key[:80]!r}, which [trust] does not name",
            "add the key to [trust] keys if you trust its owner, who decides what runs here",
        )  # fmt: skip
    try:
        key = Ed25519PublicKey.from_public_bytes(key_bytes(signature.key, path))
        key.verify(_decoded(signature.signature), signed_message(manifest))
    except InvalidSignature:
        raise InputError(
            path, "does not fit manifest.json: the bundle was changed after it was signed",
            f"copy the bundle again, or {_SIGN} again",
        ) from None  # fmt: skip
    return signature.key
