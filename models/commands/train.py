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
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import msgspec

from firmware_py.core.console import DONE, NEGATIVE, Progress, emit
from firmware_py.core.errors import InputError
from firmware_py.core.units import FRACTION, LENGTH
from firmware_py.link.link_facts import STUDY_FACTS, other_link
from models.commands.output_paths import check_output_directory
from models.plant.document import Provenance
from models.trials.checks.trials import (
    judge_doubled,
    judge_not_fitted,
    judge_pressures,
    read_usable_trials,
)
from models.trials.files import STEP_TOLERANCE
from models.trials.trial import Trial, TrialSet, is_one_amplitude

if TYPE_CHECKING:
    from models.plant.plant import Plant
    from models.predictor.document import PredictorsDocument
    from models.study.document import StudyDocument

EXAMPLE = (
    "dropstitch train build/trials --dof 1 --plant build/plant.json "
    "--out build/bundle_1dof --motions build/unseen_multisine"
)
LARGEST_ASKEW_DEG: Final = 0.8
"""Largest angle of a link mounted askew: 14 mm at the tip; with 15 mm nothing would be in range."""


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
    if args.study_only and (args.candidate or args.compare):
        option = "--candidate" if args.candidate else "--compare"
        raise InputError(option, "changes nothing with --study-only", "leave out one")

    from models.bundle.files import ParityError, check_bundle_directory, write_bundle
    from models.plant.identification.doubts import refuse_other_links
    from models.plant.plant import read_plant
    from models.plant.simulation.runner import CompiledModel
    from models.predictor.candidates import CANDIDATES, DEFAULT_CANDIDATES, load_candidate
    from models.predictor.fallback import doubts_of_di, fit_fallback
    from models.predictor.training import train_tip
    from models.study.study import run_study

    check_output_directory(args.out)
    check_bundle_directory(args.out)
    trials = select_trials(args)
    plant = read_plant(args.plant)
    held_out = [t for of_test in trials.tests.values() for t in of_test]
    refuse_other_links(plant, args.plant, (*trials.everything, *held_out, *trials.further))
    refuse_fitted(plant.provenance, args.plant, trials.tests)
    candidates = CANDIDATES if args.compare else DEFAULT_CANDIDATES
    for path in args.candidate:
        candidates = (*candidates, load_candidate(path, candidates))

    with_tip, with_study = not args.study_only, args.study or args.study_only
    steps = 2 + with_tip * len(candidates) + with_study * (1 + len(trials.tests))
    progress = Progress(f"train {args.dof}DOF", steps).step
    observer = CompiledModel(plant.step_model(args.dof, "observer"))
    fallback = fit_fallback(trials.training, observer, progress)
    tip = study = None
    if with_tip:
        together, askew_rad = (*trials.training, *trials.further), math.radians(args.askew_deg)
        tip = train_tip(together, trials.tests, observer, candidates, progress, askew_rad)
    if with_study:
        study = run_study(fallback, trials.tests, trials.other_dof, progress)
        if not _is_of_the_paper(plant):
            study = msgspec.structs.replace(study, findings=())
    try:
        parity = write_bundle(args.out, plant, fallback, tip, study)
    except ParityError as error:
        emit(args, {"verdict": "no parity", "reason": str(error)}, str(error))
        return NEGATIVE

    r2_of_di = fallback.r2_of_di(trials.tests)
    judged = [
        *judge_pressures((*trials.training, *trials.further)),
        *judge_doubled((*trials.training, *held_out, *trials.further)),
        *judge_not_fitted(trials.everything.where(lambda t: t.meta.dof == args.dof)),
    ]
    doubts = [*doubts_of_di(r2_of_di), *(f"{doubt.text}; {doubt.remedy}" for doubt in judged)]
    data: dict[str, Any] = {
        "bundle": str(args.out), "parity": parity, "warnings": doubts, "degree": fallback.degree,
        "r2_of_di": r2_of_di,
    }  # fmt: skip
    lines = [str(args.out)]
    if tip:
        data["predictor"] = tip.document.chosen
        data["out_of_range"] = msgspec.to_builtins(tip.document.out_of_range)
        lines += tip_lines(tip.document)
    if study:
        distances = study.mean_euclidean_distance_m
        data["mean_euclidean_distance_m"] = {k: v["pooled"] for k, v in distances.items()}
        lines += study_lines(study)
    lines += advice(trials.tests, bool(study))
    emit(args, data, "\n  ".join(lines))
    for warning in doubts:
        print(f"warning: {warning}", file=sys.stderr)
    return DONE


class SelectedTrials(NamedTuple):
    """Trials of the command line, by their use."""

    everything: TrialSet  # Of the first directory
    training: TrialSet
    further: tuple[Trial, ...]  # Of --motions, for the robot's predictor alone
    tests: dict[str, TrialSet]
    other_dof: TrialSet  # For the study's comparison of mean DI


