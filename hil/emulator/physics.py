"""Interface of the plant behind the emulated servos, and the description of a rig as plant."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Physics(Protocol):
    """Plant behind the servos, including their closed loops."""

    dof: int  # Number of joints, one servo each
    angle_rad: Array  # (dof,), at the end of the last step
    current_a: Array  # (dof,), at the end of the last step

    @property
    def tip_m(self) -> Array:
        """Tip in the world frame at the end of the last step, shape (3,)."""
        ...

    def advance(self, goal_rad: Sequence[float], step_s: float) -> None:
        """Advance by one step with constant goals."""
        ...


@dataclass(frozen=True)
class RigSource:
    """Rig to simulate behind the servos."""

    # Strength of each effect added to the rig, in the unit that `models.shared.catalogue` lists
    hidden: Mapping[str, float] = field(default_factory=dict)
    seed: int = 0  # Seed of the variation between trials and of the current's noise
    # Name of a structure, or a TOML file that changes values (`models.rig.drawn.rig_named`)
    rig: str = "default"
    pressure_pa: float | None = None  # Declared pressure; by default that of the link
