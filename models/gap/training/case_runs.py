"""Runs of data sets with hidden effects: trials of the rig, their diagnosis, one file a data set.

What has a file is not run again, so a run that was stopped goes on.
"""

from __future__ import annotations

import itertools
import time
import zlib
from collections.abc import Iterable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Final

import msgspec
import numpy as np

from firmware_py.core.errors import InputError
from models.gap.decision.certainty import (
    Answers,
    Evidence,
    Knowledge,
    knowledge_of,
    read_certainty,
)
from models.gap.decision.naming import evidence_of
from models.gap.diagnosis import diagnose
from models.gap.report.gap_json import GapVerdict
from models.gap.report.gap_results import Diagnosis
from models.gap.training.cases import PAYLOAD_SETS, PAYLOADS_KG, HiddenCase, motion_named
from models.plant.identification.identify import identify
from models.plant.plant import Plant, read_plant
from models.rig.drawn import rig_named
from models.rig.parameters import RigParameters
from models.rig.protocol import TrialCase, run_case
from models.shared.catalogue import effect_and_joint
from models.shared.missing_files import make_missing
from models.trials.trial import Trial, TrialSet

HANGING_RAD: Final = 0.1
"""Following error at the start from which the arm hangs: its current limit does not hold it
[assumed]."""
DELAY_OF: Final = {"dead_time": "goal_delay_1_s"}
"""Parameters in which a plant without the effect holds the rig's own."""