def select_trials(args: argparse.Namespace) -> SelectedTrials:
    """Read the trials of the command line, and refuse those that do not fit together."""

    def read(directory: Path) -> TrialSet:
        return of_phases(read_usable_trials([directory]), args.phase_deg, directory)

    everything = read(args.trials)
    training, held_out = of_dof(everything, args.dof, args.trials).split()
    unseen, further = (
        tuple(t for where in places for t in of_dof(read(where), args.dof, where))
        for places in (args.unseen, args.motions)
    )
    refuse_mixed_steps((*training, *held_out, *unseen, *further))
    trained = {t.sha256() for t in further}
    for t in (*held_out, *unseen):
        if t.sha256() in trained:
            raise InputError(
                t.path, "is a trial of --motions and a test", "name it in one of the two"
            )
    tests = name_tests(training, (*held_out, *unseen))
    other_dof, _ = everything.where(lambda t: t.meta.dof != args.dof).split()
    return SelectedTrials(everything, training, further, tests, other_dof)


def tip_lines(document: PredictorsDocument) -> list[str]:
    """The robot's predictor: reason for the choice, and each test with the right plant."""
    from models.bundle.model_card import range_texts  # loads scikit-learn

    tests, outside = document.candidates[document.chosen].tests, range_texts(document)
    lines = [f"the robot gets: {document.reason}"]
    for name in sorted(document.data.keys() & tests.keys()):
        score = tests[name]["all"]
        lines.append(
            f"{name}: {LENGTH.number(score.mean_m, 2)} mm on average, "
            f"{LENGTH.number(score.max_m)} mm at most; the interval covers "
            f"{FRACTION.text(score.coverage)}; {outside[name]}"
        )
    return lines


def study_lines(study: StudyDocument) -> list[str]:
    """The paper's polynomial of the chosen degree on each test."""
    degree = str(study.chosen_degree)
    lines = [f"the paper's polynomial: degree {degree} by cross-validation on trial 1"]
    for name, table in study.mean_euclidean_distance_m.items():
        mm = {k: LENGTH.number(by_degree[degree], 2) for k, by_degree in table["pooled"].items()}
        lines.append(
            f"{name}: mean Euclidean distance {mm['estimated_di']} mm with estimated DI "
            f"({mm['with_di']} with true DI, {mm['without_di']} without), "
            f"R² of DI {study.estimators[name]['observer'].r2_di:.3f}"
        )
    return lines


def advice(tests: Mapping[str, TrialSet], has_study: bool) -> list[str]:
    """What the bundle lacks, and the option that adds it."""
    lines = []
    if not any(name.startswith("trial_") for name in tests):
        lines.append("no trial 2 to test on: simulate with --trials 2")
    if not any(name.startswith("unseen") for name in tests):
        lines.append(
            "no unseen motion: dropstitch simulate --amplitude-deg 20 --trials 1 --out "
            "build/unseen_20deg (with --rig link.toml for your link), then --unseen that directory"
        )
    if not has_study:
        lines.append("add --study for the paper's tables, --compare for other candidates")
    return lines


def of_dof(trials: TrialSet, dof: int, where: Path) -> TrialSet:
    chosen = trials.where(lambda t: t.meta.dof == dof)
    if not chosen:
        raise InputError(where, f"holds no trial of {dof}DOF", f"simulate with --dof {dof}")
    return chosen


def of_phases(trials: TrialSet, phases_deg: Sequence[float], where: Path) -> TrialSet:
    """All 1DOF trials, and the 2DOF trials at some phases of joint 2 in degrees, or at all."""
    for wanted in phases_deg:
        if not any(t.meta.dof == 2 and phase_deg(t) == round(wanted) for t in trials):
            raise InputError(
                where, f"holds no 2DOF trial at phase {wanted:g} degrees",
                f"simulate with --dof 2 --phase-deg {wanted:g}",
            )  # fmt: skip
    chosen = {round(wanted) for wanted in phases_deg}
    return trials.where(lambda t: not chosen or t.meta.dof != 2 or phase_deg(t) in chosen)


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
            name = f"unseen_{motion}{phase}{math.degrees(t.meta.amplitude_rad):.0f}deg"
        named.setdefault(name, []).append(t)
    return {name: TrialSet(tuple(named[name])) for name in sorted(named)}


def _is_of_the_paper(plant: Plant) -> bool:
    """Whether the link is the paper's, on any servo: no other link repeats its findings."""
    if plant.load != "link":
        return False
    joints, servo = STUDY_FACTS.joints, STUDY_FACTS.servo
    link = msgspec.structs.replace(plant.link_facts(), joints=joints, servo=servo)
    return not other_link(link, STUDY_FACTS)


def refuse_fitted(provenance: Provenance, where: Path | str, tests: Mapping[str, TrialSet]) -> None:
    """Refuse an unseen trial that the plant, or one of its parents, was fitted to."""
    for name, trials in tests.items():
        for t in trials if name.startswith("unseen") else ():
            if provenance.was_fitted_to(t):
                raise InputError(
                    where, f"was fitted to {t.name}, a trial of the unseen motion",
                    "identify without it, or give other trials to --unseen",
                )  # fmt: skip
