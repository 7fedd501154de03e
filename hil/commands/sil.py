"""Run the robot's loop in software against emulated servos, and judge its timing.

Writes to OUT: timing.json and timing.xml (the verdict), ticks.mcap (the robot's log), trial/sil.csv
(the run as a trial, with the true tip), summary.svg. Exit 0: pass. Exit 1: the loop itself missed
deadlines, or the safety supervisor stopped it. Exit 3, inconclusive: the host caused the misses,
the run was too short for the miss rate asked for, or a signal ended it.

With --rig, the rig is simulated behind the servos instead of a twin, on the virtual line. This
tests the robot's prediction on a link that no plant describes exactly.
"""

from __future__ import annotations

import argparse
import contextlib
import math
import sys
from dataclasses import replace
from pathlib import Path
from typing import Final, get_args

import msgspec

from firmware_py.bus.servo_models import model_named
from firmware_py.core.console import emit
from firmware_py.core.errors import InputError
from firmware_py.core.motion import KINDS, STUDY_PERIOD_S, MotionConfig
from firmware_py.goals.for_robot import outside_goals
from firmware_py.goals.tip_plan import read_tip_plan
from firmware_py.inference.bundle import ModelBundle
from hil.commands.emulate import add_line_arguments
from hil.emulator.line_faults import parse_rates
from hil.emulator.physics import RigSource
from hil.sil import LineKind, SilOptions, run_sil
from hil.sil.sil_options import DERIVED, sil_config
from hil.sil.sil_results import timing_in_words
from hil.sil.timing_document import TimingDocument
from hil.sil.timing_verdict import MISS_RATE
from models.shared.catalogue import parse_strengths

EXAMPLE = (
    "dropstitch sil --bundle build/bundle_1dof --fmu build/twin_1dof.fmu --out build/sil "
    "--seconds 60 --load 1"
)

PATIENCE_S: Final = 2.0
"""Longest wait for the goal of the other program, in each tick of simulated time [assumed]."""


def configure(parser: argparse.ArgumentParser) -> None:
    # fmt: off
    add = parser.add_argument
    add("--bundle", type=Path, required=True, metavar="BUNDLE", help="bundle of the robot")
    add("--runtime", choices=("onnx", "compiled"),
        help="what evaluates the predictor (default: compiled, where the bundle has it)")
    add("--out", type=Path, required=True, help="directory for the results")
    add("--fmu", type=Path, help="twin behind the servos (default: built from the bundle's plant)")
    add("--rig", nargs="?", const="default", metavar="RIG",
        help="put the rig behind the servos instead; RIG is a structure, a file that changes it, "
        "or the file of a link")
    add("--hide", action="append", default=[], metavar="EFFECT[:JOINT]=STRENGTH",
        help="with --rig: add an effect to what the rig has; repeatable")
    add("--line", choices=get_args(LineKind), default="socket",
        help="socket for timing claims, pty as with any program, virtual clock (default: socket)")
    add("--seconds", type=float,
        help="duration (default: what --miss-rate needs, 10 on the virtual line, or the runs of "
        "the plan)")
    add("--miss-rate", type=float, default=MISS_RATE, metavar="RATE",
        help="in real time: miss rate that the run has to bound with 95 %% confidence "
        f"(default: {MISS_RATE:g})")
    add("--plan", type=Path, metavar="PLAN",
        help="plan of a path of the tip instead of the motion, see 'dropstitch plan'")
    add("--runs", type=int, default=1, help="with --plan: times to run it (1)")
    add("--open-loop", action="store_true", help="run the plan without feedback of the tip")
    add("--goals", metavar="unix:PATH",
        help="goals of another program, see 'dropstitch run --goals'")
    add("--goal-map", type=Path, metavar="MAP", help="with --goals: see 'dropstitch goalmap'")
    add("--payload-known", action="store_true",
        help="tell the robot the payload (default: it estimates it)")
    add("--motion", default="sinusoid", metavar="KIND|FILE",
        help=f"{', '.join(KINDS)}, or a motion file (default: sinusoid)")
    add("--amplitude-deg", type=float, default=30.0)
    add("--period", type=float, default=STUDY_PERIOD_S, help="of a cycle, s")
    add("--phase-deg", type=float, default=0.0, help="of joint 2")
    add("--load", type=int, default=0, metavar="N",
        help="processes that load the other processor; declared host load")
    # fmt: on
    add_line_arguments(parser)


def run(args: argparse.Namespace) -> int:
    options = _options(args)
    with contextlib.ExitStack() as stack:
        if args.goals is not None:
            patience_s = PATIENCE_S if args.line == "virtual" else 0.0
            config = sil_config(options, options.line)
            goals = stack.enter_context(
                outside_goals(args.goals, args.goal_map, config, options.bundle, patience_s)
            )
            options = replace(options, goals=goals)
        if options.goals_note:
            print(f"dropstitch: {options.goals_note}", file=sys.stderr)
        result = run_sil(options)
    result.write()
    timing = result.timing
    emit(args, msgspec.to_builtins(timing), describe_sil(timing, args.out))
    return timing.verdict.exit_code


def _options(args: argparse.Namespace) -> SilOptions:
    """Return the options of the run, which check themselves."""
    if args.goal_map is not None and args.goals is None:
        raise InputError("--goal-map", "is given without --goals", "leave it out")
    if args.goals is not None and args.plan is not None:
        raise InputError("--goals", "cannot be used together with --plan", "leave one out")
    if args.open_loop and args.plan is None:
        raise InputError("--open-loop", "is given without --plan", "leave it out")
    effects = parse_strengths(args.hide)
    if effects and not args.rig:
        raise InputError("--hide", "needs the rig, not a twin", "add --rig")
    return SilOptions(
        plan=read_tip_plan(args.plan) if args.plan is not None else None,
        bundle=ModelBundle.load(args.bundle, runtime=args.runtime),
        out=args.out,
        fmu=args.fmu,
        rig=RigSource(effects, args.seed, args.rig) if args.rig else None,
        model=model_named(args.model) if args.model else DERIVED,
        line=args.line,
        seconds=args.seconds,
        miss_rate=args.miss_rate,
        baud=args.baud,
        latency_s=args.latency_ms * 1e-3,
        payload_kg=args.payload_kg,
        payload_known=args.payload_known,
        runs=args.runs,
        open_loop=args.open_loop,
        motion=MotionConfig(
            amplitude_rad=math.radians(args.amplitude_deg),
            period_s=args.period,
            phase_2_rad=math.radians(args.phase_deg),
        ).with_motion(args.motion),
        load=args.load,
        faults=parse_rates(args.faults),
        seed=args.seed,
    )


def describe_sil(timing: TimingDocument, out: Path) -> str:
    return f"{timing_in_words(timing)}\nsee {out}/summary.svg and timing.json"
