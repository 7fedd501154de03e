"""Plan of a path of the tip: the goals that lead it there, although the link bends.

PATH is circle, figure_eight, line, square, star, hold, point_to_point, text:HELLO, or a CSV file
with the columns time_s, x_m and, for two joints, y_m. The plan holds goals for a grid of payloads,
the tip and the currents that the twin predicts with them, and the error to expect; 'dropstitch run
--plan' and 'dropstitch sil --plan' run it. A picture is written beside it. What the arm cannot
reach, or what breaks a limit, is refused with the row.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from firmware_py.config import read_config
from firmware_py.core.console import DONE, Progress, emit
from firmware_py.core.errors import InputError
from firmware_py.core.units import LENGTH, TIME
from firmware_py.goals.plan_goals import recording_beyond_plan
from firmware_py.goals.tip_plan import read_tip_plan
from firmware_py.inference.manifest import BundleFiles, read_bundle_files
from firmware_py.link.link_description import STUDY_LINK
from models.bundle.plant import compare_with_bundle
from models.plant.plant import read_plant
from models.shared.output_paths import check_output_file

if TYPE_CHECKING:
    from models.plan.plan import Method, PathPlan

EXAMPLE = (
    "dropstitch plan circle --plant build/plant.json --bundle build/bundle_2dof "
    "--seconds 8 --out build/circle.json"
)


def configure(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("path", metavar="PATH",
        help="built-in path or CSV file; with --improve the plan that was run")  # fmt: skip
    add("--improve", type=Path, metavar="LOG", help="improve the plan PATH by a recorded run of "
        "it: a trial (.csv) or a log (.mcap)")  # fmt: skip
    add("--plant", type=Path, required=True, metavar="PLANT", help="plant to invert")
    add("--bundle", type=Path, required=True, metavar="BUNDLE",
        help="bundle of the robot: its joints and its period")  # fmt: skip
    add("--out", type=Path, required=True, metavar="PLAN", help="file to write")
    add("--config", type=Path, metavar="ROBOT",
        help="robot.toml, for its limits (default: those of one without [limits] that names the "
        "plant's link)")  # fmt: skip
    add("--size", type=float, default=0.3, metavar="M", help="half of the largest extent, m (0.3)")
    add("--centre", type=float, nargs="+", default=[], metavar="M", help="x, and y, in m (0)")
    add("--seconds", type=float, default=8.0, help="duration of one turn, or of the text (8)")
    add("--turns", type=int, default=1, help="times that the path is passed (1)")
    add("--angle-deg", type=float, default=0.0, help="direction of a line, from x towards y (0)")
    add("--payloads", type=float, nargs="+", metavar="KG",
        help="grid of payloads (five up to the largest of the link, 2 of the study's)")  # fmt: skip
    add("--rigid", action="store_true", help="take the link as rigid, for comparison; moves of "
        "point_to_point are as fast as the limits permit")  # fmt: skip
    add("--zvd", action="store_true", help="the same, moves shaped so that the first mode rests")
    add("--move", type=float, default=0.0, metavar="S",
        help="duration of a move of point_to_point (a quarter of --seconds)")  # fmt: skip
    add("--fastest", action="store_true", help="shortest move that keeps the limits")
    add("--open-loop", action="store_true", help="leave the feedback of the estimated tip out")
    add("--probe", action="store_true", help="begin the first run with a short motion whose "
        "currents show the link's stiffness and payload")  # fmt: skip


def run(args: argparse.Namespace) -> int:
    if args.out.suffix == ".svg":
        raise InputError(
            args.out, "is the name of the picture", "end the name of the plan in .json"
        )
    read = [args.plant, args.config, args.improve]
    if args.improve is None and args.path.lower().endswith(".csv"):
        read.append(Path(args.path))  # an improved plan may replace the one that it improves
    check_output_file(args.out, [path for path in read if path is not None])
    files = read_bundle_files(args.bundle)
    return _plan(args, files) if args.improve is None else _improve(args, files)


def _plan(args: argparse.Namespace, files: BundleFiles) -> int:
    if args.zvd and args.rigid:
        raise InputError("--zvd", "is set beside --rigid", "leave one out")
    plant = read_plant(args.plant)
    limits = read_config(args.config).limits_in_force if args.config else None
    # CasADi and SciPy are loaded here, so that a wrong option is refused at once.
    from models.plan.plan import plan

    method: Method = "zvd" if args.zvd else "rigid" if args.rigid else "inverse"
    payloads_kg = args.payloads or (plant.link or STUDY_LINK).payloads_kg
    steps = 1
    if method == "inverse":
        steps += (not args.open_loop) + args.probe + len(payloads_kg)
    progress = Progress("plan", steps)
    result = plan(
        args.path, plant, files.directory, size_m=args.size, centre_m=args.centre,
        seconds=args.seconds, turns=args.turns, angle_rad=math.radians(args.angle_deg),
        move_s=args.move, payloads_kg=payloads_kg, limits=limits, method=method,
        feedback=not args.open_loop, fastest=args.fastest, probe=args.probe, report=progress.step,
    )  # fmt: skip
    _write(args, result)
    return DONE


def _improve(args: argparse.Namespace, files: BundleFiles) -> int:
    plan = read_tip_plan(Path(args.path))
    if plan.bundle_sha256 != files.manifest_sha256:
        raise InputError(
            args.path, f"was made for another bundle than {args.bundle}", "name its bundle"
        )
    from models.plan.learning import improve_plan, read_plan_run
    from models.plan.plan import PathPlan, usual_limits

    recorded = read_plan_run(args.improve, plan)
    if beyond := recording_beyond_plan(plan, recorded.payload_kg):
        print(f"warning: {args.improve}: {beyond}", file=sys.stderr)
    plant = read_plant(args.plant)
    compare_with_bundle(plant, args.plant, files, "this plan")
    limits = read_config(args.config).limits_in_force if args.config else usual_limits(plant)
    improved, went_back = improve_plan(plan, recorded, plant, limits)
    run = improved.learned[-1]
    lines = [
        f"{args.improve}: tip by {run.source}, {run.payload_kg:.2f} kg, off its path by "
        f"{LENGTH.number(run.rms_m, 2)} mm RMS; {LENGTH.number(run.expected_rms_m, 2)} mm expected "
        f"for the next run, {LENGTH.number(run.predicted_rms_m, 2)} mm where all errors repeat"
    ]
    if went_back:
        lines.append("this run was worse than the best one, from which half a step was taken")
    if run.goal_delay_s:
        delay = TIME.number(run.goal_delay_s, 4)
        lines.append(f"the joints follow {delay} s later than the twin's")
    lines.append(
        f"the link of the recording is {run.stiffness:.2f} times as stiff and {run.damping:.2f} "
        "times as damped as the plant's"
    )
    _write(
        args, PathPlan(improved), lines,
        learned=[msgspec.to_builtins(r) for r in improved.learned], went_back=went_back,
    )  # fmt: skip
    return DONE


def _write(
    args: argparse.Namespace, plan: PathPlan, lines: Sequence[str] = (), **further: Any
) -> None:
    """Write a plan and its picture, and print both."""
    plan.write(args.out)
    text = [*lines, f"{args.out}: {plan.summary()}", f"see {args.out.with_suffix('.svg')}"]
    emit(args, {"plan": str(args.out)} | plan.as_json() | further, "\n".join(text))
