"""Generated parts of docs/safety.md, which `python -m hil.faults.fault_docs` writes."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Final, NamedTuple

from firmware_py.safety.states import TRANSITIONS, SafetyState
from hil.faults.fault_table import PARTS, ROWS

DOCUMENT: Final = Path(__file__).parents[2] / "docs" / "safety.md"
_REQUIREMENTS: Final = Path(__file__).with_name("safety_requirements.toml")


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


def state_machine() -> str:
    """Return the supervisor's states and transitions as a Mermaid diagram and a table."""
    arrows = [
        f"    {t.source.name} --> {t.target.name}: {t.cause.replace('`', '')}" for t in TRANSITIONS
    ]
    rows = [f"| {t.source.name} | {t.target.name} | {t.cause} |" for t in TRANSITIONS]
    diagram = [
        "```mermaid",
        "stateDiagram-v2",
        f"    [*] --> {SafetyState(0).name}",
        *arrows,
        "```",
    ]
    return "\n".join([*diagram, "", "| from | to | when |", "|---|---|---|", *rows])


def fault_matrix() -> str:
    lines = []
    for title, rows in PARTS.items():
        lines += [f"**{title}**", "", "| fault | how | line | must | proves |"]
        lines.append("|---|---|---|---|---|")
        for row in rows:
            must = str(row.must).replace("|", " or ")
            cells = [row.fault, row.how, ", ".join(row.lines), must, ", ".join(row.proves)]
            lines.append(f"| {' | '.join(cells)} |")
        lines.append("")
    return "\n".join(lines).rstrip()


def requirement_table() -> str:
    """Return the safety requirements and their verification in Markdown."""
    lines = ["| | requirement | tests | faults |", "|---|---|---|---|"]
    for r in requirements():
        tests = "<br>".join(f"`{test.rpartition('/')[2]}`" for test in r.tests)
        faults = ", ".join(r.faults) or f"none: {r.no_fault}"
        lines.append(f"| {r.identifier} | {r.text} | {tests} | {faults} |")
    return "\n".join(lines)


def redraw(text: str) -> str:
    """Return a document with the text between its marks regenerated."""
    parts = {
        "state machine": state_machine(),
        "requirements": requirement_table(),
        "faults": fault_matrix(),
    }
    for name, part in parts.items():
        head, begin, rest = text.partition(f"<!-- drawn: {name} -->\n")
        _, end, tail = rest.partition(f"<!-- end: {name} -->\n")
        text = head + begin + part + "\n" + end + tail
    return text


if __name__ == "__main__":
    DOCUMENT.write_text(redraw(DOCUMENT.read_text(encoding="utf-8")), encoding="utf-8")
