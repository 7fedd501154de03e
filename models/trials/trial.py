"""Trial: one run of the robot, its conditions and its samples."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from firmware_py.core.errors import InputError
from firmware_py.core.motion import KINDS, Motion
from firmware_py.core.signals import marker_signals
from firmware_py.link.marker_layout import MarkerLayout, square_layout

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
SCHEMA: Final = 1
LINK_CONDITIONS: Final = (
    "pressure_pa", "amplitude_rad", "base_offset_m", "link_length_m", "link_width_m",
)  # fmt: skip
"""Conditions that a trial of the link has and a trial of another plant lacks."""

UPRIGHT_M_S2: Final = (0.0, 0.0, -9.81)
"""Gravity where a trial does not state it: docs/sources.md, "The link"."""


class SignalRole(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """Signal of a plant that is not the link."""

    # SI unit of the plant's quantity in the spelling of FMI, "1" if dimensionless. The map of an
    # import converts a recording that is in another unit.
    unit: str
    # `goal`: sent to the drive, constant until the next. `measured`: compared with the plant's
    # output of that name. `supply`: measured, and an input of the plant. `condition`: constant in a
    # trial, set under `[conditions]` of its TOML file, and replaces the plant's parameter of that
    # name. All but conditions are columns.
    role: Literal["goal", "measured", "supply", "condition"]
    # Name of the signal in the plant, if the trial files use another. Reading a trial renames the
    # column to it.
    quantity: str = ""


class TrialMeta(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Conditions of a trial (the TOML file); every dimensional key ends in its unit.

    `LINK_CONDITIONS` are zero for a trial of another plant. `conditions` replace the plant's
    parameters of the same name in this trial. `gravity_m_s2` is None where the link stands
    upright, `markers` is None for four rows of four. `recording_sha256` is the hash of the
    recording that the trial was imported from, empty if it was not imported.

    Examples
    --------
    >>> meta = TrialMeta(dof=1, payload_kg=0.5, trial=1, motion="step", source="measured",
    ...                  period_s=1.0, rest_samples=1)
    >>> meta.payload_kg, meta.gravity
    (0.5, (0.0, 0.0, -9.81))
    """

    schema: int = SCHEMA
    dof: int
    payload_kg: float
    pressure_pa: float = 0.0
    trial: int
    motion: str
    source: str
    period_s: float
    amplitude_rad: float = 0.0
    phase_2_rad: float = 0.0
    base_offset_m: float = 0.0
    link_length_m: float = 0.0
    link_width_m: float = 0.0
    gravity_m_s2: tuple[float, float, float] | None = None
    rest_samples: int
    notes: str = ""
    conditions: dict[str, float] = {}
    markers: MarkerLayout | None = None
    recording_sha256: str = ""

    @property
    def layout(self) -> MarkerLayout:
        """Layout of the markers on the link."""
        return self.markers or square_layout(self.link_length_m, self.link_width_m)

    @property
    def gravity(self) -> tuple[float, float, float]:
        """Gravity in m/s², in the frame whose z axis is the link at zero angle."""
        return self.gravity_m_s2 or UPRIGHT_M_S2

    def document(self) -> dict[str, object]:
        """Return the content of the TOML file, without conditions that do not apply."""
        entries: dict[str, object] = msgspec.to_builtins(self)
        for key in ("conditions", "recording_sha256"):
            if not entries[key]:
                del entries[key]
        entries = {k: v for k, v in entries.items() if v is not None}
        if not self.link_length_m:
            entries = {k: v for k, v in entries.items() if k not in LINK_CONDITIONS}
        return entries


