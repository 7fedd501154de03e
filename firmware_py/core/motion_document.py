"""Document of a designed motion: a Fourier series of each joint, read from a TOML file.

The goal of a joint is w(t) Σ (a_k sin(2π h_k t / T) + b_k cos(2π h_k t / T)): h_k are the
harmonics, T is the duration, and the window w eases in and out, so that the motion begins and ends
at rest at zero. Series of few harmonics are the usual form of motions that excite a robot (Swevers
et al., IEEE Trans. Robotics and Automation 13, 1997)::

    schema = 1
    duration_s = 10.0
    harmonics = [1, 2, 5]                  # cycles in the duration; 0 is a constant lean

    [[joints]]
    sine_rad = [0.2, -0.1, 0.02]
    cosine_rad = [0.1, 0.0, 0.01]
"""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import ClassVar, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from firmware_py.core.documents import Document, check_version
from firmware_py.core.errors import InputError
from firmware_py.core.input_files import convert, read_toml

__all__ = ["JointSeries", "MotionDocument", "read_motion_document"]

Array = NDArray[np.float64]
FADE_FRACTION: Final = 0.1
"""Fraction of the duration for easing in, and for easing out; that of the multisine."""
HIGHEST_FREQUENCY_HZ: Final = 10.0
"""Highest frequency of a harmonic: six samples a cycle at the nominal period [assumed]."""
_MAKE: Final = "correct it after docs/gap/experiment.md"


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
        """Largest goal of any joint."""
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
    """Read and check a motion file."""
    path = Path(path)
    raw = read_toml(path, _MAKE, _MAKE)
    check_version(path, raw, MotionDocument.VERSION, _MAKE)
    document = convert(raw, MotionDocument, path, "is no motion", _MAKE)
    check_motion_document(document, path)
    return document


def check_motion_document(document: MotionDocument, where: Path | str) -> None:
    """Refuse values of a series that are out of range or do not fit together."""
    count = len(document.harmonics)
    every = [c for j in document.joints for c in (*j.sine_rad, *j.cosine_rad)]
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
    elif not np.isfinite(every).all():
        wrong = "has a coefficient that is not finite"
    elif not 0 <= payload_kg <= 100:
        wrong = f"has a payload of {payload_kg:g} kg, outside 0 to 100 kg"
    elif document.amplitude_rad > np.pi / 2:
        wrong = f"reaches {document.amplitude_rad:.3g} rad, more than 1.57 rad"
    if wrong:
        raise InputError(where, wrong, _MAKE)
