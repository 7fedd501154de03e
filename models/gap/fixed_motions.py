"""Fixed motions that may tell effects apart, and planned trials of a motion."""

from __future__ import annotations

from typing import Final

import msgspec
import numpy as np

from firmware_py.core.motion import Kind, Motion
from firmware_py.core.signals import PERIOD_S
from models.plant.step_model import Array
from models.trials.trial import Trial, TrialMeta

REST_SAMPLES: Final = 60
"""Samples at rest before a motion that is simulated to separate look-alikes [assumed]."""
SWAPPED_PAYLOAD_KG: Final = 2.0
"""Payload of the payload swap among these motions; none where trials carried more than half of it
[assumed]."""

MENU: Final[dict[str, Kind]] = {
    "multisine": "multisine", "payload swap": "sinusoid", "slow triangle": "triangle",
    "step and hold": "steps", "free decay": "decay",
}  # fmt: skip
"""Motions of the link by their displayed name; a slow robot may not be able to run all of them."""


def motion_like(meta: TrialMeta, kind: Kind) -> Motion:
    """Motion of a kind, with amplitude, period and phase of a trial."""
    return Motion(kind, meta.amplitude_rad, meta.period_s, meta.phase_2_rad, meta.dof)


def planned_trial(like: Trial, motion: Motion, payload_kg: float, rest_samples: int) -> Trial:
    """Trial of a motion before it is run: conditions and goals; the angles equal the goals."""
    goal_rad = motion.table_rad(rest_samples=rest_samples)
    columns: dict[str, Array] = {"time_s": PERIOD_S * np.arange(len(goal_rad), dtype=np.float64)}
    for j in range(motion.dof):
        columns[f"goal_{j + 1}_rad"] = columns[f"angle_{j + 1}_rad"] = goal_rad[:, j]
    meta = msgspec.structs.replace(
        like.meta, motion=motion.kind, payload_kg=payload_kg, period_s=motion.period_s,
        amplitude_rad=motion.amplitude_rad, phase_2_rad=motion.phase_2_rad,
        rest_samples=rest_samples, source="simulated",
    )  # fmt: skip
    return Trial(motion.kind, meta, columns)