@dataclass(frozen=True, repr=False)
class Trial:
    """One run of the robot: conditions and samples.

    Attributes
    ----------
    name : str
        File name without its suffix.
    meta : TrialMeta
        Conditions of the run.
    columns : dict of str to ndarray, shape (n,)
        Samples by column name, in file order.
    path : Path
        CSV file that it was read from; empty for a trial that was not read from a file.

    Examples
    --------
    >>> meta = TrialMeta(dof=1, payload_kg=0.5, trial=1, motion="step", source="measured",
    ...                  period_s=1.0, rest_samples=1)
    >>> columns = {"time_s": np.arange(3) * 0.01, "position_1_m": np.array([0.0, 0.5, 1.0])}
    >>> trial = Trial("run", meta, columns)
    >>> trial
    <Trial run: 1 joint, step, 0.5 kg, 3 rows of 10 ms>
    >>> trial.joint.ravel()
    array([0. , 0.5, 1. ])
    """

    name: str
    meta: TrialMeta
    columns: dict[str, Array]
    path: Path = field(default=Path(), compare=False)

    def __len__(self) -> int:
        return len(self.columns["time_s"])

    def __repr__(self) -> str:
        meta = self.meta
        joints = f"{meta.dof} joint{'s' if meta.dof > 1 else ''}"
        return (
            f"<Trial {self.name}: {joints}, {meta.motion}, {meta.payload_kg:g} kg, "
            f"{len(self)} rows of {1e3 * self.step_s:.3g} ms>"
        )

    def plot(self) -> Figure:
        """Draw all signals but the markers over time, one panel for each unit."""
        from models.shared.notebook import plot_by_unit

        unused = {"time_s", *(s.name for s in marker_signals(self.meta.layout.count))}
        return plot_by_unit(
            self.name, self.time_s, {n: v for n, v in self.columns.items() if n not in unused}
        )

    def stack(self, *names: str) -> Array:
        """Return columns side by side, shape (n, len(names))."""
        return np.column_stack([self.columns[name] for name in names])

    @property
    def time_s(self) -> Array:
        """Sample times in s, shape (n,)."""
        return self.columns["time_s"]

    @property
    def step_s(self) -> float:
        """Time step in s."""
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
    def joint(self) -> Array:
        """Joint coordinates, in rad or, on a straight guide, in m; shape (n, dof).

        Measured where there is an encoder, else as commanded, else zero.
        """
        last = self.meta.dof
        for pattern in ("angle_{j}_rad", "position_{j}_m", "goal_{j}_rad", "goal_{j}_m"):
            if all(pattern.format(j=j) in self.columns for j in range(1, last + 1)):
                return self._joints(pattern)
        return np.zeros((len(self), last))

    @property
    def current_a(self) -> Array:
        """Measured motor currents, shape (n, dof)."""
        return self._joints("current_{j}_a")

    @property
    def tip_m(self) -> Array:
        """Position of the end effector in the world frame, shape (n, 3)."""
        return self.stack("tip_x_m", "tip_y_m", "tip_z_m")

    @property
    def markers_m(self) -> Array:
        """Markers in m in the world frame, shape (n, markers, 3); NaN where occluded."""
        markers = self.meta.layout.names
        names = [f"{marker}_{axis}_m" for marker in markers for axis in "xyz"]
        return self.stack(*names).reshape(len(self), len(markers), 3)

    @property
    def marker_rows_m(self) -> Array:
        """Markers in m by row and corner, shape (n, rows, corners, 3); NaN where occluded."""
        layout = self.meta.layout
        return self.markers_m.reshape(len(self), layout.rows, layout.corners, 3)

    @property
    def moving(self) -> slice:
        """Rows after the initial rest."""
        return slice(self.meta.rest_samples, None)

    def sha256(self) -> str:
        """Return the hash of samples and conditions, independent of the recording."""
        meta = msgspec.structs.replace(self.meta, recording_sha256="")
        digest = hashlib.sha256(msgspec.json.encode(meta.document()))
        for name, column in self.columns.items():
            digest.update(name.encode())
            digest.update(np.where(np.isnan(column), np.nan, column).tobytes())  # one kind of NaN
        return digest.hexdigest()


ONE_AMPLITUDE_FRACTION: Final = 0.01
"""Largest relative difference between amplitudes of one motion; 30° may be written as 0.5236 rad
[assumed]."""


def is_one_amplitude(first_rad: float, second_rad: float) -> bool:
    """Whether two amplitudes belong to one motion."""
    return math.isclose(first_rad, second_rad, rel_tol=ONE_AMPLITUDE_FRACTION)


