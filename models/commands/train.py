"""Training of the robot's tip predictor of one dof, its tests, and the bundle.

By default the robot gets the observer's tip with an interval that is calibrated on payloads and
motions left out of training. --compare also trains the other candidates (polynomials, boosted
trees, a perceptron), and the robot gets the best of them; --candidate adds yours. --study
writes study.json: the paper's tables and findings on these trials.

Predictors are trained on trial 1 of the largest amplitude and tested on its repetitions (trial_2)
and on an unseen motion: trials of --unseen, or trials of a smaller amplitude in DIR. The plant
comes from `identify`; its observer gives the DI that the robot will have.

A 2DOF predictor for the robot needs trials in which the joints move independently: joints that
always move together are one input. --phase-deg selects phases, for a study of one phase.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from pathlib import Path

from firmware_py.core.console import DONE, NEGATIVE, Progress, emit
from firmware_py.core.errors import InputError
from models.shared.output_paths import check_output_directory
from models.trials.files import read_trials
from models.trials.trial import Trial

EXAMPLE = (
    "dropstitch train build/trials --dof 1 --plant build/plant.json "
    "--out build/bundle_1dof --motions build/unseen_multisine"
)


def configure(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("trials", type=Path, metavar="DIR", help="trials to train and test on")
    add("--dof", type=int, choices=(1, 2), required=True, help="driven joints")
    add("--plant", type=Path, required=True, metavar="PLANT", help="identified plant")
    add(
        "--out", type=Path, required=True, metavar="BUNDLE",
        help="directory of the bundle; the files of an old bundle there are replaced, others stay",
    )  # fmt: skip
    for option, help_text in (
        ("--unseen", "trials of motions that neither training nor identification used"),
        ("--motions", "trials of further motions to train the robot's predictor on, not the study"),
    ):
        add(option, type=Path, nargs="+", default=[], metavar="DIR", help=help_text)
    add("--compare", action="store_true", help="compare all candidates; the robot gets the best")
    add(
        "--candidate", type=Path, action="append", default=[], metavar="FILE.py",
        help="compare your candidate, too; the file is run; repeatable",
    )  # fmt: skip
    add("--study", action="store_true", help="write the paper's study of these trials, study.json")
    add(
        "--study-only", action="store_true",
        help="the study alone: the bundle holds the paper's polynomial",
    )  # fmt: skip
    add(
        "--phase-deg", type=float, action="append", default=[], metavar="DEG",
        help="only 2DOF trials with this lead of joint 2; repeatable (default: all)",
    )  # fmt: skip
    add(
        "--askew-deg", type=float, metavar="DEG",
        help="angle by which the link may be mounted askew, which no servo sees and the interval "
        "covers; 0 where the mount is exact (default: 0.29, 5 mm at the tip)",
    )  # fmt: skip


def run(args: argparse.Namespace) -> int:
    if args.study_only and (args.candidate or args.compare):
        option = "--candidate" if args.candidate else "--compare"
        raise InputError(option, "changes nothing with --study-only", "leave out one")
    check_output_directory(args.out)
    # scikit-learn and CasADi are loaded here, so that a wrong option is refused at once.
    from models.bundle.files import ParityError, check_bundle_directory
    from models.bundle.train import ASKEW_RAD, of_phases, train
    from models.plant.plant import read_plant
    from models.predictor.candidates import CANDIDATES, DEFAULT_CANDIDATES, load_candidate

    check_bundle_directory(args.out)

    def read(directories: Sequence[Path]) -> list[Trial]:
        parts = [of_phases(read_trials(path), args.phase_deg, path) for path in directories]
        return [trial for part in parts for trial in part]

    askew_rad = ASKEW_RAD if args.askew_deg is None else math.radians(args.askew_deg)
    trials, unseen, motions = map(read, ([args.trials], args.unseen, args.motions))
    plant = read_plant(args.plant)
    candidates = CANDIDATES if args.compare else DEFAULT_CANDIDATES
    for path in args.candidate:
        candidates = (*candidates, load_candidate(path, candidates))
    try:
        result = train(
            trials, plant, args.out, dof=args.dof, unseen=unseen, motions=motions,
            candidates=() if args.study_only else candidates,
            study=args.study or args.study_only, askew_rad=askew_rad,
            report=Progress(f"train {args.dof}DOF", 0).step,
        )  # fmt: skip
    except ParityError as error:
        emit(args, {"verdict": "no parity", "reason": str(error)}, str(error))
        return NEGATIVE
    emit(args, result.as_json(), result.summary())
    for warning in result.doubts:
        print(f"warning: {warning}", file=sys.stderr)
    return DONE
