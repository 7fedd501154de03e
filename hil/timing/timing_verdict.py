"""The timing verdict: which deadlines were missed, and whose doing it was.

A tick misses when it ends after its slot. Its excess, lateness + busy - period, is the time that
it would have had to be faster by. It is set against the time for which the kernel shows that
somebody else had the processor:

What is the host's
    Run-queue delay of the loop's thread (`/proc/…/schedstat`), less what processes of ours ran on
    that processor meanwhile. Time in which the processor stood still: a probe with a higher
    priority than everything of ours is pinned to it and wakes every few milliseconds; where even
    the probe was late the hypervisor, an interrupt or a stranger's real-time task had the
    processor. Such a stall is known to within one period of the probe: all that is possible
    excuses a miss, only what is certain makes a tick count as preempted. The larger of the two
    accounts counts, since they overlap.
    The same two for the processor of the emulator, as far as the loop waited longer for the wire
    than it usually does. The processes of `--load` are declared host load: time lost to them is
    the host's. Steal time (`/proc/stat`) comes in steps of 10 ms over all processors: it is
    evidence of the same stalls and counts only where no probe ran, or where the kernel refused
    the probe its priority: then it may have waited behind ourselves.

What is ours
    Everything else: computing, waiting for the bus, and every delay by a process of ours, be it
    emulator, recorder or probe. Lateness that no counter explains is ours as well.

A miss is the host's where its excess is no longer than the host's time, and ours beyond doubt
where it would have been a miss without it. A tick counts as preempted by the host from
`PREEMPTED_NS` on. Verdict:

==================== ==== =======================================================================
fail                 1    the safety supervisor stopped the robot, or a miss is ours beyond doubt
inconclusive         3    else, more than 1 % of the ticks were preempted by the host, or it took so
                          many slots in a row that the supervisor stopped the robot
pass                 0    else; misses that are the host's are listed
==================== ==== =======================================================================
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from firmware_py.console import DONE, INCONCLUSIVE, NEGATIVE
from firmware_py.realtime.timing import Cause, miss_rate_bound
from firmware_py.safety.states import SafetyState
from firmware_py.signals import STAGES
from hil.timing.cpu_accounts import ProbeRecord, Releases

Nanoseconds = NDArray[np.int64]

PREEMPTED_NS: Final = 500_000
"""Host time in a tick from which on the tick counts as preempted: half of the cost budget."""
PREEMPTED_SHARE: Final = 0.01
"""Share of preempted ticks above which a run proves nothing."""
OWN_COST_P50_NS: Final = 500_000
OWN_COST_P99_NS: Final = 1_000_000
"""Targets for a tick without its waiting for the wire; reported, not judged."""


@dataclass(frozen=True)
class Miss:
    """A tick that ended after its slot.

    Attributes
    ----------
    tick : int
        Number of its slot.
    slots : int
        Slots lost by it.
    excess_ns, host_ns, bus_wait_ns : int
        How much too long it took; the time that was the host's; its wait for the wire.
    cause : Cause
        Whose doing it was.
    """

    tick: int
    slots: int
    excess_ns: int
    host_ns: int
    bus_wait_ns: int
    cause: Cause


def host_time_ns(
    records: NDArray[np.void], loop_cpu: ProbeRecord, line_cpu: ProbeRecord, releases: Releases
) -> tuple[Nanoseconds, Nanoseconds]:
    """Time of each tick in which the host had a processor that we were waiting for.

    Parameters
    ----------
    records : ndarray of tick_dtype, shape (n,)
        The run.
    loop_cpu, line_cpu : ProbeRecord
        What the probes saw on the processors of loop and emulator; may be empty.
    releases : Releases
        The emulator's own record; may be empty.

    Returns
    -------
    (ndarray, ndarray), each of shape (n,)
        What is certain, and what is possible.
    """
    host = np.zeros((len(records), 2), np.int64)
    waits = records["bus_wait_ns"]
    longer = np.maximum(waits - np.median(waits), 0) if len(waits) else waits
    starts = records["deadline_ns"]
    ends = starts + records["lateness_ns"] + records["busy_ns"]
    for k, (start_ns, end_ns) in enumerate(zip(starts.tolist(), ends.tolist(), strict=True)):
        # A tick's run-queue delay counts from the end of the tick before.
        queued = int(records["preempted_ns"][k]) - loop_cpu.ours_between_ns(
            int(ends[k - 1]) if k else start_ns, end_ns
        )
        line_queued = releases.run_delay_between_ns(start_ns, end_ns)
        line_queued -= line_cpu.ours_between_ns(start_ns, end_ns)
        steal = int(records["steal_ns"][k])
        stalls = loop_cpu.stall_ns(start_ns, end_ns) if loop_cpu.proves else (steal, steal)
        for column, (stall, line_stall) in enumerate(
            zip(stalls, line_cpu.stall_ns(start_ns, end_ns), strict=True)
        ):
            wire = min(max(line_queued, line_stall, 0), int(longer[k]))
            host[k, column] = min(max(queued, stall, 0) + wire, end_ns - start_ns)
    return host[:, 0], host[:, 1]


def find_misses(records: NDArray[np.void], host_ns: Nanoseconds, period_ns: int) -> list[Miss]:
    """Every tick that ended after its slot, with its cause."""
    excess = records["lateness_ns"] + records["busy_ns"] - period_ns
    skipped = np.append(records["missed"][1:], 0)  # by the tick in front of the gap
    misses = []
    for k in np.flatnonzero((excess > 0) | (skipped > 0)).tolist():
        excess_ns, wait_ns = max(int(excess[k]), 1), int(records["bus_wait_ns"][k])
        if excess_ns <= host_ns[k]:
            cause = Cause.PREEMPTED
        elif wait_ns > records["busy_ns"][k] - wait_ns:
            cause = Cause.BUS_WAIT
        else:
            cause = Cause.OWN_COMPUTE
        slots = int(skipped[k]) or -(-excess_ns // period_ns)
        tick = int(records["tick"][k])
        misses.append(Miss(tick, slots, excess_ns, int(host_ns[k]), wait_ns, cause))
    return misses


def stopped_after_miss(records: NDArray[np.void]) -> bool:
    """Whether the supervisor stopped the robot in a tick right after slots had been missed."""
    stopping = np.flatnonzero(records["state"] == SafetyState.STOPPING)
    return len(stopping) > 0 and bool(records["missed"][stopping[0]])


def judge_timing(
    records: NDArray[np.void],
    period_s: float,
    loop_cpu: ProbeRecord | None = None,
    line_cpu: ProbeRecord | None = None,
    releases: Releases | None = None,
    environment: dict[str, Any] | None = None,
    stopped: str = "",
) -> dict[str, Any]:
    """Judge a run; the contents of `timing.json`.

    Parameters
    ----------
    records : ndarray of tick_dtype, shape (n,)
        Every tick of the run, in order.
    period_s : float
        Control period.
    loop_cpu, line_cpu : ProbeRecord, optional
        What the probes saw.
    releases : Releases, optional
        The emulator's own record.
    environment : dict, optional
        Facts about machine and line, copied.
    stopped : str
        Why the safety supervisor stopped the robot; empty where it did not.

    Returns
    -------
    dict
        Times in nanoseconds; "verdict" is "pass", "fail" or "inconclusive".
    """
    period_ns = round(period_s * 1e9)
    loop_cpu = loop_cpu or ProbeRecord()
    host_ns, possible_ns = host_time_ns(
        records, loop_cpu, line_cpu or ProbeRecord(), releases or Releases()
    )
    misses = find_misses(records, possible_ns, period_ns)
    causes = {cause: sum(m.slots for m in misses if m.cause is cause) for cause in Cause}
    lost = sum(causes.values())
    own = lost - causes[Cause.PREEMPTED]
    slots = len(records) + lost
    preempted = int(np.count_nonzero(host_ns >= PREEMPTED_NS))
    share = preempted / max(len(records), 1)
    stages = {name: summarise(records[f"{name}_ns"]) for name in STAGES}
    cost = summarise(records["busy_ns"] - records["bus_wait_ns"])
    if stopped and not own and stopped_after_miss(records):
        verdict = "inconclusive"
        reason = f"the host stood still, so the safety supervisor stopped the robot: {stopped}"
    elif stopped:
        verdict, reason = "fail", f"the safety supervisor stopped the robot: {stopped}"
    elif own:
        verdict, reason = "fail", f"{own} of {slots} slots were missed by our own doing"
    elif share > PREEMPTED_SHARE:
        verdict = "inconclusive"
        reason = f"the host preempted {preempted} of {len(records)} ticks: run it on a calmer one"
    else:
        verdict, reason = "pass", f"no slot of {slots} was missed by our own doing"
    return {
        "schema": 1,
        "verdict": verdict,
        "reason": reason,
        "stopped": stopped,
        "budget": {
            "period_ns": period_ns,
            "own_cost_p50_ns": OWN_COST_P50_NS,
            "own_cost_p99_ns": OWN_COST_P99_NS,
            "preempted_share": PREEMPTED_SHARE,
        },
        "slots": slots,
        "ticks": len(records),
        "stages": stages,
        "tick": summarise(records["busy_ns"]),
        "own_cost": {
            **cost,
            "within_budget": cost["p50_ns"] <= OWN_COST_P50_NS
            and cost["p99_ns"] <= OWN_COST_P99_NS,
        },
        "bus_wait": summarise(records["bus_wait_ns"]),
        "lateness": summarise(records["lateness_ns"]),
        "host": {**summarise(host_ns), "preempted_ticks": preempted, "preempted_share": share},
        "misses": lost,
        "own_misses": own,
        "longest_run_of_misses": max((m.slots for m in misses), default=0),
        "causes": {cause.value: count for cause, count in causes.items()},
        "missed": [{**vars(m), "cause": m.cause.value} for m in misses],
        "miss_rate_upper_bound_95": miss_rate_bound(lost, slots),
        "own_miss_rate_upper_bound_95": miss_rate_bound(own, slots),
        "reference_jitter": {
            **summarise(loop_cpu.lateness_ns),
            "period_ns": loop_cpu.period_ns,
            "method": "clock_nanosleep in a process of its own on the loop's processor",
            "above_the_loop": loop_cpu.proves,
        },
        "environment": dict(environment or {}),
    }


def exit_code(timing: dict[str, Any]) -> int:
    """Exit code of a verdict."""
    return {"pass": DONE, "fail": NEGATIVE, "inconclusive": INCONCLUSIVE}[timing["verdict"]]


def summarise(values: Nanoseconds) -> dict[str, int]:
    """Count, percentiles and maximum; a percentile is a value that occurred."""
    names = ("p50_ns", "p99_ns", "p99_9_ns", "max_ns")
    if len(values) == 0:
        return {"n": 0, **dict.fromkeys(names, 0)}
    shares = np.quantile(values, (0.5, 0.99, 0.999, 1.0), method="inverted_cdf")
    return {"n": len(values), **{name: int(v) for name, v in zip(names, shares, strict=True)}}


def junit_xml(timing: dict[str, Any]) -> bytes:
    """The verdict as JUnit XML: one case per question."""
    own, stopped = timing["own_misses"], timing["stopped"]
    missed = [m for m in timing["missed"] if m["cause"] != Cause.PREEMPTED.value]
    restless = timing["verdict"] == "inconclusive"
    # Question, how it was answered where not with yes, and what there is to say about it.
    cases = (
        (
            "the robot is not stopped",
            ("skipped" if restless else "failure") if stopped else "",
            stopped,
        ),
        (
            "no deadline is missed by our own doing",
            "failure" if own else "",
            "\n".join(map(str, missed)),
        ),
        (
            "the host leaves the loop alone",
            "skipped" if restless else "",
            f"{timing['host']['preempted_ticks']} ticks preempted",
        ),
    )
    outcomes = [outcome for _, outcome, _ in cases]
    suite = ET.Element(
        "testsuite", name="dropstitch.sil", tests=str(len(cases)),
        failures=str(outcomes.count("failure")), skipped=str(outcomes.count("skipped")),
    )  # fmt: skip
    properties = ET.SubElement(suite, "properties")
    for name, value in (
        ("verdict", timing["verdict"]),
        ("own_cost_p99_ns", timing["own_cost"]["p99_ns"]),
        ("own_miss_rate_upper_bound_95", timing["own_miss_rate_upper_bound_95"]),
        *timing["environment"].items(),
    ):
        ET.SubElement(properties, "property", name=str(name), value=str(value))
    for name, outcome, text in cases:
        case = ET.SubElement(suite, "testcase", classname="sil", name=name)
        if outcome:
            ET.SubElement(case, outcome, message=timing["reason"]).text = text
    ET.indent(suite)
    document: bytes = ET.tostring(suite, encoding="utf-8", xml_declaration=True)
    return document
