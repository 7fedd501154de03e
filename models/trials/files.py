"""Trial files: `NAME.csv` with the samples beside `NAME.toml` with the conditions.

Row k holds angle, current and markers sampled at `time_s`, and the goal sent right after that
sample. The time step is uniform. An empty cell is an occluded marker (NaN). Without motion capture
all markers and the tip are empty. docs/trials.md defines all columns and keys.
"""

from __future__ import annotations

import csv
import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
import tomli_w

from firmware_py.core.errors import InputError
from firmware_py.core.input_files import convert, read_lines, read_toml, resolved
from firmware_py.core.motion import KINDS
from firmware_py.core.output_files import replacing, write_whole
from firmware_py.core.signals import TIME, Signal, tick_signals, tip_names, trial_signals, unit_of
from models.shared.numeric_text import check_columns, read_header, read_numbers
from models.trials.trial import (
    LINK_CONDITIONS,
    SCHEMA,
    SignalRole,
    Trial,
    TrialMeta,
    TrialSet,
)

PlantSignals = Mapping[str, SignalRole]
"""Signals of a plant by name; empty for the link, whose columns the contract defines."""

STEP_TOLERANCE: Final = 1e-3
"""Largest relative deviation of a time step from the mean."""
STEP_RANGE_S: Final = (5e-5, 0.5)
"""Shortest and longest time step: the motion is below 4 Hz, the fastest analogue channels have a
few kilohertz."""


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
    paths = _sample_files(directory)
    if not paths:
        raise InputError(
            directory, "holds no trial", "write some with 'dropstitch simulate --out DIR'"
        )
    return TrialSet(tuple(read_trial(path, signals) for path in paths))


def _sample_files(directory: Path) -> list[Path]:
    """CSV files of the trials of a directory, in order; a trial needs both of its files.

    Suffixes may be in capitals. Other TOML files, such as a map or a plant, may lie beside them.
    """
    try:
        files = sorted(directory.iterdir())
    except OSError as error:
        remedy = "name a directory of trials"
        raise InputError(directory, f"cannot be read ({error.strerror})", remedy) from None
    paths: dict[str, Path] = {}
    for path in (p for p in files if p.suffix.lower() == ".csv"):
        other = paths.setdefault(path.stem, path)
        if other is not path:
            what = f"has the name of the trial {other.name}"
            raise InputError(path, what, "rename or remove one of the two")
    sampled = {name.casefold() for name in paths}  # a file system may ignore the case
    for path in (p for p in files if p.suffix.lower() == ".toml"):
        if path.stem.casefold() not in sampled and _holds_conditions(path):
            what = f"is a trial without samples: {path.stem}.csv is missing"
            raise InputError(path, what, "put it beside this file, or remove this file")
    return list(paths.values())


def _holds_conditions(path: Path) -> bool:
    """Whether a TOML file holds a trial's conditions; in a map, `trial` is a table."""
    try:
        document = read_toml(path)
    except InputError:
        return False
    is_complete = document.keys() >= {"motion", "rest_samples", "trial"}
    return is_complete and not isinstance(document["trial"], dict)


def conditions_beside(samples: Path) -> Path:
    """Path of a trial's TOML file, existing or not; its suffix may be in capitals."""
    usual = samples.with_suffix(".toml")
    beside = samples.parent.glob("*") if not usual.exists() else ()
    named = (p for p in beside if p.stem == samples.stem and p.suffix.lower() == ".toml")
    return min(named, default=usual)


def read_trial_directories(
    directories: Sequence[Path], signals: PlantSignals | None = None
) -> TrialSet:
    """Read the trials of several directories.

    If two directories hold a trial of the same name, the directory's name is put in front.
    """
    if len(set(map(resolved, directories))) < len(directories):
        raise InputError(directories[-1], "is named twice", "name each directory once")
    trials = [(d, trial) for d in directories for trial in read_trials(d, signals)]
    counts = Counter(trial.name for _, trial in trials)
    named = [replace(t, name=f"{d.name}_{t.name}") if counts[t.name] > 1 else t for d, t in trials]
    return TrialSet(tuple(sorted(named, key=lambda t: t.name)))


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
    >>> from firmware_py.core.signals import trial_signals
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
    conditions = conditions_beside(path)
    document = read_toml(conditions, "write the conditions beside the CSV")
    if document.get("schema") != SCHEMA:
        raise InputError(
            conditions, f"schema is {document.get('schema')!r}",
            f"this version reads schema = {SCHEMA}",
        )  # fmt: skip
    meta = check_meta(document, conditions, signals)
    lines = read_lines(path, "name an existing trial")
    header = read_header(path, next(lines, ""))
    _check_names(path, header, meta, signals)
    samples = read_numbers(path, lines, header, range(len(header)))
    columns = {name: np.ascontiguousarray(samples[:, k]) for k, name in enumerate(header)}
    trial = Trial(path.stem, meta, columns, path)
    _check_samples(trial, signals)
    return _with_plant_names(trial, signals)


