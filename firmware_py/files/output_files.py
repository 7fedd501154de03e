"""Output files that are whole: the old content stays until the new one is written."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

__all__ = ["replacing", "write_whole"]


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Name of a scratch file that replaces a file when the body ends without an error.

    Where the body fails the scratch file is removed and the file stays as it was. What is no
    regular file, like `/dev/stdout`, is written in place. A link to a file stays a link.

    Yields file to write to, in the same directory.
    """
    whole = Path(os.path.realpath(path))
    in_place = whole.exists() and not whole.is_file()
    scratch = whole if in_place else whole.with_name(f".{whole.name}.{os.getpid()}.part")
    try:
        yield scratch
        if not in_place:
            scratch.replace(whole)
    except OSError as error:
        error.filename = str(path)  # a full disk is refused without a name
        error.filename2 = None
        raise
    finally:
        if not in_place:
            scratch.unlink(missing_ok=True)


def write_whole(path: Path, data: bytes) -> None:
    """Write a file as a whole."""
    with replacing(path) as scratch:
        scratch.write_bytes(data)
