"""The report of a whole run: one self-contained HTML page.

`inputs` reads a build directory; `motion_figures`, `error_figures`, `estimator_figures` and
`loop_figures` draw (`svg` gives them one look); `tables` sets figures against targets; `page` puts
it all together with `page.html` in the look of `models.page`. `fault_tables` shows a campaign of
faults, in the page and by itself.
"""

from __future__ import annotations

from pathlib import Path

from hil.report.inputs import Json, read_inputs
from hil.report.page import render, render_faults

__all__ = ["write_fault_report", "write_report"]


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


def _write(page: str, out: Path) -> int:
    data = page.encode("utf-8")
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_bytes(data)
    return len(data)
