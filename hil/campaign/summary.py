"""Summary of a campaign: rows of its cases, `summary.csv` and `campaign.json`.

They contain no measured times, so `summary.csv` is the same bytes whatever ran the cases.
"""

from __future__ import annotations

import csv
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Final

import msgspec

from firmware_py.core.documents import Document
from firmware_py.core.output_files import replacing
from hil.campaign.cases import CampaignCase, CaseMaker, flat
from hil.campaign.specification import CampaignSpec
from hil.campaign.store import ResultStore

MOST_SENTENCES: Final = 50
"""Largest number of different failures in the document; summary.csv has all."""

Value = str | int | float | bool | None


@dataclass(frozen=True)
class SummaryRow:
    """One case of a summary."""

    key: str
    state: str  # "done", the state of a failure, or "missing"
    sentence: str  # Why there is no result
    config: dict[str, Value]  # Values by dotted name
    result: dict[str, Value]  # Values by dotted name


class FailureCount(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Cases that failed with the same message."""

    state: str  # State of the cases, such as "refused", "failed" or "killed"
    sentence: str  # Message
    cases: int  # Number of cases
    example: str  # Key of one of the cases; `failures/KEY-N.json` holds its log


class CampaignDocument(Document, frozen=True, kw_only=True):
    """Result of a campaign."""

    MADE_BY: ClassVar[str] = "dropstitch campaign"

    name: str  # Name in the campaign's file
    kind: str  # Kind of the cases
    code: str  # Version of the code
    axes: tuple[str, ...]  # Names of the axes
    cases: int  # Number of different cases
    states: dict[str, int]  # Number of cases by state
    # The last run: number of earlier results used, of damaged ones, and of cases run by outcome
    last_run: dict[str, int]
    failures: tuple[FailureCount, ...]  # Cases without a result, the most frequent message first


def summary_rows(cases: Sequence[CampaignCase], store: ResultStore) -> list[SummaryRow]:
    """Return the rows of the summary, in the order of the campaign's file."""
    rows = []
    for case in cases:
        config = _scalars(msgspec.to_builtins(case.options))
        if (record := store.read(case.key)) is not None:
            rows.append(SummaryRow(case.key, "done", "", config, _scalars(record.result)))
        elif (failure := store.last_failure(case.key)) is not None:
            rows.append(SummaryRow(case.key, failure.state, failure.sentence, config, {}))
        else:
            rows.append(SummaryRow(case.key, "missing", "", config, {}))
    return rows


def write_summary(rows: Sequence[SummaryRow], path: Path) -> None:
    config = sorted({name for row in rows for name in row.config})
    result = sorted({name for row in rows for name in row.result})
    names = [f"config.{n}" for n in config] + [f"result.{n}" for n in result]
    with replacing(path) as scratch, scratch.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(["key", "state", "sentence", *names])
        for row in rows:
            values = [row.config.get(n) for n in config] + [row.result.get(n) for n in result]
            table.writerow([row.key, row.state, row.sentence, *values])


def campaign_document(
    spec: CampaignSpec, maker: CaseMaker, rows: Sequence[SummaryRow], last_run: dict[str, int]
) -> CampaignDocument:
    examples: dict[tuple[str, str], str] = {}
    for row in rows:
        examples.setdefault((row.state, row.sentence), row.key)
    failures = Counter((row.state, row.sentence) for row in rows if row.state != "done")
    return CampaignDocument(
        schema=CampaignDocument.VERSION, name=spec.name, kind=maker.kind.name, code=maker.code,
        axes=tuple(spec.axes), cases=len(rows), last_run=last_run,
        states=dict(sorted(Counter(row.state for row in rows).items())),
        failures=tuple(
            FailureCount(state=state, sentence=sentence, cases=count,
                         example=examples[state, sentence])
            for (state, sentence), count in failures.most_common(MOST_SENTENCES)
        ),
    )  # fmt: skip


def describe_campaign(document: CampaignDocument, out: Path) -> str:
    done, reused = document.states.get("done", 0), document.last_run["kept"]
    before = f", {reused} of them before" if reused else ""
    lines = [f"{done} of {document.cases} cases have a result{before}"]
    lines += [f"{f.cases} {f.state}: {f.sentence}" for f in document.failures[:5]]
    if document.failures:
        lines.append(f"logs in {out}/failures; a second run begins these cases again")
    lines.append(f"see {out}/report.html and summary.csv")
    return "\n".join(lines)


def _scalars(table: Mapping[str, Any]) -> dict[str, Value]:
    """Values by dotted name; a list stays in one cell, as JSON."""
    return {
        # Equal names of many rows take the memory of one.
        sys.intern(name): value if isinstance(value, Value) else msgspec.json.encode(value).decode()
        for name, value in flat(table).items()
    }
