"""Timing verdict of a run: pass, fail or inconclusive, from its missed deadlines and their causes.

==================== ==== =======================================================================
pass                 0    no miss is the loop's own, and all misses together bound the miss rate
                          below the one asked for, with 95 % confidence
fail                 1    the safety supervisor stopped the robot, or a miss is the loop's own
inconclusive         3    the host caused the misses, or every tick for which the supervisor stopped
                          the robot; or a signal ended the run, or it was too short for the miss
                          rate asked for
==================== ==== =======================================================================

A host that preempts the loop without a miss does not prevent a pass: the loop met every deadline
in spite of it. A tick counts as preempted if its certain host time is `PREEMPTED_NS` or more.

A tick misses its deadline if it ends after its slot. Its excess, lateness + busy - period, is
compared with the time for which the kernel shows that something outside this program had the
processor (`firmware_py.system.timing.cause_of_miss`).

Host time
    - Run-queue delay of the loop's thread (`/proc/…/schedstat`), less the time that processes of
      this program ran on that processor meanwhile.
    - Steal time: the thread neither slept nor waited in the run queue, but the kernel counted less
      processor time than had passed.
    - Stalls of the processor at any other point of the tick, which the probe on it shows by being
      late itself (`hil.sil.probe`): the hypervisor, an interrupt or a foreign real-time task had
      the processor. A stall is known to within one period of the probe: its possible time excuses
      a miss, and only its certain time makes a tick count as preempted.
    - The same for the processor of the emulator, up to the time by which the loop waited for the
      bus longer than the median.

    The accounts of thread and probe overlap, so only the larger one counts. The processes of
    `--load` are declared host load: time lost to them is host time.

Own time
    Everything else: computing, waiting for the bus, and every delay by a process of this program
    (emulator, recorder or probe). Lateness that no counter explains is own time as well.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from typing import Any, ClassVar, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from firmware_py.bus.servo_bus import BusStatus
from firmware_py.core.documents import Document
from firmware_py.core.signals import STAGES
from firmware_py.safety.states import Fault, SafetyState
from firmware_py.system.timing import (
    Cause,
    Nanoseconds,
    Percentiles,
    cause_of_miss,
    miss_rate_bound,
)
from hil.emulator.emulator import Releases
from hil.sil.probe import ProbeRecord
from hil.sil.tick_budget import Slack, StageTime, slack, stage_time
from hil.verdict import JUnitCase, Verdict, junit_xml

PREEMPTED_NS: Final = 500_000
"""Certain host time at which a tick counts as preempted: half of the cost budget."""
MISS_RATE: Final = 1e-3
"""Miss rate that a run in real time bounds by default, with 95 % confidence."""
_OF_A_HOST: Final = {Fault.DATA, Fault.SLOTS}
"""Faults that the host can cause."""


class Miss(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A tick that ended after its slot."""

    tick: int  # Number of its slot
    slots: int  # Number of slots lost
    excess_ns: int  # Time by which it ended after its slot
    host_ns: int  # Possible host time in the tick
    bus_wait_ns: int  # Wait for the bus in the tick
    cause: Cause  # The host if it explains the excess, else the larger of bus wait and computing


