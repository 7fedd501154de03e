"""Signature of a bundle, which a robot with `[trust] keys` asks for before it loads anything.

A bundle is executable code: its observer.fmu is a native library that runs in the process that
moves the robot. --new-key makes a private key, which only its owner can read; keys of 'openssl
genpkey -algorithm ed25519' and 'ssh-keygen -t ed25519' serve as well. The command prints the public
key for robot.toml. A bundle that is changed later has to be signed again.
"""

from __future__ import annotations

import argparse
import base64
import getpass
import os
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from firmware_py.core.console import DONE, emit
from firmware_py.core.documents import write_document
from firmware_py.core.errors import InputError
from firmware_py.core.input_files import content_of
from firmware_py.inference.bundle import ModelBundle
from firmware_py.inference.bundle_signature import (
    SIGNATURE,
    BundleSignature,
    check_signature,
    key_text,
    signed_message,
)
from firmware_py.inference.manifest import MANIFEST

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

EXAMPLE = "dropstitch sign build/bundle_1dof --key ~/.dropstitch.pem"


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("bundle", type=Path, metavar="BUNDLE", help="bundle to sign")
    parser.add_argument("--key", type=Path, required=True, help="private key, Ed25519")
    parser.add_argument("--new-key", action="store_true", help="make the private key first")


def run(args: argparse.Namespace) -> int:
    ModelBundle.load(args.bundle)  # refuses what the robot would refuse
    key = make_key(args.key) if args.new_key else read_key(args.key)
    public = sign_bundle(args.bundle, key)
    manifest = content_of(args.bundle / MANIFEST)
    emit(
        args,
        {"bundle": str(args.bundle), "key": public, "manifest_sha256": manifest.sha256},
        f'{args.bundle / SIGNATURE}: signed; in robot.toml:\n\n[trust]\nkeys = ["{public}"]',
    )
    return DONE


def sign_bundle(directory: Path, key: Ed25519PrivateKey) -> str:
    """Sign the manifest of a bundle; return the public key."""
    manifest, now = content_of(directory / MANIFEST), datetime.now(UTC)
    public = key_text(key.public_key().public_bytes_raw())
    signature = base64.b64encode(key.sign(signed_message(manifest, now))).decode()
    path = directory / SIGNATURE
    document = BundleSignature(
        schema=BundleSignature.VERSION, signed_utc=now, key=public, signature=signature
    )
    write_document(path, document)
    check_signature(manifest, path, (public,))
    return public


def make_key(path: Path) -> Ed25519PrivateKey:
    """Make a private key that only its owner can read."""
    from cryptography.hazmat.primitives import serialization
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

    key = Ed25519PrivateKey.generate()
    text = key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except FileExistsError:
        raise InputError(path, "exists", "omit --new-key to sign with it") from None
    except OSError as error:
        raise InputError(path, f"cannot be written ({error})", "choose another --key") from None
    with open(descriptor, "wb") as file:
        file.write(text)
    return key


def read_key(path: Path) -> Ed25519PrivateKey:
    """Read a private key; asks for the passphrase of an encrypted one."""
    from cryptography.exceptions import UnsupportedAlgorithm
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
    from cryptography.hazmat.primitives.serialization import (
        load_pem_private_key,
        load_ssh_private_key,
    )

    remedy = "make one with --new-key"
    data = content_of(path, remedy).data
    load = load_ssh_private_key if b"OPENSSH PRIVATE KEY" in data else load_pem_private_key
    try:
        try:
            key = load(data, None)
        except TypeError:  # it is encrypted
            key = load(data, getpass.getpass(f"passphrase of {path}: ").encode())
    except EOFError:
        raise InputError(
            path, "is encrypted, and there is nobody to ask for its passphrase",
            "run the command in a terminal",
        ) from None  # fmt: skip
    except (ValueError, TypeError, UnsupportedAlgorithm) as error:
        raise InputError(path, f"is no private key that opens ({error})", remedy) from None
    if not isinstance(key, Ed25519PrivateKey):
        raise InputError(path, "is not an Ed25519 key", remedy)
    return key
