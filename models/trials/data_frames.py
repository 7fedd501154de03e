"""Trials as pandas data frames, and back, with the SI unit in every column's name.

pandas is imported on first use; it is in the extra `library`.
"""

from __future__ import annotations

import importlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from firmware_py.core.errors import InputError
from models.trials.files import PlantSignals, check_meta, check_trial_of_frame
from models.trials.trial import Trial, TrialMeta

if TYPE_CHECKING:
    import pandas as pd


CONDITIONS = ("name", "dof", "motion", "payload_kg", "amplitude_rad", "trial")
"""Columns that distinguish the trials of one frame."""


def as_data_frame(columns: Mapping[str, Any]) -> pd.DataFrame:
    """Return columns by name as a data frame.

    Parameters
    ----------
    columns : mapping of str to array_like, shape (n,)
        For example of a log (`Recording.columns`), of `simulate_plant` or of
        `Predictions.columns`.

    Returns
    -------
    DataFrame
        One column per name.

    Raises
    ------
    InputError
        If pandas is not installed.

    Examples
    --------
    >>> as_data_frame({"time_s": [0.0, 0.1], "angle_1_rad": [0.0, 0.2]}).set_index("time_s")
            angle_1_rad
    time_s
    0.0             0.0
    0.1             0.2
    """
    frame: pd.DataFrame = _pandas().DataFrame(dict(columns))
    return frame


def trial_frame(trial: Trial) -> pd.DataFrame:
    """Return the samples of a trial, one row each; the conditions are in `attrs`.

    Parameters
    ----------
    trial : Trial
        Trial of the link or of any plant.

    Raises
    ------
    InputError
        If pandas is not installed.

    Examples
    --------
    >>> meta = TrialMeta(dof=1, payload_kg=0.5, trial=1, motion="step", source="measured",
    ...                  period_s=1.0, rest_samples=1)
    >>> columns = {"time_s": np.arange(3) * 0.01, "position_1_m": np.array([0.0, 0.5, 1.0])}
    >>> frame = trial_frame(Trial("run", meta, columns))
    >>> list(frame.columns), frame.attrs["name"], frame.attrs["payload_kg"]
    (['time_s', 'position_1_m'], 'run', 0.5)
    """
    frame = as_data_frame(trial.columns)
    frame.attrs = {"name": trial.name, **trial.meta.document()}
    return frame


def trials_frame(trials: Iterable[Trial]) -> pd.DataFrame:
    """Return the samples of several trials in one frame, with columns that distinguish the trials.

    Parameters
    ----------
    trials : iterable of Trial
        At least one trial.

    Raises
    ------
    InputError
        If pandas is not installed, or `trials` is empty.

    Examples
    --------
    >>> meta = TrialMeta(dof=1, payload_kg=0.5, trial=1, motion="step", source="measured",
    ...                  period_s=1.0, rest_samples=1)
    >>> columns = {"time_s": np.arange(3) * 0.01, "position_1_m": np.array([0.0, 0.5, 1.0])}
    >>> frame = trials_frame([Trial("first", meta, columns), Trial("second", meta, columns)])
    >>> frame.groupby("name")["position_1_m"].max().to_dict()
    {'first': 1.0, 'second': 1.0}
    """
    frames = []
    for trial in trials:
        facts = {"name": trial.name} | {c: getattr(trial.meta, c) for c in CONDITIONS[1:]}
        count = len(trial)
        added = {c: [v] * count for c, v in facts.items() if c not in trial.columns}
        frames.append(as_data_frame(added | trial.columns))
    if not frames:
        raise InputError("trials", "are none", "give one at least")
    whole: pd.DataFrame = _pandas().concat(frames, ignore_index=True)
    return whole


def trial_from_frame(
    frame: pd.DataFrame,
    name: str = "",
    meta: TrialMeta | None = None,
    signals: PlantSignals | None = None,
) -> Trial:
    """Return the trial that a data frame holds, checked like a file.

    Parameters
    ----------
    frame : DataFrame
        Columns as in a trial file; a missing value is an occluded marker.
    name : str, optional
        Name of the trial; by default the one in `frame.attrs`.
    meta : TrialMeta, optional
        Conditions; by default those in `frame.attrs`, as `trial_frame` sets them.
    signals : mapping of str to SignalRole, optional
        Signals of a plant that is not the link (`Plant.signals`).

    Raises
    ------
    InputError
        If name or conditions are missing, or if samples or conditions are invalid.

    Examples
    --------
    >>> import dropstitch
    >>> signals = dropstitch.read_plant("models/plant/examples/xl330_pendulum.toml").signals
    >>> meta = TrialMeta(dof=1, payload_kg=0.0, trial=1, motion="rest", source="measured",
    ...                  period_s=1.0, rest_samples=0,
    ...                  conditions={"duty_gain_1": 1.0, "mass_kg": 0.5, "arm_length_m": 0.1})
    >>> columns = {"time_s": 0.01 * np.arange(3), "goal_1_rad": 0.0, "enabled_1": 1.0,
    ...            "angle_1_rad": 0.0, "supply_1_v": 7.5}
    >>> trial_from_frame(dropstitch.as_data_frame(columns), "rest", meta, signals)
    <Trial rest: 1 joint, rest, 0 kg, 3 rows of 10 ms>
    """
    attributes = dict(frame.attrs)
    stored_name = str(attributes.pop("name", ""))
    name = name or stored_name
    if not name:
        raise InputError("trial_from_frame", "has no name for the trial", "give one")
    if meta is None:
        if not attributes:
            what = "has no conditions in the frame's attrs"
            raise InputError(name, what, "give a TrialMeta as meta")
        meta = check_meta(attributes, Path(name), signals)
    columns = {}
    for column in frame.columns:
        try:
            columns[str(column)] = np.array(frame[column], dtype=np.float64)
        except (TypeError, ValueError):
            raise InputError(
                name, f"column {column!r} holds no numbers", "convert or drop it"
            ) from None
    trial = Trial(name, meta, columns)
    check_trial_of_frame(trial, signals)
    return trial


def _pandas() -> ModuleType:
    try:
        return importlib.import_module("pandas")
    except ImportError:
        raise InputError(
            "pandas", "is not installed", "install it with pip install 'dropstitch[library]'"
        ) from None