class Strength(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Strength of a rightly named effect, as a change of the plant, in the catalogue's unit."""

    effect: str
    fitted: float
    chance_error: float  # Standard error without that of the equation
    hidden: float


class Addition(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Set that took the place of a smaller one, whether it is named or not."""

    candidates: tuple[str, ...]
    knowledge: Knowledge
    evidence: Evidence
    added: Evidence  # Of what it adds to the smaller set


class DataSetRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Result of one data set."""

    case: HiddenCase
    impossible: str = ""  # Why nobody would record these trials; nothing else is set then
    verdict: GapVerdict = "no floor"
    named: tuple[str, ...] = ()
    # By name: sets of candidates that these trials cannot tell from it
    look_alikes: dict[str, tuple[tuple[str, ...], ...]] = {}
    best: tuple[str, ...] = ()  # Candidate with the largest d′ alone
    knowledge: Knowledge = "identified"
    evidence: Evidence = Evidence(0.0, 0.0, 1.0)  # Of it
    additions: tuple[Addition, ...] = ()
    answers: Answers | None = None
    strengths: tuple[Strength, ...] = ()
    # Whether the whole catalogue tells a denied effect from what was named instead
    separable: bool = True
    seconds: float = 0.0

    @property
    def best_is_right(self) -> bool:
        """Whether all effects of the best set are hidden, or the first name's look-alike is."""
        hidden = set(self.case.hidden)
        alike = {e for sets in self.look_alikes.values() for s in sets for e in effects_of(s)}
        best = effects_of(self.best)
        return bool(best) and (best <= hidden or (len(hidden) == 1 and hidden <= alike))


def effects_of(candidates: Iterable[str]) -> set[str]:
    """Effects of some candidates; EFFECT:JOINT is one too."""
    return {effect_and_joint(c)[0] for c in candidates}


def run_cases(cases: Iterable[HiddenCase], out: Path) -> int:
    """Run the cases that have no record yet, each with a plant of its rig; return how many failed.

    The cases of a rig that cannot run the identification's trials are left out. Errors stand in
    OUT/failures.
    """
    wanted = list(cases)
    robots = {plant_path(out / "plants", c.rig, c.joints): (c.rig, c.joints) for c in wanted}
    failed = make_missing(
        "plants of the rigs",
        {path: partial(identify_on_rig, path, *robot) for path, robot in robots.items()},
        failures=out / "failures",
    )
    jobs = {}
    for case in wanted:
        plant = plant_path(out / "plants", case.rig, case.joints)
        if plant.exists():
            path = record_path(out, case)
            jobs[path] = partial(_write_record, path, case, plant)
    return failed + make_missing("data sets", jobs, failures=out / "failures")


def records_of(cases: Iterable[HiddenCase], out: Path) -> list[DataSetRecord]:
    """Records of those cases that have one."""
    paths = (record_path(out, case) for case in cases)
    return [msgspec.json.decode(p.read_bytes(), type=DataSetRecord) for p in paths if p.exists()]


def record_path(out: Path, case: HiddenCase) -> Path:
    key = zlib.crc32(msgspec.json.encode(case, order="deterministic"))
    return out / "results" / f"{case.rig}_{case.kind}_{key:08x}.json"


def plant_path(directory: Path, rig: str, joints: int = 1) -> Path:
    return directory / (f"{rig}.json" if joints == 1 else f"{rig}_{joints}dof.json")


def identification_cases(joints: int) -> tuple[TrialCase, ...]:
    """Conditions that a plant is identified on: motions of one joint and, if driven, of both."""
    return tuple(
        TrialCase(motion_named("study", dof), payload_kg, 1)
        for dof in range(1, joints + 1)
        for payload_kg in PAYLOADS_KG
    )


def identify_on_rig(path: Path, rig: str, joints: int = 1) -> None:
    """Write the plant of a rig, with its noise floor; the reason beside it where the rig cannot run
    the trials.
    """
    seed = zlib.crc32(f"identification of {rig}".encode())  # rigs share no noise
    cases = [
        replace(case, trial=trial, seed=seed)
        for case in identification_cases(joints)
        for trial in (1, 2)
    ]
    try:
        trials = TrialSet(tuple(run_case(rig_named(rig), case) for case in cases))
        identify(read_plant(), trials).plant.write(path)
    except InputError as error:
        path.with_suffix(".refused.txt").write_text(f"{error}\n", encoding="utf-8")


def _write_record(path: Path, case: HiddenCase, plant: Path) -> None:
    record = run_hidden_case(case, read_plant(plant))
    fresh = path.with_suffix(".part")
    fresh.write_bytes(msgspec.json.format(msgspec.json.encode(record), indent=1))
    fresh.replace(path)


def run_hidden_case(case: HiddenCase, plant: Plant) -> DataSetRecord:
    """Record of a case."""
    rig, start_s = rig_of(case), time.monotonic()
    try:
        trials = TrialSet(tuple(hidden_trials(rig, case)))
    except InputError as error:
        return DataSetRecord(case=case, impossible=str(error))
    denied = list(case.hidden) if case.kind == "outside" else []
    diagnosis = diagnose(plant, trials, leave_out=denied)
    separable = True
    if denied:
        whole = diagnose(plant, trials)
        separable = set(denied) <= effects_of(whole.named) and not effects_of(diagnosis.named) & {
            e for name, sets in _look_alikes(whole).items() if effects_of([name]) <= set(denied)
            for s in sets for e in effects_of(s)
        }  # fmt: skip
    search, first = diagnosis.naming.search, diagnosis.naming.rounds[0]
    # The candidate that explains most alone: what is named beyond it depends on the certainty.
    best = next(iter(first), search.nothing)
    return DataSetRecord(
        case=case,
        verdict=diagnosis.verdict,
        named=diagnosis.named,
        look_alikes=_look_alikes(diagnosis),
        best=best.candidates,
        knowledge=knowledge_of(search.estimator, best.point),
        evidence=evidence_of(search, best),
        additions=tuple(_additions(diagnosis)),
        answers=diagnosis.answers,
        strengths=tuple(_strengths(diagnosis, rig, case)),
        separable=separable,
        seconds=round(time.monotonic() - start_s, 1),
    )


def rig_of(case: HiddenCase) -> RigParameters:
    """Rig of a case, without the hidden effects."""
    rig = rig_named(case.rig)
    turns = {f"sensor.frame_{name}_rad": turn for name, turn in case.frame_turn_rad.items()}
    factors = {name: factor * rig[name] for name, factor in case.nuisance.items()}
    return rig.changed(**factors, **turns)


def hidden_trials(rig: RigParameters, case: HiddenCase) -> list[Trial]:
    """Trials of a case on its rig: some payloads, each repeated once."""
    motion = motion_named(case.motion, case.joints)
    trials = [
        run_case(rig.hide(case.hidden), TrialCase(motion, payload_kg, trial, case.seed))
        for payload_kg in PAYLOAD_SETS[case.payloads]
        for trial in (1, 2)
    ]
    for trial in trials:
        off_rad = float(np.abs(trial.angle_rad[0] - trial.goal_rad[0]).max())
        if off_rad > HANGING_RAD:
            raise InputError(trial.name, f"starts {off_rad:.2f} rad off its goal", "use less load")
    return trials


def true_strength(plant: Plant, rig: RigParameters, effect: str, hidden: float) -> float:
    """Change that is to be estimated.

    Where the plant has no such effect, nor a parameter for it, the rig's own is added.
    """
    known = effect in plant.effects or DELAY_OF.get(effect) in plant.parameters
    return hidden if known else hidden + rig[rig.effects()[effect]]


def _additions(diagnosis: Diagnosis) -> Iterable[Addition]:
    search, error = diagnosis.naming.search, diagnosis.settings.equation_error_fraction
    for smaller, fit in itertools.pairwise(diagnosis.naming.grown):
        yield Addition(
            fit.candidates,
            knowledge_of(search.estimator, fit.point),
            evidence_of(search, fit),
            evidence_of(search, fit, smaller, error),
        )


def _look_alikes(diagnosis: Diagnosis) -> dict[str, tuple[tuple[str, ...], ...]]:
    return {n: tuple(fit.candidates for fit in sets) for n, sets in diagnosis.look_alikes.items()}


def _strengths(diagnosis: Diagnosis, rig: RigParameters, case: HiddenCase) -> Iterable[Strength]:
    """Strength of each hidden effect that is named in all driven joints."""
    fit_parameters = diagnosis.naming.search.estimator.residuals.fit_parameters
    certainty = read_certainty()
    for effect in sorted(set(case.hidden) & set(diagnosis.named)):
        name = next(q.name for q in fit_parameters if q.effect == effect and q.is_strength)
        baseline, fitted = diagnosis.plant.parameters.get(name), diagnosis.fitted.parameters[name]
        change = fitted.value - (baseline.value if baseline else 0.0)
        equation = certainty.error_of_strength(effect) * change
        chance = float(np.sqrt(max((fitted.error or 0.0) ** 2 - equation**2, 0.0)))
        hidden = true_strength(diagnosis.plant, rig, effect, case.hidden[effect])
        yield Strength(effect, change, chance, hidden)
