"""Low-pass of the measured signals of a joint: set by an effect, applied by the composition."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class SensorLowPass:
    """Low-pass of the measured signals of a joint."""

    time_s: Any  # Mean delay of the filtered signals
    # Fraction of the delay in a second stage, 0.5 for two equal stages; None for first order
    second_share: Any | None
    angle_s: Any  # Time constant of the first-order low-pass of the coordinate
    # Mean of the current above the plant's, in units of the jumps of a goal that moves as the joint
    # does; None for a drive without a saw-tooth
    jump_fraction: Any | None = None
