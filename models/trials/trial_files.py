"""Trial files: `NAME.csv` with the samples beside `NAME.toml` with the conditions.

Row k holds angle, current and markers sampled at `time_s`, and the goal sent right after that
sample. The time step is uniform. An empty cell is an occluded marker (NaN). Without motion capture
all markers and the tip are empty. docs/trials.md defines all columns and keys.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
import tomli_w

from firmware_py.errors import InputError
from firmware_py.files.input_files import convert, read_toml
from firmware_py.files.output_files import replacing, write_whole
from firmware_py.motion import KINDS
from firmware_py.signals import tick_signals
from models.trials.trial import (
    LINK_CONDITIONS,
    SCHEMA,
    Array,
    Trial,
    TrialMeta,
    TrialSet,
)
from models.trials.trial_columns import (
    FEWEST_ROWS,
    PlantSignals,
    check_columns,
    check_step_range,
    columns_of,
    read_sample_columns,
)
from models.trials.trial_listing import conditions_beside, sample_files

__all__ = [
    "check_meta",
    "check_samples",
    "check_trial_name",
    "read_trial",
    "read_trials",
    "write_trial",
]

STEP_TOLERANCE: Final = 1e-3
"""Largest relative deviation of a time step from the mean."""

LONGEST_NAME_BYTES: Final = 200
"""Longest name of a trial; file systems take 255 bytes with the suffix."""

_ALWAYS: Final = ("dof", "payload_kg", "trial", "motion", "period_s")
"""Conditions that every trial has."""
_META_RANGE: Final[dict[str, tuple[float, float]]] = {
    "dof": (1, 2), "payload_kg": (0, 100), "pressure_pa": (1e3, 1e6), "trial": (0, 1e6),
    "period_s": (0, 1e4), "amplitude_rad": (0, 3.2), "phase_2_rad": (-6.3, 6.3),
    "base_offset_m": (0, 10), "link_length_m": (1e-3, 100), "link_width_m": (1e-3, 100),
}  # fmt: skip
_PERIOD_S: Final = (1e-3, 1e4)
"""Range for the link: a goal lasts at least one step. The period of another plant may be zero."""


def read_trials(directory: Path | str, signals: PlantSignals | None = None) -> TrialSet:
    """Read every trial of a directory.

    Parameters
    ----------
    directory : Path or str
        Directory of the trials.
    signals : mapping of str to SignalRole, optional
        Signals that the plant's file declares, for a plant that is not the link.

    Raises
    ------
    InputError
        If the directory is missing or holds no trial, or a trial is invalid or lacks a file.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> from models.trials.trial import SignalRole
    >>> signals = {"position_1_m": SignalRole("m", "measured")}
    >>> meta = TrialMeta(dof=1, payload_kg=0.0, trial=1, motion="step", source="measured",
    ...                  period_s=1.0, rest_samples=1)
    >>> columns = {"time_s": np.arange(4) * 0.01, "position_1_m": np.zeros(4)}
    >>> with TemporaryDirectory() as directory:
    ...     for name in ("first", "second"):
    ...         _ = write_trial(Trial(name, meta, columns), directory)
    ...     trials = read_trials(directory, signals)
    >>> [t.name for t in trials]
    ['first', 'second']
    """
    directory = Path(directory)
    if not directory.is_dir():
        raise InputError(directory, "is not a directory", "name a directory of trials")
    paths = sample_files(directory)
    if not paths:
        raise InputError(
            directory, "holds no trial", "write some with 'dropstitch simulate --out DIR'"
        )
    return TrialSet(tuple(read_trial(path, signals) for path in paths))


def read_trial(path: Path | str, signals: PlantSignals | None = None) -> Trial:
    """Read one trial.

    Parameters
    ----------
    path : Path or str
        CSV file; `NAME.toml` must lie beside it.
    signals : mapping of str to SignalRole, optional
        As for `read_trials`.

    Raises
    ------
    InputError
        If a file is missing or truncated, a key, column or unit is wrong, a value is not a
        finite number where one is required, or the time step is not uniform.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> from firmware_py.signals import trial_signals
    >>> columns = {s.name: np.zeros(4) for s in trial_signals(dof=1)}
    >>> columns["time_s"] = 0.017 * np.arange(4)
    >>> meta = TrialMeta(dof=1, payload_kg=1.0, pressure_pa=41300.0, trial=1, motion="sinusoid",
    ...                  source="measured", period_s=4.352, amplitude_rad=0.5, base_offset_m=0.06,
    ...                  link_length_m=0.95, link_width_m=0.15, rest_samples=2)
    >>> with TemporaryDirectory() as directory:
    ...     trial = read_trial(write_trial(Trial("still", meta, columns), directory))
    >>> trial.name, len(trial), trial.markers_m.shape
    ('still', 4, (4, 16, 3))
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(path, "is missing", "name an existing trial")
    meta = _read_meta(conditions_beside(path), signals)
    columns = read_sample_columns(
        path,
        columns_of(meta.dof, signals, meta.layout.count),
        {s.name for s in tick_signals(meta.dof)},
    )
    trial = Trial(path.stem, _own_conditions(meta, signals), _own_columns(columns, signals), path)
    _check_rows(trial, signals)
    return trial


