"""What happened in a case, combined from the loop's record and the servos' log.

The observation holds what `hil.faults.faults_document` judges and writes.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from firmware_py.bus.servo_bus import BusStatus
from firmware_py.config import RobotConfig
from firmware_py.safety.estimate_trust import TrustState
from firmware_py.safety.states import SafetyState
from hil.faults.servo_log import ServoLog

Columns = Mapping[str, NDArray[Any]]
_SAME_RAD: Final = 1e-12
_READS_PER_TICK: Final = 2


class CaseObservation(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Observation of a case; its fields are those of `faults.json`."""

    # How the run ended: "finished", "tripped", "signalled", "refused", "killed" or an exit code
    ended: str
    reason: str  # Why it ended
    injected: bool = True  # Whether the fault occurred
    # Ticks until the record showed the fault, 1 for the same tick; None if it never did
    detected_ticks: int | None = None
    driven: bool = False  # Whether a servo got a goal, or its torque was on at the end
    lost_ticks: int = 0  # Slots without fresh data after the fault, including missed slots
    unlogged_ticks: int = 0  # Ticks missing in the log
    replugs: int = 0  # Number of times that the robot continued after its port came back
    misses: dict[str, int] = msgspec.field(default_factory=dict)  # Missed slots by cause
    unheard_ns: int = 0  # Longest time for which a servo was driven without an instruction
    watched: bool = True  # Whether the servos have a watchdog
    live: bool = False  # Whether a servo is still driven at the end
    drift_rad: float = 0.0  # Largest movement of a servo after its last instruction
    # Largest excess of a step of the goal over the rate limit; 0 if there was none
    goal_jump_rad: float = 0.0
    stale_as_fresh: int = 0  # Ticks whose data counted as fresh but was not sent in them
    late_replies: int = 0  # Replies that the servos' process sent late because of the host
    held_up_replies: int = 0  # Replies before which the host preempted the servos' process
    held_up_ticks: int = 0  # Ticks without fresh data in which the host preempted the loop
    # Lowest trust in the estimated tip, see `firmware_py.safety.estimate_trust`
    trust: str = TrustState.NONE.name
    # Ticks from the first loss of trust until the corrections were gone; None if they never were
    fade_ticks: int | None = None


def observe_case(
    reported: CaseObservation,
    columns: Columns,
    servo_log: ServoLog,
    began_ns: Iterable[int | None],
    slots: int,
    config: RobotConfig,
    stepped_in_tick: int | None = None,
) -> CaseObservation:
    """Complete what the robot `reported` by its ticks and the servos' log.

    The first of `began_ns` is the start of the fault; None for what never began. `slots` is the
    length of the motion, without the stop at its end. `stepped_in_tick` is the tick, from 1, in
    which a clock fault separated the record's clock from the servos' clock.
    """
    first_ns = min((time_ns for time_ns in began_ns if time_ns is not None), default=None)
    facts: dict[str, Any] = {}
    if len(columns.get("tick", ())):
        first = stepped_in_tick - 1 if stepped_in_tick else _first(columns, first_ns)
        facts = _course(columns, first, slots)
        if not stepped_in_tick:
            facts["stale_as_fresh"] = _stale_as_fresh(columns, servo_log)
    if reported.lost_ticks:  # by a robot whose log is incomplete
        facts["lost_ticks"] = reported.lost_ticks
    return msgspec.structs.replace(
        reported,
        injected=first_ns is not None,
        driven=bool(len(servo_log.goal_ns)) or servo_log.live,
        unheard_ns=servo_log.unheard_ns, watched=servo_log.watched, live=servo_log.live,
        drift_rad=servo_log.drift_rad, late_replies=servo_log.late_replies,
        held_up_replies=servo_log.held_up_replies,
        goal_jump_rad=_goal_jump_rad(servo_log, config),
        **facts,
    )  # fmt: skip


