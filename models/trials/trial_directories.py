"""Trials of several directories as one set."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from firmware_py.errors import InputError
from models.trials.trial import SignalRole, Trial, TrialSet
from models.trials.trial_files import read_trials
from models.trials.verdict.motion_findings import runs_against
from models.trials.verdict.whole_run.condition_findings import judge_undeclared
from models.trials.verdict.whole_run.goal_findings import judge_standing_goals
from models.trials.verdict.whole_run.tip_findings import judge_tip


def read_trial_directories(
    directories: Sequence[Path], signals: Mapping[str, SignalRole] | None = None
) -> TrialSet:
    """Read the trials of several directories.

    If two directories hold a trial of the same name, the directory's name is put in front.
    """
    if len({d.resolve() for d in directories}) < len(directories):
        raise InputError(directories[-1], "is given twice", "name each directory once")
    sets = [read_trials(d, signals and dict(signals)) for d in directories]
    refuse_unusable([t for own in sets for t in own])
    if len(sets) == 1:
        return sets[0]
    names = [t.name for own in sets for t in own]
    every = [
        replace(t, name=f"{d.name}_{t.name}") if names.count(t.name) > 1 else t
        for d, own in zip(directories, sets, strict=True) for t in own
    ]  # fmt: skip
    return TrialSet(tuple(sorted(every, key=lambda t: t.name)))


def refuse_unusable(trials: Sequence[Trial]) -> None:
    """Refuse trials whose errors would silently spoil a fit or a diagnosis."""
    known: dict[bytes, Trial] = {}
    for trial in trials:
        for j in range(1, trial.meta.dof + 1):
            goal, angle = (trial.columns.get(f"{of}_{j}_rad") for of in ("goal", "angle"))
            if goal is not None and angle is not None and runs_against(goal, angle):
                what = f"goal and angle of joint {j} run against each other"
                raise InputError(trial.path, what, f"correct the sign of angle_{j}_rad")
        for finding in (
            *judge_tip(trial), *judge_undeclared(trial), *judge_standing_goals(trial),
        ):  # fmt: skip
            if finding.level == "refused":
                raise InputError(trial.path, finding.text, finding.remedy)
        samples = hashlib.sha256()
        for name in sorted(trial.columns):
            samples.update(name.encode())
            samples.update(np.ascontiguousarray(trial.columns[name]).tobytes())
        other = known.setdefault(samples.digest(), trial)
        if other is not trial:
            raise InputError(trial.path, f"is a copy of {other.path}", "leave one of them out")