class TrialSet(tuple[Trial, ...]):
    """Trials that belong together, such as those of one directory.

    Examples
    --------
    >>> meta = TrialMeta(dof=1, payload_kg=0.5, trial=1, motion="step", source="measured",
    ...                  period_s=1.0, rest_samples=1)
    >>> columns = {"time_s": np.arange(3) * 0.01, "position_1_m": np.zeros(3)}
    >>> again = msgspec.structs.replace(meta, trial=2)
    >>> trials = TrialSet([Trial("first", meta, columns), Trial("second", again, columns)])
    >>> trials
    <TrialSet of 2 trials: first, second>
    >>> [[t.name for t in part] for part in trials.split()]
    [['first'], ['second']]
    """

    def __repr__(self) -> str:
        names = [t.name for t in self]
        shown = names if len(names) <= 2 else [names[0], "…", names[-1]]
        count = f"{len(names)} trial{'' if len(names) == 1 else 's'}"
        return f"<TrialSet of {count}: {', '.join(shown)}>" if names else "<TrialSet, empty>"

    def _repr_html_(self) -> str:
        from models.shared.notebook import html_table

        head = ("trial", "joints", "motion", "amplitude, rad", "payload, kg", "rows", "step, s")
        rows = [
            (t.name, t.meta.dof, t.meta.motion, f"{t.meta.amplitude_rad:.3g}",
             f"{t.meta.payload_kg:g}", len(t), f"{t.step_s:.4g}")
            for t in self
        ]  # fmt: skip
        return html_table(f"{len(self)} trials", head, rows)

    @property
    def trials(self) -> tuple[Trial, ...]:
        """The trials as a plain tuple."""
        return tuple(self)

    def where(self, keep: Callable[[Trial], bool]) -> TrialSet:
        """Return the trials for which `keep` is true."""
        return TrialSet(filter(keep, self))

    def split(self) -> tuple[TrialSet, TrialSet]:
        """Split the trials into a set to fit and a set to test on.

        The fitted set holds, for each motion and number of joints, the trials at the largest
        amplitude; among those of equal payload and phase, the one with the lowest number. The
        held-out set holds the repetitions and the smaller amplitudes. It is empty where there is
        one trial of each kind only.

        Returns
        -------
        fitted, held_out : TrialSet
        """

        def motion(meta: TrialMeta) -> tuple[int, str]:
            return meta.dof, meta.motion

        def kind(meta: TrialMeta) -> tuple[int, str, float, float]:
            return *motion(meta), round(meta.payload_kg, 3), round(meta.phase_2_rad, 2)

        largest: dict[Any, float] = {}
        for t in self:
            key = motion(t.meta)
            largest[key] = max(largest.get(key, 0.0), t.meta.amplitude_rad)
        whole = self.where(
            lambda t: is_one_amplitude(t.meta.amplitude_rad, largest[motion(t.meta)])
        )
        lowest: dict[Any, int] = {}
        for t in whole:
            lowest[kind(t.meta)] = min(lowest.get(kind(t.meta), t.meta.trial), t.meta.trial)
        fitted = whole.where(lambda t: t.meta.trial == lowest[kind(t.meta)])
        chosen = {id(t) for t in fitted}
        return fitted, self.where(lambda t: id(t) not in chosen)

    def sha256(self) -> str:
        """Return the hash of all trials and their names, for provenance."""
        digest = hashlib.sha256()
        for t in self:
            digest.update(t.name.encode() + t.sha256().encode())
        return digest.hexdigest()

    def content_sha256(self) -> str:
        """Return the hash of all trials without their names, which depend on their directories."""
        return hashlib.sha256("".join(sorted(t.sha256() for t in self)).encode()).hexdigest()


LINK_SIZES: Final = ("link_length_m", "link_width_m", "base_offset_m")
SAME_SIZE_FRACTION: Final = 0.01
"""Largest difference in size, relative to the length: the accuracy of a tape [assumed]."""
ALIKE_M_S2: Final = 0.3
"""Largest difference between two gravity vectors that count as equal: 2° or 3 % [assumed]."""


