"""Time budget of a tick: the time of each stage and its budget, the parts of the read, the slack.

::

    slot   |<------------------------------- period --------------------------------->|
           | wake | read                              | estimate … write | log | slack |
                  | own | transmission | servo | wait |

`transmission` and `servo` follow from the bus plan: bits at the baud rate, return delays. `wait` is
the rest of the wait: latency timer, operating system, and the retry after a lost reply. `own` is
the work on packets. The high-water mark is the longest measured tick. It is not a worst-case
execution time: a longer tick is possible, and the bound on the miss rate limits how often.
"""

from __future__ import annotations

from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from firmware_py.bus.bus_plan import Plan
from firmware_py.bus.servo_bus import BusStatus
from firmware_py.core.signals import STAGES
from firmware_py.core.units import CPU_TIME, TICK_TIME
from firmware_py.system.timing import FRACTIONS, LABELS, Nanoseconds, Percentiles

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


class StageBudget(Percentiles, frozen=True, kw_only=True):
    """Time of a stage, its budget, and whether its 99th percentile is within it."""

    budget_p99_ns: int  # Budget for the 99th percentile
    within_budget: bool  # Whether the 99th percentile is within its budget


class Slack(Percentiles, frozen=True, kw_only=True):
    """Time left in the period after a tick."""

    min_ns: int  # Least slack of any tick; negative if one ended after its slot


class TickCost(Percentiles, frozen=True, kw_only=True):
    """Duration of some ticks, and the slots lost after them."""

    missed_slots: int  # Slots lost after these ticks


class ExchangeTime(Percentiles, frozen=True, kw_only=True):
    """Measured time of read and write together, compared with the bus plan."""

    plan_ns: int  # Time of read and write by the bus plan
    ratio_p50: float  # Ratio of the measured median to the plan
    # The same ratio with the transmission of the goals, for which the loop does not wait
    until_goals_arrived_ratio_p50: float


