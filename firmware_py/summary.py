"""What a run was: how it ended, what went wrong on the way, where the time went."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from firmware_py.realtime.timing import Timing


class Ended(Enum):
    """How a run ended."""

    FINISHED = "finished"
    """The motion, or the time asked for, was over."""
    SIGNALLED = "signalled"
    """SIGINT or SIGTERM came; the robot was brought to a controlled stop."""
    TRIPPED = "tripped"
    """The safety supervisor stopped the robot."""


@dataclass(frozen=True)
class RunSummary:
    """What a run was.

    Attributes
    ----------
    ended : Ended
        How it ended.
    reason : str
        One sentence.
    ticks : int
        Ticks that ran.
    bus_faults : dict of str to int
        Ticks by status of the bus, OK left out.
    out_of_range : int
        Ticks in which the predictor's inputs lay outside its training range.
    timing : Timing
        Histograms, misses and their causes.
    records : ndarray of tick_dtype, shape (n,)
        The last ticks, oldest first, as many as were asked to be kept.
    telemetry_drops : int
        Ticks that the recorder did not get.
    replugs : int
        Times that the robot went on after its port had been gone.
    released : bool
        Whether every servo confirmed at the end that its torque is off.
    """

    ended: Ended
    reason: str
    ticks: int
    bus_faults: dict[str, int]
    out_of_range: int
    timing: Timing
    records: NDArray[np.void]
    telemetry_drops: int
    replugs: int = 0
    released: bool = True

    def as_dict(self) -> dict[str, Any]:
        """Everything but the records, for JSON."""
        return {
            "ended": self.ended.value,
            "reason": self.reason,
            "ticks": self.ticks,
            "bus_faults": self.bus_faults,
            "out_of_range": self.out_of_range,
            "telemetry_drops": self.telemetry_drops,
            "replugs": self.replugs,
            "released": self.released,
            "timing": self.timing.summary(),
        }
