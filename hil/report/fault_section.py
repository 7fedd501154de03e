"""Section about a fault campaign: a row for each fault, with the worst values of its cases."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import groupby
from typing import Any, Final

import msgspec

from firmware_py.core.units import ANGLE_ERROR, DURATION, TICK_TIME
from hil.faults.faults_document import CaseResult, FaultsDocument
from hil.verdict import Verdict
from models.shared.pages import NO_VALUE, Cell, Facts, Paragraph, Part, Table, TableCell

_HEADER: Final = [
    "fault", "required", "detected after, ticks", "ticks lost", "ticks missing in the log",
    "longest without packet, ms", "cases passed",
]  # fmt: skip
_LINES: Final = {
    "virtual": "Virtual line: simulated time, repeatable by seed",
    "socket": "Socket line: real time",
    "process": "Processes: real time, killed and stopped by signals",
}


def campaign_parts(document: FaultsDocument) -> list[Part]:
    parts: list[Part] = [Paragraph(sentence) for sentence in _sentences(document)]
    for line, title in _LINES.items():
        cases = [case for case in document.cases if case.line == line]
        by_row = groupby(cases, lambda case: (case.fault, case.how))
        if rows := [_row(list(of_row)) for _, of_row in by_row]:
            parts.append(Table(title, _HEADER, rows))
    environment = msgspec.structs.asdict(document.environment)
    facts = {
        "joints": document.dof, "servos": ", ".join(document.models),
        "seeds": ", ".join(map(str, document.seeds)), **environment,
    }  # fmt: skip
    return [*parts, Facts([(name.replace("_", " "), str(v)) for name, v in facts.items()])]


def _sentences(document: FaultsDocument) -> list[str]:
    cases, counts = document.cases, document.counts
    results = f"{counts[Verdict.PASS]} passed, {counts[Verdict.FAIL] or 'none'} failed"
    if undecided := counts[Verdict.INCONCLUSIVE]:
        results += f", {undecided} are inconclusive because the host preempted the process"
    sentences = [
        f"Verdict: {document.verdict}. {document.faults} faults were injected in {len(cases)} "
        f"cases (once, in bursts and combined): {results}.",
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
    if unheard_ns := [case.unheard_ns for case in cases if case.watched]:
        sentences.append(
            "With a watchdog, the longest time that a servo was driven without a packet was "
            f"{TICK_TIME.text(max(unheard_ns), 1)}."
        )
    if unwatched := [case for case in cases if not case.watched]:
        drift_rad = [case.drift_rad for case in unwatched if case.live]
        moved = (
            f": in {len(drift_rad)} such cases it moved at most "
            f"{ANGLE_ERROR.text(max(drift_rad), 0)} after its last packet."
            if drift_rad
            else "."
        )
        sentences.append(
            "The legacy PRO has no watchdog. When its host stops, it moves to its last goal and "
            "holds it with torque on until somebody switches it off. Therefore its goals are "
            "limited to 1\u00a0rad/s, the servo's own velocity limit is set to the same value, "
            f"and the following error bounds the distance{moved}"
        )
    return sentences


def _row(cases: list[CaseResult]) -> list[Cell]:
    first = cases[0]
    passed = sum(case.verdict is Verdict.PASS for case in cases)
    failed = any(case.verdict is Verdict.FAIL for case in cases)
    complaints = "; ".join(dict.fromkeys(words for case in cases for words in case.complaints))
    met = False if failed else True if passed == len(cases) else None
    return [
        f"{first.fault}, {first.how}",
        first.must,
        _largest(case.detected_ticks for case in cases),
        _largest(case.lost_ticks for case in cases),
        _largest(case.unlogged_ticks for case in cases),
        TICK_TIME.number(max(case.unheard_ns for case in cases), 0),
        TableCell(f"{passed} of {len(cases)} {complaints}".strip(), met),
    ]


def _largest(values: Iterable[Any]) -> str:
    known = [value for value in values if value is not None]
    return str(max(known)) if known else NO_VALUE
