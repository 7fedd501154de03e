"""Training of the predictors of one dof, their tests, and the bundle.

The study compares the paper's polynomials on one motion. The robot gets the best of several
candidates (`models.predictor`), trained on the study's trials and on those of --motions and chosen by
payloads and motions left out.

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
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from firmware_py.console import DONE, NEGATIVE, Progress, emit
from firmware_py.errors import InputError
from models.bundle.files import check_bundle_directory
from models.commands.output_paths import check_output_directory
from models.plant.document import Provenance
from models.study.study import study_summary
from models.trials.checks.trials import read_usable_trials
from models.trials.files import STEP_TOLERANCE
from models.trials.trial import Trial, TrialSet, is_one_amplitude

if TYPE_CHECKING:
    from models.predictor.training import TipTraining
    from models.study.document import StudyDocument

EXAMPLE = (
    "dropstitch train build/trials --dof 1 --plant build/plant.json "
    "--out build/bundle_1dof --unseen build/unseen_20deg"
)
STEPS: Final = 20
"""Progress steps of a study before its tests: DI, 18 cross-validations and the fits."""
LARGEST_ASKEW_DEG: Final = 0.8
"""Largest angle of a link mounted askew: 14 mm at the tip; with 15 mm nothing would be in range."""


def configure(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("trials", type=Path, metavar="DIR", help="trials to train and test on")
    add("--dof", type=int, choices=(1, 2), required=True, help="driven joints")
    add("--plant", type=Path, required=True, metavar="PLANT", help="identified plant")
    add(
        "--out", type=Path, required=True, metavar="BUNDLE",
        help="directory of the bundle; the files of an old bundle there are replaced, others kept",
    )  # fmt: skip
    add(
        "--unseen", type=Path, nargs="+", default=[], metavar="DIR",
        help="trials of motions that neither training nor identification used",
    )  # fmt: skip
    add(
        "--motions", type=Path, nargs="+", default=[], metavar="DIR",
        help="trials of further motions to train the robot's predictor on, not the study",
    )  # fmt: skip
    add(
        "--study-only", action="store_true",
        help="compare no candidates: the bundle holds the study's polynomial",
    )  # fmt: skip
    add(
        "--candidate", type=Path, action="append", default=[], metavar="FILE.py",
        help="compare a candidate of one's own too; the file is run; repeatable",
    )  # fmt: skip
    add(
        "--phase-deg", type=float, action="append", metavar="DEG",
        help="only 2DOF trials with this lead of joint 2; repeatable (default: all)",
    )  # fmt: skip
    add(
        "--askew-deg", type=float, default=math.degrees(0.005), metavar="DEG",
        help="angle by which the link may be mounted askew, which no servo sees and the interval "
        "covers; 0 where the mount is exact (default: 0.29, 5 mm at the tip)",
    )  # fmt: skip


def run(args: argparse.Namespace) -> int:
    if not 0.0 <= args.askew_deg <= LARGEST_ASKEW_DEG:
        raise InputError(
            "--askew-deg", f"is {args.askew_deg:g}, not within 0 to {LARGEST_ASKEW_DEG:g}",
            "mount the link upright, or train on trials of it as it is",
        )  # fmt: skip
    if args.study_only and args.candidate:
        raise InputError("--candidate", "changes nothing with --study-only", "leave out one")
    check_output_directory(args.out)
    check_bundle_directory(args.out)
    everything = of_phases(read_usable_trials([args.trials]), args.phase_deg, args.trials)
    own = of_dof(everything, args.dof, args.trials)
    training, held_out = own.split()
    unseen = [t for where in args.unseen for t in _of_directory(where, args)]
    further = [t for where in args.motions for t in _of_directory(where, args)]
    tests = name_tests(training, (*held_out, *unseen))
    every = (*training, *held_out, *unseen, *further)
    refuse_mixed_steps(every)
    refuse_trained(further, (*held_out, *unseen))

    from models.bundle.files import ParityError, write_bundle  # loads scikit-learn
    from models.plant.identification.doubts import refuse_other_links
    from models.plant.plant import read_plant
    from models.study.findings import doubts_of_di
    from models.study.study import run_study

    plant = read_plant(args.plant)
    refuse_other_links(plant, args.plant, (*everything, *unseen, *further))
    refuse_fitted(plant.provenance, args.plant, tests)
    observer = plant.step_model(args.dof, "observer")
    from models.predictor.candidates import own_candidate
    from models.predictor.learners import CANDIDATES
    from models.predictor.training import train_tip
    from models.trials.checks.trials import judge_doubled, judge_not_fitted, judge_pressures

    candidates = CANDIDATES
    for path in args.candidate:
        candidates = (*candidates, own_candidate(path, candidates))
    steps = STEPS + len(tests) + (0 if args.study_only else len(candidates))
    progress = Progress(f"train {args.dof}DOF", steps)
    others, _ = everything.where(lambda t: t.meta.dof != args.dof).split()
    study = run_study(training, tests, observer, others, progress.step)
    tip = None
    if not args.study_only:
        together = (*training, *further)
        askew_rad = math.radians(args.askew_deg)
        tip = train_tip(together, tests, study.observer, candidates, progress.step, askew_rad)
    try:
        parity = write_bundle(args.out, study, plant, tip)
    except ParityError as error:
        emit(args, {"verdict": "no parity", "reason": str(error)}, str(error))
        return NEGATIVE
    doubts = doubts_of_di(study.document)
    found = [*judge_pressures((*training, *further)), *judge_doubled(every), *judge_not_fitted(own)]
    doubts += [f"{f.text}; {f.remedy}" for f in found]
    data = {"bundle": str(args.out), "parity": parity, "warnings": doubts}
    _report(args, study.document, tip, data)
    return DONE


def _report(
    args: argparse.Namespace, document: StudyDocument, tip: TipTraining | None, data: dict[str, Any]
) -> None:
    """Print results of the study and of the robot's predictor, and warnings."""
    pooled = {name: of["pooled"] for name, of in document.mean_euclidean_distance_m.items()}
    data |= {"degree": document.chosen_degree, "mean_euclidean_distance_m": pooled}
    text = study_summary(args.out, document)
    if tip:
        data["predictor"] = tip.document.chosen
        text = f"{text}\n  the robot gets: {tip.document.reason}"
    emit(args, data, text)
    for warning in data["warnings"]:
        print(f"warning: {warning}", file=sys.stderr)


