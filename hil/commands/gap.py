"""Write an HTML page that compares plant, FMU and robot before and after a gap was closed.

DIR holds the results of `make gap-demo`: the diagnosis (found/), runs of both twin FMUs in FMPy on
held-out trials (fmpy_*), and runs of the robot's loop with both bundles (sil_*).
"""

from __future__ import annotations

import argparse
from pathlib import Path

import msgspec

from firmware_py.core.console import DONE, Progress, emit
from models.shared.catalogue import parse_strengths

EXAMPLE = (
    "dropstitch report gap build/gap_demo/dead_time_0.03 --plant build/plant.json "
    "--hide dead_time=0.03"
)


def configure(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("directory", type=Path, metavar="DIR", help="directory that `make gap-demo` filled")
    add("--plant", type=Path, metavar="PLANT", required=True, help="plant before the diagnosis")
    add(
        "--hide", action="append", default=[], metavar="EFFECT[:JOINT]=STRENGTH",
        help="effect hidden in the rig, shown beside the effect found; repeatable",
    )  # fmt: skip
    add("--out", type=Path, metavar="FILE", help="page to write (default: DIR/report.html)")


def run(args: argparse.Namespace) -> int:
    hidden = parse_strengths(args.hide)
    from hil.report import gap_page  # loads CasADi
    from models.shared.pages import write_page

    inputs = gap_page.read_gap(args.directory, args.plant)
    progress = Progress("report gap", 1)
    progress.begin("drawing")
    figures = gap_page.gap_figures(inputs, hidden)
    out = args.out or args.directory / "report.html"
    write_page(out, gap_page.closed_gap_page(inputs, figures))
    progress.step(str(out))
    output = {**msgspec.to_builtins(figures), "report": str(out)}
    emit(args, output, f"{gap_page.describe_gap(figures)}\n{out}")
    return DONE
