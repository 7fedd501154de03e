"""Trust in the estimated tip: whether corrections by it may act, and what follows where not.

::

    NONE        no feedback
    TRUSTED ──innovation too large, out of range, stale data──► FADING
    FADING  ──the corrections are gone, 0.2 s later──► LOST
    LOST    ──the estimate was good for `regain_s`──► TRUSTED

It stands beside the supervisor's states: a robot without trust runs on without feedback, or stops.
"""

from __future__ import annotations

import math
from enum import IntEnum
from typing import Final, Literal

import msgspec

__all__ = ["EstimateTrust", "TrustOptions", "TrustState"]

FADE_S: Final = 0.2
"""Time in which corrections fade out (requirement)."""


class TrustState(IntEnum):
    """State of the trust in the estimate; see the module's drawing."""

    NONE = 0
    TRUSTED = 1
    FADING = 2
    LOST = 3


class TrustOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Table `[feedback]` of robot.toml."""

    use: bool = True  # Whether a plan that has feedback runs with it
    # What follows when the estimate is not trusted: the plan goes on without feedback, or a
    # controlled stop
    when_lost: Literal["continue", "stop"] = "continue"
    bad_ticks: int = 2  # Ticks in a row with a bad estimate after which it is not trusted
    regain_s: float = 1.0  # Time for which the estimate must be good before it is trusted again


class EstimateTrust:
    """State machine of `TrustState`, run once a tick."""

    def __init__(self, options: TrustOptions, period_s: float) -> None:
        self._options, self._period_s = options, period_s
        self.state, self.fraction = TrustState.TRUSTED, 1.0
        self.reason, self.losses = "", 0
        self._bad, self._good_s = 0, 0.0

    @property
    def stops(self) -> bool:
        """Whether the robot must stop."""
        return self.losses > 0 and self._options.when_lost == "stop"

    def update(self, doubt: str, step_s: float) -> None:
        """Take what is wrong with the estimate of a tick; empty for nothing."""
        self._bad = self._bad + max(1, math.floor(step_s / self._period_s + 0.5)) if doubt else 0
        if self.state is TrustState.TRUSTED and self._bad >= self._options.bad_ticks:
            self.state, self.reason = TrustState.FADING, doubt
            self.losses += 1
            self._good_s = 0.0
        if self.state is TrustState.FADING:
            self.fraction = max(self.fraction - step_s / FADE_S, 0.0)
            if self.fraction <= 0.0:
                self.state = TrustState.LOST
        elif self.state is TrustState.LOST:
            self._good_s = 0.0 if doubt else self._good_s + step_s
            if self._good_s >= self._options.regain_s:
                self.state, self.fraction = TrustState.TRUSTED, 1.0
