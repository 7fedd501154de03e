"""Writing of files: directories, and files whose old content stays until the new is complete."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from firmware_py.core.errors import InputError


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a scratch file that replaces a file when the body ends without an error.

    It is in the same directory. If the body fails, it is removed and the file is unchanged. A path
    that is not a regular file, like `/dev/stdout`, is written in place. A link stays a link.
    """
    whole = Path(os.path.realpath(path))
    in_place = whole.exists() and not whole.is_file()
    scratch = whole if in_place else whole.with_name(f".{whole.name}.{os.getpid()}.part")
    try:
        yield scratch
        if not in_place:
            scratch.replace(whole)
    except OSError as error:
        error.filename = str(path)  # the error of a full disk has no name
        error.filename2 = None
        raise
    finally:
        if not in_place:
            scratch.unlink(missing_ok=True)


def write_whole(path: Path, data: bytes) -> None:
    with replacing(path) as scratch:
        scratch.write_bytes(data)


def make_directory(path: Path, remedy: str) -> None:
    """Make a directory and its parents, or refuse the name; an existing one is left alone."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        what = f"cannot be made a directory ({error.strerror})"
        raise InputError(path, what, remedy) from None
