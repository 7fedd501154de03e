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
import itertools
from pathlib import Path
from typing import Any, ClassVar

import msgspec

from firmware_py.core.documents import Document, read_document, write_document
from firmware_py.core.output_files import make_directory, write_whole
from hil.campaign.cases import CampaignCase, canonical_json
from hil.campaign.worker import CaseCost, CaseOutcome, State


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
        self.shared, self.costs = directory / "shared", directory / "costs.csv"
        for path in (directory / "results", directory / "failures", self.shared):
            make_directory(path, "name another --out")

    def path(self, key: str) -> Path:
        return self.directory / "results" / key[:2] / f"{key}.json"

    def read(self, key: str) -> CaseRecord | None:
        """Return the result of a case; None if it is missing, damaged or of another case."""
        try:
            record = msgspec.json.decode(self.path(key).read_bytes(), type=CaseRecord)
        except (OSError, ValueError, RecursionError):
            return None
        whole = record.schema == CaseRecord.VERSION and record.key == key
        return record if whole and record.sha256 == _hash_of(record) else None

    def last_failure(self, key: str) -> FailureRecord | None:
        """Return the last failure of a case; None if there is none."""
        number = self._failures(key)
        return read_document(self._failure_path(key, number), FailureRecord) if number else None

    def add(self, case: CampaignCase, kind: str, code: str, outcome: CaseOutcome) -> None:
        """Write the result or the failure of a case, and append its cost to the table."""
        config = msgspec.to_builtins(case.options)
        if outcome.state == "done":
            record = CaseRecord(
                schema=CaseRecord.VERSION, sha256="", key=case.key, kind=kind, code=code,
                config=config, result=outcome.result,
            )  # fmt: skip
            record = msgspec.structs.replace(record, sha256=_hash_of(record))
            self.path(case.key).parent.mkdir(exist_ok=True)
            write_whole(self.path(case.key), f"{canonical_json(record)}\n".encode())
        else:
            failure = FailureRecord(
                schema=FailureRecord.VERSION, key=case.key, kind=kind, code=code, config=config,
                state=outcome.state, sentence=outcome.sentence, log=outcome.log,
            )  # fmt: skip
            write_document(self._failure_path(case.key, self._failures(case.key) + 1), failure)
        if outcome.cost is not None:
            new = not self.costs.exists()
            with self.costs.open("a", newline="", encoding="utf-8") as file:
                table = csv.writer(file, lineterminator="\n")
                table.writerows([CaseCost.__struct_fields__] * new)
                table.writerow(msgspec.structs.astuple(outcome.cost))

    def _failures(self, key: str) -> int:
        numbers = itertools.count(1)
        return next(n for n in numbers if not self._failure_path(key, n).exists()) - 1

    def _failure_path(self, key: str, number: int) -> Path:
        return self.directory / "failures" / f"{key}-{number}.json"


def _hash_of(record: CaseRecord) -> str:
    body = {n: getattr(record, n) for n in ("key", "kind", "code", "config", "result")}
    return hashlib.sha256(canonical_json(body).encode()).hexdigest()
