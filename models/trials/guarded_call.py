"""Call of a library that reads a foreign file, in a child process with limits.

Libraries that read binary formats may crash, hang or allocate without bound on damaged files. In a
child process each of these becomes an error message of the parent.
"""

from __future__ import annotations

import contextlib
import errno
import faulthandler
import io
import math
import os
import select
import signal
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Final, NoReturn

import msgspec

from firmware_py.core.errors import InputError
from firmware_py.core.input_files import MEMORY_BYTES, limit_memory
from firmware_py.core.units import DATA_SIZE

SECONDS: Final = 8.0
"""Limit of the processor time for a small file; the demo's recordings need less than a second."""
ELAPSED_FACTOR: Final = 10.0
"""Ratio of the limits of elapsed and processor time, for a busy computer [assumed]."""
MOST_WRITTEN_BYTES: Final = 400_000_000
"""Largest file that a child may write: twice a trial of 10⁷ numbers of 20 digits."""

_RESULT, _REFUSED, _MEMORY, _DISK, _FAILED = b"r", b"i", b"m", b"d", b"f"
_CRASHED: Final = "is damaged or too large: the program that reads it has crashed"
_REPORT: Final = "; if the file is sound, report this sentence"
_DISK_ERRORS: Final = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
"""Errors that end the writing of a result: a full disk, a quota, `MOST_WRITTEN_BYTES`."""


def guarded_call(
    work: Callable[[], bytes], where: Path | str, remedy: str,
    memory_bytes: int = MEMORY_BYTES, seconds: float = SECONDS,
) -> bytes:  # fmt: skip
    """Return the result of `work()`, which runs in a child process with limits.

    The child is a fork: it starts in milliseconds with all modules loaded. It writes nothing to the
    terminal, and its temporary files are removed. Without fork (Windows) the work runs in this
    process, which it may crash, and no limit of memory, time or size applies.

    `remedy`: remedy in the message if the child fails.
    `memory_bytes`: memory in addition to the present use (Linux; other systems do not limit it).
    `seconds`: limit of the processor time; the elapsed time may be `ELAPSED_FACTOR` times as long.
    """
    if not hasattr(os, "fork"):
        return _called_here(work, where, remedy)
    reader, writer = os.pipe()
    with tempfile.TemporaryDirectory(prefix="dropstitch-") as scratch:
        child = _fork()
        if child == 0:
            os.close(reader)
            _live(work, writer, scratch, memory_bytes, seconds)
        os.close(writer)
        try:
            answer, late = _received(reader, time.monotonic() + ELAPSED_FACTOR * seconds)
        finally:
            os.close(reader)
            with contextlib.suppress(ProcessLookupError):
                os.kill(child, signal.SIGKILL)  # it has sent its result, or never will
            _, status = os.waitpid(child, 0)
    kind, content = answer[:1], answer[1:]
    if kind == _RESULT and not late:
        return content
    _raise_sent(kind if not late else b"", content, where, remedy)
    if late or (os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGXCPU):
        raise InputError(where, f"takes more than {seconds:g} s to read", remedy)
    if kind == _MEMORY:
        raise InputError(
            where, f"takes more than {DATA_SIZE.number(memory_bytes)} MB to read", remedy
        )
    raise InputError(where, _CRASHED, remedy)


def _raise_sent(kind: bytes, content: bytes, where: Path | str, remedy: str) -> None:
    """Raise the exception that a child has sent, if any."""
    if kind == _REFUSED:
        raise InputError(*msgspec.msgpack.decode(content, type=tuple[str, str, str]))
    if kind == _DISK:
        raise OSError(int(content), os.strerror(int(content)))
    if kind == _FAILED:
        raise InputError(where, content.decode(errors="replace"), remedy + _REPORT)


def _failure(error: Exception) -> str:
    return f"cannot be read ({type(error).__name__}: {' '.join(str(error).split())[:300]})"


def _called_here(work: Callable[[], bytes], where: Path | str, remedy: str) -> bytes:
    """Run the work in this process, with the same messages as from a child."""
    printed = io.StringIO()
    try:
        with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(printed):
            return work()
    except InputError:
        raise
    except MemoryError:
        raise InputError(where, "takes more memory to read than there is", remedy) from None
    except Exception as error:
        if isinstance(error, OSError) and error.errno in _DISK_ERRORS:
            raise
        raise InputError(where, _failure(error), remedy + _REPORT) from error


def _fork() -> int:
    """Fork, without the warning of Python 3.12 about threads.

    OpenBLAS has handlers that make its threads survive a fork.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        return os.fork()


def _received(reader: int, deadline_s: float) -> tuple[bytes, bool]:
    """Read a pipe until it closes; return the data and whether the deadline passed."""
    parts: list[bytes] = []
    while (left_s := deadline_s - time.monotonic()) > 0:
        if select.select([reader], [], [], left_s)[0]:
            part = os.read(reader, 1 << 20)
            if not part:
                return b"".join(parts), False
            parts.append(part)
    return b"", True


def _live(
    work: Callable[[], bytes], writer: int, scratch: str, memory_bytes: int, seconds: float
) -> NoReturn:
    """Run the child, which always exits here, without the clean-up of the parent."""
    try:
        faulthandler.disable()
        nowhere = os.open(os.devnull, os.O_RDWR)
        for stream in (0, 1, 2):
            os.dup2(nowhere, stream)
        tempfile.tempdir = scratch
        _limit(memory_bytes, seconds)
        try:
            answer = _RESULT + work()
        except InputError as error:
            refusal = (error.where, error.what, error.remedy)
            answer = _REFUSED + msgspec.msgpack.encode(refusal)
        except MemoryError:
            answer = _MEMORY
        except Exception as error:
            if isinstance(error, OSError) and error.errno in _DISK_ERRORS:
                answer = _DISK + str(error.errno).encode()
            elif isinstance(error, OSError) and error.errno == errno.ENOMEM:
                answer = _MEMORY
            else:
                answer = _FAILED + _failure(error).encode(errors="replace")
        while answer:
            answer = answer[os.write(writer, answer) :]
    except MemoryError:
        os.write(writer, _MEMORY)
    finally:
        os._exit(0)


def _limit(memory_bytes: int, seconds: float) -> None:
    import resource  # only where there is a fork

    limits = {
        resource.RLIMIT_CORE: 0, resource.RLIMIT_CPU: math.ceil(seconds),
        resource.RLIMIT_FSIZE: MOST_WRITTEN_BYTES,
    }  # fmt: skip
    limit_memory(memory_bytes)
    for limit, most in limits.items():
        hard = resource.getrlimit(limit)[1]
        least = most if hard == resource.RLIM_INFINITY else min(most, hard)
        resource.setrlimit(limit, (least, hard))
