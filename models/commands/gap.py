"""Find where plant and measurement disagree, name the missing effect and add it.

Writes OUT/gap.json (what was found), OUT/plant.json (the plant with it) and OUT/report.html.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

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
    from models.gap.diagnosis import (
        diagnose,  # loads CasADi and SciPy, which a typo need not wait for
    )
    from models.gap.report.gap_json import gap_document, gap_in_words
    from models.gap.report.gap_page import write_gap_page
    from models.gap.report.waterfall import waterfall_steps

    if args.dof is not None:
        trials = trials.where(lambda t: t.meta.dof == args.dof)
    progress = Progress("gap", 12)
    found = diagnose(plant, trials, progress.step, args.without)
    data = gap_document(found, trials)
    data["waterfall"] = [
        {"step": step, "floors": floors} for step, floors in waterfall_steps(found, trials)
    ]
    args.out.mkdir(parents=True, exist_ok=True)
    (args.out / "gap.json").write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")
    found.improved.write(args.out / "plant.json")
    report = write_gap_page(data, found.plant, found.improved, trials, args.out / "report.html")
    progress.total = progress.done + 1
    progress.step("done")
    emit(args, data, f"{gap_in_words(data)}\n{report}")
    return NEGATIVE if found.verdict == "not in the catalogue" else DONE