class TickBudget(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Breakdown of the ticks' time in a run."""

    # Time and budget by stage; the read without its wait
    stages: dict[str, StageBudget] = msgspec.field(name="budget")
    read: dict[str, Percentiles]  # Parts of the read: own, transmission, servo, wait
    slack: Slack  # Time left in the period
    high_water_mark_ns: int  # Longest tick, including its lateness
    read_again: TickCost  # Ticks in which a retry replaced a lost or damaged reply
    without_data: TickCost  # Ticks without fresh data, in which the retry failed as well
    cpu_fraction: float  # Fraction of the time in which the loop computes
    exchange: ExchangeTime  # Read and write compared with the bus plan
    # Ratio of the loop's lateness to the reference jitter, by percentile
    lateness_against_reference: dict[str, float]


def plan_times(plan: Plan) -> PlanTimes:
    return PlanTimes(
        plan=plan.name,
        transmission_ns=round((plan.read_s - plan.pause_s) * 1e9),
        servo_ns=round(plan.pause_s * 1e9),
        write_ns=round(plan.write_s * 1e9),
    )


def measure_budget(
    records: NDArray[np.void], period_s: float, plan: PlanTimes, reference: Percentiles
) -> TickBudget:
    """Break down the time of the ticks in `records`, shape (n,)."""
    period_ns = round(period_s * 1e9)
    own_ns = records["busy_ns"] - records["bus_wait_ns"]
    taken_ns = records["lateness_ns"] + records["busy_ns"]
    slack_ns = period_ns - taken_ns
    lateness = Percentiles.of(records["lateness_ns"])
    return TickBudget(
        stages={stage: _stage(records, stage) for stage in STAGES},
        read=_read_parts(records, plan),
        slack=Slack.of(slack_ns, min_ns=int(slack_ns.min()) if len(slack_ns) else 0),
        high_water_mark_ns=int(taken_ns.max()) if len(taken_ns) else 0,
        read_again=_cost(records, taken_ns, records["bus_status"] == BusStatus.RETRIED),
        without_data=_cost(records, taken_ns, records["bus_status"] > BusStatus.ALERT),
        cpu_fraction=float(own_ns.sum()) / (period_ns * len(own_ns)) if len(own_ns) else 0.0,
        exchange=_exchange(records["read_ns"] + records["write_ns"], plan),
        lateness_against_reference={
            name: getattr(lateness, name) / known
            for name in FRACTIONS
            if (known := getattr(reference, name))
        },
    )


def _stage(records: NDArray[np.void], stage: str) -> StageBudget:
    taken_ns = records[f"{stage}_ns"]
    if stage == "read":
        taken_ns = taken_ns - records["bus_wait_ns"]
    measured, limit_ns = Percentiles.of(taken_ns), BUDGET_NS[stage]
    return StageBudget(
        **msgspec.structs.asdict(measured),
        budget_p99_ns=limit_ns,
        within_budget=measured.p99_ns <= limit_ns,
    )


def _read_parts(records: NDArray[np.void], plan: PlanTimes) -> dict[str, Percentiles]:
    waited_ns, every_tick = records["bus_wait_ns"], np.ones(len(records), np.int64)
    return {
        "own": Percentiles.of(records["read_ns"] - waited_ns),
        "transmission": Percentiles.of(plan.transmission_ns * every_tick),
        "servo": Percentiles.of(plan.servo_ns * every_tick),
        "wait": Percentiles.of(waited_ns - plan.transmission_ns - plan.servo_ns),
    }


def _cost(records: NDArray[np.void], taken_ns: Nanoseconds, ticks: NDArray[np.bool_]) -> TickCost:
    skipped = np.append(records["missed"][1:], 0)
    return TickCost.of(taken_ns[ticks], missed_slots=int(skipped[ticks].sum()))


def _exchange(exchange_ns: Nanoseconds, plan: PlanTimes) -> ExchangeTime:
    p50_ns = Percentiles.of(exchange_ns).p50_ns
    plan_ns = plan.transmission_ns + plan.servo_ns + plan.write_ns
    return ExchangeTime.of(
        exchange_ns,
        plan_ns=plan_ns,
        ratio_p50=p50_ns / plan_ns,
        until_goals_arrived_ratio_p50=(p50_ns + plan.write_ns) / plan_ns,
    )


def describe_budget(budget: TickBudget, own_cost: Percentiles, reference: Percentiles) -> list[str]:
    """Return the table of a tick's parts, and the figures below it, as lines of text.

    `own_cost`: a tick without its wait for the bus. `reference`: the reference jitter.
    """
    rows: dict[str, tuple[Percentiles, str]] = {}
    for stage, measured in budget.stages.items():
        limit = f"{CPU_TIME.number(measured.budget_p99_ns):>13}"
        rows["read: own" if stage == "read" else stage] = measured, limit
        if stage == "wake":
            rows["wake: reference"] = reference, ""
        if stage == "read":
            for part in ("transmission", "servo", "wait"):
                rows[f"read: {part}"] = budget.read[part], ""
    rows["own cost"] = own_cost, ""
    rows["slack"] = budget.slack, f"{'least ' + CPU_TIME.number(budget.slack.min_ns):>13}"
    lines = [f"{'stage, µs':18} " + " ".join(f"{name:>8}" for name in LABELS) + " budget of p99"]
    for name, (row, note) in rows.items():
        numbers = " ".join(f"{CPU_TIME.number(getattr(row, f)):>8}" for f in LABELS.values())
        lines.append(f"{name:18} {numbers} {note}".rstrip())
    exchange = budget.exchange
    lines.append(
        f"read and write p50 {CPU_TIME.number(exchange.p50_ns)} µs, {exchange.ratio_p50:.2f} × "
        f"their {CPU_TIME.number(exchange.plan_ns)} µs by the plan, "
        f"{exchange.until_goals_arrived_ratio_p50:.2f} × until the goals have arrived; the loop "
        f"computes for {budget.cpu_fraction:.1%} of the time"
    )
    lines += [
        f"{cost.n} ticks {words} took at most {TICK_TIME.number(cost.max_ns, 2)} ms, p99 "
        f"{TICK_TIME.number(cost.p99_ns, 2)} ms, and lost {cost.missed_slots} slots"
        for words, cost in (
            ("that read twice", budget.read_again),
            ("without data", budget.without_data),
        )
        if cost.n
    ]
    mark = TICK_TIME.number(budget.high_water_mark_ns, 2)
    return [*lines, f"longest tick measured: {mark} ms; a longer one is possible"]
