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
designed     a Fourier series from a file
============ ====================================================================================

A motion file names a kind with its amplitude and period (`FixedMotionDocument`), or it holds a
Fourier series of each joint (`MotionDocument`). The goal of a joint is then
w(t) Σ (a_k sin(2π h_k t / T) + b_k cos(2π h_k t / T)): h_k are the harmonics, T is the duration,
and the window w eases in and out, so that the motion begins and ends at rest at zero. Series of few
harmonics are the usual form of motions that excite a robot (Swevers et al., IEEE Trans. Robotics
and Automation 13, 1997)::

    schema = 1
    duration_s = 10.0
    harmonics = [1, 2, 5]                  # cycles in the duration; 0 is a constant lean

    [[joints]]
    sine_rad = [0.2, -0.1, 0.02]
    cosine_rad = [0.1, 0.0, 0.01]
"""

from __future__ import annotations

import hashlib
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
FADE_FRACTION: Final = 0.1
"""Fraction of the duration for easing in, and for easing out; that of the multisine."""
HIGHEST_FREQUENCY_HZ: Final = 10.0
"""Highest frequency of a harmonic: six samples a cycle at the nominal period [assumed]."""
_CORRECT: Final = "correct it after docs/gap/experiment.md"


class JointSeries(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Coefficients of one joint, one per harmonic, in rad."""

    sine_rad: tuple[float, ...]
    cosine_rad: tuple[float, ...]


class MotionDocument(Document, frozen=True):
    """Content of a motion file; the module's text defines the series."""

    VERSION: ClassVar[int] = 1
    MADE_BY: ClassVar[str] = "dropstitch experiment"

    duration_s: float
    harmonics: tuple[int, ...]  # Cycles per duration; 0 is a constant lean
    joints: tuple[JointSeries, ...]  # Coefficients of one or two joints, in joint order
    payload_kg: float | None = None  # Payload to attach for the run
    notes: str = ""

    @property
    def name(self) -> str:
        """Name of the motion in trials and logs, derived from its series alone."""
        text = msgspec.json.encode((self.duration_s, self.harmonics, self.joints))
        return f"designed-{hashlib.sha256(text).hexdigest()[:8]}"

    @property
    def amplitude_rad(self) -> float:
        fine_s = np.linspace(0.0, self.duration_s, 4097)
        return float(np.max(np.abs(self.goal_rad(fine_s))))

    def goal_rad(self, time_s: Array) -> Array:
        """Return goals at times of shape (...), shape (..., joints); zero outside the motion."""
        basis = fourier_basis(time_s, self.duration_s, self.harmonics)
        weights = np.array([[*j.sine_rad, *j.cosine_rad] for j in self.joints])
        return np.asarray(basis @ weights.T)


def fourier_basis(time_s: Array, duration_s: float, harmonics: tuple[int, ...]) -> Array:
    """Return windowed sines and cosines of a series at times of shape (...).

    Returns shape (..., 2 h) for h harmonics, sines first.
    """
    fraction = np.clip(np.asarray(time_s, dtype=np.float64) / duration_s, 0.0, 1.0)
    ramp = np.minimum(fraction, 1.0 - fraction) / FADE_FRACTION
    window = 0.5 - 0.5 * np.cos(np.pi * np.minimum(ramp, 1.0))
    turn = 2.0 * np.pi * fraction[..., None] * np.array(harmonics, dtype=np.float64)
    return np.asarray(window[..., None] * np.concatenate([np.sin(turn), np.cos(turn)], axis=-1))


def read_motion_document(path: Path | str) -> MotionDocument:
    path = Path(path)
    raw = read_toml(path, _CORRECT, _CORRECT)
    check_version(path, raw, MotionDocument.VERSION, _CORRECT)
    document = convert(raw, MotionDocument, path, "is no motion", _CORRECT)
    check_motion_document(document, path)
    return document


def check_motion_document(document: MotionDocument, where: Path | str) -> None:
    """Refuse values of a series that are out of range or do not fit together."""
    count = len(document.harmonics)
    coefficients = [c for j in document.joints for c in (*j.sine_rad, *j.cosine_rad)]
    payload_kg = 0.0 if document.payload_kg is None else document.payload_kg
    wrong = ""
    if len(document.joints) not in (1, 2):
        wrong = f"is for {len(document.joints)} joints; 1 or 2 can move"
    elif not 0.1 <= document.duration_s <= 600:
        wrong = f"lasts {document.duration_s:g} s, outside 0.1 to 600 s"
    elif not count or len(set(document.harmonics)) < count or min(document.harmonics) < 0:
        wrong = "needs harmonics that differ and are not negative"
    elif max(document.harmonics) > HIGHEST_FREQUENCY_HZ * document.duration_s:
        wrong = f"has a harmonic above {HIGHEST_FREQUENCY_HZ:g} Hz"
    elif any(len(s) != count for j in document.joints for s in (j.sine_rad, j.cosine_rad)):
        wrong = f"needs {count} coefficients in each list of a joint, one per harmonic"
    elif not np.isfinite(coefficients).all():
        wrong = "has a coefficient that is not finite"
    elif not 0 <= payload_kg <= 100:
        wrong = f"has a payload of {payload_kg:g} kg, outside 0 to 100 kg"
    elif document.amplitude_rad > np.pi / 2:
        wrong = f"reaches {document.amplitude_rad:.3g} rad, more than 1.57 rad"
    if wrong:
        raise InputError(where, wrong, _CORRECT)


