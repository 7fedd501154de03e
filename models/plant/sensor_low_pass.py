"""Low-pass of the measured signals of a joint: set by an effect, applied by the composition."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class SensorLowPass:
    """Low-pass of the measured signals of a joint.

    Attributes
    ----------
    time_s : SX
        Mean delay of the filtered signal.
    second_share : SX or None
        Fraction of it in a second stage, 0.5 for two equal stages; None for first order.
    angle_s : SX
        Time of the first-order low-pass of the coordinate.
    jump_fraction : SX or None
        Mean of the current above that of the plant, in jumps of a goal that moves as the joint
        does; None for a drive without a saw-tooth.
    """

    time_s: Any
    second_share: Any | None
    angle_s: Any
    jump_fraction: Any | None = None
