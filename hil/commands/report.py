"""Write all results in a build directory as one self-contained HTML page.

A section without inputs becomes one line that names the command to run.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from firmware_py.core.console import DONE, Progress, emit
from firmware_py.core.units import FILE_SIZE

EXAMPLE = "dropstitch report build build --out build/report.html"


def configure(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("build", type=Path, nargs="?", default=Path("build"), metavar="DIR",
        help="what 'make demo' built (build)")  # fmt: skip
    add("--out", type=Path, metavar="FILE", help="page to write (default: DIR/report.html)")


def run(args: argparse.Namespace) -> int:
    from hil.report.build_inputs import read_build
    from hil.report.build_page import report_page  # loads matplotlib
    from models.shared.pages import write_page

    inputs = read_build(args.build)
    progress = Progress("report", 10, is_estimate=True)
    progress.begin("drawing")
    out = args.out or args.build / "report.html"
    size = write_page(out, report_page(inputs, progress.step))
    text = f"{out}: {FILE_SIZE.number(size)} {FILE_SIZE.name}"
    emit(args, {"report": str(out), "bytes": size}, text)
    return DONE
