"""Summary of a run: end, faults, timing."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from firmware_py.realtime.timing import Timing


class Ended(Enum):
    """Kind of end of a run."""

    FINISHED = "finished"
    """The motion, or the requested time, was over."""
    SIGNALLED = "signalled"
    """SIGINT or SIGTERM; the robot came to a controlled stop."""
    TRIPPED = "tripped"
    """The safety supervisor stopped the robot."""


@dataclass(frozen=True)
class RunSummary:
    """Result of a run.

    Attributes
    ----------
    ended : Ended
        Kind of end.
    reason : str
        Cause of the end, one sentence.
    ticks : int
        Ticks that ran.
    bus_faults : dict of str to int
        Ticks by status of the bus, OK left out.
    out_of_range : int
        Ticks in which the predictor's inputs lay outside its training range.
    timing : Timing
        Histograms, misses and their causes.
    records : ndarray of tick_dtype, shape (n,)
        The last ticks, oldest first.
    telemetry_drops : int
        Ticks that the recorder did not receive.
    replugs : int
        Times that the robot continued after its port had gone.
    released : bool
        Whether every servo confirmed torque off at the end.
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
        """Return everything but the records, for JSON."""
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
