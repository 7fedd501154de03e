"""Where the time of a tick goes: every stage against its budget, the read taken apart, the slack.

::

    slot   |<----------------------------- period ------------------------------->|
           | wake | read                      | estimate … write | log |  slack   |
                  | own | wire | servo | wait |

`wire` and `servo` follow from the bus plan: bits at the baud rate, return delays. `wait` is what
the read waited beyond them: latency timer, operating system, an answer that did not come and was
asked for again. `own` is its work on packets. The high-water mark is the longest tick seen. It is
no worst-case execution time: nothing rules out a longer one, and the bound on the miss rate says
how rare it must be.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from firmware_py.bus.bus_plan import Plan
from firmware_py.bus.servo_bus import BusStatus
from firmware_py.signals import STAGES
from hil.timing.timing_verdict import summarise

BUDGET_NS: Final = {
    "wake": 100_000, "read": 200_000, "estimate": 200_000, "predict": 200_000, "command": 20_000,
    "check": 80_000, "write": 100_000, "log": 200_000,
}  # fmt: skip
"""99th percentile that a stage may take by itself, the waiting of the read left out. Tails do not
add up, so the sum may be above the 1 ms of the whole. Reported, not judged."""
CPU_SHARE: Final = 0.04
EXCHANGE_RATIO: Final = 1.15
LATENESS_RATIOS: Final = {"p50_ns": 2.5, "p99_ns": 2.0, "p99_9_ns": 3.0}
"""How much later than the reference beside it the loop may wake."""


def plan_times(plan: Plan) -> dict[str, Any]:
    """What a plan says about one tick, times in ns."""
    return {
        "plan": plan.name,
        "wire_ns": round((plan.read_s - plan.pause_s) * 1e9),
        "servo_ns": round(plan.pause_s * 1e9),
        "write_ns": round(plan.write_s * 1e9),
    }


def measure_budget(
    records: NDArray[np.void], period_s: float, wire: dict[str, Any], reference: dict[str, Any]
) -> dict[str, Any]:
    """Account for the time of every tick.

    Parameters
    ----------
    records : ndarray of tick_dtype, shape (n,)
        The run.
    period_s : float
        Control period.
    wire : dict
        See `plan_times`.
    reference : dict
        Reference jitter beside it: percentiles as `hil.timing.timing_verdict.summarise` gives them.

    Returns
    -------
    dict
        "budget" by stage; "read" by part; "slack"; "high_water_mark_ns"; "read_again": ticks in
        which a reply was lost or spoilt and the second read made up for it; "without_data": ticks
        in which it did not; "cpu_share" of the loop; "exchange": read and write against the wire's
        own time; "lateness_against_reference".
    """
    period_ns = round(period_s * 1e9)
    waited = records["bus_wait_ns"]
    own_read = records["read_ns"] - waited
    taken = records["lateness_ns"] + records["busy_ns"]
    budget = {}
    for stage in STAGES:
        stages_own = summarise(own_read if stage == "read" else records[f"{stage}_ns"])
        met = stages_own["p99_ns"] <= BUDGET_NS[stage]
        budget[stage] = {**stages_own, "budget_p99_ns": BUDGET_NS[stage], "within_budget": met}
    every_tick = np.ones(len(records), np.int64)
    read = {
        "own": summarise(own_read),
        "wire": summarise(wire["wire_ns"] * every_tick),
        "servo": summarise(wire["servo_ns"] * every_tick),
        "wait": summarise(waited - wire["wire_ns"] - wire["servo_ns"]),
    }
    exchange = summarise(records["read_ns"] + records["write_ns"])
    on_wire_ns = wire["wire_ns"] + wire["servo_ns"] + wire["write_ns"]
    slack = period_ns - taken
    again = records["bus_status"] == BusStatus.RETRIED
    blind = records["bus_status"] > BusStatus.ALERT
    return {
        "budget": budget,
        "read": read,
        "slack": {**summarise(slack), "min_ns": int(slack.min()) if len(slack) else 0},
        "high_water_mark_ns": int(taken.max()) if len(taken) else 0,
        "read_again": _cost(records, taken, again),
        "without_data": _cost(records, taken, blind),
        "cpu_share": _share(records["busy_ns"] - waited, period_ns),
        "exchange": {
            **exchange,
            "wire_ns": on_wire_ns,
            "ratio_p50": exchange["p50_ns"] / on_wire_ns,
            "until_goals_arrived_ratio_p50": (exchange["p50_ns"] + wire["write_ns"]) / on_wire_ns,
        },
        "lateness_against_reference": _ratios(summarise(records["lateness_ns"]), reference),
    }  # fmt: skip


def _cost(
    records: NDArray[np.void], taken_ns: NDArray[np.int64], ticks: NDArray[np.bool_]
) -> dict[str, int]:
    """How long some ticks took, and how many slots they cost."""
    skipped = np.append(records["missed"][1:], 0)
    return {**summarise(taken_ns[ticks]), "missed_slots": int(skipped[ticks].sum())}


def _share(own_ns: NDArray[np.int64], period_ns: int) -> float:
    return float(own_ns.sum()) / (period_ns * len(own_ns)) if len(own_ns) else 0.0


def _ratios(lateness: dict[str, int], reference: dict[str, Any]) -> dict[str, float]:
    return {
        name: lateness[name] / reference[name] for name in LATENESS_RATIOS if reference.get(name)
    }


def describe_budget(account: dict[str, Any]) -> list[str]:
    """The budget table and what else is worth a line, for people."""
    rows = [f"{'stage, µs':14} {'p50':>8} {'p99':>8} {'p99.9':>8} {'max':>8} {'budget':>8}"]
    for stage, row in account["budget"].items():
        within = f"{row['budget_p99_ns'] / 1e3:8.0f}" + ("" if row["within_budget"] else "  over")
        if stage == "read":
            rows += [_row(f"read: {part}", account["read"][part]) for part in account["read"]]
            rows[-len(account["read"])] += " " + within
        else:
            rows.append(f"{_row(stage, row)} {within}")
    rows.append(_row("slack", account["slack"]) + f"  least {account['slack']['min_ns'] / 1e3:.0f}")
    exchange, ratios = account["exchange"], account["lateness_against_reference"]
    rows.append(
        f"read and write p50 {exchange['p50_ns'] / 1e3:.0f} µs, {exchange['ratio_p50']:.2f} × the "
        f"wire's own {exchange['wire_ns'] / 1e3:.0f} µs, "
        f"{exchange['until_goals_arrived_ratio_p50']:.2f} × until the goals have arrived; the loop "
        f"computes for {account['cpu_share']:.1%} of the time"
    )
    for key, words in (("read_again", "that read twice"), ("without_data", "without data")):
        if (cost := account[key])["n"]:
            rows.append(
                f"{cost['n']} ticks {words} took at most {cost['max_ns'] / 1e6:.2f} ms, p99 "
                f"{cost['p99_ns'] / 1e6:.2f} ms, and cost {cost['missed_slots']} slots"
            )
    if ratios:
        late = ", ".join(
            f"{name.removesuffix('_ns').replace('_', '.')} {ratio:.1f} ×"
            for name, ratio in ratios.items()
        )
        rows.append(f"wake-up against the reference beside it: {late}")
    rows.append(
        f"high-water mark {account['high_water_mark_ns'] / 1e6:.2f} ms: the longest tick seen, "
        "which bounds nothing"
    )
    return rows


def _row(name: str, summary: dict[str, Any]) -> str:
    keys = ("p50_ns", "p99_ns", "p99_9_ns", "max_ns")
    return f"{name:14} " + " ".join(f"{summary[key] / 1e3:8.0f}" for key in keys)
