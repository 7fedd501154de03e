"""Checks of the place that a command writes to (--out), before its work begins."""

from __future__ import annotations

import itertools
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
    for written, source in itertools.product([path / name for name in names], inputs):
        if is_same_file(written, source):
            raise InputError(
                f"--out {path}", f"would replace {written}, which is read", "name another directory"
            )


def check_output_file(path: Path, inputs: Iterable[Path] = ()) -> None:
    """Refuse a file that cannot be written, or that the command reads."""
    resolved(path)
    if path.is_dir():
        raise InputError(f"--out {path}", "is a directory", "name a file")
    if any(is_same_file(path, source) for source in inputs):
        raise InputError(f"--out {path}", "is a file that is read", "name another file")
    _check_place(path.parent)


def is_same_file(a: Path, b: Path) -> bool:
    """Whether two paths lead to one file or directory, also if a link or the case differs."""
    return resolved(a) == resolved(b) or (a.exists() and b.exists() and a.samefile(b))


def _check_place(path: Path) -> None:
    """Refuse a directory that does not exist and cannot be created."""
    place = path.absolute()
    while not place.exists() and place != place.parent:
        place = place.parent
    if not place.is_dir():
        raise InputError(f"--out {path}", f"lies under the file {place}", "name another place")
    if not os.access(place, os.W_OK):
        raise InputError(f"--out {path}", "may not be written", "name another place")
