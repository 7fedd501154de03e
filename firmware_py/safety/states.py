"""States of the safety supervisor and the transitions between them.

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

`TRANSITIONS` holds this drawing as data; the drawing in docs/safety.md is generated from it.
"""

from __future__ import annotations

from enum import IntEnum
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
