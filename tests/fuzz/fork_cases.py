"""Cases of the fuzzer in forked children with limits of memory and time."""

import contextlib
import faulthandler
import os
import resource
import select
import signal
import tempfile
import traceback
from typing import NamedTuple

from firmware_py.core.errors import InputError

MEMORY_BYTES = 500_000_000
"""Memory of a child beyond what the fork server holds: address space, and resident size."""
SECONDS = 10
"""Processor time of a case, of its own children included."""
WALL_S = 120.0
"""Elapsed time after which a case is ended: other programs may have the processor."""
GUARDED = ("has crashed", " to read; ", "if the file is sound, report")


class Verdict(NamedTuple):
    """End of a case: what it was, the sentence or the traceback, peak in bytes, seconds."""

    kind: str
    text: str
    peak_bytes: int
    cpu_s: float

    @property
    def failed(self):
        return self.kind not in ("used", "refused", "guarded")


def run_cases(works, scratch):
    """Verdicts on functions one after the other, each of which must return, or raise `InputError`.

    They run in one child as long as it lives; the next child goes on behind the one that ended it.
    Kinds: used, refused, guarded (the reader's own child was ended), traceback, sentence (no single
    one), crash, hang, memory.
    """
    verdicts = []
    while len(verdicts) < len(works):
        verdicts += _in_one_child(works[len(verdicts) :], scratch)
    return verdicts


def run_case(work, scratch):
    """Verdict on one function, see `run_cases`."""
    return run_cases([work], scratch)[0]


def _in_one_child(works, scratch):
    """Verdicts on the first of some functions, up to the one that ended the child."""
    reader, writer = os.pipe()
    shared_bytes = _memory_bytes(1)
    child = os.fork()
    if child == 0:
        os.close(reader)
        _live(works, writer, scratch)
    os.close(writer)
    verdicts, late, rest = [], False, b""
    while len(verdicts) < len(works):
        if not select.select([reader], [], [], WALL_S)[0]:
            late = True
            break
        part = os.read(reader, 1 << 16)
        if not part:
            break
        *whole, rest = (rest + part).split(b"\0")
        verdicts += [_judged(said) for said in whole]
    os.close(reader)
    if late:
        for end in (os.killpg, os.kill):
            with contextlib.suppress(ProcessLookupError):
                end(child, signal.SIGKILL)
    _, status, used = os.wait4(child, 0)
    peak = max(1024 * used.ru_maxrss - shared_bytes, 0)
    if len(verdicts) < len(works):  # it ended in the next one
        late |= os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGXCPU
        verdicts.append(Verdict("hang" if late else "crash", f"status {status}", peak, 0.0))
    elif peak > MEMORY_BYTES:
        verdicts[-1] = Verdict("memory", "or one before it", peak, 0.0)
    return [verdict._replace(peak_bytes=peak) for verdict in verdicts]


def _judged(said):
    kind, cpu_s, text = said.decode("utf-8", "replace").split("\n", 2)
    if float(cpu_s) > SECONDS:
        kind = "hang"
    elif kind == "refused" and not _is_one_sentence(text):
        kind = "sentence"
    elif kind == "refused" and any(words in text for words in GUARDED):
        kind = "guarded"
    return Verdict(kind, text, 0, float(cpu_s))


def _is_one_sentence(text):
    return text.isprintable() and text.endswith(".") and ": " in text and len(text) < 4000


def _live(works, writer, scratch):
    try:
        os.setpgid(0, 0)
        faulthandler.disable()
        nowhere = os.open(os.devnull, os.O_RDWR)
        for stream in (0, 1, 2):
            os.dup2(nowhere, stream)
        tempfile.tempdir = str(scratch)
        most = _memory_bytes(0) + MEMORY_BYTES
        resource.setrlimit(resource.RLIMIT_AS, (most, most))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        for work in works:
            before_s = _used_s()
            resource.setrlimit(resource.RLIMIT_CPU, (int(before_s) + SECONDS + 2, -1))
            kind, text = _end_of(work)
            said = f"{kind}\n{_used_s() - before_s}\n{text}".replace("\0", "\\0")
            os.write(writer, said.encode("utf-8", "backslashreplace")[:60_000] + b"\0")
    finally:
        os._exit(0)


def _end_of(work):
    try:
        work()
    except InputError as error:
        return "refused", str(error)
    except MemoryError:
        return "memory", traceback.format_exc(limit=-4)
    except BaseException:
        return "traceback", traceback.format_exc(limit=-6)
    return "used", ""


def _memory_bytes(column):
    """Own address space (column 0) or resident size (column 1)."""
    with open("/proc/self/statm", encoding="ascii") as file:
        return int(file.read().split()[column]) * resource.getpagesize()


def _used_s():
    own, ended = (resource.getrusage(w) for w in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return own.ru_utime + own.ru_stime + ended.ru_utime + ended.ru_stime
