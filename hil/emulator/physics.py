"""Interface of the physics behind the emulated servos, and the rig as its source."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Physics(Protocol):
    """Plant behind the servos, their own closed loops included."""

    dof: int  # Number of joints, one servo each
    angle_rad: Array  # (dof,), state at the end of the last step
    current_a: Array

    @property
    def tip_m(self) -> Array:
        """End effector at the end of the last step."""
        ...

    def advance(self, goal_rad: Sequence[float], step_s: float) -> None:
        """Advance by a step with constant goals."""
        ...


@dataclass(frozen=True)
class RigSource:
    """Rig behind the servos."""

    # Effects added to its default ones, in the unit that `models.shared.catalogue` lists
    hidden: Mapping[str, float] = field(default_factory=dict)
    seed: int = 0  # Of the variation between trials and of the current's noise
    # Name of a structure, or a TOML file that changes values (`models.rig.drawn_rig.rig_named`)
    rig: str = "default"
    pressure_pa: float | None = None  # Declared pressure; that of the link by default
