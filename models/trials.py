"""The trial file contract: `NAME.csv` (samples) beside `NAME.toml` (conditions).

Row k holds angle, current and markers as sampled at `time_s`, and the goal that was sent just
after that sample. The time step is uniform. An empty cell is an occluded marker (NaN).
"""

from __future__ import annotations

import csv
import hashlib
import tomllib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
import tomli_w
from numpy.typing import NDArray

from firmware_py.errors import InputError
from firmware_py.signals import Signal, trial_signals, unit_of

Array = NDArray[np.float64]
SCHEMA: Final = 1
STEP_TOLERANCE: Final = 1e-3
"""Largest deviation of a time step from the mean, as a share of it, that counts as uniform."""


class TrialMeta(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Conditions of a trial (the TOML file); every dimensional key carries its unit."""

    schema: int = SCHEMA
    dof: int
    payload_kg: float
    pressure_pa: float
    trial: int
    motion: str
    source: str
    period_s: float
    amplitude_rad: float
    phase_2_rad: float = 0.0
    base_offset_m: float
    link_length_m: float
    link_width_m: float
    rest_samples: int
    notes: str = ""


@dataclass(frozen=True)
class Trial:
    """One run: its conditions and its samples.

    Attributes
    ----------
    name : str
        File name without suffix.
    meta : TrialMeta
        Conditions.
    columns : dict of str to ndarray, shape (n,)
        Samples by column name, in file order.
    path : Path
        CSV file that it was read from (or `NAME.csv` for one not yet written).
    """

    name: str
    meta: TrialMeta
    columns: dict[str, Array]
    path: Path = field(default=Path(), compare=False)

    def __len__(self) -> int:
        return len(self.columns["time_s"])

    def stack(self, *names: str) -> Array:
        """Columns side by side, shape (n, len(names))."""
        return np.column_stack([self.columns[name] for name in names])

    @property
    def time_s(self) -> Array:
        """Sample times, shape (n,)."""
        return self.columns["time_s"]

    @property
    def step_s(self) -> float:
        """Uniform time step."""
        return float((self.time_s[-1] - self.time_s[0]) / (len(self) - 1))

    def _joints(self, pattern: str) -> Array:
        return self.stack(*(pattern.format(j=j) for j in range(1, self.meta.dof + 1)))

    @property
    def goal_rad(self) -> Array:
        """Goals sent after each sample, shape (n, dof)."""
        return self._joints("goal_{j}_rad")

    @property
    def angle_rad(self) -> Array:
        """Measured joint angles, shape (n, dof)."""
        return self._joints("angle_{j}_rad")

    @property
    def current_a(self) -> Array:
        """Measured motor currents, shape (n, dof)."""
        return self._joints("current_{j}_a")

    @property
    def tip_m(self) -> Array:
        """End effector in the world frame, shape (n, 3)."""
        return self.stack("tip_x_m", "tip_y_m", "tip_z_m")

    @property
    def markers_m(self) -> Array:
        """Markers in the world frame, shape (n, 16, 3); NaN where occluded."""
        names = [f"m{i:02d}_{axis}_m" for i in range(1, 17) for axis in "xyz"]
        return self.stack(*names).reshape(len(self), 16, 3)

    @property
    def moving(self) -> slice:
        """Rows after the rest rows."""
        return slice(self.meta.rest_samples, None)

    def sha256(self) -> str:
        """Hash of the samples and conditions, for provenance."""
        digest = hashlib.sha256(msgspec.json.encode(self.meta))
        for name, column in self.columns.items():
            digest.update(name.encode())
            digest.update(np.ascontiguousarray(column).tobytes())
        return digest.hexdigest()


@dataclass(frozen=True)
class TrialSet(Sequence[Trial]):
    """Trials of one directory, ordered by name."""

    trials: tuple[Trial, ...]

    def __len__(self) -> int:
        return len(self.trials)

    def __getitem__(self, index: Any) -> Any:
        return self.trials[index]

    def __iter__(self) -> Iterator[Trial]:
        return iter(self.trials)

    def where(self, keep: Callable[[Trial], bool]) -> TrialSet:
        """Trials for which `keep` is true."""
        return TrialSet(tuple(t for t in self.trials if keep(t)))

    def split(self) -> tuple[TrialSet, TrialSet]:
        """Separate the trials to fit on from the trials to test on.

        To fit on: of each kind of motion at its largest amplitude, the trials with the lowest
        number. Everything else is held out: repetitions, and smaller amplitudes of the same
        motion. Where that would hold out nothing there is only one trial of each kind, and the
        second set is empty.
        """
        largest: dict[tuple[int, str], float] = {}
        lowest: dict[tuple[int, str], int] = {}
        for t in self:
            key = (t.meta.dof, t.meta.motion)
            largest[key] = max(largest.get(key, 0.0), round(t.meta.amplitude_rad, 6))
        for t in self:
            key = (t.meta.dof, t.meta.motion)
            if round(t.meta.amplitude_rad, 6) == largest[key]:
                lowest[key] = min(lowest.get(key, t.meta.trial), t.meta.trial)

        def fitted(t: Trial) -> bool:
            key = (t.meta.dof, t.meta.motion)
            return round(t.meta.amplitude_rad, 6) == largest[key] and t.meta.trial == lowest[key]

        return self.where(fitted), self.where(lambda t: not fitted(t))

    def sha256(self) -> str:
        """Hash over all trials, for provenance."""
        digest = hashlib.sha256()
        for t in self.trials:
            digest.update(t.name.encode() + t.sha256().encode())
        return digest.hexdigest()


def read_trials(directory: Path | str) -> TrialSet:
    """Read every trial of a directory.

    Raises
    ------
    InputError
        If the directory is missing or holds no trial, or a trial cannot be used.
    """
    directory = Path(directory)
    if not directory.is_dir():
        raise InputError(directory, "is not a directory", "name a directory of trials")
    paths = sorted(directory.glob("*.csv"))
    if not paths:
        raise InputError(
            directory, "holds no trial", "write some with 'python -m models simulate --out DIR'"
        )
    return TrialSet(tuple(read_trial(path) for path in paths))


def read_trial(path: Path | str) -> Trial:
    """Read one trial.

    Parameters
    ----------
    path : Path or str
        The CSV file; the TOML file of the same name must lie beside it.

    Raises
    ------
    InputError
        If a file is missing or truncated, a key, column or unit is wrong, a value is not a
        finite number where one is required, or the time step is not uniform.
    """
    path = Path(path)
    meta = _read_meta(path.with_suffix(".toml"))
    columns = _read_columns(path, trial_signals(meta.dof))
    trial = Trial(path.stem, meta, columns, path)
    _check_time(trial)
    if not 0 <= meta.rest_samples < len(trial):
        raise InputError(
            path.with_suffix(".toml"),
            f"rest_samples is {meta.rest_samples}, the trial has {len(trial)} rows",
            "set rest_samples to the number of leading rows at rest",
        )
    return trial


def write_trial(trial: Trial, directory: Path | str) -> Path:
    """Write a trial so that `read_trial` returns the same bits; returns the CSV's path."""
    directory = Path(directory)
    directory.mkdir(parents=True, exist_ok=True)
    path = directory / f"{trial.name}.csv"
    names = list(trial.columns)
    samples = trial.stack(*names)
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(names)
        for row in samples:
            writer.writerow("" if np.isnan(v) else repr(float(v)) for v in row)
    path.with_suffix(".toml").write_text(
        tomli_w.dumps(msgspec.to_builtins(trial.meta)), encoding="utf-8"
    )
    return path


def _read_meta(path: Path) -> TrialMeta:
    try:
        document = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(path, "is missing", "write the conditions beside the CSV") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(path, f"is not TOML ({error})", "correct the line it names") from None
    if document.get("schema") != SCHEMA:
        raise InputError(
            path, f"schema is {document.get('schema')!r}", f"this version reads schema = {SCHEMA}"
        )
    try:
        meta = msgspec.convert(document, TrialMeta)
    except msgspec.ValidationError as error:
        raise InputError(path, str(error), "see the trial contract in the README") from None
    limits: tuple[tuple[str, float, float], ...] = (
        ("dof", 1, 2), ("payload_kg", 0, 100), ("pressure_pa", 0, 1e6), ("period_s", 0, 1e4),
        ("amplitude_rad", 0, 3.2), ("base_offset_m", 0, 10), ("link_length_m", 1e-3, 100),
        ("link_width_m", 1e-3, 100),
    )  # fmt: skip
    for key, low, high in limits:
        value = getattr(meta, key)
        if not low <= value <= high:
            raise InputError(
                path, f"{key} is {value}, outside {low:g} to {high:g}", "give it in the unit named"
            )
    return meta


def _read_columns(path: Path, signals: Sequence[Signal]) -> dict[str, Array]:
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.reader(file))
    except FileNotFoundError:
        raise InputError(path, "is missing", "name an existing trial") from None
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(path, f"is not CSV text ({error})", "export it as UTF-8 CSV") from None
    if len(rows) < 4:
        raise InputError(path, f"has {max(len(rows) - 1, 0)} rows", "give at least three")
    header, body = rows[0], rows[1:]
    required = [s.name for s in signals]
    missing = [name for name in required if name not in header]
    if missing:
        name = missing[0]
        raise InputError(path, f"column {name} is missing", _column_remedy(name, header))
    doubled = [name for name in header if header.count(name) > 1]
    if doubled:
        raise InputError(path, f"column {doubled[0]} stands twice", "remove one of the two")
    for name in header:
        if name not in required and unit_of(name) is None:
            raise InputError(
                path, f"column {name!r} has no unit suffix", "name it like temperature_1_degc"
            )
    samples = np.full((len(body), len(header)), np.nan)
    may_be_empty = [(name[0] == "m" and name[1:3].isdigit()) or name not in required
                    for name in header]  # fmt: skip
    for i, row in enumerate(body):
        if len(row) != len(header):
            raise InputError(
                path, f"row {i + 2} has {len(row)} cells, the header {len(header)}",
                "the file is truncated or damaged: export it again",
            )  # fmt: skip
        for k, cell in enumerate(row):
            if cell == "" and may_be_empty[k]:
                continue
            try:
                samples[i, k] = float(cell)
            except ValueError:
                samples[i, k] = np.nan
            if not np.isfinite(samples[i, k]):
                raise InputError(
                    path, f"row {i + 2}, column {header[k]}: {cell!r} is not a finite number",
                    "correct the cell (only a marker may be empty, where it was occluded)",
                )  # fmt: skip
    return {name: np.ascontiguousarray(samples[:, k]) for k, name in enumerate(header)}


def _column_remedy(name: str, header: Sequence[str]) -> str:
    stem = name.rsplit("_", 1)[0]
    alike = [h for h in header if h.rsplit("_", 1)[0] == stem or h == stem]
    if alike:
        return f"convert column {alike[0]!r} to the SI unit and call it {name}"
    return "add it, or use 'python -m models import' to map your columns"


def _check_time(trial: Trial) -> None:
    steps = np.diff(trial.time_s)
    mean = trial.step_s
    worst = int(np.argmax(np.abs(steps - mean)))
    if not mean > 0 or abs(steps[worst] - mean) > STEP_TOLERANCE * mean:
        raise InputError(
            trial.path,
            f"row {worst + 3}, column time_s: step {steps[worst]:.6g} s, mean {mean:.6g} s",
            "resample to a uniform step with 'python -m models import --as table'",
        )
