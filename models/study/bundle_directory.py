"""Directory of a bundle on disk: its replacement, and the check before it.

An old bundle is replaced file by file, its manifest last: until then a reader detects that a hash
differs. Other files in the directory are kept.
"""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from firmware_py.errors import InputError
from firmware_py.files.input_files import read_json
from firmware_py.inference.bundle_signature import SIGNATURE
from firmware_py.inference.manifest import FILES, MANIFEST

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
