"""Generated parts of docs/safety.md and docs/safety/faults.md.

`python -m hil.faults.fault_docs` writes them.
"""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Final, NamedTuple

from firmware_py.safety.states import TRANSITIONS, SafetyState
from hil.faults.fault_table import PARTS, ROWS

_DOCS: Final = Path(__file__).parents[2] / "docs"
SAFETY_PAGE: Final = _DOCS / "safety.md"
"""Written by hand, but for the table of transitions between two marks."""
FAULTS_PAGE: Final = _DOCS / "safety" / "faults.md"
_REQUIREMENTS: Final = Path(__file__).with_name("safety_requirements.toml")

_FAULTS_TEXT: Final = """# Faults and requirements

Written by `python -m hil.faults.fault_docs`; do not edit. The text of a requirement and its tests
stand in `hil/faults/safety_requirements.toml`, the faults in `hil/faults/fault_table.py`. What the
requirements mean for you: [Safety](../safety.md). How to add a fault:
[Extend](../guides/extend.md#add-a-fault).

## Requirements

{requirements}

## Faults

`dropstitch faults --bundle BUNDLE --out OUT` injects each fault on its lines: in simulated time
(virtual), against emulated servos on a socket, or against the whole program (process). Faults in
one row are injected and judged alike. Words in quotes must stand in the reason of the stop.

{faults}
"""


class SafetyRequirement(NamedTuple):
    """Safety requirement of safety_requirements.toml and its verification."""

    identifier: str  # "SR-" and a number
    text: str
    tests: tuple[str, ...]  # File, `::` and the name of the test
    no_fault: str  # Why no fault of the table can prove it; empty if one does
    faults: tuple[str, ...]  # Faults of the rows that prove it


def requirements() -> list[SafetyRequirement]:
    tables = tomllib.loads(_REQUIREMENTS.read_text(encoding="utf-8"))
    return [
        SafetyRequirement(
            name, table["text"], tuple(table["tests"]), table.get("no_fault", ""),
            tuple(dict.fromkeys(row.fault for row in ROWS if name in row.proves)),
        )
        for name, table in tables.items()
    ]  # fmt: skip


def transitions() -> str:
    """Return the supervisor's transitions in Markdown."""
    first = f"| | {SafetyState(0).name} | the program starts |"
    rows = [f"| {t.source.name} | {t.target.name} | {t.cause} |" for t in TRANSITIONS]
    return "\n".join(["| from | to | when |", "|---|---|---|", first, *rows])


def fault_matrix() -> str:
    """Return the faults in Markdown; those that are injected and judged alike share a row."""
    lines = ["| fault | how, and what the robot must do | line | proves |", "|---|---|---|---|"]
    for title, rows in PARTS.items():
        lines.append(f"| **{title}** | | | |")
        alike: dict[tuple[str, ...], list[str]] = {}
        for fault in dict.fromkeys(row.fault for row in rows):
            cases = [row for row in rows if row.fault == fault]
            musts = [str(row.must).replace("|", " or ") for row in cases]
            what = "<br>".join(f"{c.how}: {must}" for c, must in zip(cases, musts, strict=True))
            where = dict.fromkeys(line for row in cases for line in row.lines)
            proves = sorted({identifier for row in cases for identifier in row.proves})
            alike.setdefault((what, ", ".join(where), ", ".join(proves)), []).append(fault)
        lines += [f"| {'<br>'.join(names)} | {' | '.join(key)} |" for key, names in alike.items()]
    return "\n".join(lines)


def requirement_table() -> str:
    """Return the safety requirements and their tests in Markdown."""
    lines = ["| | requirement | tests |", "|---|---|---|"]
    for r in requirements():
        tests = "<br>".join(f"`{test.rpartition('/')[2]}`" for test in r.tests)
        none = f"<br>no fault: {r.no_fault}" if r.no_fault else ""
        lines.append(f"| {r.identifier} | {r.text} | {tests}{none} |")
    return "\n".join(lines)


def safety_page(text: str) -> str:
    """Return docs/safety.md with its table of transitions renewed."""
    head, begin, rest = text.partition("<!-- drawn: state machine -->\n")
    _, end, tail = rest.partition("<!-- end: state machine -->\n")
    return f"{head}{begin}{transitions()}\n{end}{tail}"


def faults_page() -> str:
    """Return the whole of docs/safety/faults.md."""
    return _FAULTS_TEXT.format(requirements=requirement_table(), faults=fault_matrix())


if __name__ == "__main__":
    SAFETY_PAGE.write_text(safety_page(SAFETY_PAGE.read_text(encoding="utf-8")), encoding="utf-8")
    FAULTS_PAGE.write_text(faults_page(), encoding="utf-8")