def _first(columns: Columns, began_ns: int | None) -> int | None:
    """Index of the tick in which the fault began."""
    if began_ns is None:
        return None
    ends_ns = columns["deadline_ns"] + columns["lateness_ns"] + columns["busy_ns"]
    return int(np.argmax(ends_ns >= began_ns))


def _course(columns: Columns, first: int | None, slots: int) -> dict[str, Any]:
    """Detection and lost ticks, from the tick of the fault to the end of the motion."""
    ticks, states = columns["tick"].astype(int), columns["state"].astype(int)
    stale = columns["bus_status"] > BusStatus.ALERT
    missed = columns["missed"].astype(int)
    rows = np.arange(len(ticks))
    span = rows[(rows >= (first or 0)) & (ticks - missed < slots)]
    bad = span[
        (columns["bus_status"][span] != BusStatus.OK)
        | (states[span] != SafetyState.RUNNING)
        | (missed[span] > 0)
    ]
    return {
        "detected_ticks": int(bad[0] - first + 1) if len(bad) and first is not None else None,
        "lost_ticks": int(stale[span].sum() + missed[span].sum()),
    } | _trust(columns)


def _trust(columns: Columns) -> dict[str, Any]:
    """Lowest trust in the estimated tip, and the number of ticks in which corrections faded."""
    trust, ticks = columns["trust"].astype(int), columns["tick"].astype(int)
    fading, lost = np.flatnonzero(trust == TrustState.FADING), trust == TrustState.LOST
    fade = None
    if len(fading) and lost[fading[0] :].any():
        gone = fading[0] + int(np.argmax(lost[fading[0] :]))
        fade = int(ticks[gone] - ticks[fading[0]])
    return {"trust": TrustState(int(trust.max())).name, "fade_ticks": fade}


def _stale_as_fresh(columns: Columns, servo_log: ServoLog) -> int:
    """Number of fresh ticks with an angle that its servo did not report in that tick."""
    fresh = columns["bus_status"] <= BusStatus.ALERT
    starts = columns["deadline_ns"] + columns["lateness_ns"]
    ends = starts + columns["busy_ns"]
    times_ns, reported_rad = servo_log.sample_ns, servo_log.sample_rad
    dof = reported_rad.shape[1]
    angles = np.stack([columns[f"angle_{j}_rad"] for j in range(1, dof + 1)], axis=1)
    first, end = np.searchsorted(times_ns, starts), np.searchsorted(times_ns, ends, side="right")
    true = np.zeros(angles.shape, bool)
    for read in range(_READS_PER_TICK):
        sample = np.minimum(first + read, len(times_ns) - 1)
        same = np.abs(reported_rad[sample] - angles) <= _SAME_RAD
        true |= same & (first + read < end)[:, None]
    return int((fresh & ~true.all(axis=1)).sum())


def _goal_jump_rad(servo_log: ServoLog, config: RobotConfig) -> float:
    """Largest excess of a goal's step over the rate limit.

    The first step after torque on is measured from the angle at that time.
    """
    excess, period_s, rate_rad_s = 0.0, config.period_s, config.limits_in_force.rate_rad_s
    for goals_rad, stands_rad in zip(servo_log.goal_rad.T, servo_log.stand_rad.T, strict=True):
        before, before_ns = math.inf, 0
        for now_ns, goal, stand in zip(
            servo_log.goal_ns.tolist(), goals_rad.tolist(), stands_rad.tolist(), strict=True
        ):
            if math.isinf(goal):
                before = math.inf
            elif math.isfinite(goal):
                fresh_start = math.isinf(before)
                since_s = 0.0 if fresh_start else (now_ns - before_ns) * 1e-9
                allowed_rad = rate_rad_s * period_s * max(round(since_s / period_s), 1)
                step_rad = abs(goal - (stand if fresh_start else before))
                excess = max(excess, step_rad - allowed_rad)
                before, before_ns = goal, now_ns
    return excess
