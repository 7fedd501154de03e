"""Trial case: the conditions, the name and the random numbers of one trial."""

from __future__ import annotations

import math
import zlib
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from firmware_py.motion import STUDY_PERIOD_S, Motion

STUDY_PRESSURE_PA: Final = 41_300.0
DOWN: Final = (0.0, 0.0, -1.0)
"""Direction of gravity for an upright robot."""

FOLDED_RAD: Final = 0.8
"""Bend of a hinge or section above which the link has folded and the trial is refused [assumed]."""

BENDING_RAD: Final = 0.3
"""Bend above which a link whose state diverges in the next period has folded [assumed]; a
simulation with too long a step diverges from small bends."""

LinkState = Literal["whole", "folded", "unstable"]


def state_of_link(bend_rad: float, before_rad: float) -> LinkState:
    """State of a simulated link, from its largest bend now and one period earlier.

    `bend_rad` is not finite if the simulation has diverged.
    """
    if bend_rad < FOLDED_RAD:
        return "whole"
    return "folded" if before_rad > BENDING_RAD else "unstable"


@dataclass(frozen=True)
class TrialCase:
    """Conditions of one trial to simulate.

    Attributes
    ----------
    motion : Motion
        Reference motion, with the number of driven joints.
    payload_kg : float
        Declared payload in kg.
    trial : int
        Number of the repetition, each with its own variation and noise.
    seed : int
        Seed of the whole set of trials.
    pressure_pa : float
        Declared pressure in Pa.
    gravity : tuple of float
        Direction of gravity in the world frame; its length does not matter.
    """

    motion: Motion
    payload_kg: float
    trial: int
    seed: int = 0
    pressure_pa: float = STUDY_PRESSURE_PA
    gravity: tuple[float, float, float] = DOWN

    @property
    def name(self) -> str:
        """Name of the trial; it lists the conditions that differ from the study's."""
        m = self.motion
        parts = [
            f"dof{m.dof}",
            f"payload{self.payload_kg:g}",
            f"trial{self.trial}",
            m.name,
            f"{math.degrees(m.amplitude_rad):.6g}deg",
        ]
        if m.dof == 2 and m.phase_2_rad:
            parts.append(f"phase{math.degrees(m.phase_2_rad):.6g}deg")
        if m.design is None and m.period_s != STUDY_PERIOD_S:
            parts.append(f"period{m.period_s:g}s")
        if self.pressure_pa != STUDY_PRESSURE_PA:
            parts.append(f"{self.pressure_pa:g}pa")
        if self.gravity != DOWN:
            parts.append("gravity" + ",".join(f"{g:g}" for g in self.gravity))
        return "_".join(parts)

    def rng(self) -> np.random.Generator:
        """Return the trial's random generator, independent of other trials and of the process."""
        return np.random.default_rng([self.seed, zlib.crc32(self.name.encode())])