Kind = Literal["sinusoid", "multisine", "triangle", "steps", "decay"]
KINDS: Final[tuple[Kind, ...]] = get_args(Kind)
"""Kinds of motion that have a name; `Motion.designed` makes others."""
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
    kind : {"sinusoid", "multisine", "triangle", "steps", "decay", "designed"}
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
    design : MotionDocument or None
        Fourier series of a designed motion, see `Motion.designed`; it determines all other
        parameters.

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

    kind: Kind | Literal["designed"] = "sinusoid"
    amplitude_rad: float = STUDY_AMPLITUDE_RAD
    period_s: float = STUDY_PERIOD_S
    phase_2_rad: float = 0.0
    dof: int = 1
    design: MotionDocument | None = None

    @classmethod
    def designed(cls, design: MotionDocument) -> Motion:
        """Return the motion of a document.

        Parameters
        ----------
        design : MotionDocument
            Fourier series of each joint.

        Returns
        -------
        Motion
            Motion whose period is the duration of the series, and whose amplitude is its largest
            goal.

        Raises
        ------
        InputError
            If a value of the document is out of range.
        """
        check_motion_document(design, "motion")
        return cls(
            "designed", design.amplitude_rad, design.duration_s, 0.0, len(design.joints), design
        )

    @property
    def name(self) -> str:
        """Name in trials and logs: the kind, or the name of the design."""
        return self.kind if self.design is None else self.design.name

    def __post_init__(self) -> None:
        if self.kind not in KINDS and self.design is None:
            raise InputError("motion", f"{self.kind!r} is unknown", "choose " + ", ".join(KINDS))
        if self.dof not in (1, 2):
            raise InputError("dof", f"is {self.dof}", "choose 1 or 2")
        if not 0 <= self.amplitude_rad <= np.pi / 2:
            raise InputError(
                "amplitude", f"is {ANGLE.factor * self.amplitude_rad:g} degrees", "choose 0 to 90"
            )
        if not 0.1 <= self.period_s <= 600:
            raise InputError("period", f"is {self.period_s:g} s", "choose 0.1 to 600")
        if not np.isfinite(self.phase_2_rad):
            raise InputError("phase", f"is {self.phase_2_rad}", "give a finite angle")

    @property
    def duration_s(self) -> float:
        """Time from the start to the last goal in s, without the return to zero."""
        return self.period_s if self.kind == "designed" else _PERIODS[self.kind] * self.period_s

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
        if self.design is not None:
            return self.design.goal_rad(time_s) + 0.0
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


_MAKE: Final = "write it anew with dropstitch experiment"


class FixedMotionDocument(Document, frozen=True):
    """Motion file with a kind of motion: its keys stand for those of the table `[motion]`."""

    MADE_BY: ClassVar[str] = "dropstitch experiment"

    kind: Kind
    amplitude_rad: float
    period_s: float
    phase_2_rad: float = 0.0
    payload_kg: float | None = None  # Payload to attach for the run
    notes: str = ""


class MotionConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Table `[motion]`: the reference motion, see `firmware_py.core.motion`."""

    kind: Kind = "sinusoid"  # Kind of motion, see `firmware_py.core.motion`
    amplitude_rad: float = STUDY_AMPLITUDE_RAD  # Largest goal of each joint
    period_s: float = STUDY_PERIOD_S  # Time of one cycle of the sinusoid
    phase_2_rad: float = 0.0  # Phase by which joint 2 leads joint 1
    rest_s: float = 1.0  # Rest before the motion, the reference of the Deformation Index
    # Motion file, relative to robot.toml, instead of kind, amplitude, period and phase
    file: str | None = None
    design: MotionDocument | None = None  # Fourier series of the motion file

    def motion(self, dof: int) -> Motion:
        if self.design is None:
            return Motion(self.kind, self.amplitude_rad, self.period_s, self.phase_2_rad, dof)
        if len(self.design.joints) != dof:
            raise InputError(
                f"motion {self.design.name}",
                f"has {len(self.design.joints)} joints, the robot {dof}",
                "give one for this robot",
            )
        return Motion.designed(self.design)

    def with_motion(self, wanted: str) -> MotionConfig:
        """Return the table for another motion: the name of a kind, or the path of a motion file."""
        if wanted in KINDS:
            kind = msgspec.convert(wanted, Kind)
            return msgspec.structs.replace(self, kind=kind, file=None, design=None)
        if not Path(wanted).exists():
            raise InputError(
                f"motion {wanted}", "is no kind of motion and no file",
                "choose " + ", ".join(KINDS) + " or a motion file",
            )  # fmt: skip
        return self.with_file(Path(wanted))

    def with_file(self, path: Path) -> MotionConfig:
        """Return the table for a motion file: of a kind of motion, or of a Fourier series."""
        raw = read_toml(path, _MAKE, _MAKE)
        if "kind" not in raw:
            series = read_motion_document(path)
            return msgspec.structs.replace(self, file=str(path), design=series)
        check_version(path, raw, FixedMotionDocument.VERSION, _MAKE)
        document = convert(raw, FixedMotionDocument, path, "is no motion", _MAKE)
        motion = msgspec.structs.replace(
            self, kind=document.kind, amplitude_rad=document.amplitude_rad,
            period_s=document.period_s, phase_2_rad=document.phase_2_rad, file=None, design=None,
        )  # fmt: skip
        try:
            motion.motion(1)
        except InputError as error:
            raise InputError(path, f"its {error.where} {error.what}", error.remedy) from None
        return motion
