"""Checks of the place that a command writes to (--out), before its work begins."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterable
from pathlib import Path

from firmware_py.core.errors import InputError
from firmware_py.core.input_files import resolved


def check_output_directory(
    path: Path, names: Iterable[str] = (), inputs: Iterable[Path] = ()
) -> None:
    """Refuse a directory that cannot be written, or in which an output would replace an input."""
    resolved(path)  # refuses a loop of links, which `exists` takes for nothing
    if path.exists() and not path.is_dir():
        raise InputError(f"--out {path}", "is a file", "name a directory")
    _check_place(path)
    read = _identities(inputs)
    for written in (path / name for name in names):
        if _identities([written]) & read:
            raise InputError(
                f"--out {path}", f"would replace {written}, which is read", "name another directory"
            )


def check_output_file(path: Path, inputs: Iterable[Path] = ()) -> None:
    """Refuse a file that cannot be written, or that the command reads."""
    resolved(path)
    if path.is_dir():
        raise InputError(f"--out {path}", "is a directory", "name a file")
    if _identities([path]) & _identities(inputs):
        raise InputError(f"--out {path}", "is a file that is read", "name another file")
    _check_place(path.parent)


def _identities(paths: Iterable[Path]) -> set[tuple[int, int]]:
    """Device and inode of the existing files, whatever link or spelling leads to them."""
    identities = set()
    for path in paths:
        with contextlib.suppress(OSError, ValueError):
            status = resolved(path).stat()
            identities.add((status.st_dev, status.st_ino))
    return identities


def _check_place(path: Path) -> None:
    """Refuse a directory that does not exist and cannot be created."""
    place = path.absolute()
    while not place.exists() and place != place.parent:
        place = place.parent
    if not place.is_dir():
        raise InputError(f"--out {path}", f"lies under the file {place}", "name another place")
    if not os.access(place, os.W_OK):
        raise InputError(f"--out {path}", "may not be written", "name another place")
