"""Evaluation of a plant on trials: the twin runs each trial's goals, signal by signal.

The error of the end effector is given beside that of a rigid link at the measured angles.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import msgspec

from firmware_py.console import DONE, emit
from firmware_py.display_units import LENGTH
from models.plant.document import Evaluation
from models.plant.identification.doubts import evaluation_doubts, refuse_other_links
from models.plant.identification.evaluation import evaluate_plant
from models.plant.plant import read_plant
from models.trials.checks.trials import read_usable_trials

EXAMPLE = "dropstitch evaluate build/unseen_20deg --plant build/plant.json"


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
        lines += ["", f"{'end effector':14s}{'plant, mm':>12s}{'rigid, mm':>14s}"]
        for dof, part in result.dof.items():
            rows = {f"{load} kg": row for load, row in part.payloads.items()} | {"all": part}
            lines += [
                f"{dof}DOF {label:9s}{_millimetres(row.tip_rms_m):>12s}"
                f"{_millimetres(row.rigid_tip_rms_m):>14s}"
                for label, row in rows.items()
            ]
    return "\n".join(lines)


def _millimetres(length_m: float | None) -> str:
    return "" if length_m is None else f"{LENGTH.number(length_m, 2)}"
