"""States of the safety supervisor, the transitions between them, and the reason of a stop.

::

    STARTING ──arm──► READY ──start──► RUNNING ◄──fresh data──┐
        │                                │  └──stale data──► DEGRADED
        ▲                                │                     │ `stale_ticks` in a row
        │                                │ limit, alert,       │
        │                                │ stall, request      │
        │                                ▼                     ▼
        │                             STOPPING ◄───────────────┘
        │ the port is back               │ goals slowed down to rest, held for `hold_s`
        │                                ▼
        └─────────────────────────────  OFF: the loop ends and switches the torque off

`TRANSITIONS` holds this drawing as data; the table in docs/safety.md is generated from it.
"""

from __future__ import annotations

from enum import Enum, IntEnum, auto
from typing import Final, NamedTuple


class SafetyState(IntEnum):
    """State of the supervisor; see the module's drawing."""

    STARTING = 0
    READY = 1
    RUNNING = 2
    DEGRADED = 3
    STOPPING = 4
    OFF = 5


class Transition(NamedTuple):
    source: SafetyState
    target: SafetyState
    cause: str


TRANSITIONS: Final = (
    Transition(
        SafetyState.STARTING, SafetyState.READY, "every joint stands inside `limits.angle_rad`"
    ),
    Transition(SafetyState.READY, SafetyState.RUNNING, "the torque is on"),
    Transition(SafetyState.RUNNING, SafetyState.DEGRADED, "the data is stale"),
    Transition(SafetyState.DEGRADED, SafetyState.RUNNING, "the data is fresh again"),
    Transition(
        SafetyState.RUNNING, SafetyState.STOPPING,
        "a limit broken, an alert of a servo, slots missed, the clock set back, a request",
    ),
    Transition(
        SafetyState.DEGRADED, SafetyState.STOPPING,
        "`limits.stale_ticks` without fresh data, slots missed, a goal beyond a limit, a request",
    ),
    Transition(SafetyState.READY, SafetyState.STOPPING, "a request before the torque is on"),
    Transition(
        SafetyState.STOPPING, SafetyState.OFF,
        "the goals came to rest and were held for `hold_s`; an alert, a measurement beyond a limit "
        "or a port that has gone ends the hold",
    ),
    Transition(SafetyState.OFF, SafetyState.STARTING, "the port is back within `bus.replug_s`"),
)  # fmt: skip

ALLOWED: Final = frozenset((t.source, t.target) for t in TRANSITIONS)
"""Every permitted pair of source and target."""


UNRELEASED: Final = "not every servo confirmed torque off: switch its power off"


class Fault(Enum):
    """Kind of fault; a reason names the first of each kind."""

    ALERT = auto()
    DATA = auto()
    SLOTS = auto()
    CLOCK = auto()
    MEASUREMENT = auto()
    FROZEN = auto()
    GOAL = auto()
    TORQUE = auto()
    ESTIMATE = auto()


class StopReason:
    """Cause of a stop, then the faults detected while the robot stopped.

    A robot that starts again keeps the reasons of earlier stops, for the summary of the run.
    """

    def __init__(self) -> None:
        self.text, self.tripped = "", False
        self.faults: set[Fault] = set()
        self.earlier_faults: set[Fault] = set()
        self._earlier: list[str] = []

    @property
    def whole(self) -> str:
        """Text of the earlier stops, once each, and of this one; empty before a stop."""
        return "; then ".join([*self._earlier, self.text]) if self.text else ""

    def restart(self, cause: str) -> None:
        """Store this stop as an earlier one, since the robot starts again."""
        if self.text not in self._earlier:
            self._earlier += [self.text, cause]
        self.earlier_faults |= self.faults
        self.text, self.tripped, self.faults = "", False, set()

    def begin(self, text: str, fault: Fault | None = None) -> None:
        self.text = text
        self.tripped = fault is not None
        self.faults = set() if fault is None else {fault}

    def add(self, fault: Fault, text: str) -> None:
        """Add a fault detected later, unless the reason already has one of its kind."""
        if fault not in self.faults:
            self.faults.add(fault)
            self.text += f"; then {text}"
