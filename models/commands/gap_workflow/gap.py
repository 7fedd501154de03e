"""Diagnosis of the difference between plant and measurement: missing effects are named and added.

Writes OUT/gap.json (results), OUT/plant.json (the improved plant) and OUT/report.html.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Final

import msgspec

from firmware_py.core.console import DONE, NEGATIVE, Progress, emit
from firmware_py.core.errors import InputError
from firmware_py.core.input_files import resolved
from models.plant.plant import read_plant
from models.shared.output_paths import check_output_directory
from models.trials.files import read_trial_directories

EXAMPLE = "dropstitch gap build/gap_trials --plant build/plant.json --out build/gap"

DIAGNOSIS_FILES: Final = ("gap.json", "plant.json", "report.html")
"""Files that `models.gap.report.gap_page.write_results` writes to a directory."""


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "trials", type=Path, nargs="+", metavar="DIR",
        help="directory of trials; several are diagnosed together",
    )  # fmt: skip
    parser.add_argument(
        "--plant", type=Path, required=True, metavar="PLANT", help="plant to compare with"
    )
    parser.add_argument("--out", type=Path, required=True, help="directory to write")
    parser.add_argument(
        "--dof", type=int, choices=(1, 2), help="joints of the trials to look at, where both are"
    )
    parser.add_argument(
        "--without", action="append", default=[], metavar="EFFECT",
        help="leave an effect out of the catalogue; repeatable",
    )  # fmt: skip
    parser.add_argument(
        "--same-link", action="store_true",
        help="the link is the one that the plant was identified on, unchanged since: fainter "
        "effects show then, as creep and hysteresis",
    )  # fmt: skip


def run(args: argparse.Namespace) -> int:
    check_output_directory(args.out, DIAGNOSIS_FILES, [args.plant])
    plant = read_plant(args.plant)
    trials = read_trial_directories(args.trials, plant.signals)
    # CasADi and SciPy are loaded here, so that a wrong option is refused at once.
    from models.gap.diagnosis import diagnose
    from models.gap.report.gap_json import DiagnosisInputs
    from models.gap.report.gap_page import write_results
    from models.gap.report.gap_words import gap_in_words
    from models.gap.settings import GapSettings
    from models.plant.identification.doubts import evaluation_doubts
    from models.plant.identification.evaluation import evaluate_plant

    if args.dof is not None:
        trials = trials.where(lambda t: t.meta.dof == args.dof)
        if not len(trials):
            raise InputError(
                f"--dof {args.dof}", "is the number of joints of no trial", "leave it out"
            )
    progress = Progress("gap", 0)
    inputs = DiagnosisInputs(
        str(resolved(args.plant)), plant.sha256(), tuple(str(resolved(d)) for d in args.trials),
        trials.content_sha256(), args.dof,
    )  # fmt: skip
    settings = GapSettings(same_link=args.same_link)
    diagnosis = diagnose(plant, trials, progress.step, args.without, settings)
    document, page = write_results(diagnosis, inputs, args.out)
    progress.step("done", 0)
    emit(
        args,
        msgspec.to_builtins(document),
        f"{gap_in_words(document, str(args.out / 'gap.json'))}\n{page}",
    )
    if diagnosis.verdict != "not in the catalogue":
        return DONE
    for warning in evaluation_doubts(evaluate_plant(plant, diagnosis.trials), plant):
        print(f"warning: {warning}", file=sys.stderr)
    return NEGATIVE
