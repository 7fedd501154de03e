"""Evaluation of a plant on trials: the twin runs each trial's goals, signal by signal.

The error of the end effector is stated as it is, with the clock of each trial's motion capture
refitted, and beside that of a rigid link at the measured angles.
"""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path

import msgspec

from firmware_py.core.console import DONE, emit
from firmware_py.core.units import LENGTH
from models.plant.document import Evaluation
from models.plant.identification.doubts import evaluation_doubts, refuse_other_links
from models.plant.identification.evaluation import CLOCK_LIMIT_S, evaluate_plant
from models.plant.plant import read_plant
from models.trials.checks.trials import read_usable_trials

EXAMPLE = "dropstitch evaluate build/unseen_multisine --plant build/plant.json"


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("trials", type=Path, metavar="DIR", help="directory of trials")
    parser.add_argument("--plant", type=Path, required=True, metavar="PLANT", help="plant document")


def run(args: argparse.Namespace) -> int:
    plant = read_plant(args.plant)
    trials = read_usable_trials([args.trials], plant.signals)
    refuse_other_links(plant, args.plant, trials)
    result = evaluate_plant(plant, trials)
    emit(args, msgspec.to_builtins(result), evaluation_text(result))
    for warning in evaluation_doubts(result, plant):
        print(f"warning: {warning}", file=sys.stderr)
    return DONE


def evaluation_text(result: Evaluation) -> str:
    """Tables for the console: signals in SI units, end effector in mm."""
    lines = [f"{'signal':14s}{'rms':>12s}{'mean |error|':>14s}  unit"]
    lines += [
        f"{name:14s}{row.rms:12.4g}{row.mae:14.4g}  {row.unit}"
        for name, row in result.signals.items()
    ]
    if result.tip_rms_m is not None:
        titles = ("plant, mm", "clock refitted", "rigid, mm")
        lines += ["", f"{'end effector':14s}" + "".join(f"{title:>16s}" for title in titles)]
        for dof, part in result.dof.items():
            rows = {f"{load} kg": row for load, row in part.payloads.items()} | {"all": part}
            for label, row in rows.items():
                errors_m = (row.tip_rms_m, row.clock_tip_rms_m, row.rigid_tip_rms_m)
                texts = ("" if m is None else LENGTH.number(m, 2) for m in errors_m)
                lines.append(f"{dof}DOF {label:9s}" + "".join(f"{text:>16s}" for text in texts))
        lines += ["", clock_sentence(result)]
    return "\n".join(lines)


def clock_sentence(result: Evaluation) -> str:
    """Say which part of the tip's error is the plant's, and which that of the clocks."""
    whole_m, plant_m = result.tip_rms_m or 0.0, result.clock_tip_rms_m or 0.0
    clock_m = math.sqrt(max(whole_m**2 - plant_m**2, 0.0))
    clocks_ms = [1e3 * clock_s for clock_s in result.clocks_s.values()]
    text = (
        f"of {LENGTH.text(whole_m)} RMS, {LENGTH.text(clock_m)} is the motion capture's clock "
        f"({min(clocks_ms):.1f} to {max(clocks_ms):.1f} ms from trial to trial); with each trial's "
        f"clock refitted {LENGTH.text(plant_m)}"
    )
    common_ms = sum(clocks_ms) / len(clocks_ms)
    if abs(common_ms) > 0.5:  # A good plant has less [assumed].
        text += f"; all trials share {common_ms:.1f} ms, which may be a delay that the plant lacks"
    limit_s = (1 - 1e-3) * CLOCK_LIMIT_S
    at_limit = [name for name, clock_s in result.clocks_s.items() if abs(clock_s) > limit_s]
    if at_limit:
        limit = f"at the limit of {1e3 * CLOCK_LIMIT_S:g} ms, so the clock may be off by more"
        text += f"; {limit}: " + ", ".join(at_limit)
    return text