def check_trial_of_frame(trial: Trial, signals: PlantSignals | None = None) -> None:
    """Refuse a trial that could not be written as a valid file; its names are the plant's."""
    where = Path(trial.name)
    quantities = {s.quantity or name: s for name, s in (signals or {}).items()}
    meta = check_meta(trial.meta.document(), where, quantities)
    check_columns(where, list(trial.columns))
    _check_names(where, list(trial.columns), meta, quantities)
    _check_samples(trial, quantities)


def _with_plant_names(trial: Trial, signals: PlantSignals | None) -> Trial:
    """Trial whose columns and conditions have the names of the plant (`SignalRole.quantity`)."""
    renamed = {name: s.quantity for name, s in (signals or {}).items() if s.quantity}
    conditions = {renamed.get(n, n): value for n, value in trial.meta.conditions.items()}
    columns = {renamed.get(n, n): values for n, values in trial.columns.items()}
    meta = msgspec.structs.replace(trial.meta, conditions=conditions)
    return Trial(trial.name, meta, columns, trial.path)


# --- columns ---------------------------------------------------------------------------------

_FEWEST_ROWS: Final = 3
"""Fewest rows of a trial: a velocity needs two, an acceleration three."""
_MARKER = re.compile(r"m\d\d_[xyz]_m")
_COLUMN_RANGE: Final = {"rad": (6.3, "degrees"), "a": (100.0, "mA"), "m": (100.0, "mm")}
"""Largest plausible magnitude by suffix, and the unit that a larger one suggests."""


def columns_of(dof: int, signals: PlantSignals | None, markers: int) -> tuple[Signal, ...]:
    """Columns that a trial must have; without `signals` of a plant file, those of the link."""
    if not signals:
        return trial_signals(dof, markers)
    rows = [Signal(n, s.unit, s.role) for n, s in signals.items() if s.role != "condition"]
    return (TIME, *rows)


def _required(meta: TrialMeta, signals: PlantSignals | None) -> list[str]:
    return [signal.name for signal in columns_of(meta.dof, signals, meta.layout.count)]


def _check_names(
    where: Path, header: Sequence[str], meta: TrialMeta, signals: PlantSignals | None
) -> None:
    """Refuse a missing column, or one that has no unit and is not of a robot's log."""
    required = _required(meta, signals)
    for name in (n for n in required if n not in header):
        stem = name.rsplit("_", 1)[0]
        alike = next((h for h in header if stem in (h, h.rsplit("_", 1)[0])), None)
        remedy = "add it, or use 'dropstitch import' to map your columns"
        if alike is not None:
            remedy = f"convert column {alike!r} to the SI unit and call it {name}"
        raise InputError(where, f"column {name} is missing", remedy)
    known = {*required, *(signal.name for signal in tick_signals(meta.dof))}
    for name in (n for n in header if n not in known and unit_of(n) is None):
        remedy = "name it like temperature_1_degc"
        raise InputError(where, f"column {name!r} has no unit suffix", remedy)


