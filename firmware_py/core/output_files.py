"""Writing of files: directories of one run each, and files that are replaced when complete."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator
from pathlib import Path

from firmware_py.core.errors import InputError

if sys.platform != "win32":
    import fcntl


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


@contextlib.contextmanager
def locked_directory(directory: Path) -> Iterator[None]:
    """Lock the directory of --out during the block; refuse one that another run has locked.

    The lock ends with the process, however that ends; its file `.lock` stays.
    """
    if sys.platform == "win32":
        yield
        return
    try:
        file = (directory / ".lock").open("w")
    except OSError as error:
        raise InputError(
            directory, f"cannot be written to ({error.strerror})", "name another --out"
        ) from None
    with file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InputError(
                directory, "is in use by another run", "wait, or name another --out"
            ) from None
        except OSError:  # a file system without locks
            pass
        yield
