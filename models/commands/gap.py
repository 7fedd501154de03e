"""Diagnosis of the difference between plant and measurement: missing effects are named and added.

Writes OUT/gap.json (results), OUT/plant.json (the improved plant) and OUT/report.html.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import msgspec

from firmware_py.console import DONE, NEGATIVE, Progress, emit
from models.plant.plant import read_plant
from models.trials.trial_files import read_trials

EXAMPLE = "python -m models gap build/gap_trials --plant build/plant.json --out build/gap"


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("trials", type=Path, metavar="DIR", help="directory of trials")
    parser.add_argument("--plant", type=Path, required=True, help="plant to compare with")
    parser.add_argument("--out", type=Path, required=True, help="directory to write")
    parser.add_argument(
        "--dof", type=int, choices=(1, 2), help="joints of the trials to look at, where both are"
    )
    parser.add_argument(
        "--without", action="append", default=[], metavar="EFFECT",
        help="leave an effect out of the catalogue; repeatable",
    )  # fmt: skip


def run(args: argparse.Namespace) -> int:
    """Diagnose, write and print."""
    plant = read_plant(args.plant)
    trials = read_trials(args.trials, plant.signals)
    # CasADi and SciPy are loaded here, so that a wrong option is refused at once.
    from models.gap.diagnosis import diagnose
    from models.gap.report.gap_json import write_gap_document
    from models.gap.report.gap_page import write_gap_page
    from models.gap.report.gap_results import gap_document
    from models.gap.report.gap_words import gap_in_words
    from models.gap.report.waterfall import waterfall_steps

    if args.dof is not None:
        trials = trials.where(lambda t: t.meta.dof == args.dof)
    progress = Progress("gap", 12)
    found = diagnose(plant, trials, progress.step, args.without)
    document = gap_document(found, trials, waterfall_steps(found, found.trials))
    args.out.mkdir(parents=True, exist_ok=True)
    write_gap_document(args.out / "gap.json", document)
    found.improved.write(args.out / "plant.json")
    page = write_gap_page(document, found.plant, found.improved, trials, args.out / "report.html")
    progress.total = progress.done + 1
    progress.step("done")
    emit(args, msgspec.to_builtins(document), f"{gap_in_words(document)}\n{page}")
    return NEGATIVE if found.verdict == "not in the catalogue" else DONE
