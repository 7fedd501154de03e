"""A campaign of faults as tables: a row per fault and way to try it, the worst of its cases."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import groupby
from typing import Any, Final

from hil.report.build_inputs import Json
from hil.report.report_tables import NO_VALUE, Table, TableCell

_HEADER: Final = [
    "fault", "must", "seen after, ticks", "supervisor", "servos were told",
    "recovered after, ticks", "ticks lost", "log lacks, ticks", "longest unheard, ms", "cases",
]  # fmt: skip
_LINES: Final = {
    "virtual": "Simulated time: the same seed gives the same run",
    "socket": "Real time over the socket",
    "process": "Real processes",
}


def summary(document: Json) -> list[str]:
    """What came out, in sentences."""
    cases, counts = document["cases"], document["counts"]
    watched = [case for case in cases if case["watched"]]
    unwatched = [case for case in cases if not case["watched"]]
    limit_ms = document["watchdog_s"] * 1e3
    sentences = [
        f"Verdict: {document['verdict']}. {document['faults']} faults were tried in "
        f"{len(cases)} cases (once, in bursts and together): {counts['pass']} went as they must, "
        f"{counts['fail']} did not, {counts['inconclusive']} prove nothing because the host took "
        "the processor away.",
        "In every case four things must hold: no servo is driven without hearing anything for "
        f"longer than its watchdog's {limit_ms:.0f}\u00a0ms, no goal jumps, no old data passes "
        "for fresh, no servo drives on in the end. The first and the last are told by the "
        "emulated servos, not by the loop.",
    ]
    if watched:
        longest = max(case["unheard_ns"] for case in watched) / 1e6
        sentences.append(
            f"With a watchdog the longest time that a driven servo heard nothing was "
            f"{longest:.1f}\u00a0ms."
        )
    if unwatched:
        left = [case for case in unwatched if case["live"]]
        drift = max((case["drift_rad"] for case in left), default=0.0) * 1e3
        sentences.append(
            "The legacy PRO has no watchdog: a servo whose host is gone goes to its last goal and "
            "holds it, torque on, until somebody switches it off. So its goals are limited to "
            "1\u00a0rad/s, the servo itself is told to move no faster, and the following error "
            f"bounds the way: in {len(left)} such cases it moved {drift:.0f}\u00a0mrad at most "
            "after the last that it heard."
        )
    return sentences


def facts(document: Json) -> list[tuple[str, str]]:
    """Machine and set-up."""
    return [
        ("joints", str(document["dof"])),
        ("servos", ", ".join(document["models"])),
        ("seeds", ", ".join(map(str, document["seeds"]))),
        *((name.replace("_", " "), str(v)) for name, v in document["environment"].items()),
    ]


def matrix(document: Json) -> list[Table]:
    """A table per line."""
    tables = []
    for line, title in _LINES.items():
        cases = [case for case in document["cases"] if case["line"] == line]
        rows = [_row(list(group)) for _, group in groupby(cases, _key)]
        if rows:
            tables.append(Table(title, _HEADER, rows))
    return tables


def _key(case: Json) -> tuple[str, str]:
    return case["fault"], case["how"]


def _row(cases: list[Json]) -> list[TableCell]:
    first = cases[0]
    passed = sum(case["verdict"] == "pass" for case in cases)
    failed = any(case["verdict"] == "fail" for case in cases)
    complaints = _each(words for case in cases for words in case["complaints"])
    return [
        TableCell(f"{first['fault']}, {first['how']}"),
        TableCell(first["must"]),
        TableCell(_worst(case["detected_ticks"] for case in cases)),
        TableCell(_each(case["state"].lower() for case in cases)),
        TableCell(_each(case["told"] for case in cases)),
        TableCell(_worst(case["recovered_ticks"] for case in cases)),
        TableCell(_worst(case["lost_ticks"] for case in cases)),
        TableCell(_worst(case["unlogged_ticks"] for case in cases)),
        TableCell(f"{max(case['unheard_ns'] for case in cases) / 1e6:.0f}"),
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
