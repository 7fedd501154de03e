"""Simulate an FMU in FMPy along a motion or a trial.

A twin FMU gets the goals and the payload. An observer or predictor FMU gets measured angles and
currents, from a trial or from the twin of the same plant. Writes result.csv and result.svg.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

from firmware_py.core.console import DONE, emit
from firmware_py.core.errors import InputError
from firmware_py.core.motion import KINDS, STUDY_PERIOD_S, Motion
from firmware_py.core.signals import PERIOD_S

EXAMPLE = "dropstitch fmu simulate build/twin_1dof.fmu --payload-kg 1 --out build/twin_run"


def configure(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("file", type=Path, metavar="FILE.fmu", help="the FMU")
    add("--out", type=Path, required=True, metavar="DIR", help="where result.csv and .svg go")
    add("--trial", type=Path, metavar="TRIAL.csv", help="take the inputs from this trial")
    add("--motion", choices=KINDS, default="sinusoid", help="reference motion (sinusoid)")
    add("--amplitude-deg", type=float, default=30.0, metavar="DEG", help="largest goal (30)")
    add("--period", type=float, default=STUDY_PERIOD_S, metavar="S", help="of the motion (4.352)")
    add("--phase-deg", type=float, default=0.0, metavar="DEG", help="lead of joint 2 (0)")
    add(
        "--payload-kg", type=float, metavar="KG",
        help="mass at the tip in kg (half of the link's largest: 1 for the study's)",
    )  # fmt: skip
    add("--step", type=float, default=PERIOD_S, metavar="S", help="communication step (0.017)")
    add(
        "--set", action="append", default=[], metavar="NAME=VALUE",
        help="parameter to set before the start, like parameters.link_mass_kg=1.2; repeatable",
    )  # fmt: skip


def run(args: argparse.Namespace) -> int:
    if not (math.isfinite(args.step) and 0 < args.step <= 1):
        raise InputError(
            f"--step {args.step}", "is not a step size", "choose more than 0, at most 1 s"
        )
    from fmu.fmpy_run import simulate_fmu
    from models.shared.drawing import save_svg
    from models.trials.files import read_trial

    trial = read_trial(args.trial) if args.trial else None
    motion = Motion(
        args.motion, math.radians(args.amplitude_deg), args.period, math.radians(args.phase_deg)
    )
    result = simulate_fmu(
        args.file, trial or motion, args.payload_kg, args.step, _assignments(args.set)
    )
    args.out.mkdir(parents=True, exist_ok=True)
    result.write(args.out / "result.csv")
    save_svg(result.plot(), args.out / "result.svg")
    rms = result.rms_against_trial()
    data = {"rows": len(result.time_s), "out": str(args.out), "rms": rms, "units": result.units}
    lines = [f"{name:20s} {value:.4g} {result.units[name]} RMS" for name, value in rms.items()]
    lines.append(f"{len(result.time_s)} rows to {args.out}/result.csv, plot in result.svg")
    emit(args, data, "\n".join(lines))
    return DONE


def _assignments(arguments: list[str]) -> dict[str, float]:
    values = {}
    for argument in arguments:
        name, _, text = argument.partition("=")
        try:
            values[name] = float(text)
        except ValueError:
            raise InputError(
                f"--set {argument}", f"{text!r} is not a number", "write NAME=VALUE"
            ) from None
    return values
