"""Training of a bundle: the robot's tip predictor of one dof, its tests, and what it rests on."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import msgspec

from firmware_py.core.errors import InputError
from firmware_py.core.units import FRACTION, LENGTH
from firmware_py.inference.bundle import ModelBundle
from firmware_py.link.link_facts import STUDY_FACTS, other_link
from models.bundle.files import check_bundle_directory, write_bundle
from models.bundle.model_card import range_texts
from models.plant.document import Provenance
from models.plant.identification.doubts import refuse_other_links
from models.plant.plant import Plant
from models.plant.simulation.runner import CompiledModel
from models.predictor.candidates import DEFAULT_CANDIDATES, TipPredictor
from models.predictor.document import PredictorsDocument
from models.predictor.fallback import doubts_of_di, fit_fallback
from models.predictor.training import train_tip
from models.shared.output_paths import check_output_directory
from models.study.document import StudyDocument
from models.study.study import run_study
from models.trials.checks.trials import (
    judge_doubled,
    judge_not_fitted,
    judge_pressures,
    refuse_unusable,
)
from models.trials.files import STEP_TOLERANCE
from models.trials.trial import Trial, TrialSet, is_one_amplitude

ASKEW_RAD: Final = 0.005
"""Usual angle by which a link is mounted askew: 5 mm at the tip."""
LARGEST_ASKEW_RAD: Final = math.radians(0.8)
"""Largest angle of a link mounted askew: 14 mm at the tip; with 15 mm nothing would be in range."""


@dataclass(frozen=True, repr=False)
class Training:
    """Result of `train`: a bundle on disk, and its tests.

    Attributes
    ----------
    directory : Path
        Directory of the bundle.
    tests : dict of str to TrialSet
        Trials that nothing was trained on, by name of the test, such as "trial_2".
    predictors : PredictorsDocument or None
        Tests of the robot's predictor; None for the study alone.
    study : StudyDocument or None
        The paper's tables on these trials, where they were asked for.
    degree : int
        Degree of the paper's polynomial, chosen by cross-validation.
    r2_of_di : dict of str to float
        R² of the estimated Deformation Index, by test.
    parity : dict of str to float
        Largest differences between the graph and scikit-learn, by output.
    doubts : tuple of str
        What speaks against the result, one sentence each.

    Examples
    --------
    >>> result = Training(Path("bundle"), {}, None, None, 3, {"trial_2": 0.98}, {}, ())
    >>> result
    <Training of bundle: polynomial of degree 3, tests: none>
    """

    directory: Path
    tests: dict[str, TrialSet]
    predictors: PredictorsDocument | None
    study: StudyDocument | None
    degree: int
    r2_of_di: dict[str, float]
    parity: dict[str, float]
    doubts: tuple[str, ...]

    def __repr__(self) -> str:
        chosen = f"polynomial of degree {self.degree}"
        if self.predictors is not None:
            chosen = self.predictors.chosen
        return f"<Training of {self.directory}: {chosen}, tests: {', '.join(self.tests) or 'none'}>"

    def bundle(self) -> ModelBundle:
        """Load the bundle."""
        return ModelBundle.load(self.directory)

    def summary(self) -> str:
        """Return the predictor, its errors on each test, and what the bundle lacks."""
        lines = [str(self.directory)]
        if self.predictors:
            lines += tip_lines(self.predictors)
        if self.study:
            lines += study_lines(self.study)
        return "\n  ".join([*lines, *advice(self.tests, bool(self.study))])

    def as_json(self) -> dict[str, Any]:
        """Return the results as plain types, as `dropstitch train --json` prints them."""
        data: dict[str, Any] = {
            "bundle": str(self.directory), "parity": self.parity, "warnings": list(self.doubts),
            "degree": self.degree, "r2_of_di": self.r2_of_di,
        }  # fmt: skip
        if self.predictors:
            data["predictor"] = self.predictors.chosen
            data["out_of_range"] = msgspec.to_builtins(self.predictors.out_of_range)
        if self.study:
            distances = self.study.mean_euclidean_distance_m
            data["mean_euclidean_distance_m"] = {k: v["pooled"] for k, v in distances.items()}
        return data


def train(
    trials: Iterable[Trial],
    plant: Plant,
    out: Path | str,
    *,
    dof: int = 1,
    unseen: Iterable[Trial] = (),
    motions: Iterable[Trial] = (),
    candidates: Sequence[type[TipPredictor]] = DEFAULT_CANDIDATES,
    study: bool = False,
    askew_rad: float = ASKEW_RAD,
    report: Callable[[str, int], None] = lambda text, further: None,
) -> Training:
    """Train the robot's tip predictor on trials, test it, and write the bundle.

    The predictor is trained on trial 1 of the largest amplitude and tested on its repetitions and
    on unseen motions. Its interval is calibrated on payloads and motions left out of training.

    Parameters
    ----------
    trials : iterable of Trial
        Trials to train and test on.
    plant : Plant
        Identified plant. Its observer gives the Deformation Index that the robot will have.
    out : Path or str
        Directory of the bundle. The files of an old bundle there are replaced.
    dof : int
        Driven joints, 1 or 2; trials of the other number are left out.
    unseen : iterable of Trial
        Trials of motions that neither training nor identification used.
    motions : iterable of Trial
        Trials of further motions to train on.
    candidates : sequence of type
        Predictors to compare, the simplest first; the robot gets the best. Without any, it gets the
        paper's polynomial.
    study : bool
        Whether to write study.json, the paper's tables on these trials.
    askew_rad : float
        Angle by which the link may be mounted askew, which no servo sees and the interval covers.
    report : callable
        Called after each part of the work with a phrase and the number of parts to follow.

    Returns
    -------
    Training
        The bundle's directory, and the tests.

    Raises
    ------
    InputError
        If there are no trials of `dof` joints, they do not fit together or are of another link than
        the plant, or a test was trained on.
    ParityError
        If the exported graph differs from what was trained; no bundle is written then.

    Examples
    --------
    Two trials of the rig and the nominal plant; identify the plant first for a useful predictor.

    >>> import dropstitch
    >>> rig, motion = dropstitch.rig_named("default"), dropstitch.Motion()
    >>> cases = [dropstitch.TrialCase(motion, kg, trial=1) for kg in (0.0, 1.0)]
    >>> trials = [dropstitch.run_case(rig, case) for case in cases]
    >>> result = dropstitch.train(trials, dropstitch.read_plant(), "bundle_1dof")
    >>> result
    <Training of bundle_1dof: observer, tests: none>
    >>> print(result.summary())
    bundle_1dof
      the robot gets: the observer's tip, without a correction, off by ...
    """
    directory = Path(out)
    if not 0.0 <= askew_rad <= LARGEST_ASKEW_RAD:
        raise InputError(
            "--askew-deg",
            f"is {math.degrees(askew_rad):g}, not within 0 to {math.degrees(LARGEST_ASKEW_RAD):g}",
            "mount the link upright, or train on trials of it as it is",
        )
    check_output_directory(directory)
    check_bundle_directory(directory)
    everything, others, further = (TrialSet(tuple(part)) for part in (trials, unseen, motions))
    refuse_unusable(everything)
    training, held_out = of_dof(everything, dof).split()
    others, further = (of_dof(part, dof) if part else part for part in (others, further))
    for part in (others, further):
        refuse_unusable(part)
    refuse_mixed_steps((*training, *held_out, *others, *further))
    refuse_trained(further, (*held_out, *others))
    tests = name_tests(training, (*held_out, *others))
    other_dof, _ = everything.where(lambda t: t.meta.dof != dof).split()
    refuse_other_links(plant, plant.where, (*everything, *held_out, *others, *further))
    refuse_fitted(plant.provenance, plant.where, tests)

    steps = 2 + len(candidates) + study * (1 + len(tests))
    done = 0

    def step(text: str) -> None:
        nonlocal done
        done += 1
        report(text, max(steps - done, 0))

    observer = CompiledModel(plant.step_model(dof, "observer"))
    fallback = fit_fallback(training, observer, step)
    tip = document = None
    if candidates:
        tip = train_tip((*training, *further), tests, observer, candidates, step, askew_rad)
    if study:
        document = run_study(fallback, tests, other_dof, step)
        if not _is_of_the_paper(plant):
            document = msgspec.structs.replace(document, findings=())
    parity = write_bundle(directory, plant, fallback, tip, document)
    r2_of_di = fallback.r2_of_di(tests)
    judged = [
        *judge_pressures((*training, *further)),
        *judge_doubled((*training, *held_out, *others, *further)),
        *judge_not_fitted(everything.where(lambda t: t.meta.dof == dof)),
    ]
    doubts = (*doubts_of_di(r2_of_di), *(f"{doubt.text}; {doubt.remedy}" for doubt in judged))
    predictors = tip.document if tip else None
    return Training(
        directory, tests, predictors, document, fallback.degree, r2_of_di, parity, doubts
    )


def tip_lines(document: PredictorsDocument) -> list[str]:
    """The robot's predictor: reason for the choice, and each test with the right plant."""
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


def of_dof(trials: TrialSet, dof: int) -> TrialSet:
    chosen = trials.where(lambda t: t.meta.dof == dof)
    if not chosen:
        place = trials[0].path.parent if trials and trials[0].path.name else "trials"
        raise InputError(place, f"holds no trial of {dof}DOF", f"simulate with --dof {dof}")
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


def refuse_trained(further: Sequence[Trial], tests: Sequence[Trial]) -> None:
    """Refuse a test that is a trial of further motions to train on as well."""
    trained = {t.sha256() for t in further}
    for t in tests:
        if t.sha256() in trained:
            raise InputError(
                t.path, "is a trial of --motions and a test", "name it in one of the two"
            )


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
