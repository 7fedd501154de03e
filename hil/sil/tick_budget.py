"""Time budget of a tick: the time of each stage and its budget, the parts of the read, the slack.

::

    slot   |<------------------------------- period --------------------------------->|
           | wake | read                              | estimate … write | log | slack |
                  | own | transmission | servo | wait |

`transmission` and `servo` follow from the bus plan: bits at the baud rate, return delays. `wait` is
the rest of the wait: latency timer, operating system, and the retry after a lost reply. `own` is
the work on packets. The longest tick is not a worst-case execution time: a longer one is possible,
and the bound on the miss rate limits how often.
"""

from __future__ import annotations

from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from firmware_py.bus.bus_plan import Plan
from firmware_py.system.timing import Percentiles

BUDGET_NS: Final = {
    "wake": 100_000, "read": 200_000, "estimate": 200_000, "predict": 200_000, "command": 20_000,
    "check": 80_000, "write": 100_000, "log": 200_000,
}  # fmt: skip
"""Budget for the 99th percentile of each stage; the read without its wait. Percentiles do not add,
so the sum may exceed the 1 ms of the whole tick. The budgets are reported, not judged."""


class PlanTimes(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Times of one tick that follow from the bus plan."""

    plan: str  # Name of the bus plan
    transmission_ns: int  # Bits of the read at the baud rate
    servo_ns: int  # Return delays of the servos
    write_ns: int  # Bits of the write at the baud rate


class StageTime(Percentiles, frozen=True, kw_only=True):
    """Time of a stage and its budget."""

    budget_p99_ns: int  # Budget for the 99th percentile; that of the read is for its own part
    within_budget: bool  # Whether the 99th percentile is within its budget


class Slack(Percentiles, frozen=True, kw_only=True):
    """Time left in the period after a tick."""

    min_ns: int  # Least slack of any tick; negative if one ended after its slot


def plan_times(plan: Plan) -> PlanTimes:
    return PlanTimes(
        plan=plan.name,
        transmission_ns=round((plan.read_s - plan.pause_s) * 1e9),
        servo_ns=round(plan.pause_s * 1e9),
        write_ns=round(plan.write_s * 1e9),
    )


def stage_time(records: NDArray[np.void], stage: str) -> StageTime:
    taken_ns, limit_ns = records[f"{stage}_ns"], BUDGET_NS[stage]
    own_ns = taken_ns - records["bus_wait_ns"] if stage == "read" else taken_ns
    return StageTime.of(
        taken_ns,
        budget_p99_ns=limit_ns,
        within_budget=Percentiles.of(own_ns).p99_ns <= limit_ns,
    )


def read_parts(records: NDArray[np.void], plan: PlanTimes) -> dict[str, Percentiles]:
    waited_ns, every_tick = records["bus_wait_ns"], np.ones(len(records), np.int64)
    return {
        "own": Percentiles.of(records["read_ns"] - waited_ns),
        "transmission": Percentiles.of(plan.transmission_ns * every_tick),
        "servo": Percentiles.of(plan.servo_ns * every_tick),
        "wait": Percentiles.of(waited_ns - plan.transmission_ns - plan.servo_ns),
    }


def slack(records: NDArray[np.void], period_ns: int) -> Slack:
    left_ns = period_ns - records["lateness_ns"] - records["busy_ns"]
    return Slack.of(left_ns, min_ns=int(left_ns.min()) if len(left_ns) else 0)
