"""Write all results in build directories as one self-contained HTML page.

The page shows what it recognises, the arm first; at its end it names the commands that make what
is missing. The study has a section if a directory has a study.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from firmware_py.core.console import DONE, Progress, emit
from firmware_py.core.units import FILE_SIZE

EXAMPLE = "dropstitch report build build --out build/report.html"


def configure(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("build", type=Path, nargs="*", default=[Path("build")], metavar="DIR",
        help="what 'make demo' or 'make study' built (build)")  # fmt: skip
    add("--out", type=Path, metavar="FILE", help="page to write (report.html in the first DIR)")


def run(args: argparse.Namespace) -> int:
    from hil.report.build_inputs import read_build
    from hil.report.build_page import report_page  # loads matplotlib
    from models.shared.pages import write_page

    inputs = read_build(*args.build)
    progress = Progress("report", 8)
    progress.begin("drawing")
    out = args.out or args.build[0] / "report.html"
    size = write_page(out, report_page(inputs, progress.step))
    text = f"{out}: {FILE_SIZE.number(size)} {FILE_SIZE.name}"
    emit(args, {"report": str(out), "bytes": size}, text)
    return DONE
