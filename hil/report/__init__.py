"""The report of a whole run: one self-contained HTML page.

`inputs` reads a build directory; `motion_figures`, `error_figures`, `estimator_figures` and
`loop_figures` draw (`svg` gives them one look); `tables` sets figures against targets; `page` puts
it all together with `page.html` and `style.css`.
"""

from __future__ import annotations

from pathlib import Path

from hil.report.inputs import read_inputs
from hil.report.page import render

__all__ = ["write_report"]


def write_report(build: Path, out: Path) -> int:
    """Write the report of a build directory; returns its size in bytes.

    Raises
    ------
    InputError
        If the directory is missing or a file in it is damaged.
    """
    page = render(read_inputs(build)).encode("utf-8")
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_bytes(page)
    return len(page)
