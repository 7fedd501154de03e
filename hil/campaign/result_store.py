"""Store of a campaign: one file for each result, failure files with logs, costs in a table.

::

    DIR/results/ab/KEY.json     result, with its own hash
    DIR/failures/KEY-1.json     first failure of a case, with its log; failures are never removed
    DIR/costs.csv               time and memory of each case, in the order of their ends
    DIR/shared/                 files that cases share, such as a twin

A file gets its name only when it is complete. A result counts only if its hash matches.
"""

from __future__ import annotations

import csv
import hashlib
import json
import math
import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, ClassVar, Final

import msgspec

from firmware_py.core.documents import Document, read_document
from firmware_py.core.errors import InputError
from hil.campaign.case_task import State, TaskOutcome, canonical_json

if sys.platform != "win32":  # --help, the schemas and the report work there
    import fcntl

COST_COLUMNS: Final = ("key", "code", "state", "wall_s", "cpu_s", "memory_bytes", "result_bytes",
                       "worker", "parts_s")  # fmt: skip


class CaseRecord(Document, frozen=True, kw_only=True):
    """Result of one case."""

    MADE_BY: ClassVar[str] = "dropstitch campaign"

    sha256: str  # Hash of key, kind, code, config and result as canonical JSON
    key: str  # Hash of the full configuration and the version of the code
    kind: str  # Kind of the case
    code: str  # Version of the code
    config: dict[str, Any]  # Configuration of the case
    result: dict[str, Any]  # Result of the case


class FailureRecord(Document, frozen=True, kw_only=True):
    """Failure of one case."""

    MADE_BY: ClassVar[str] = "dropstitch campaign"

    key: str  # Hash of the full configuration and the version of the code
    kind: str  # Kind of the case
    code: str  # Version of the code
    # "refused": the input cannot be used; "failed": an error in the code; "killed": workers died
    state: State
    sentence: str  # Why there is no result
    log: str  # Output of the case, with the traceback of an error
    config: dict[str, Any]  # Configuration of the case


class ResultStore:
    """Store of results, failures and costs in the directory of a campaign."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self._results, self._failures = directory / "results", directory / "failures"
        self._last_failures: dict[str, int] | None = None
        self.shared, self.costs = directory / "shared", directory / "costs.csv"
        for path in (directory, self._results, self._failures, self.shared):
            _make_directory(path)

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Lock the directory against other campaigns during the block."""
        path = self.directory / ".lock"
        try:
            file = path.open("w")
        except OSError as error:
            raise InputError(
                self.directory, f"cannot be written to ({error.strerror})", "name another --out"
            ) from None
        with file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise InputError(
                    self.directory, "is in use by another campaign", "wait, or name another --out"
                ) from None
            except OSError:  # a file system without locks
                pass
            yield

    def path(self, key: str) -> Path:
        """Return the path of a result."""
        return self._results / key[:2] / f"{key}.json"

    def read(self, key: str) -> CaseRecord | None:
        """Return the result of a case; None if it is missing, damaged or of another case."""
        try:
            record = msgspec.json.decode(self.path(key).read_bytes(), type=CaseRecord)
        except (OSError, ValueError, RecursionError):
            return None
        whole = record.schema == CaseRecord.VERSION and record.key == key
        return record if whole and record.sha256 == _hash_of(record) else None

    def write(self, key: str, kind: str, code: str, config: Any, result: str) -> int:
        """Write a result; return the size of its file."""
        record = CaseRecord(
            schema=CaseRecord.VERSION, sha256="", key=key, kind=kind, code=code,
            config=msgspec.to_builtins(config), result=json.loads(result),
        )  # fmt: skip
        record = msgspec.structs.replace(record, sha256=_hash_of(record))
        return _write_whole(self.path(key), canonical_json(record) + "\n")

    def write_failure(self, kind: str, code: str, config: Any, outcome: TaskOutcome) -> None:
        """Write a failure, in addition to earlier ones of the case."""
        record = FailureRecord(
            schema=FailureRecord.VERSION, key=outcome.key, kind=kind, code=code,
            state=outcome.state, sentence=outcome.sentence, log=outcome.log,
            config=msgspec.to_builtins(config),
        )  # fmt: skip
        number = self._failed().get(outcome.key, 0) + 1
        text = json.dumps(msgspec.to_builtins(record), indent=1, ensure_ascii=False)
        _write_whole(self._failures / f"{outcome.key}-{number}.json", text + "\n")
        self._failed()[outcome.key] = number

    def _failed(self) -> dict[str, int]:
        """Number of the last failure of each case; the directory is read once."""
        if self._last_failures is None:
            self._last_failures = {}
            for path in self._failures.glob("*-*.json"):
                key, _, number = path.stem.rpartition("-")
                if number.isdecimal():
                    last = max(int(number), self._last_failures.get(key, 0))
                    self._last_failures[key] = last
        return self._last_failures

    def last_failure(self, key: str) -> FailureRecord | None:
        """Return the last failure of a case; None if there is none."""
        if not (number := self._failed().get(key)):
            return None
        return read_document(self._failures / f"{key}-{number}.json", FailureRecord)

    def add_cost(self, code: str, outcome: TaskOutcome, result_bytes: int) -> None:
        """Append the cost of a case to the table."""
        if outcome.cost is None:
            return
        new, cost = not self.costs.exists(), outcome.cost
        with self.costs.open("a", newline="", encoding="utf-8") as file:
            table = csv.writer(file, lineterminator="\n")
            if new:
                table.writerow(COST_COLUMNS)
            table.writerow(
                [outcome.key, code, outcome.state, f"{cost.wall_s:.6f}", f"{cost.cpu_s:.6f}",
                 cost.memory_bytes, result_bytes, cost.worker, json.dumps(cost.parts_s)]
            )  # fmt: skip

    def read_costs(self) -> list[dict[str, str]]:
        """Return the rows of the table of costs, without damaged or incomplete ones."""
        if not self.costs.exists():
            return []
        try:
            with self.costs.open(newline="", encoding="utf-8") as file:
                return [row for row in csv.DictReader(file) if _is_whole(row)]
        except (OSError, UnicodeDecodeError, csv.Error) as error:
            raise InputError(self.costs, f"cannot be read ({error})", "remove it") from None


def _is_whole(row: Mapping[str | None, Any]) -> bool:
    """Whether a row of costs has all columns, and finite numbers."""
    if not all(isinstance(row.get(name), str) for name in COST_COLUMNS):
        return False
    try:
        times_s = [float(row[name]) for name in ("wall_s", "cpu_s")]
        sizes = [int(row[name]) for name in ("memory_bytes", "result_bytes")]
        parts_s = json.loads(row["parts_s"])
    except (ValueError, RecursionError):
        return False
    known = isinstance(parts_s, dict) and all(math.isfinite(v) for v in times_s)
    return known and all(0 <= v < 2**63 for v in sizes)


def _hash_of(record: CaseRecord) -> str:
    body = {n: getattr(record, n) for n in ("key", "kind", "code", "config", "result")}
    return hashlib.sha256(canonical_json(body).encode()).hexdigest()


def _write_whole(path: Path, text: str) -> int:
    """Write a file atomically, by renaming a temporary one; return its size."""
    path.parent.mkdir(exist_ok=True)
    fresh = path.with_name(f".{path.name}.{os.getpid()}.part")
    data = text.encode()
    try:
        fresh.write_bytes(data)
        fresh.replace(path)
    except OSError:
        fresh.unlink(missing_ok=True)
        raise
    return len(data)


def _make_directory(path: Path) -> None:
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            path, f"cannot be made a directory ({error.strerror})", "name another --out"
        ) from None
