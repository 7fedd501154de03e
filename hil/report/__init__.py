"""Self-contained HTML pages of a build directory, a fault campaign and a closed gap.

`build_inputs` reads a build directory, `study/` and `loop_figures` draw figures, `report_tables`
compares results with their targets, `fault_tables` shows a fault campaign, and `report_page`
assembles the sections. `gap/` makes the page of a closed gap, `plans/` that of plans run on the
rig. Page parts, colours and drawings come from `models.shared`.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec

from firmware_py.core.console import Progress
from firmware_py.core.output_files import write_whole
from hil.faults.faults_document import FaultsDocument
from hil.report.build_inputs import read_build
from hil.report.gap.before_after import before_after, describe_before_after
from hil.report.gap.before_after_page import before_after_page
from hil.report.gap.gap_inputs import read_gap
from hil.report.report_page import SECTIONS, fault_page, report_page

__all__ = ["write_fault_report", "write_gap_report", "write_report"]


def write_report(build: Path, out: Path) -> int:
    """Write the report of a build directory; return its size in bytes."""
    inputs = read_build(build)
    progress = Progress("report", SECTIONS + max(len(inputs.loops), 1))
    progress.begin("drawing")
    return _write(report_page(inputs, progress.step), out)


def write_fault_report(document: FaultsDocument, out: Path) -> int:
    """Write the page of a fault campaign; return its size in bytes."""
    return _write(fault_page(document), out)


def write_gap_report(
    directory: Path, plant: Path, hidden: Mapping[str, float], out: Path
) -> tuple[dict[str, Any], str]:
    """Write the page of a closed gap; return its figures as a dictionary and as text."""
    inputs = read_gap(directory, plant)
    data = before_after(inputs, hidden)
    _write(before_after_page(inputs, data), out)
    figures = {**msgspec.to_builtins(data), "report": str(out)}
    return figures, f"{describe_before_after(data)}\n{out}"


def _write(page: str, out: Path) -> int:
    data = page.encode("utf-8")
    out.parent.mkdir(parents=True, exist_ok=True)
    write_whole(out, data)
    return len(data)
