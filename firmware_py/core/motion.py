"""Reference motions: goal angles as a function of time, and the files that describe them.

Rig and robot run the same motions. Before time zero a motion rests at zero. After its end it
returns to zero within `GLIDE_S`: a wave that still moves at its end is faded out, since an abrupt
stop would excite the link.

============ ====================================================================================
sinusoid     the study's: two cycles 0 -> -A -> 0 -> +A -> 0 of one period each
multisine    several harmonics at once, different ones for each joint; slower ones are larger
triangle     one slow cycle at constant speed, four periods long: hysteresis without inertia
steps        lean, hold, lean, hold: creep
decay        lean, then step back by a fifth of the lean and hold: free vibration
============ ====================================================================================

A motion file names a kind with its amplitude and period (`MotionDocument`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Final, Literal, get_args

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray

from firmware_py.core.documents import Document, check_version
from firmware_py.core.errors import InputError
from firmware_py.core.input_files import convert, read_toml
from firmware_py.core.signals import PERIOD_S
from firmware_py.core.units import ANGLE

Array = NDArray[np.float64]
Kind = Literal["sinusoid", "multisine", "triangle", "steps", "decay"]
KINDS: Final[tuple[Kind, ...]] = get_args(Kind)
STUDY_PERIOD_S: Final = 256 * PERIOD_S
"""One cycle of the study: 256 steps of 17 ms (the study, section IV-A; docs/sources.md)."""
STUDY_AMPLITUDE_RAD: Final = float(np.radians(30.0))
GLIDE_S: Final = 1.0
"""Duration of the return to zero after the end of a motion."""

_PERIODS: Final[dict[Kind, float]] = {
    "sinusoid": 2, "multisine": 4, "triangle": 4, "steps": 8, "decay": 6,
}  # fmt: skip
"""Duration of a motion in periods."""

_RUNS_ON: Final = ("sinusoid", "triangle")
"""Motions that still move at their end."""

_HARMONICS: Final = ((2, 5, 9, 14), (3, 7, 11, 16))
"""Harmonics of each joint's multisine in cycles per four periods, with none in common."""

_STEP_LEVELS: Final = (-1.0, -0.5, 0.0, 0.5, 1.0, 0.5, -0.5, 0.0)
_DECAY_LEVELS: Final = ((-1.0, -0.8, 0.0), (1.0, 0.8, 0.0))
"""For each lean: its level, the level after the step back, and upright."""


