"""Write an HTML page about tip plans that were run on the rig: paths, errors, payloads.

DIR holds the results of `make tip-demo`: the plans inverse_Ndof.json and rigid_Ndof.json, and the
results of 'dropstitch sil --rig --plan' in Ndof_rigid_KG, Ndof_known_KG and Ndof_unknown_KG.
--json prints the RMS errors, and their ratios to that of rigid kinematics.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from firmware_py.core.console import DONE, Progress, emit
from firmware_py.core.units import LENGTH

EXAMPLE = "dropstitch report plans build/plans"


def configure(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("directory", type=Path, metavar="DIR", help="directory that `make tip-demo` filled")
    add("--out", type=Path, metavar="FILE", help="page to write (default: DIR/plans.html)")


def run(args: argparse.Namespace) -> int:
    from hil.report.plans_page import plan_figures, plans_page, read_planned_runs
    from models.shared.pages import write_page

    runs = read_planned_runs(args.directory)
    progress = Progress("report plans", 1)
    progress.begin("drawing")
    out = args.out or args.directory / "plans.html"
    write_page(out, plans_page(runs))
    progress.step(str(out))
    figures = plan_figures(runs)
    lines = ["tip off its path, RMS in mm   rigid    known  unknown"]
    for case in figures["cases"]:
        values = (case.get(f"{k}_rms_m") for k in ("rigid", "known", "unknown"))
        cells = "".join(f"{'–' if v is None else LENGTH.number(v, 2):>9}" for v in values)
        lines.append(f"  {case['dof']}DOF, {case['payload_kg']:4g} kg          {cells}")
    emit(args, figures, "\n".join([*lines, f"see {out}"]))
    return DONE
