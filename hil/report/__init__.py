"""The report of a whole run: one self-contained HTML page.

`build_inputs` reads a build directory; the modules in `study/` and `loop_figures` draw;
`report_tables` compares figures with their targets; `fault_tables` shows a fault campaign, in the
report and on a page of its own; `report_page` puts the sections together. `gap/` does the same for
the page of a closed gap. Page parts, colours and drawings are those of `models.shared`.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hil.report.build_inputs import Json, read_inputs
from hil.report.gap.before_after_page import render_gap
from hil.report.gap.gap_figures import in_words, summary
from hil.report.gap.gap_inputs import read_gap
from hil.report.report_page import render, render_faults

__all__ = ["write_fault_report", "write_gap_report", "write_report"]


def write_report(build: Path, out: Path) -> int:
    """Write the report of a build directory; returns its size in bytes.

    Raises
    ------
    InputError
        If the directory is missing or a file in it is damaged.
    """
    return _write(render(read_inputs(build)), out)


def write_fault_report(document: Json, out: Path) -> int:
    """Write the page of a campaign (`faults.json`); returns its size in bytes."""
    return _write(render_faults(document), out)


def write_gap_report(
    directory: Path, plant: Path, hidden: Mapping[str, float], out: Path
) -> tuple[dict[str, Any], str]:
    """Write the page of a gap; returns its figures for machines and for people.

    Parameters
    ----------
    directory : Path
        What was built around the diagnosis (see `hil.report.gap.gap_inputs`).
    plant : Path
        Plant that the diagnosis began with.
    hidden : mapping of str to float
        Effects that were hidden, each with its strength.
    out : Path
        Page to write.

    Raises
    ------
    InputError
        If something is missing or damaged.
    """
    inputs = read_gap(directory, plant)
    data = {**summary(inputs, hidden), "report": str(out)}
    _write(render_gap(inputs, data, hidden), out)
    return data, in_words(data)


def _write(page: str, out: Path) -> int:
    data = page.encode("utf-8")
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_bytes(data)
    return len(data)