@dataclass(frozen=True)
class Motion:
    """Reference motion of one or two joints.

    Attributes
    ----------
    kind : {"sinusoid", "multisine", "triangle", "steps", "decay"}
        Kind of motion, see the module's table.
    amplitude_rad : float
        Largest goal of each joint, in rad.
    period_s : float
        Time of one cycle of the sinusoid in s; the other motions scale with it.
    phase_2_rad : float
        Phase by which joint 2 leads joint 1, in rad; the multisine ignores it. Joint 2 still starts
        at zero, because it is faded in during half a period.
    dof : int
        Number of joints, 1 or 2.

    Raises
    ------
    InputError
        If a parameter is out of range.

    Examples
    --------
    >>> motion = Motion(period_s=2.0)
    >>> goals_rad = motion.table_rad(rest_samples=60)  # one row every 17 ms
    >>> goals_rad.shape[1], round(float(goals_rad.max()), 2)
    (1, 0.52)
    """

    kind: Kind = "sinusoid"
    amplitude_rad: float = STUDY_AMPLITUDE_RAD
    period_s: float = STUDY_PERIOD_S
    phase_2_rad: float = 0.0
    dof: int = 1

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise InputError("motion", f"{self.kind!r} is unknown", "choose " + ", ".join(KINDS))
        if self.dof not in (1, 2):
            raise InputError("dof", f"is {self.dof}", "choose 1 or 2")
        if not 0 <= self.amplitude_rad <= np.pi / 2:
            size = f"{self.amplitude_rad:g} rad, {ANGLE.factor * self.amplitude_rad:g} degrees"
            raise InputError("amplitude_rad", f"is {size}", "choose 0 to 90 degrees")
        if not 0.1 <= self.period_s <= 600:
            raise InputError("period_s", f"is {self.period_s:g}", "choose 0.1 to 600")
        if not np.isfinite(self.phase_2_rad):
            raise InputError("phase_2_rad", f"is {self.phase_2_rad}", "give a finite angle")

    @property
    def duration_s(self) -> float:
        """Time from the start to the last goal in s, without the return to zero."""
        return _PERIODS[self.kind] * self.period_s

    def goal_rad(self, time_s: ArrayLike) -> Array:
        """Return the goals at given times.

        Parameters
        ----------
        time_s : array_like, shape (...)
            Time since the start of the motion in s.

        Returns
        -------
        ndarray, shape (..., dof)
            Goal angles in rad.

        Examples
        --------
        >>> motion = Motion(amplitude_rad=0.5, period_s=4.0)
        >>> goals_rad = motion.goal_rad([0.0, 1.0, 2.0, 3.0])
        >>> goals_rad.shape
        (4, 1)
        >>> bool(np.allclose(goals_rad[:, 0], [0.0, -0.5, 0.0, 0.5]))
        True
        >>> motion.goal_rad(motion.duration_s + GLIDE_S)  # back at zero
        array([0.])
        """
        time_s = np.asarray(time_s, dtype=np.float64)
        last_s = self.duration_s + (GLIDE_S if self.kind in _RUNS_ON else 0.0)
        clipped_s = np.clip(time_s, 0.0, last_s)
        fade = 1.0 - _ease((time_s - self.duration_s) / GLIDE_S)
        joints = [self._joint(j, clipped_s) * fade for j in range(self.dof)]
        return self.amplitude_rad * np.stack(joints, axis=-1) + 0.0  # no negative zeros

    def table_rad(self, step_s: float = PERIOD_S, rest_samples: int = 0) -> Array:
        """Return the goals of a whole run with a fixed period.

        Parameters
        ----------
        step_s : float
            Control period in s.
        rest_samples : int
            Number of rows at zero before the motion.

        Returns
        -------
        ndarray, shape (rest_samples + round(duration_s / step_s), dof)
            Row k is the goal to send at k * step_s.

        Examples
        --------
        >>> Motion(amplitude_rad=0.5, period_s=4.0, dof=2).table_rad(1.0, rest_samples=2).shape
        (10, 2)
        """
        moving = round(self.duration_s / step_s)
        return self.goal_rad((np.arange(rest_samples + moving) - rest_samples) * step_s)

    def _joint(self, joint: int, time_s: Array) -> Array:
        """Return the goal of one joint during the motion, as a fraction of the amplitude."""
        if self.kind == "multisine":
            return _multisine(time_s / self.duration_s, _HARMONICS[joint])
        wave, cycles = _WAVES[self.kind]
        turn = time_s / self.duration_s * cycles
        if joint == 0 or self.phase_2_rad == 0.0:
            return wave(turn % 1.0)
        lead = self.phase_2_rad / (2.0 * np.pi)
        return wave((turn + lead) % 1.0) * _ease(2.0 * time_s / self.period_s)


def _ease(fraction: Array) -> Array:
    """Return half a cosine from 0 to 1 while `fraction` goes from 0 to 1."""
    return np.asarray(0.5 - 0.5 * np.cos(np.pi * np.clip(fraction, 0.0, 1.0)))


def _sinusoid(turn: Array) -> Array:
    return np.asarray(-np.sin(2.0 * np.pi * turn))


def _triangle(turn: Array) -> Array:
    return np.asarray(np.interp(turn, [0.0, 0.25, 0.75, 1.0], [0.0, -1.0, 1.0, 0.0]))


def _steps(turn: Array) -> Array:
    """Return eight levels of equal duration; each transition takes a quarter of it."""
    return _staircase(turn, _STEP_LEVELS, 0.25)


def _staircase(turn: Array, levels: Sequence[float], ease_fraction: float) -> Array:
    """Return levels of equal duration with eased transitions, starting from zero."""
    position = turn * len(levels)
    goal, before = np.zeros_like(position), 0.0
    for k, level in enumerate(levels):
        goal = goal + (level - before) * _ease((position - k) / ease_fraction)
        before = level
    return goal


def _decay(turn: Array) -> Array:
    """Return two leans of three periods each: eased out, stepped back, eased to zero."""
    position = turn * 6.0
    goal = np.zeros_like(position)
    for start, (lean, released, upright) in zip((0.0, 3.0), _DECAY_LEVELS, strict=True):
        goal = goal + lean * _ease((position - start) / 0.5)
        goal = goal + (released - lean) * (position >= start + 1.0)
        goal = goal + (upright - released) * _ease((position - start - 2.25) / 0.5)
    return goal


