"""Reference motions: goal angles as a pure function of time.

The laboratory and the robot run the same motions. Before zero a motion rests at zero; after its
end it glides back to zero within `GLIDE_S`: a wave that ends at speed runs on while it fades, for
a dead stop would set the link swinging.

============ ====================================================================================
sinusoid     the study's: two cycles 0 -> -A -> 0 -> +A -> 0 of one period each
multisine    many incommensurate frequencies at once, each joint its own; slower ones are larger
triangle     one slow cycle at constant speed, four periods long: hysteresis without inertia
steps        lean, hold, lean, hold: creep
decay        lean, then let go by a fifth of the lean at once and hold: free vibration
============ ====================================================================================
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from firmware_py.errors import InputError
from firmware_py.signals import PERIOD_S

Array = NDArray[np.float64]
Kind = Literal["sinusoid", "multisine", "triangle", "steps", "decay"]
KINDS: Final[tuple[Kind, ...]] = get_args(Kind)
STUDY_PERIOD_S: Final = 256 * PERIOD_S
"""One cycle of the study: 256 steps of 17 ms (paper, section IV-A)."""
STUDY_AMPLITUDE_RAD: Final = float(np.radians(30.0))
GLIDE_S: Final = 1.0
"""Time in which a motion returns to zero after its end."""

_PERIODS: Final[dict[Kind, float]] = {
    "sinusoid": 2, "multisine": 4, "triangle": 4, "steps": 8, "decay": 6,
}  # fmt: skip
"""Duration of a motion in periods."""

_RUNS_ON: Final = ("sinusoid", "triangle")
"""Motions that are still at speed at their end."""

_HARMONICS: Final = ((2, 5, 9, 14), (3, 7, 11, 16))
"""Of the joints' multisines, in cycles per four periods: no common frequency."""

_STEP_LEVELS: Final = (-1.0, -0.5, 0.0, 0.5, 1.0, 0.5, -0.5, 0.0)
_DECAY_LEVELS: Final = ((-1.0, -0.8, 0.0), (1.0, 0.8, 0.0))
"""Per lean: where to, how far to let go, and back to upright."""


