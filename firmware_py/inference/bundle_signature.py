"""Signature of a bundle: Ed25519 over its manifest, which holds the hash of every other file.

It covers the time of signing, too. The robot remembers the latest time of each key that ran on it,
so that nobody can put an older bundle of the same key in the place of a newer one.

A private key is a PEM file (`openssl genpkey -algorithm ed25519`) or one of OpenSSH (`ssh-keygen -t
ed25519`); a public key is written `ed25519:` and its 32 bytes in base64 (RFC 8032, RFC 4648).
"""

from __future__ import annotations

import base64
import binascii
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import Annotated, ClassVar, Final

import msgspec

from firmware_py.core.documents import Document, check_version, read_document, write_document
from firmware_py.core.errors import InputError
from firmware_py.core.input_files import FileContent, content_of, convert

SIGNATURE: Final = "manifest.sig"
_PREFIX: Final = "ed25519:"
_KEY_BYTES: Final = 32
_CONTEXT: Final = "dropstitch bundle manifest 2\n"
"""Prefix of the signed message, so that no signature of other data is valid for a bundle."""
_SIGN: Final = "sign it with 'dropstitch sign'"


ZonedTime = Annotated[datetime, msgspec.Meta(tz=True)]


class TrustConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Table `[trust]` of `robot.toml`."""

    # Public keys of which one must have signed the bundle; empty accepts unsigned bundles
    keys: tuple[str, ...] = ()
    # File in which `dropstitch run` remembers the newest signed bundle, relative to robot.toml
    memory: str = "newest-bundle.json"


class BundleSignature(Document, frozen=True, kw_only=True):
    """Contents of `manifest.sig`."""

    VERSION: ClassVar[int] = 2
    MADE_BY: ClassVar[str] = "dropstitch sign"

    signed_utc: ZonedTime  # Time of signing
    key: str  # Public key: `ed25519:` and 32 bytes in base64
    signature: str  # Signature: 64 bytes in base64


class NewestBundle(Document, frozen=True, kw_only=True):
    """Times of the newest signed bundles that ran on a robot."""

    MADE_BY: ClassVar[str] = "dropstitch run"

    signed_utc: dict[str, ZonedTime]  # By public key


def signed_message(manifest: FileContent, signed_utc: datetime) -> bytes:
    return f"{_CONTEXT}{signed_utc.isoformat()}\n".encode() + manifest.data


def refuse_older(signature: BundleSignature, bundle: Path, memory: Path) -> None:
    """Refuse a bundle that is older than the newest of its key; remember a newer one.

    `memory`: file that holds the newest of each key.
    """
    known = {}
    if memory.exists():
        known = read_document(memory, NewestBundle).signed_utc
    newest = known.get(signature.key)
    if newest is not None and signature.signed_utc < newest:
        raise InputError(
            bundle, f"was signed at {signature.signed_utc.isoformat()}, an older bundle than the "
            f"one of {newest.isoformat()} that ran here",
            f"copy the newest bundle here; to go back on purpose, sign this one again or delete "
            f"{memory}",
        )  # fmt: skip
    if newest != signature.signed_utc:
        newer = known | {signature.key: signature.signed_utc}
        try:
            write_document(memory, NewestBundle(schema=NewestBundle.VERSION, signed_utc=newer))
        except OSError as error:
            raise InputError(
                memory, f"cannot be written ({error.strerror})",
                "name another file as memory under [trust]",
            ) from None  # fmt: skip


def key_text(raw: bytes) -> str:
    return _PREFIX + base64.b64encode(raw).decode()


def key_bytes(text: str, where: Path | str) -> bytes:
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


def check_signature(manifest: FileContent, path: Path, trusted: Sequence[str]) -> BundleSignature:
    """Return the signature of a manifest by a trusted key, or refuse the manifest."""
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
        raw = msgspec.json.decode(content_of(path, _SIGN).data)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise InputError(path, f"is no signature ({error})", f"{_SIGN} again") from None
    check_version(path, raw, BundleSignature.VERSION, f"{_SIGN} again")
    signature = convert(raw, BundleSignature, path, "is no signature", f"{_SIGN} again")
    if signature.key not in trusted:
        raise InputError(
            path, f"is by the key {signature.key[:80]!r}, which [trust] does not name",
            "add the key to [trust] keys if you trust its owner, who decides what runs here",
        )  # fmt: skip
    try:
        key = Ed25519PublicKey.from_public_bytes(key_bytes(signature.key, path))
        message = signed_message(manifest, signature.signed_utc)
        key.verify(_decoded(signature.signature), message)
    except InvalidSignature:
        raise InputError(
            path, "does not fit manifest.json: the bundle was changed after it was signed",
            f"copy the bundle again, or {_SIGN} again",
        ) from None  # fmt: skip
    return signature