def _multisine(fraction: Array, harmonics: Sequence[int]) -> Array:
    """Return a sum of harmonics with peak 1, faded in and out over a tenth of the duration each."""
    fine = np.linspace(0.0, 1.0, 4097)
    scale = 1.0 / np.max(np.abs(_harmonic_sum(fine, harmonics)))
    peak_held = np.clip(
        scale * _harmonic_sum(fraction, harmonics), -1.0, 1.0
    )  # the peak may lie between the points
    return np.asarray(peak_held)


def _harmonic_sum(fraction: Array, harmonics: Sequence[int]) -> Array:
    # The amplitudes fall so that no harmonic needs much more acceleration than the study's motion.
    # The quadratic phases keep the peak low (Schroeder, IEEE Trans. Inf. Theory 16, 1970).
    total = np.zeros_like(fraction)
    for k, harmonic in enumerate(harmonics):
        phase = np.pi * k * (k + 1) / len(harmonics)
        total = total + harmonic**-1.5 * np.sin(2.0 * np.pi * harmonic * fraction + phase)
    return np.asarray(-total * _ease(fraction / 0.1) * _ease((1.0 - fraction) / 0.1))


_WAVES: Final[dict[str, tuple[Callable[[Array], Array], int]]] = {
    "sinusoid": (_sinusoid, 2),
    "triangle": (_triangle, 1),
    "steps": (_steps, 1),
    "decay": (_decay, 1),
}
"""Shape over one turn, which starts and ends at zero, and the number of turns in the motion."""


class MotionDocument(Document, frozen=True):
    """Motion file: a kind of motion, whose keys stand for those of the table `[motion]`."""

    MADE_BY: ClassVar[str] = "dropstitch experiment"

    kind: Kind
    amplitude_rad: float
    period_s: float
    phase_2_rad: float = 0.0
    payload_kg: float | None = None  # Payload to attach for the run
    notes: str = ""


_MAKE: Final = f"write it anew with {MotionDocument.MADE_BY}"


def read_motion_document(path: Path | str) -> MotionDocument:
    path = Path(path)
    raw = read_toml(path, _MAKE, _MAKE)
    check_version(path, raw, MotionDocument.VERSION, _MAKE)
    document = convert(raw, MotionDocument, path, "is no motion", _MAKE)
    try:
        Motion(document.kind, document.amplitude_rad, document.period_s, document.phase_2_rad)
    except InputError as error:
        raise InputError(path, f"its {error.where} {error.what}", error.remedy) from None
    return document


class MotionConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Table `[motion]`: the reference motion, see `firmware_py.core.motion`."""

    kind: Kind = "sinusoid"  # Kind of motion, see `firmware_py.core.motion`
    amplitude_rad: float = STUDY_AMPLITUDE_RAD  # Largest goal of each joint
    period_s: float = STUDY_PERIOD_S  # Time of one cycle of the sinusoid
    phase_2_rad: float = 0.0  # Phase by which joint 2 leads joint 1
    rest_s: float = 1.0  # Rest before the motion, the reference of the Deformation Index
    # Motion file, relative to robot.toml, instead of kind, amplitude, period and phase
    file: str | None = None

    def motion(self, dof: int) -> Motion:
        return Motion(self.kind, self.amplitude_rad, self.period_s, self.phase_2_rad, dof)

    def with_motion(self, wanted: str) -> MotionConfig:
        """Return the table for another motion: the name of a kind, or the path of a motion file."""
        if wanted in KINDS:
            return msgspec.structs.replace(self, kind=msgspec.convert(wanted, Kind), file=None)
        if not Path(wanted).exists():
            raise InputError(
                f"motion {wanted}", "is no kind of motion and no file",
                "choose " + ", ".join(KINDS) + " or a motion file",
            )  # fmt: skip
        return self.with_file(Path(wanted))

    def with_file(self, path: Path) -> MotionConfig:
        document = read_motion_document(path)
        return msgspec.structs.replace(
            self, kind=document.kind, amplitude_rad=document.amplitude_rad,
            period_s=document.period_s, phase_2_rad=document.phase_2_rad, file=None,
        )  # fmt: skip