def check_samples(trial: Trial, signals: PlantSignals | None = None) -> None:
    """Refuse a trial that could not be written as a valid file."""
    where = Path(trial.name)
    own = {s.quantity or name: s for name, s in (signals or {}).items()}
    meta = check_meta(trial.meta.document(), where, own)
    known = {s.name for s in tick_signals(meta.dof)}
    check_columns(where, trial.columns, columns_of(meta.dof, own, meta.layout.count), known)
    if len(trial) < FEWEST_ROWS:
        raise InputError(where, f"has {len(trial)} rows", "give at least three")
    _check_rows(trial, own)


def _own_columns(columns: Mapping[str, Array], signals: PlantSignals | None) -> dict[str, Array]:
    """Columns under the names of the plant's signals (`SignalRole.quantity`)."""
    return {_quantity(name, signals): values for name, values in columns.items()}


def _own_conditions(meta: TrialMeta, signals: PlantSignals | None) -> TrialMeta:
    own = {_quantity(name, signals): value for name, value in meta.conditions.items()}
    return msgspec.structs.replace(meta, conditions=own)


def _quantity(name: str, signals: PlantSignals | None) -> str:
    return (signals[name].quantity if signals and name in signals else "") or name


def check_trial_name(name: str, where: Path | str) -> None:
    """Refuse a trial name that would put its files elsewhere or hide them."""
    plain = name.isprintable() and not set(name) & set("/\\") and not name.startswith(".")
    if not name or not plain or len(name.encode("utf-8", "surrogateescape")) > LONGEST_NAME_BYTES:
        raise InputError(where, f"{name!r} is no name of a trial", "give one without a directory")


def write_trial(trial: Trial, directory: Path | str) -> Path:
    """Write a trial so that `read_trial` returns it bit for bit.

    Parameters
    ----------
    trial : Trial
        Trial to write; its name becomes the file name.
    directory : Path or str
        Target directory; it is created if missing.

    Returns
    -------
    Path
        CSV file; the TOML file lies beside it.

    Raises
    ------
    InputError
        If the name of the trial would leave the directory, or is hidden, empty or too long.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> meta = TrialMeta(dof=1, payload_kg=0.0, trial=1, motion="step", source="measured",
    ...                  period_s=1.0, rest_samples=1)
    >>> columns = {"time_s": np.arange(3) * 0.01, "position_1_m": np.array([0.0, 0.5, 1.0])}
    >>> with TemporaryDirectory() as directory:
    ...     print(write_trial(Trial("run", meta, columns), directory).read_text())
    time_s,position_1_m
    0.0,0.0
    0.01,0.5
    0.02,1.0
    <BLANKLINE>
    """
    check_trial_name(trial.name, directory)
    directory = Path(directory)
    directory.mkdir(parents=True, exist_ok=True)
    path = directory / f"{trial.name}.csv"
    names = list(trial.columns)
    samples = trial.stack(*names)
    with replacing(path) as fresh:  # an interrupted run leaves no partial trial
        with fresh.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(names)
            for row in samples:
                writer.writerow("" if np.isnan(v) else repr(float(v)) for v in row)
        write_whole(path.with_suffix(".toml"), tomli_w.dumps(trial.meta.document()).encode())
    return path


