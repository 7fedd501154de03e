"""Trials of several directories as one set."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from firmware_py.errors import InputError
from models.trials.trial import SignalRole, TrialSet
from models.trials.trial_files import read_trials


def read_trial_directories(
    directories: Sequence[Path], signals: Mapping[str, SignalRole]
) -> TrialSet:
    """Read the trials of several directories.

    A name that two directories hold gets the directory's name in front.

    Parameters
    ----------
    directories : sequence of Path
        At least one.
    signals : mapping of str to SignalRole
        Of the plant, see `models.trials.trial_files.read_trials`.

    Raises
    ------
    InputError
        If a directory is given twice, or holds no readable trial.
    """
    if len({d.resolve() for d in directories}) < len(directories):
        raise InputError(directories[-1], "is given twice", "name each directory once")
    sets = [read_trials(d, dict(signals)) for d in directories]
    if len(sets) == 1:
        return sets[0]
    names = [t.name for own in sets for t in own]
    every = [
        replace(t, name=f"{d.name}_{t.name}") if names.count(t.name) > 1 else t
        for d, own in zip(directories, sets, strict=True) for t in own
    ]  # fmt: skip
    return TrialSet(tuple(sorted(every, key=lambda t: t.name)))