def link_differences(one: TrialMeta, other: TrialMeta) -> list[tuple[str, str, str]]:
    """Conditions by which two trials are of two links: name and both values.

    Sizes and places of markers measured with a tape differ a little, and so do 9.81 and 9.80665.
    """
    most_m = SAME_SIZE_FRACTION * max(one.link_length_m, other.link_length_m)

    def differ(a: Iterable[float], b: Iterable[float]) -> bool:
        return any(abs(x - y) > most_m for x, y in zip(a, b, strict=True))

    sizes = [(name, getattr(one, name), getattr(other, name)) for name in LINK_SIZES]
    differences = [(n, f"{a:g}", f"{b:g}") for n, a, b in sizes if differ([a], [b])]
    a, b = one.layout, other.layout
    if not differences and (
        (a.rows, a.corners) != (b.rows, b.corners)
        or differ(a.rows_m, b.rows_m)
        or differ(chain(*a.corners_m), chain(*b.corners_m))
    ):
        differences.append(("markers", _worded(a), _worded(b)))
    if math.dist(one.gravity, other.gravity) > ALIKE_M_S2:
        differences.append(("gravity_m_s2", _listed(one.gravity), _listed(other.gravity)))
    return differences


def _listed(vector: Iterable[float]) -> str:
    return "[" + ", ".join(f"{part + 0.0:.3g}" for part in vector) + "]"  # no -0


def _worded(layout: MarkerLayout) -> str:
    return f"{layout.rows} rows of {layout.corners}, the first at {layout.rows_m[0]:g} m"


REST_FRACTION: Final = 1e-3
"""Largest change of a goal at rest, as a fraction of the goal's range [assumed]."""
JUMP_FRACTION: Final = 0.05
"""Least change of a goal from one row to the next that may be a step, as a fraction of its range
[assumed]."""
SMOOTHEST_START_ROWS: Final = 120
"""Rows within which a reference motion has changed by `REST_FRACTION`; a multisine of 20 s needs
34."""
GOAL_TOLERANCE: Final = 0.01
"""Largest root mean square difference between the goals and a motion, as a fraction of the largest
goal: the resolution of a small servo is a seventh of that [assumed]."""


def rows_at_rest(goals: Array) -> int:
    """Rows before the goals of any motion start; `goals` has shape (n, goals).

    A smooth motion first changes in the row after time zero, a step in the row of time zero.
    """
    scale = np.ptp(goals, axis=0)
    moved = np.flatnonzero(np.any(np.abs(goals - goals[0]) > REST_FRACTION * scale, axis=1))
    if not len(moved):
        return len(goals)
    first = int(moved[0])
    now = np.abs(goals[first] - goals[first - 1])
    later = np.abs(goals[min(first + 1, len(goals) - 1)] - goals[first])
    steps = (now > JUMP_FRACTION * scale) & (now > 2.0 * later)
    return first if steps.any() else first - 1


def motion_start(trial: Trial) -> int:
    """Row of time zero of a trial.

    Where the conditions name a reference motion and the goals follow it, in either direction, the
    row is fitted to the goals. Otherwise it is `rest_samples` of the conditions.
    """
    meta, stated = trial.meta, trial.meta.rest_samples
    if meta.motion not in KINDS or "goal_1_rad" not in trial.columns:
        return stated
    try:
        motion = Motion(
            meta.motion, amplitude_rad=meta.amplitude_rad, period_s=meta.period_s, dof=meta.dof,
            phase_2_rad=meta.phase_2_rad,
        )  # fmt: skip
    except InputError:
        return stated
    goals, first = trial.goal_rad, rows_at_rest(trial.goal_rad)
    starts = range(max(first - SMOOTHEST_START_ROWS, 0), min(first + 1, len(trial) - 1) + 1)
    wanted = motion.goal_rad(trial.step_s * np.arange(-starts[-1], len(trial) - starts[0]))
    end = min(len(trial), int(starts[0] + motion.duration_s / trial.step_s))

    def error(start: int) -> float:
        due = wanted[starts[-1] - start :][:end]
        return min(float(np.sqrt(np.mean((goals[:end] - s * due) ** 2))) for s in (1, -1))

    errors = {start: error(start) for start in starts}
    best = min(errors, key=errors.__getitem__)
    return best if errors[best] <= GOAL_TOLERANCE * np.abs(goals).max() else stated