def _of_directory(where: Path, args: argparse.Namespace) -> TrialSet:
    return of_dof(of_phases(read_usable_trials([where]), args.phase_deg, where), args.dof, where)


def refuse_trained(training: Sequence[Trial], tests: Sequence[Trial]) -> None:
    """Refuse a test trial that the robot's predictor is trained on."""
    trained = {t.sha256() for t in training}
    for t in tests:
        if t.sha256() in trained:
            raise InputError(
                t.path, "is a trial of --motions and a test", "name it in one of the two"
            )


def of_dof(trials: TrialSet, dof: int, where: Path) -> TrialSet:
    chosen = trials.where(lambda t: t.meta.dof == dof)
    if not chosen:
        raise InputError(where, f"holds no trial of {dof}DOF", f"simulate with --dof {dof}")
    return chosen


def of_phases(trials: TrialSet, phases_deg: Sequence[float] | None, where: Path) -> TrialSet:
    """All 1DOF trials, and the 2DOF trials at some phases of joint 2 in degrees; None keeps every
    trial.
    """
    if not phases_deg:
        return trials
    for wanted in phases_deg:
        if not any(t.meta.dof == 2 and phase_deg(t) == round(wanted) for t in trials):
            raise InputError(
                where, f"holds no 2DOF trial at phase {wanted:g} degrees",
                f"simulate with --dof 2 --phase-deg {wanted:g}",
            )  # fmt: skip
    kept = {round(wanted) for wanted in phases_deg}
    return trials.where(lambda t: t.meta.dof != 2 or phase_deg(t) in kept)


def phase_deg(trial: Trial) -> int:
    """Lead of joint 2 in whole degrees."""
    return round(math.degrees(trial.meta.phase_2_rad))


def refuse_mixed_steps(trials: Sequence[Trial]) -> None:
    """Refuse trials of different time steps: the predictor has one period."""
    step_s = trials[0].step_s
    for t in trials:
        if abs(t.step_s - step_s) > STEP_TOLERANCE * step_s:
            raise InputError(
                t.path, f"has a time step of {t.step_s:.6g} s, {trials[0].name} of {step_s:.6g} s",
                "resample it with 'dropstitch import --as table'",
            )  # fmt: skip


def name_tests(training: TrialSet, held_out: tuple[Trial, ...]) -> dict[str, TrialSet]:
    """Sort held-out trials into named tests.

    The names are "trial_2" (repetition of the training motion), "unseen_20deg" (another amplitude),
    "unseen_multisine_20deg" (another motion), "unseen_phase_45deg_30deg" (another phase).
    """

    def is_one_motion(a: Trial, b: Trial) -> bool:
        alike = is_one_amplitude(a.meta.amplitude_rad, b.meta.amplitude_rad)
        return alike and (a.meta.motion, phase_deg(a)) == (b.meta.motion, phase_deg(b))

    motions, phases = {t.meta.motion for t in training}, {phase_deg(t) for t in training}
    named: dict[str, list[Trial]] = {}
    for t in held_out:
        if any(is_one_motion(t, other) for other in training):
            name = f"trial_{t.meta.trial}"
        else:
            motion = "" if t.meta.motion in motions else f"{t.meta.motion}_"
            phase = "" if phase_deg(t) in phases else f"phase_{phase_deg(t)}deg_"
            name = f"unseen_{motion}{phase}{np.degrees(t.meta.amplitude_rad):.0f}deg"
        named.setdefault(name, []).append(t)
    return {name: TrialSet(tuple(named[name])) for name in sorted(named)}


def refuse_fitted(provenance: Provenance, where: Path | str, tests: Mapping[str, TrialSet]) -> None:
    """Refuse an unseen trial that the plant, or one of its parents, was fitted to.

    `tests`: as sorted by `name_tests`; those whose name begins with "unseen" are checked.
    """
    for name, trials in tests.items():
        for t in trials if name.startswith("unseen") else ():
            if provenance.was_fitted_to(t):
                raise InputError(
                    where, f"was fitted to {t.name}, a trial of the unseen motion",
                    "identify without it, or give other trials to --unseen",
                )  # fmt: skip