def check_meta(
    document: Mapping[str, object], where: Path, signals: PlantSignals | None = None
) -> TrialMeta:
    """Check the conditions of a decoded TOML table."""
    needed = () if signals else LINK_CONDITIONS
    conditions: Any = document.get("conditions", {})
    misspelt = document.keys() - {field.name for field in msgspec.structs.fields(TrialMeta)}
    for key in (*needed, *(() if misspelt else _ALWAYS)):
        if key not in document:
            raise InputError(where, f"{key} is missing", "see docs/trials.md for its form")
    for name, signal in (signals or {}).items():
        if signal.role == "condition" and name not in conditions:
            raise InputError(
                where, f"[conditions] lacks {name}, which the plant's file declares", "add it"
            )
    meta = convert(document, TrialMeta, where, "", "see docs/trials.md for its form")
    for key, value in meta.conditions.items():
        if not math.isfinite(value):
            raise InputError(where, f"[conditions] {key} is {value}", "give a finite number")
    for key in (k for k in _META_RANGE if k in needed or k not in LINK_CONDITIONS):
        low, high = _PERIOD_S if key == "period_s" and not signals else _META_RANGE[key]
        value = getattr(meta, key)
        if not low <= value <= high:
            raise InputError(
                where, f"{key} is {value}, outside {low:g} to {high:g}", "give it in the unit named"
            )
    if not signals:
        _check_motion_name(where, meta.motion)
        meta.layout.check(where, meta.link_length_m)
        if not math.hypot(*meta.gravity) < 100.0:
            raise InputError(where, f"gravity_m_s2 is {meta.gravity}", "give it in m/s²")
    return meta


def _check_motion_name(where: Path, name: str) -> None:
    """Refuse a name that differs from a reference motion by case only: it groups the trials."""
    if not name.strip():
        raise InputError(where, "motion is empty", "name the reference motion, like sinusoid")
    meant = name.strip().lower()
    if meant in KINDS and name != meant:
        raise InputError(where, f"motion is {name!r}", f'write motion = "{meant}"')


def _read_meta(path: Path, signals: PlantSignals | None) -> TrialMeta:
    document = read_toml(path, "write the conditions beside the CSV")
    if document.get("schema") != SCHEMA:
        raise InputError(
            path, f"schema is {document.get('schema')!r}", f"this version reads schema = {SCHEMA}"
        )
    return check_meta(document, path, signals)


def _check_rows(trial: Trial, signals: PlantSignals | None) -> None:
    where = trial.path if trial.path.name else Path(trial.name)
    steps = np.diff(trial.time_s)
    mean = trial.step_s
    worst = int(np.argmax(np.abs(steps - mean)))
    if not mean > 0 or abs(steps[worst] - mean) > STEP_TOLERANCE * mean:
        raise InputError(
            where, f"row {worst + 3}, column time_s: step {steps[worst]:.6g} s, mean {mean:.6g} s",
            "resample to a uniform step with 'dropstitch import --as table'",
        )  # fmt: skip
    if not signals:
        check_step_range(where, "column time_s", mean)
    if not 0 <= trial.meta.rest_samples < len(trial):
        raise InputError(
            conditions_beside(where),
            f"rest_samples is {trial.meta.rest_samples}, the trial has {len(trial)} rows",
            "set rest_samples to the number of leading rows at rest",
        )
