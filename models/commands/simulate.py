"""Simulation of trials on a rig, a model of the robot, with the study's protocol.

Every trial settles, runs the motion once as a warm-up (discarded), settles again, rests for 60
rows and then runs the motion that is recorded. The paper gives no phase between the joints of
2DOF: at --phase-deg 0 both move together, at 90 the tip moves on an ellipse. A second run with the
same options writes the same trials again; other files in DIR stay.
"""

from __future__ import annotations

import argparse
import math
import os
import sys
from pathlib import Path

import msgspec

from firmware_py.core.console import DONE, Progress, emit
from firmware_py.core.errors import InputError
from firmware_py.core.motion import KINDS, STUDY_PERIOD_S, MotionConfig
from firmware_py.link.link_description import STUDY_LINK, LinkDescription
from models.rig.drawn import rig_named
from models.rig.parameters import RigParameters
from models.rig.protocol import (
    RigConditions,
    TrialCase,
    record_conditions,
    run_trial_cases,
)
from models.shared.catalogue import parse_strengths
from models.shared.link_scale import LinkScale
from models.shared.output_paths import check_output_directory

EXAMPLE = "dropstitch simulate --out build/trials --dof 1 2 --hide backlash=0.01"


def configure(parser: argparse.ArgumentParser) -> None:
    add, cores = parser.add_argument, os.cpu_count() or 1
    # fmt: off
    add("--out", type=Path, required=True, metavar="DIR", help="directory of the trials")
    add("--dof", type=int, nargs="+", choices=(1, 2),
        help="driven joints (1, or those of a link's file)")
    add("--payloads", type=float, nargs="+", metavar="KG",
        help="payloads in kg (0 0.5 1 1.5 2, or five up to the payload_kg of a link's file)")
    add("--trials", type=int, default=2, metavar="N", help="repetitions of each payload (2)")
    add("--seed", type=int, default=0, help="of all variation and noise (0)")
    add("--motion", default="sinusoid", metavar="KIND|FILE",
        help=f"reference motion: {', '.join(KINDS)}, or a motion file (sinusoid)")
    add("--amplitude-deg", type=float, default=30.0, metavar="DEG", help="largest goal (30)")
    add("--period", type=float, default=STUDY_PERIOD_S, metavar="S",
        help="cycle of the sinusoid; other motions scale with it (4.352)")
    add("--phase-deg", type=float, metavar="DEG",
        help="lead of joint 2 (0, or 90 of a link's file with two joints)")
    add("--hide", action="append", default=[], metavar="EFFECT[:JOINT]=STRENGTH",
        help="add an effect to the rig's defaults, with JOINT in that servo alone; repeatable; "
        "names and units: 'dropstitch list effects'")
    add("--pressure-pa", type=float, metavar="PA",
        help="inflation pressure (41300, or that of a link's file)")
    add("--gravity", type=float, nargs=3, metavar=("X", "Y", "Z"),
        help="direction of gravity, z along the link at zero angle (0 0 -1, or that of a link's "
        "file)")
    add("--rig", default="default", metavar="NAME|TOML",
        help="structure ('dropstitch list rigs'), a file that changes it, or a link's (default)")
    add("--workers", type=int, default=cores, metavar="N", help="processes (all cores)")
    # fmt: on


def run(args: argparse.Namespace) -> int:
    nominal, hidden = rig_named(args.rig), parse_strengths(args.hide)
    cases = _cases(args, nominal)
    rig = nominal.hide(hidden)
    conditions = RigConditions(
        seed=args.seed,
        hidden=hidden,
        rig_sha256=rig.sha256(),
        rig=args.rig,
        structure=rig.structure,
    )
    inputs = (Path(args.motion), Path(args.rig))
    check_output_directory(args.out, [f"{case.name}.toml" for case in cases], inputs)
    record_conditions(cases, conditions, args.out)
    progress = Progress("simulate", len(cases))
    paths = run_trial_cases(cases, rig, args.out, args.workers, progress.step)
    from models.rig.overview import draw_overview  # loads Matplotlib

    overview = draw_overview(args.out)
    emit(
        args,
        {"trials": [str(path) for path in paths], "overview": str(overview), "hidden": hidden},
        f"{len(paths)} trials in {args.out}; look at {overview}",
    )
    return DONE


def _cases(args: argparse.Namespace, rig: RigParameters) -> list[TrialCase]:
    """Trials of the options; what the user omits is that of the described link.

    Joints that move together cannot be separated, so only the study's protocol has phase 0 by
    default.
    """
    link = rig.link or STUDY_LINK
    dof = args.dof or [rig.link.joints if rig.link else 1]
    payloads_kg = args.payloads or link.payloads_kg
    pressure_pa = link.pressure_pa if args.pressure_pa is None else args.pressure_pa
    gravity = tuple(args.gravity or link.gravity.unit)
    phase_deg = args.phase_deg
    if phase_deg is None:
        phase_deg = 90.0 if rig.link and dof == [2] else 0.0
    most_payload_kg = rig.link.most_payload_kg if rig.link else 10
    pressure = rig.entries["stiffness.pressure_pa"]
    ranges: list[tuple[str, float, float, float]] = [
        ("--trials", args.trials, 1, 1000),
        ("--seed", args.seed, 0, 2**32 - 1),
        ("--phase-deg", phase_deg, -360, 360),
        ("--pressure-pa", pressure_pa, pressure.minimum, pressure.maximum),
        ("--workers", args.workers, 1, 1024),
        *(("--payloads", kg, 0, most_payload_kg) for kg in payloads_kg),
        *(("--gravity", g, -1e6, 1e6) for g in gravity),
    ]
    for option, value, low, high in ranges:
        if not low <= value <= high:
            remedy = f"choose {low:g} to {high:g}"
            if rig.link and option == "--payloads":
                remedy += f", or raise payload_kg in {rig.path}"
            raise InputError(f"{option} {value:g}", "is out of range", remedy)
    if not any(gravity):
        raise InputError("--gravity 0 0 0", "has no direction", "give one, like 0 0 -1")
    if rig.link:
        _warn_of_weight(rig.link, max(payloads_kg))
    motion = MotionConfig(
        amplitude_rad=math.radians(args.amplitude_deg),
        period_s=args.period,
        phase_2_rad=math.radians(phase_deg),
    ).with_motion(args.motion)
    return [
        TrialCase(motion.motion(joints), payload_kg, trial, args.seed, pressure_pa, gravity)
        for joints in sorted(set(dof))
        for payload_kg in sorted(set(payloads_kg))
        for trial in range(1, args.trials + 1)
    ]


def _warn_of_weight(link: LinkDescription, payload_kg: float) -> None:
    used = LinkScale(msgspec.structs.replace(link, payload_kg=payload_kg)).holding_of_limit
    if used > 1:
        print(
            f"warning: the weight takes {used:.0%} of the torque of {link.servo.model}, "
            "which cannot hold it; lower the payload or take a stronger servo",
            file=sys.stderr,
        )