class TimingTargets(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Limits of a run."""

    period_ns: int  # Control period
    # Miss rate that the run has to bound with 95 % confidence; 1 asks for none
    miss_rate: float = 1.0


class HostTime(Percentiles, frozen=True, kw_only=True):
    """Certain host time of a tick, and how many ticks count as preempted."""

    preempted_ticks: int  # Number of ticks that count as preempted by the host
    preempted_fraction: float  # Fraction of ticks that count as preempted by the host


class TimingVerdict(Document, frozen=True, kw_only=True):
    """Verdict on the timing of a run; the first part of `timing.json`."""

    VERSION: ClassVar[int] = 4

    verdict: Verdict
    reason: str  # One sentence that explains the verdict
    stopped: str  # Reason for which the safety supervisor stopped the robot; empty if it did not
    # Signal that ended the run early, and the slots completed by then; empty if none did
    interrupted: str = ""
    targets: TimingTargets = msgspec.field(name="budget")  # Limits
    slots: int  # Number of slots, including lost ones
    ticks: int  # Number of ticks that ran
    stages: dict[str, StageTime]  # Duration of each stage of a tick, and its budget
    tick: Percentiles  # Duration of a tick
    own_cost: Percentiles  # Duration of a tick without its wait for the bus
    bus_wait: Percentiles  # Wait for the bus in a tick
    lateness: Percentiles  # Lateness of the wake-up
    slack: Slack  # Time left in the period after a tick
    host: HostTime  # Certain host time of a tick
    misses: int  # Number of lost slots
    own_misses: int  # Number of lost slots that are not attributed to the host
    longest_run_of_misses: int  # Largest number of slots lost in a row
    causes: dict[Cause, int]  # Number of lost slots by cause
    missed: tuple[Miss, ...]  # Every tick that ended after its slot
    miss_rate_upper_bound_95: float  # Upper bound on the miss rate with 95 % confidence
    # Upper bound with 95 % confidence on the rate of misses that are not attributed to the host
    own_miss_rate_upper_bound_95: float


def judge_timing(
    records: NDArray[np.void],
    period_s: float,
    loop_cpu: ProbeRecord | None = None,
    line_cpu: ProbeRecord | None = None,
    releases: Releases | None = None,
    stopped: str = "",
    faults: Collection[Fault] = (),
    interrupted: str = "",
    miss_rate: float = 1.0,
) -> TimingVerdict:
    """Judge the timing of a run from its `records`, shape (n,).

    `stopped` is the reason of the safety supervisor for a stop, `faults` what it detected;
    `interrupted` names a signal that ended the run early. They are empty otherwise. `miss_rate` is
    the one that the run has to bound; 1 asks for none, as in simulated time.
    """
    targets = TimingTargets(period_ns=round(period_s * 1e9), miss_rate=miss_rate)
    certain_ns, possible_ns = host_time_ns(
        records, loop_cpu or ProbeRecord(), line_cpu or ProbeRecord(), releases or Releases()
    )
    misses = find_misses(records, possible_ns, targets.period_ns)
    causes = {cause: sum(m.slots for m in misses if m.cause is cause) for cause in Cause}
    lost = sum(causes.values())
    own_misses, slots = lost - causes[Cause.PREEMPTED], len(records) + lost
    excused = bool(faults) and not own_misses and stopped_by_host(records, possible_ns, faults)
    verdict, reason = _decide(
        stopped, own_misses, lost, slots, targets, excused=excused, interrupted=interrupted
    )
    preempted = int(np.count_nonzero(certain_ns >= PREEMPTED_NS))
    return TimingVerdict(
        schema=TimingVerdict.VERSION,
        verdict=verdict,
        reason=reason,
        stopped=stopped,
        interrupted=interrupted,
        targets=targets,
        slots=slots,
        ticks=len(records),
        stages={name: stage_time(records, name) for name in STAGES},
        tick=Percentiles.of(records["busy_ns"]),
        own_cost=Percentiles.of(records["busy_ns"] - records["bus_wait_ns"]),
        bus_wait=Percentiles.of(records["bus_wait_ns"]),
        lateness=Percentiles.of(records["lateness_ns"]),
        slack=slack(records, targets.period_ns),
        host=HostTime.of(
            certain_ns,
            preempted_ticks=preempted,
            preempted_fraction=preempted / max(len(records), 1),
        ),
        misses=lost,
        own_misses=own_misses,
        longest_run_of_misses=max((m.slots for m in misses), default=0),
        causes=causes,
        missed=tuple(misses),
        miss_rate_upper_bound_95=miss_rate_bound(lost, slots),
        own_miss_rate_upper_bound_95=miss_rate_bound(own_misses, slots),
    )


def _decide(
    stopped: str,
    own_misses: int,
    lost: int,
    slots: int,
    targets: TimingTargets,
    *,
    excused: bool,
    interrupted: str,
) -> tuple[Verdict, str]:
    """Return the verdict and its reason by the module's table."""
    if excused:
        return Verdict.INCONCLUSIVE, (
            f"the host delayed the loop, so the safety supervisor stopped the robot: {stopped}"
        )
    if stopped:
        return Verdict.FAIL, f"the safety supervisor stopped the robot: {stopped}"
    if own_misses:
        return Verdict.FAIL, f"the loop missed {own_misses} of {slots} slots by its own time"
    if interrupted:
        return Verdict.INCONCLUSIVE, f"{interrupted}: run it to its end"
    bound, rate = miss_rate_bound(lost, slots), targets.miss_rate
    missed = f"{lost} of {slots} deadlines missed" if lost else f"all {slots} deadlines met"
    if bound <= rate and (lost == 0 or rate < 1.0):
        sure = f"with 95 % confidence fewer than 1 in {1 / bound:.0f} is late"
        return Verdict.PASS, f"{missed}; {sure}"
    if lost:
        return Verdict.INCONCLUSIVE, f"{missed}, all by the host: run it on a calmer one"
    least_s = slots_needed(rate) * targets.period_ns * 1e-9
    return Verdict.INCONCLUSIVE, (
        f"{missed}, too few for a miss rate of {rate:g}: run {math.ceil(least_s)} s, or ask for "
        f"--miss-rate {bound:.1g}"
    )


def host_time_ns(
    records: NDArray[np.void], loop_cpu: ProbeRecord, line_cpu: ProbeRecord, releases: Releases
) -> tuple[Nanoseconds, Nanoseconds]:
    """Return the certain and the possible host time in each tick, shape (n,) each.

    `loop_cpu` and `line_cpu` are the probes on the processors of loop and emulator; they may be
    empty.
    """
    host = np.zeros((len(records), 2), np.int64)
    waits = records["bus_wait_ns"]
    longer = np.maximum(waits - np.median(waits), 0) if len(waits) else waits
    starts = records["deadline_ns"]
    ends = starts + records["lateness_ns"] + records["busy_ns"]
    for k, (start_ns, end_ns) in enumerate(zip(starts.tolist(), ends.tolist(), strict=True)):
        # A tick's run-queue delay counts from the end of the previous tick.
        queued = int(records["preempted_ns"][k]) - loop_cpu.own_between_ns(
            int(ends[k - 1]) if k else start_ns, end_ns
        )
        line_queued = releases.run_delay_between_ns(start_ns, end_ns)
        line_queued -= line_cpu.own_between_ns(start_ns, end_ns)
        withheld = queued + int(records["steal_ns"][k])
        stalls = loop_cpu.stall_ns(start_ns, end_ns)
        for column, (stall, line_stall) in enumerate(
            zip(stalls, line_cpu.stall_ns(start_ns, end_ns), strict=True)
        ):
            line = min(max(line_queued, line_stall, 0), int(longer[k]))
            host[k, column] = min(max(withheld, stall, 0) + line, end_ns - start_ns)
    return host[:, 0], host[:, 1]


def find_misses(records: NDArray[np.void], host_ns: Nanoseconds, period_ns: int) -> list[Miss]:
    """Return every tick that ended after its slot, with its cause.

    Shapes: `records` (n,), `host_ns` (n,).
    """
    excess = records["lateness_ns"] + records["busy_ns"] - period_ns
    skipped = np.append(records["missed"][1:], 0)  # attributed to the tick before the gap
    misses = []
    for k in np.flatnonzero((excess > 0) | (skipped > 0)).tolist():
        excess_ns, wait_ns = max(int(excess[k]), 1), int(records["bus_wait_ns"][k])
        misses.append(
            Miss(
                tick=int(records["tick"][k]),
                slots=int(skipped[k]) or -(-excess_ns // period_ns),
                excess_ns=excess_ns,
                host_ns=int(host_ns[k]),
                bus_wait_ns=wait_ns,
                cause=cause_of_miss(
                    excess_ns, int(host_ns[k]), int(records["busy_ns"][k]), wait_ns
                ),
            )
        )
    return misses


def stopped_by_host(
    records: NDArray[np.void], host_ns: Nanoseconds, faults: Collection[Fault]
) -> bool:
    """Return whether the supervisor stopped only for missed slots or late data, all by the host.

    The ticks that count are those of the stop, and those without a fresh measurement directly
    before it. The host caused one if slots were missed just before it, or if the wait for its data,
    less the host time, is no longer than the longest wait of a tick with data. None of the run's
    missed slots may be the loop's own.

    Shapes: `records` (n,), `host_ns` (n,).
    """
    stopping = np.flatnonzero(records["state"] == SafetyState.STOPPING)
    fresh = records["stale_ticks"] == 0
    if not set(faults) <= _OF_A_HOST or not len(stopping) or not fresh.any():
        return False
    measured = np.flatnonzero(fresh[: int(stopping[0]) + 1])
    first = min(int(measured[-1]) + 1 if len(measured) else 0, int(stopping[0]))
    remaining = records["bus_wait_ns"] - host_ns
    late = (records["bus_status"] < BusStatus.PORT_GONE) & (remaining <= remaining[fresh].max())
    missed = records["missed"] > 0
    counted = (~fresh | missed)[first : int(stopping[-1]) + 1]
    by_host = ((~fresh & late) | missed)[first : int(stopping[-1]) + 1]
    return bool(counted.any() and by_host[counted].all())


def slots_needed(miss_rate: float) -> int:
    """Slots without a miss that bound a miss rate with 95 % confidence."""
    return math.ceil(math.log(0.05) / math.log1p(-miss_rate)) if miss_rate < 1.0 else 1


def timing_junit(timing: TimingVerdict, facts: Mapping[str, Any]) -> bytes:
    """Return the verdict as JUnit XML, one test case per question."""
    own_misses = [str(miss) for miss in timing.missed if miss.cause is not Cause.PREEMPTED]
    host = f"{timing.misses} misses by the host, {timing.host.preempted_ticks} ticks preempted"
    inconclusive = timing.verdict is Verdict.INCONCLUSIVE
    stop = Verdict.INCONCLUSIVE if inconclusive else Verdict.FAIL
    short = inconclusive and not timing.interrupted
    # Question, whether the answer is no, the verdict in that case, details
    questions: Sequence[tuple[str, object, Verdict, str]] = (
        ("the robot is not stopped", timing.stopped, stop, timing.stopped),
        ("no signal ends the run early", timing.interrupted, Verdict.INCONCLUSIVE,
         timing.interrupted),
        ("the loop misses no deadline by its own time", own_misses, Verdict.FAIL,
         "\n".join(own_misses)),
        ("the run bounds the miss rate", short, Verdict.INCONCLUSIVE, host),
    )  # fmt: skip
    cases = [
        JUnitCase(question, verdict if negative else Verdict.PASS, timing.reason, details)
        for question, negative, verdict, details in questions
    ]
    properties = {
        "verdict": timing.verdict.value,
        "own_cost_p99_ns": timing.own_cost.p99_ns,
        "own_miss_rate_upper_bound_95": timing.own_miss_rate_upper_bound_95,
    }
    return junit_xml("sil", cases, properties | dict(facts))
