"""Evaluation of a plant on trials: the twin runs each trial's goals, signal by signal.

The error of the end effector is stated as it is, with the clock of each trial's motion capture
refitted, and beside that of a rigid link at the measured angles.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import msgspec

from firmware_py.core.console import DONE, emit
from models.plant.identification.doubts import evaluation_doubts, refuse_other_links
from models.plant.identification.evaluation import evaluate_plant
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
    emit(args, msgspec.to_builtins(result), result.summary())
    for warning in evaluation_doubts(result, plant):
        print(f"warning: {warning}", file=sys.stderr)
    return DONE
