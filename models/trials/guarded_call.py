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
import signal
import tempfile
import warnings
from collections.abc import Callable
from multiprocessing import get_context
from pathlib import Path
from typing import Final

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

Outcome = bytes | int | tuple[str, str, str]
"""Result of the work, number of a disk's error, or the parts of an `InputError`."""

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
    if hasattr(os, "fork"):
        outcome = _outcome_of_child(work, str(where), remedy, memory_bytes, seconds)
    else:
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(printed):
            outcome = _outcome(work, str(where), remedy, "more memory to read than there is")
    if isinstance(outcome, bytes):
        return outcome
    if isinstance(outcome, int):
        raise OSError(outcome, os.strerror(outcome))
    raise InputError(*outcome)


def _outcome(work: Callable[[], bytes], where: str, remedy: str, memory: str) -> Outcome:
    """Outcome of the work in this process; `memory` says how much is more than there is."""
    try:
        return work()
    except InputError as error:
        refusal = error
    except Exception as error:
        number = error.errno if isinstance(error, OSError) else None
        if number in _DISK_ERRORS:
            return number
        if isinstance(error, MemoryError) or number == errno.ENOMEM:
            refusal = InputError(where, f"takes {memory}", remedy)
        else:
            text = f"{type(error).__name__}: {' '.join(str(error).split())[:300]}"
            report = f"{remedy}; if the file is sound, report this sentence"
            refusal = InputError(where, f"cannot be read ({text})", report)
    return refusal.where, refusal.what, refusal.remedy


def _outcome_of_child(
    work: Callable[[], bytes], where: str, remedy: str, memory_bytes: int, seconds: float
) -> Outcome:
    """Outcome of the work in a child; only msgpack comes back, as pickle would run code."""
    context = get_context("fork")
    reader, writer = context.Pipe(duplex=False)
    with reader, tempfile.TemporaryDirectory(prefix="dropstitch-") as scratch:
        memory = f"more than {DATA_SIZE.number(memory_bytes)} MB to read"

        def live() -> None:
            reader.close()
            _confine(scratch, memory_bytes, seconds)
            writer.send_bytes(msgspec.msgpack.encode(_outcome(work, where, remedy, memory)))

        child = context.Process(target=live)
        with writer, warnings.catch_warnings():
            # Python 3.12 warns about threads; those of OpenBLAS survive a fork.
            warnings.simplefilter("ignore", DeprecationWarning)
            child.start()
        is_late, answer = True, b""
        try:
            is_late = not reader.poll(ELAPSED_FACTOR * seconds)
            answer = b"" if is_late else reader.recv_bytes()
        except (EOFError, OSError):
            pass  # it crashed, before its answer or within it
        finally:
            child.kill()  # it has answered, or never will
            child.join()
    if answer:
        outcome: Outcome = msgspec.msgpack.decode(answer, type=Outcome)
        return outcome
    if is_late or child.exitcode == -signal.SIGXCPU:
        return where, f"takes more than {seconds:g} s to read", remedy
    return where, "is damaged or too large: the program that reads it has crashed", remedy


def _confine(scratch: str, memory_bytes: int, seconds: float) -> None:
    """Silence this process, and limit its memory, processor time and files."""
    import resource  # only where there is a fork

    faulthandler.disable()
    nowhere = os.open(os.devnull, os.O_RDWR)
    for stream in (0, 1, 2):
        os.dup2(nowhere, stream)
    tempfile.tempdir = scratch
    limit_memory(memory_bytes)
    limits = {
        resource.RLIMIT_CORE: 0, resource.RLIMIT_CPU: math.ceil(seconds),
        resource.RLIMIT_FSIZE: MOST_WRITTEN_BYTES,
    }  # fmt: skip
    for limit, most in limits.items():
        hard = resource.getrlimit(limit)[1]
        least = most if hard == resource.RLIM_INFINITY else min(most, hard)
        resource.setrlimit(limit, (least, hard))
