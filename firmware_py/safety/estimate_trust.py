"""Trust in the estimated tip: whether feedback may use it, and what happens if not.

::

    NONE        no feedback
    TRUSTED ──innovation too large, out of range, stale data──► FADING
    FADING  ──corrections faded out, after 0.2 s──► LOST
    LOST    ──estimate accepted for `regain_s`──► TRUSTED

It is independent of the supervisor's states: a robot without trust continues without feedback, or
stops.
"""

from __future__ import annotations

import math
from enum import IntEnum
from typing import Final, Literal

import msgspec

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

    use: bool = True  # Whether to use the feedback of a plan that has one
    # What to do when trust is lost: continue the plan without feedback, or stop (controlled)
    when_lost: Literal["continue", "stop"] = "continue"
    bad_ticks: int = 2  # Consecutive rejected estimates after which trust is lost
    regain_s: float = 1.0  # Time of accepted estimates that restores trust


class EstimateTrust:
    """State machine of `TrustState`, updated once per tick."""

    def __init__(self, options: TrustOptions, period_s: float) -> None:
        self._options, self._period_s = options, period_s
        self.state, self.fraction = TrustState.TRUSTED, 1.0
        self.reason = ""
        self._bad, self._good_s = 0, 0.0

    @property
    def stops(self) -> bool:
        """Whether trust was lost and the options demand a stop."""
        return bool(self.reason) and self._options.when_lost == "stop"

    def update(self, doubt: str, step_s: float) -> None:
        """Update with the reason to reject the estimate of a tick; empty if it is accepted."""
        self._bad = self._bad + max(1, math.floor(step_s / self._period_s + 0.5)) if doubt else 0
        if self.state is TrustState.TRUSTED and self._bad >= self._options.bad_ticks:
            self.state, self.reason = TrustState.FADING, doubt
            self._good_s = 0.0
        if self.state is TrustState.FADING:
            self.fraction = max(self.fraction - step_s / FADE_S, 0.0)
            if self.fraction <= 0.0:
                self.state = TrustState.LOST
        elif self.state is TrustState.LOST:
            self._good_s = 0.0 if doubt else self._good_s + step_s
            if self._good_s >= self._options.regain_s:
                self.state, self.fraction = TrustState.TRUSTED, 1.0
