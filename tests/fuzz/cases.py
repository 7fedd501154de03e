"""Seeded inputs for each reader, read in forked children with limits of memory and time."""

import contextlib
import faulthandler
import io
import os
import random
import resource
import select
import shutil
import signal
import tempfile
import time
import traceback
from collections import Counter
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import NamedTuple

from firmware_py.core.errors import InputError
from models.commands import import_

MEMORY_BYTES = 500_000_000
"""Memory of a child beyond that of its parent: address space, and resident size."""
SECONDS = 10
"""Processor time of a case, of its own children included."""
WALL_S = 120.0
"""Elapsed time after which a case is ended: other programs may have the processor."""
GUARDED = ("has crashed", " to read; ", "if the file is sound, report")
BATCH = 50
"""Inputs of one child: a fork takes as long as reading a small file."""
FOUND = Path(__file__).with_name("found")
"""Small files that once broke a reader: READER/NUMBER/FILE."""


# --- one child ------------------------------------------------------------------------------------


class Verdict(NamedTuple):
    """End of a case: used, refused, guarded (the reader's own child was ended), or a failure.

    Failures: traceback, sentence (no single one), crash, hang, memory.
    """

    kind: str
    text: str

    @property
    def failed(self):
        return self.kind not in ("used", "refused", "guarded")


def run_cases(works, scratch):
    """Verdicts on functions one after the other, each of which must return, or raise `InputError`.

    They run in one child as long as it lives; the next child goes on behind the one that ended it.
    """
    verdicts = []
    while len(verdicts) < len(works):
        verdicts += _in_one_child(works[len(verdicts) :], scratch)
    return verdicts


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
        verdicts += map(_judged, whole)
    os.close(reader)
    if late:
        for end in (os.killpg, os.kill):
            with contextlib.suppress(ProcessLookupError):
                end(child, signal.SIGKILL)
    _, status, used = os.wait4(child, 0)
    if len(verdicts) < len(works):  # it ended in the next one
        late |= os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGXCPU
        verdicts.append(Verdict("hang" if late else "crash", f"status {status}"))
    elif 1024 * used.ru_maxrss - shared_bytes > MEMORY_BYTES:
        verdicts[-1] = Verdict("memory", "or one before it")
    return verdicts


def _judged(report):
    kind, cpu_s, text = report.decode("utf-8", "replace").split("\n", 2)
    one_sentence = text.isprintable() and text.endswith(".") and ": " in text and len(text) < 4000
    if float(cpu_s) > SECONDS:
        kind = "hang"
    elif kind == "refused" and not one_sentence:
        kind = "sentence"
    elif kind == "refused" and any(words in text for words in GUARDED):
        kind = "guarded"
    return Verdict(kind, text)


def _live(works, writer, scratch):
    """Life of a child: it reports the end of each case, and exits."""
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
            report = f"{kind}\n{_used_s() - before_s}\n{text}".replace("\0", "\\0")
            os.write(writer, report.encode("utf-8", "backslashreplace")[:60_000] + b"\0")
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


# --- inputs of a reader ---------------------------------------------------------------------------


@dataclass
class Tally:
    """Verdicts on the inputs of one reader, and the failures by the number of their input."""

    counts: Counter = field(default_factory=Counter)
    failures: list = field(default_factory=list)


def write_files(folder, files):
    shutil.rmtree(folder, ignore_errors=True)
    for name, content in files.items():
        file = folder / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(content)
    return folder


def mutated(reader, seed):
    """Changed files of one input."""
    return reader.mutate(random.Random(f"{reader.name} {seed}"), reader.files)


def verdicts_on(reader, inputs, scratch, *, guarded=True):
    """Verdicts on inputs; each is a function that returns the changed files, in the child.

    Unguarded, an importer works in the fuzzer's own child, which has the same limits.
    """

    def work(changed):
        if not guarded:
            import_.guarded_call = lambda own, *_, **__: own()  # in this child only
        reader.read(write_files(scratch / "case", reader.files | changed()))

    return run_cases([partial(work, changed) for changed in inputs], scratch)


def fuzz(reader, scratch, seconds, inputs, first=0):
    """Tally of a reader after a time or a number of inputs, whichever ends first."""
    tally, end_s, at = Tally(), time.monotonic() + seconds, first
    quiet = io.StringIO()  # reading the valid files loads the libraries before the fork
    with contextlib.redirect_stdout(quiet), contextlib.redirect_stderr(quiet):
        reader.read(write_files(scratch / "valid", reader.files))
    while at < first + inputs and time.monotonic() < end_s and len(tally.failures) < 20:
        seeds = range(at, min(at + BATCH, first + inputs))
        changes = [partial(mutated, reader, seed) for seed in seeds]
        for k, verdict in enumerate(verdicts_on(reader, changes, scratch, guarded=False)):
            if verdict.failed:  # read it as the command does
                verdict = verdicts_on(reader, changes[k : k + 1], scratch)[0]
            tally.counts[verdict.kind] += 1
            if verdict.failed:
                tally.failures.append((seeds[k], verdict))
        at = seeds.stop
    return tally


# --- inputs that once failed ----------------------------------------------------------------------


def regressions(readers):
    """Inputs that once failed: reader, name of the input, changed files."""
    by_name = {reader.name.replace(" ", "_"): reader for reader in readers}
    for folder in sorted(FOUND.glob("*/*")):
        if (reader := by_name.get(folder.parent.name)) is not None:
            files = [p for p in folder.rglob("*") if p.is_file()]
            changed = {str(p.relative_to(folder)): p.read_bytes() for p in files}
            yield reader, folder.name, changed


def add_regression(reader, seed):
    """Keep the changed files of an input; return their folder."""
    return write_files(FOUND / reader.name.replace(" ", "_") / str(seed), mutated(reader, seed))
