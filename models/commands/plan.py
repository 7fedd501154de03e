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
import numpy as np

from firmware_py.config import UNWATCHED_RATE_RAD_S, read_config
from firmware_py.core.console import DONE, Progress, emit
from firmware_py.core.documents import write_document
from firmware_py.core.errors import InputError
from firmware_py.core.units import ANGLE, CURRENT, LENGTH, TIME
from firmware_py.goals.plan_goals import recording_beyond_plan
from firmware_py.goals.tip_plan import TipPlan, read_tip_plan
from firmware_py.inference.manifest import BundleFiles, read_bundle_files
from firmware_py.link.link_description import STUDY_LINK
from firmware_py.safety.limits import Limits, limits_of_link
from models.bundle.plant import compare_with_bundle
from models.commands.output_paths import check_output_file
from models.plan.paths import DesiredPath, PathOptions, built_in_path, read_path
from models.plant.plant import Plant, read_plant

if TYPE_CHECKING:
    from models.plan.planning import Method

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
    dof, period_s = files.manifest.dof, files.manifest.period_s
    path = _path(args, dof, period_s, args.move)
    method: Method = "zvd" if args.zvd else "rigid" if args.rigid else "inverse"
    feedback = not (args.open_loop or path.moves)
    for option, is_wrong, what, remedy in (
        ("--zvd", args.zvd and args.rigid, "is set beside --rigid", "leave one out"),
        ("--zvd", args.zvd and not path.moves, "is for point_to_point", "leave it out"),
        ("--fastest", args.fastest and (method != "inverse" or not path.moves or args.move),
         "is for the inverse of point_to_point without --move", "leave it out"),
        ("--probe", args.probe and (method != "inverse" or not feedback),
         "is for plans with feedback of the tip", "leave it out"),
    ):  # fmt: skip
        if is_wrong:
            raise InputError(option, what, remedy)
    plant = read_plant(args.plant)
    limits = _limits(args.config, plant)
    compare_with_bundle(plant, args.plant, files, "this plan")
    # CasADi and SciPy are loaded here, so that a wrong option is refused at once.
    from models.plan.planning import PlanRequest, plan_path, shortest_move_s

    payloads = tuple(args.payloads or (plant.link or STUDY_LINK).payloads_kg)
    steps = 1 + feedback + args.probe + len(payloads) if method == "inverse" else 1
    progress = Progress("plan", steps)
    request = PlanRequest(
        plant, dof, period_s, limits, payloads, files.manifest_sha256, method, feedback, args.probe
    )
    if args.fastest:
        seconds = shortest_move_s(lambda s: _path(args, dof, period_s, s), request)
        path = _path(args, dof, period_s, seconds)
    _write(args, plan_path(path, request, progress.step))
    return DONE


def _improve(args: argparse.Namespace, files: BundleFiles) -> int:
    plan = read_tip_plan(Path(args.path))
    if plan.bundle_sha256 != files.manifest_sha256:
        raise InputError(
            args.path, f"was made for another bundle than {args.bundle}", "name its bundle"
        )
    from models.plan.learning import improve_plan, read_plan_run

    recorded = read_plan_run(args.improve, plan)
    if beyond := recording_beyond_plan(plan, recorded.payload_kg):
        print(f"warning: {args.improve}: {beyond}", file=sys.stderr)
    plant = read_plant(args.plant)
    compare_with_bundle(plant, args.plant, files, "this plan")
    improved, went_back = improve_plan(plan, recorded, plant, _limits(args.config, plant))
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
        args, improved, lines,
        learned=[msgspec.to_builtins(r) for r in improved.learned], went_back=went_back,
    )  # fmt: skip
    return DONE


def _path(args: argparse.Namespace, dof: int, period_s: float, move_s: float) -> DesiredPath:
    options = PathOptions(
        args.size, tuple(args.centre), args.seconds, args.turns, math.radians(args.angle_deg),
        move_s,
    )  # fmt: skip
    if not args.path.lower().endswith(".csv"):
        return built_in_path(args.path, dof, period_s, options)
    if options != PathOptions():
        raise InputError(
            args.path, "contains size, place and time",
            "leave --size, --centre, --seconds, --turns, --angle-deg and --move out",
        )  # fmt: skip
    return read_path(Path(args.path), dof, period_s)


def _limits(path: Path | None, plant: Plant) -> Limits:
    """Limits of a robot; the default holds for servos without a bus watchdog as well."""
    if path is not None:
        return read_config(path).limits_in_force
    limits = msgspec.structs.replace(Limits(), rate_rad_s=UNWATCHED_RATE_RAD_S)
    return limits_of_link(plant.link, limits, given=()) if plant.link else limits


def _write(
    args: argparse.Namespace, plan: TipPlan, lines: Sequence[str] = (), **further: Any
) -> None:
    """Write a plan and its picture, and print both."""
    from models.plan.picture import draw_plan

    args.out.parent.mkdir(parents=True, exist_ok=True)
    write_document(args.out, plan)
    picture = args.out.with_suffix(".svg")
    draw_plan(plan, picture)
    errors = ("payload_kg", "residual_rms_m", "rigid_rms_m", "expected_rms_m")
    result = {
        "plan": str(args.out), "path": plan.path, "seconds": plan.duration_s,
        "plant_error_rms_m": plan.plant_error_rms_m,
        "payloads": [{name: getattr(one, name) for name in errors} for one in plan.payloads],
    }  # fmt: skip
    emit(args, result | further, "\n".join([*lines, *_in_words(plan, args.out), f"see {picture}"]))


def _in_words(plan: TipPlan, out: Path) -> list[str]:
    lines = [
        f"{out}: {plan.path}, {plan.method}, {plan.duration_s:.1f} s with rest and ways, "
        f"{plan.dof}DOF",
        "tip error in mm, RMS    predicted  expected     rigid  largest current",
    ]
    for one in plan.payloads:
        lines.append(
            f"  {one.payload_kg:4g} kg            {LENGTH.number(one.residual_rms_m, 2):>10}"
            f"{LENGTH.number(one.expected_rms_m, 2):>10}{LENGTH.number(one.rigid_rms_m):>10}"
            f"{CURRENT.text(np.max(np.abs(one.current_a))):>17}"
        )
    if any(run.source == "mocap" for run in plan.learned):
        lines.append(
            "no feedback of the tip: it would lead the observer's tip onto the path and undo what "
            "was learned from motion capture"
        )
    elif plan.feedback is not None:
        margins = [m for of_joint in plan.feedback.margins for m in of_joint]
        lines.append(
            f"feedback of the tip: gain margin {min(m.gain_db for m in margins):.1f} dB, phase "
            f"margin {ANGLE.text(min(m.phase_rad for m in margins))} at least over the grid"
        )
    elif plan.method == "inverse":
        lines.append("no feedback of the tip")
    if plan.probe is not None:
        from models.plan.probing import expected_deviation

        known, unknown = (
            max(expected_deviation(plan.probe, float(kg), known=known) for kg in plan.grid_kg)
            for known in (True, False)
        )
        lines.append(
            f"a probing motion of {TIME.text(plan.probe.rows * plan.period_s, 1)} before the first "
            f"run measures the stiffness to ± {known:.0%} where the payload is known, "
            f"± {unknown:.0%} where it is not"
        )
    if plan.plant_error_rms_m is None:
        lines.append("the plant does not state its error: expected is what the inversion leaves")
    return lines
