"""Missed deadlines, each attributed to the host or to the loop.

A tick misses its deadline if it ends after its slot. Its excess, lateness + busy - period, is
compared with the time for which the kernel shows that something outside this program had the
processor.

Host time
    - Run-queue delay of the loop's thread (`/proc/…/schedstat`), less the time that processes of
      this program ran on that processor meanwhile.
    - Steal time: the thread neither slept nor waited in the run queue, but the kernel counted less
      processor time than had passed.
    - Stalls of the processor at any other point of the tick. A probe with a higher priority than
      the whole program is pinned to the processor and wakes every millisecond. If the probe itself
      is late, the hypervisor, an interrupt or a foreign real-time task had the processor. A stall
      is known to within one period of the probe: its possible time excuses a miss, and only its
      certain time makes a tick count as preempted.
    - The same for the processor of the emulator, up to the time by which the loop waited for the
      bus longer than the median.

    The accounts of thread and probe overlap, so only the larger one counts. The processes of
    `--load` are declared host load: time lost to them is host time.

Own time
    Everything else: computing, waiting for the bus, and every delay by a process of this program
    (emulator, recorder or probe). Lateness that no counter explains is own time as well.

A miss is attributed to the host if its excess does not exceed the possible host time. A stop is
attributed to the host if every tick that led to it is: slots were missed before it, or its data
would have come in time without the host.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from firmware_py.bus.servo_bus import BusStatus
from firmware_py.safety.states import Fault, SafetyState
from firmware_py.system.timing import Cause
from hil.emulator.emulator import Releases
from hil.sil.cpu_accounts import ProbeRecord

__all__ = ["Miss", "find_misses", "host_time_ns", "stopped_by_host"]

Nanoseconds = NDArray[np.int64]

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
    """Return whether the supervisor stopped only for missed slots or late data, all by the host.

    The ticks that count are those of the stop, and those without a fresh measurement directly
    before it. The host spoiled a tick if slots were missed just before it, or if the wait for its
    data, less the host time, is no longer than the longest wait of a tick with data. None of the
    run's missed slots may be the loop's own.

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
    spoiled = ((~fresh & late) | missed)[first : int(stopping[-1]) + 1]
    return bool(counted.any() and spoiled[counted].all())
