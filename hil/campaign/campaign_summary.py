"""Summary of a campaign as CSV: one row for each case, in the order of the campaign's file.

It contains no measured times, so its bytes do not depend on the engine that ran the cases.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import msgspec

from hil.campaign.campaign_cases import CampaignCase
from hil.campaign.campaign_spec import flat
from hil.campaign.result_store import ResultStore

OWN_COLUMNS: Final = ("key", "state", "sentence")

Value = str | int | float | bool | None


@dataclass(frozen=True)
class SummaryRow:
    """One case of a summary."""

    key: str
    state: str  # "done", the state of a failure, or "missing"
    sentence: str  # Why there is no result
    config: dict[str, Value]  # Values by dotted name
    result: dict[str, Value]  # Values by dotted name


def summary_rows(cases: Sequence[CampaignCase], store: ResultStore) -> Iterator[SummaryRow]:
    """Yield the rows of the summary, read from the store one by one."""
    for case in cases:
        config = _scalars(msgspec.to_builtins(case.config))
        if (record := store.read(case.key)) is not None:
            yield SummaryRow(case.key, "done", "", config, _scalars(record.result))
        elif (failure := store.last_failure(case.key)) is not None:
            yield SummaryRow(case.key, failure.state, failure.sentence, config, {})
        else:
            yield SummaryRow(case.key, "missing", "", config, {})


def write_summary(cases: Sequence[CampaignCase], store: ResultStore, path: Path) -> int:
    """Write the summary; return its size in bytes."""
    config: dict[str, None] = {}
    result: dict[str, None] = {}
    for row in summary_rows(cases, store):  # read twice: all rows may not fit into memory
        config |= dict.fromkeys(row.config)
        result |= dict.fromkeys(row.result)
    columns = [*(f"config.{n}" for n in sorted(config)), *(f"result.{n}" for n in sorted(result))]
    fresh = path.with_suffix(".part")
    with fresh.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow([*OWN_COLUMNS, *columns])
        for row in summary_rows(cases, store):
            values = [_text(row.config.get(n)) for n in sorted(config)]
            values += [_text(row.result.get(n)) for n in sorted(result)]
            table.writerow([row.key, row.state, row.sentence, *values])
    fresh.replace(path)
    return path.stat().st_size


def _scalars(table: dict[str, Any]) -> dict[str, Value]:
    """Values by dotted name; a list stays in one cell, as JSON."""
    return {
        name: value if isinstance(value, Value) else msgspec.json.encode(value).decode()
        for name, value in flat(table).items()
    }


def _text(value: Value) -> str:
    if value is None:
        return ""
    return repr(value) if isinstance(value, float) else str(value)
