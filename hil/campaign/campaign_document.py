"""Document of a campaign (`campaign.json`): cases by state, version of the code, failures."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar, Final

import msgspec

from firmware_py.core.documents import Document, write_document
from hil.campaign.campaign_cases import CampaignCase, CaseMaker
from hil.campaign.campaign_run import RunCounts
from hil.campaign.campaign_spec import CampaignSpec, axis_names
from hil.campaign.campaign_summary import summary_rows
from hil.campaign.result_store import ResultStore

MOST_SENTENCES: Final = 50
"""Largest number of different failures in the document; summary.csv has all."""


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

    def write(self, path: Path) -> None:
        write_document(path, self)


def campaign_document(
    spec: CampaignSpec,
    maker: CaseMaker,
    counts: RunCounts,
    cases: Sequence[CampaignCase],
    store: ResultStore,
) -> CampaignDocument:
    """Return the contents of `campaign.json`."""
    states: Counter[str] = Counter()
    sentences: Counter[tuple[str, str]] = Counter()
    examples: dict[tuple[str, str], str] = {}
    for row in summary_rows(cases, store):
        states[row.state] += 1
        if row.state != "done":
            sentences[row.state, row.sentence] += 1
            examples.setdefault((row.state, row.sentence), row.key)
    last: dict[str, Any] = {"kept": counts.kept, "damaged": counts.damaged, **counts.ran}
    return CampaignDocument(
        schema=CampaignDocument.VERSION,
        name=spec.name,
        kind=maker.kind.name,
        code=maker.code,
        axes=tuple(axis_names(spec)),
        cases=counts.cases,
        states=dict(sorted(states.items())),
        last_run=last,
        failures=tuple(
            FailureCount(state=state, sentence=sentence, cases=count,
                         example=examples[state, sentence])
            for (state, sentence), count in sentences.most_common(MOST_SENTENCES)
        ),
    )  # fmt: skip


def describe_campaign_document(document: CampaignDocument, out: Path) -> str:
    done = document.states.get("done", 0)
    kept = f", {document.last_run['kept']} of them before" if document.last_run["kept"] else ""
    lines = [f"{done} of {document.cases} cases have a result{kept}"]
    lines += [f"{f.cases} {f.state}: {f.sentence}" for f in document.failures[:5]]
    if document.failures:
        lines.append(f"logs in {out}/failures; a second run begins these cases again")
    lines.append(f"see {out}/report.html and summary.csv")
    return "\n".join(lines)