def _check_samples(trial: Trial, signals: PlantSignals | None) -> None:
    """Refuse empty cells but of markers, implausible values, and an uneven time step."""
    where = trial.path if trial.path.name else Path(trial.name)
    if len(trial) < _FEWEST_ROWS:
        raise InputError(where, f"has {len(trial)} rows", "give at least three")
    no_tip = all(np.isnan(trial.columns.get(name, np.nan)).all() for name in tip_names())
    for name in _required(trial.meta, signals):
        column = trial.columns[name]
        may_be_empty = _MARKER.fullmatch(name) or (no_tip and name in tip_names())
        empty = np.flatnonzero(~np.isfinite(column))
        if len(empty) and not may_be_empty:
            what = f"row {empty[0] + 2}, column {name!r}: {column[empty[0]]} is not a finite number"
            remedy = "correct the cell (only a marker may be empty, where it was occluded)"
            raise InputError(where, what, remedy)
        limit, unit = _COLUMN_RANGE.get(name.rpartition("_")[2], (np.inf, ""))
        beyond = np.flatnonzero(np.abs(column) > limit)
        if len(beyond):
            what = f"row {beyond[0] + 2}, column {name}: {column[beyond[0]]:g} is not plausible"
            raise InputError(where, what, f"convert it if it is in {unit}")
    steps, mean = np.diff(trial.time_s), trial.step_s
    worst = int(np.argmax(np.abs(steps - mean)))
    if not mean > 0 or abs(steps[worst] - mean) > STEP_TOLERANCE * mean:
        what = f"row {worst + 3}, column time_s: step {steps[worst]:.6g} s, mean {mean:.6g} s"
        remedy = "resample to a uniform step with 'dropstitch import --as table'"
        raise InputError(where, what, remedy)
    if not signals:
        check_step_range(where, "column time_s", mean)
    if not 0 <= trial.meta.rest_samples < len(trial):
        raise InputError(
            conditions_beside(where),
            f"rest_samples is {trial.meta.rest_samples}, the trial has {len(trial)} rows",
            "set rest_samples to the number of leading rows at rest",
        )


def check_step_range(where: Path | str, field: str, step_s: float) -> None:
    """Refuse a time step that no recording of the link has."""
    low_s, high_s = STEP_RANGE_S
    if low_s <= step_s <= high_s:
        return
    unit = "milliseconds" if step_s > high_s else "another unit"
    raise InputError(
        where, f"{field}: the rows are {step_s:.3g} s apart, outside 0.05 ms to 0.5 s",
        f"give it in s, not in {unit}",
    )  # fmt: skip


# --- conditions ------------------------------------------------------------------------------

_ALWAYS: Final = ("dof", "payload_kg", "trial", "motion", "period_s")
"""Conditions that every trial has."""
_META_RANGE: Final[dict[str, tuple[float, float]]] = {
    "dof": (1, 2), "payload_kg": (0, 100), "pressure_pa": (1e3, 1e6), "trial": (0, 1e6),
    "period_s": (0, 1e4), "amplitude_rad": (0, 3.2), "phase_2_rad": (-6.3, 6.3),
    "base_offset_m": (0, 10), "link_length_m": (1e-3, 100), "link_width_m": (1e-3, 100),
}  # fmt: skip
_LINK_RANGE: Final = _META_RANGE | {"period_s": (1e-3, 1e4)}
"""A goal of the link lasts at least one step. The period of another plant may be zero."""


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
            what = f"[conditions] lacks {name}, which the plant's file declares"
            raise InputError(where, what, "add it")
    meta = convert(document, TrialMeta, where, "", "see docs/trials.md for its form")
    for key, value in meta.conditions.items():
        if not math.isfinite(value):
            raise InputError(where, f"[conditions] {key} is {value}", "give a finite number")
    for key, (low, high) in (_META_RANGE if signals else _LINK_RANGE).items():
        value = getattr(meta, key)
        if not low <= value <= high and (key in needed or key not in LINK_CONDITIONS):
            remedy = "give it in the unit named"
            if key == "pressure_pa":
                remedy = "give it in Pa: 6 PSI are 41370 Pa, 0.4 bar are 40000 Pa"
            raise InputError(where, f"{key} is {value}, outside {low:g} to {high:g}", remedy)
    if not signals:
        meta.layout.check(where, meta.link_length_m)
        if not math.hypot(*meta.gravity) < 100.0:
            raise InputError(where, f"gravity_m_s2 is {meta.gravity}", "give it in m/s²")
        # The name groups the trials, so it may not differ from a reference motion by case only.
        plain = meta.motion.strip().lower()
        if not plain:
            raise InputError(where, "motion is empty", "name the reference motion, like sinusoid")
        if plain in KINDS and meta.motion != plain:
            raise InputError(where, f"motion is {meta.motion!r}", f'write motion = "{plain}"')
    return meta


# --- writing ---------------------------------------------------------------------------------

LONGEST_NAME_BYTES: Final = 200
"""Longest name of a trial; file systems take 255 bytes with the suffix."""


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
