"""Missed deadlines, each attributed to the host or to the loop.

A tick misses when it ends after its slot. Its excess, lateness + busy - period, is the time by
which it was too slow. It is compared with the time for which the kernel shows that another party
had the processor.

Host time
    Run-queue delay of the loop's thread (`/proc/…/schedstat`), less the time that processes of this
    program ran on that processor meanwhile. Steal time: while the tick computed, the thread neither
    slept nor waited in the run queue, and the kernel counted less processor time than had passed.
    Time in which the processor stood still at any other point of the tick: a probe with a higher
    priority than the whole program is pinned to it and wakes every millisecond; where the probe
    itself was late, the hypervisor, an interrupt or a foreign real-time task had the processor.
    Such a stall is known to within one period of the probe: the possible time excuses a miss, and
    only the certain time makes a tick count as preempted. The accounts overlap, so the larger one
    counts: that of the thread, or that of the probe.
    The same for the processor of the emulator, as far as the loop waited longer for the bus than it
    usually does. The processes of `--load` are declared host load: time lost to them is host time.

Own time
    Everything else: computing, waiting for the bus, and every delay by a process of this program
    (emulator, recorder or probe). Lateness that no counter explains is own time as well.

A miss is attributed to the host where its excess is no longer than the possible host time. A stop
is attributed to the host where every tick that led to it is: a slot missed before it, or data that
came in time but for the host.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from firmware_py.bus.servo_bus import BusStatus
from firmware_py.realtime.timing import Cause
from firmware_py.safety.states import SafetyState
from firmware_py.safety.stop_reason import Fault
from hil.timing.cpu_accounts import ProbeRecord, Releases

__all__ = ["Miss", "find_misses", "host_time_ns", "stopped_by_host"]

Nanoseconds = NDArray[np.int64]

_OF_A_HOST: Final = {Fault.DATA, Fault.SLOTS}
"""Faults that a host can cause."""


class Miss(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A tick that ended after its slot."""

    tick: int  # Number of its slot
    slots: int
    excess_ns: int  # Time by which it was too slow; host time in it; its wait for the bus
    host_ns: int
    bus_wait_ns: int
    cause: Cause  # Largest part of it


def host_time_ns(
    records: NDArray[np.void], loop_cpu: ProbeRecord, line_cpu: ProbeRecord, releases: Releases
) -> tuple[Nanoseconds, Nanoseconds]:
    """Time of each tick in which the host had a processor that the loop was waiting for.

    Shapes: `records` (n,).
    `loop_cpu`, `line_cpu`: probes on the processors of loop and emulator; may be empty.
    Returns shape (n,), certain and possible time.
    """
    host = np.zeros((len(records), 2), np.int64)
    waits = records["bus_wait_ns"]
    longer = np.maximum(waits - np.median(waits), 0) if len(waits) else waits
    starts = records["deadline_ns"]
    ends = starts + records["lateness_ns"] + records["busy_ns"]
    for k, (start_ns, end_ns) in enumerate(zip(starts.tolist(), ends.tolist(), strict=True)):
        # A tick's run-queue delay counts from the end of the tick before.
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
    """Every tick that ended after its slot, with its cause.

    Shapes: `records` (n,), `host_ns` (n,).
    """
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
        misses.append(
            Miss(
                tick=int(records["tick"][k]),
                slots=int(skipped[k]) or -(-excess_ns // period_ns),
                excess_ns=excess_ns,
                host_ns=int(host_ns[k]),
                bus_wait_ns=wait_ns,
                cause=cause,
            )
        )
    return misses


def stopped_by_host(
    records: NDArray[np.void], host_ns: Nanoseconds, faults: Collection[Fault]
) -> bool:
    """Whether the supervisor saw nothing but missed slots and late data, all by the host.

    The ticks that count are the first one of the stop with all before it that had no fresh
    measurement, and those of the stop itself. The host spoiled one where slots were missed just
    before it, or where the wait for its data, less the host time, is no longer than that of a tick
    which got them.

    Shapes: `records` (n,), `host_ns` (n,).
    `records`: A run none of whose missed slots is the loop's own.
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
    spoiled = ((~fresh & late) | missed)[first : int(stopping[-1]) + 1]
    return bool(counted.any() and spoiled[counted].all())
