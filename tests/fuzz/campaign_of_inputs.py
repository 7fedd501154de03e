"""Campaign of the fuzzer: seeded inputs for each reader, verdicts counted, failures kept."""

import random
import shutil
import time
from collections import Counter
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from models.trials import importing
from tests.fuzz.fork_cases import run_cases

BATCH = 50
"""Inputs of one child: a fork takes as long as reading a small file."""
FOUND = Path(__file__).with_name("found")
"""Small files that once broke a reader: READER/NUMBER/FILE."""


@dataclass
class Tally:
    """Verdicts on the inputs of one reader."""

    counts: Counter = field(default_factory=Counter)
    peak_bytes: int = 0
    slowest_s: float = 0.0
    failures: list = field(default_factory=list)

    def add(self, verdict, seed):
        self.counts[verdict.kind] += 1
        self.peak_bytes = max(self.peak_bytes, verdict.peak_bytes)
        self.slowest_s = max(self.slowest_s, verdict.cpu_s)
        if verdict.failed:
            self.failures.append((seed, verdict))


def mutated(reader, seed):
    """Changed files of one input."""
    return reader.mutate(random.Random(f"{reader.name} {seed}"), reader.files)


def verdicts_on(reader, inputs, scratch, *, guarded=True):
    """Verdicts on inputs; `changed()` of each gives its files, in the child.

    Unguarded, an importer works in the fuzzer's own child, which has the same limits.
    """

    def work(changed):
        if not guarded:
            importing.guarded_call = lambda own, *_, **__: own()  # in this child only
        folder = scratch / "case"
        shutil.rmtree(folder, ignore_errors=True)
        for name, content in (reader.files | changed()).items():
            file = folder / name
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(content)
        reader.read(folder)

    return run_cases([partial(work, changed) for changed in inputs], scratch)


def fuzz(reader, scratch, seconds, inputs, first=0):
    """Tally of a reader after a time or a number of inputs, whichever ends first."""
    tally, end_s, at = Tally(), time.monotonic() + seconds, first
    reader.read(_valid(reader, scratch))
    while at < first + inputs and time.monotonic() < end_s and len(tally.failures) < 20:
        seeds = range(at, min(at + BATCH, first + inputs))
        changes = [partial(mutated, reader, seed) for seed in seeds]
        for k, verdict in enumerate(verdicts_on(reader, changes, scratch, guarded=False)):
            if verdict.failed:  # read it as the command does
                verdict = verdicts_on(reader, changes[k : k + 1], scratch)[0]
            tally.add(verdict, seeds[k])
        at = seeds.stop
    return tally


def _valid(reader, scratch):
    """Directory of the valid files; reading them loads the libraries before the fork."""
    folder = scratch / "valid"
    shutil.rmtree(folder, ignore_errors=True)
    for name, content in reader.files.items():
        file = folder / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(content)
    return folder


def kept(readers):
    """Inputs that once failed: reader, name of the input, changed files."""
    by_name = {reader.name.replace(" ", "_"): reader for reader in readers}
    for folder in sorted(FOUND.glob("*/*")):
        if (reader := by_name.get(folder.parent.name)) is not None:
            files = [p for p in folder.rglob("*") if p.is_file()]
            changed = {str(p.relative_to(folder)): p.read_bytes() for p in files}
            yield reader, folder.name, changed


def keep(reader, seed):
    """Keep the changed files of an input as a regression."""
    folder = FOUND / reader.name.replace(" ", "_") / str(seed)
    for name, content in mutated(reader, seed).items():
        file = folder / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(content)
    return folder
