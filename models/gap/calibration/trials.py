"""Protocol of measured trials, to be run on drawn rigs: goals as recorded, payloads, conditions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from firmware_py.core.motion import GLIDE_S, Motion
from models.plant.identification.noise_floor import trial_group_key
from models.rig.protocol import TrialCase
from models.shared.kinematics import Array
from models.trials.trial import Trial

MOST_PAYLOADS: Final = 5
"""Most payloads of a motion that are run; patterns are interpolated between them."""


def protocol_of(trials: Sequence[Trial]) -> tuple[TrialCase, ...]:
    """One case for each motion and payload of the trials, in their order."""
    first: dict[str, dict[float, Trial]] = {}
    for trial in trials:
        first.setdefault(trial_group_key(trial), {}).setdefault(trial.meta.payload_kg, trial)
    return tuple(
        _case(by_payload[payload_kg])
        for by_payload in first.values()
        for payload_kg in _evenly_chosen(sorted(by_payload))
    )


def repeated(cases: Sequence[TrialCase], repetitions: int, seed: int) -> list[TrialCase]:
    """Each case `repetitions` times, with the random numbers of a seed."""
    return [
        TrialCase(c.motion, c.payload_kg, trial, seed, c.pressure_pa, c.gravity)
        for c in cases
        for trial in range(1, repetitions + 1)
    ]


def _case(trial: Trial) -> TrialCase:
    meta = trial.meta
    return TrialCase(recorded_motion(trial), meta.payload_kg, 1, 0, meta.pressure_pa, meta.gravity)


def _evenly_chosen(payloads_kg: Sequence[float]) -> list[float]:
    """At most `MOST_PAYLOADS` of the payloads, evenly spread, both ends included."""
    most = min(MOST_PAYLOADS, len(payloads_kg))
    at = np.unique(np.round(np.linspace(0, len(payloads_kg) - 1, most)).astype(int))
    return [payloads_kg[k] for k in at]


@dataclass(frozen=True)
class RecordedMotion(Motion):
    """Goals of a trial as a reference motion; linear between two samples."""

    label: str = ""  # Name of the motion in its trials
    # (n,), from the start of the motion
    time_s: Array = field(default_factory=lambda: np.zeros(1), compare=False)
    goals_rad: Array = field(default_factory=lambda: np.zeros((1, 1)), compare=False)  # (n, dof)

    def __post_init__(self) -> None:
        """Skip the checks of `Motion`: the robot ran these goals."""

    @property
    def name(self) -> str:
        return self.label

    @property
    def duration_s(self) -> float:
        """Time from the start to the end of the last goal."""
        return float(self.time_s[-1] + self.time_s[1] - self.time_s[0])

    def goal_rad(self, time_s: ArrayLike) -> Array:
        """Goals at given times: the first one before the start, and again after the end.

        Shapes: `time_s` (...).
        """
        at_s = np.asarray(time_s, dtype=np.float64)
        beyond = np.clip((at_s - self.duration_s) / GLIDE_S, 0.0, 1.0)
        back = 0.5 - 0.5 * np.cos(np.pi * beyond)
        joints = []
        for goal in self.goals_rad.T:
            own = np.interp(at_s, self.time_s, goal)
            joints.append((1 - back) * own + back * goal[0])
        return np.stack(joints, axis=-1)


def recorded_motion(trial: Trial) -> RecordedMotion:
    """Motion of a trial, without its rest."""
    meta, rows = trial.meta, trial.moving
    return RecordedMotion(
        amplitude_rad=meta.amplitude_rad,
        period_s=meta.period_s,
        phase_2_rad=meta.phase_2_rad,
        dof=meta.dof,
        label=meta.motion,
        time_s=trial.time_s[rows] - trial.time_s[rows][0],
        goals_rad=trial.goal_rad[rows],
    )