@dataclass(frozen=True)
class Motion:
    """A reference motion of one or two joints.

    Attributes
    ----------
    kind : {"sinusoid", "multisine", "triangle", "steps", "decay"}
        See the module's table.
    amplitude_rad : float
        Largest goal of each joint.
    period_s : float
        Time of one cycle of the sinusoid; the other motions scale with it.
    phase_2_rad : float
        By how much joint 2 leads joint 1 (the multisine has no common phase and ignores it).
        Joint 2 still starts at zero: where it leads it fades in during half a period.
    dof : int
        Number of joints, 1 or 2.
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
            raise InputError(
                "amplitude", f"is {np.degrees(self.amplitude_rad):g} degrees", "choose 0 to 90"
            )
        if not 0.1 <= self.period_s <= 600:
            raise InputError("period", f"is {self.period_s:g} s", "choose 0.1 to 600")
        if not np.isfinite(self.phase_2_rad):
            raise InputError("phase", f"is {self.phase_2_rad}", "give a finite angle")

    @property
    def duration_s(self) -> float:
        """Time from the start to the last goal, the glide back to zero not counted."""
        return _PERIODS[self.kind] * self.period_s

    def goal_rad(self, time_s: ArrayLike) -> Array:
        """Goals at the given times.

        Parameters
        ----------
        time_s : array_like, shape (...)
            Time since the start of the motion in s.

        Returns
        -------
        ndarray, shape (..., dof)
            Goal angles in rad.
        """
        time_s = np.asarray(time_s, dtype=np.float64)
        last_s = self.duration_s + (GLIDE_S if self.kind in _RUNS_ON else 0.0)
        clipped_s = np.clip(time_s, 0.0, last_s)
        fade = 1.0 - _ease((time_s - self.duration_s) / GLIDE_S)
        joints = [self._joint(j, clipped_s) * fade for j in range(self.dof)]
        return self.amplitude_rad * np.stack(joints, axis=-1) + 0.0  # no negative zeros

    def table_rad(self, step_s: float = PERIOD_S, rest_samples: int = 0) -> Array:
        """Goals of a whole run with a fixed period, `rest_samples` zeros in front.

        Returns
        -------
        ndarray, shape (rest_samples + round(duration_s / step_s), dof)
            Row k is the goal to send at k * step_s.
        """
        moving = round(self.duration_s / step_s)
        return self.goal_rad((np.arange(rest_samples + moving) - rest_samples) * step_s)

    def _joint(self, joint: int, time_s: Array) -> Array:
        """Goal of one joint as a share of the amplitude, inside the motion."""
        if self.kind == "multisine":
            return _multisine(time_s / self.duration_s, _HARMONICS[joint])
        wave, cycles = _WAVES[self.kind]
        turn = time_s / self.duration_s * cycles
        if joint == 0 or self.phase_2_rad == 0.0:
            return wave(turn % 1.0)
        lead = self.phase_2_rad / (2.0 * np.pi)
        return wave((turn + lead) % 1.0) * _ease(2.0 * time_s / self.period_s)


def _ease(share: Array) -> Array:
    """Half a cosine from 0 to 1 while `share` runs from 0 to 1."""
    return np.asarray(0.5 - 0.5 * np.cos(np.pi * np.clip(share, 0.0, 1.0)))


def _sinusoid(turn: Array) -> Array:
    return np.asarray(-np.sin(2.0 * np.pi * turn))


def _triangle(turn: Array) -> Array:
    return np.asarray(np.interp(turn, [0.0, 0.25, 0.75, 1.0], [0.0, -1.0, 1.0, 0.0]))


def _steps(turn: Array) -> Array:
    """Eight levels; each is reached within a quarter of its share of the time."""
    return _staircase(turn, _STEP_LEVELS, 0.25)


def _staircase(turn: Array, levels: Sequence[float], ease_share: float) -> Array:
    """Run through `levels` in equal times, easing from one to the next; starts at zero."""
    position = turn * len(levels)
    goal, before = np.zeros_like(position), 0.0
    for k, level in enumerate(levels):
        goal = goal + (level - before) * _ease((position - k) / ease_share)
        before = level
    return goal


def _decay(turn: Array) -> Array:
    """Two leans, each of three periods: glide out, let go at once, glide back."""
    position = turn * 6.0
    goal = np.zeros_like(position)
    for start, (lean, released, upright) in zip((0.0, 3.0), _DECAY_LEVELS, strict=True):
        goal = goal + lean * _ease((position - start) / 0.5)
        goal = goal + (released - lean) * (position >= start + 1.0)
        goal = goal + (upright - released) * _ease((position - start - 2.25) / 0.5)
    return goal


def _multisine(share: Array, harmonics: Sequence[int]) -> Array:
    """Sum of harmonics over the whole duration, peak 1, faded in and out over a tenth each."""
    fine = np.linspace(0.0, 1.0, 4097)
    scale = 1.0 / np.max(np.abs(_harmonic_sum(fine, harmonics)))
    peak_held = np.clip(scale * _harmonic_sum(share, harmonics), -1.0, 1.0)  # between the points
    return np.asarray(peak_held)


def _harmonic_sum(share: Array, harmonics: Sequence[int]) -> Array:
    # Amplitudes fall so that no harmonic asks for much more acceleration than the study's own
    # motion; the phases are Schroeder's (quadratic), which keep the peak low.
    total = np.zeros_like(share)
    for k, harmonic in enumerate(harmonics):
        phase = np.pi * k * (k + 1) / len(harmonics)
        total = total + harmonic**-1.5 * np.sin(2.0 * np.pi * harmonic * share + phase)
    return np.asarray(-total * _ease(share / 0.1) * _ease((1.0 - share) / 0.1))


_WAVES: Final[dict[Kind, tuple[Callable[[Array], Array], int]]] = {
    "sinusoid": (_sinusoid, 2),
    "triangle": (_triangle, 1),
    "steps": (_steps, 1),
    "decay": (_decay, 1),
}
"""Shape over one turn (starts and ends at zero) and the number of turns in the motion."""
