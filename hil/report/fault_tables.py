"""Tables of a fault campaign: each row summarises the cases of a fault by their worst values."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import groupby
from typing import Any, Final

import msgspec

from firmware_py.core.units import ANGLE_ERROR, DURATION, TICK_TIME
from hil.faults.faults_document import CaseResult, FaultsDocument
from hil.verdict import Verdict
from models.shared.pages import NO_VALUE, Facts, Table, TableCell

_HEADER: Final = [
    "fault", "required", "detected after, ticks", "supervisor state", "last command to the servos",
    "recovered after, ticks", "ticks lost", "ticks missing in the log",
    "longest without packet, ms",
    "cases passed",
]  # fmt: skip
_LINES: Final = {
    "virtual": "Virtual line: simulated time, repeatable by seed",
    "socket": "Socket line: real time",
    "process": "Processes: real time, killed and stopped by signals",
}


def campaign_sentences(document: FaultsDocument) -> list[str]:
    """Return the result of a campaign as sentences."""
    cases, counts = document.cases, document.counts
    watched = [case for case in cases if case.watched]
    unwatched = [case for case in cases if not case.watched]
    sentences = [
        f"Verdict: {document.verdict}. {document.faults} faults were injected in "
        f"{len(cases)} cases (once, in bursts and combined): {counts[Verdict.PASS]} passed, "
        f"{counts[Verdict.FAIL]} failed, {counts[Verdict.INCONCLUSIVE]} are inconclusive because "
        "the host preempted the process.",
        "In every case four conditions must hold: no servo is driven for longer than its "
        f"watchdog's {DURATION.text(document.watchdog_s, 0)} without a packet, no goal jumps, "
        "no old data are taken for new, and no servo is still driven at the end. The emulated "
        "servos report the first and the last, not the loop.",
    ]
    if document.not_run:
        planned = len(cases) + document.not_run
        sentences.insert(
            0,
            f"This campaign is incomplete: it was ended after {len(cases)} of {planned} cases. "
            "What follows is about those alone.",
        )
    if watched:
        longest_ns = max(case.unheard_ns for case in watched)
        sentences.append(
            "With a watchdog, the longest time that a servo was driven without a packet was "
            f"{TICK_TIME.text(longest_ns, 1)}."
        )
    if unwatched:
        left = [case for case in unwatched if case.live]
        drift_rad = max((case.drift_rad for case in left), default=0.0)
        sentences.append(
            "The legacy PRO has no watchdog. When its host stops, it moves to its last goal and "
            "holds it with torque on until somebody switches it off. Therefore its goals are "
            "limited to 1\u00a0rad/s, the servo's own velocity limit is set to the same value, "
            "and the following error bounds the distance"
            + (
                f": in {len(left)} such cases it moved at most {ANGLE_ERROR.text(drift_rad, 0)} "
                "after its last packet."
                if left
                else "."
            )
        )
    return sentences


def campaign_facts(document: FaultsDocument) -> Facts:
    """Return the robot, the seeds and the machine of a campaign."""
    rows = [
        ("joints", str(document.dof)),
        ("servos", ", ".join(document.models)),
        ("seeds", ", ".join(map(str, document.seeds))),
        *(
            (name.replace("_", " "), str(v))
            for name, v in msgspec.structs.asdict(document.environment).items()
        ),
    ]
    return Facts(rows)


def campaign_tables(document: FaultsDocument) -> list[Table]:
    """Return one table for each kind of line, with a row per fault and way to inject it."""
    tables = []
    for line, title in _LINES.items():
        cases = [case for case in document.cases if case.line == line]
        rows = [_row(list(group)) for _, group in groupby(cases, _key)]
        if rows:
            tables.append(Table(title, _HEADER, rows))
    return tables


def _key(case: CaseResult) -> tuple[str, str]:
    return case.fault, case.how


def _row(cases: list[CaseResult]) -> list[TableCell]:
    first = cases[0]
    passed = sum(case.verdict is Verdict.PASS for case in cases)
    failed = any(case.verdict is Verdict.FAIL for case in cases)
    complaints = _each(words for case in cases for words in case.complaints)
    return [
        TableCell(f"{first.fault}, {first.how}"),
        TableCell(first.must),
        TableCell(_worst(case.detected_ticks for case in cases)),
        TableCell(_each(case.state.lower() for case in cases)),
        TableCell(_each(case.told for case in cases)),
        TableCell(_worst(case.recovered_ticks for case in cases)),
        TableCell(_worst(case.lost_ticks for case in cases)),
        TableCell(_worst(case.unlogged_ticks for case in cases)),
        TableCell(TICK_TIME.number(max(case.unheard_ns for case in cases), 0)),
        TableCell(
            f"{passed} of {len(cases)} {complaints}".strip(),
            None if passed < len(cases) and not failed else not failed,
        ),
    ]


def _worst(values: Iterable[Any]) -> str:
    known = [value for value in values if value is not None]
    return str(max(known)) if known else NO_VALUE


def _each(words: Iterable[str]) -> str:
    return "; ".join(dict.fromkeys(words))
