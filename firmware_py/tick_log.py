"""Log of the loop's ticks: records, durations, causes of missed deadlines, fault counts."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Sequence
from itertools import chain
from operator import sub
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_py.bus.servo_bus import BusStatus
from firmware_py.core.signals import tick_dtype
from firmware_py.inference.estimator import Estimate
from firmware_py.inference.predictor import Prediction
from firmware_py.log.telemetry import Telemetry
from firmware_py.safety.estimate_trust import TrustState
from firmware_py.safety.states import SafetyState
from firmware_py.summary import FeedbackUse
from firmware_py.system.kernel_counters import Counters
from firmware_py.system.timing import Timing, cause_of_miss

_FORMATS: Final = {"i": "q", "f": "d"}
_FIELD_BYTES: Final = 8


class TickRing:
    """Ring buffer of the latest records, written without net allocation."""

    def __init__(self, dof: int, keep: int) -> None:
        dtype = tick_dtype(dof)
        names = dtype.names or ()
        # Packing the whole record at once is five times faster than packing by column.
        self._pack = struct.Struct(
            "=" + "".join(_FORMATS[dtype[name].kind] for name in names)
        ).pack_into
        self._array = np.zeros(keep, dtype)
        self._bytes = self._array.view(np.uint8).data
        self._size, self._keep = dtype.itemsize, keep
        self._offsets = {name: _FIELD_BYTES * k for k, name in enumerate(names)}
        self._integer = struct.Struct("=q").pack_into
        self.count = 0

    def append(self, values: Sequence[Any]) -> None:
        self._pack(self._bytes, self.count % self._keep * self._size, *values)
        self.count += 1

    def amend(self, name: str, value: int) -> None:
        """Replace an integer of the latest record."""
        start = (self.count - 1) % self._keep * self._size
        self._integer(self._bytes, start + self._offsets[name], value)

    def latest(self) -> memoryview:
        """Bytes of the latest record, valid until it is overwritten."""
        start = (self.count - 1) % self._keep * self._size
        return self._bytes[start : start + self._size]

    def ordered(self) -> NDArray[np.void]:
        """Return a copy of the records in the ring, oldest first."""
        order = np.arange(max(0, self.count - self._keep), self.count) % self._keep
        return self._array[order]


Array = NDArray[np.float64]
LONGEST_STEP_SLOTS: Final = 100
"""Longest step of an estimator: it bounds the computation after a jump of the clock."""
_HELD_UP_NS: Final = 1_000_000
"""Delay by the host that can make a read fail: half of a read's margin for the host. [assumed]"""


class Tick(NamedTuple):
    slot: int
    missed: int  # Slots skipped since the previous tick
    goal_rad: Array  # Goals sent, shape (dof,) as are the measured angles and currents
    angle_rad: Array
    current_a: Array
    estimate: Estimate  # Deformation Index and payload
    prediction: Prediction  # Predicted tip and its prediction interval
    state: SafetyState  # State of the supervisor after the tick
    trust: TrustState  # Trust in the estimated tip that feedback uses
    status: BusStatus  # The worse result of read and write
    stale_ticks: int  # Age of the measured data in ticks
    alert: int
    bus_wait_ns: int  # Time spent waiting for the servos
    sample_late_ns: int  # Time from the deadline to the request for the measurement
    marks_ns: tuple[int, ...]  # Deadline, then the ends of the stages from "wake" to "write"


class TickLog:
    """Log of the ticks of a run, in constant memory."""

    def __init__(
        self, dof: int, period_ns: int, telemetry: Telemetry, counters: Counters, keep: int
    ) -> None:
        self.timing = Timing()
        self.out_of_range = self.held_up = 0
        self._with_feedback = self._lost_feedback = 0
        self._period_ns, self._period_s = period_ns, period_ns * 1e-9
        self._telemetry, self._counters = telemetry, counters
        self._statuses: Counter[BusStatus] = Counter()
        self._ring = TickRing(dof, keep)
        self._run_delay_ns = 0
        self._delays_ns = (0, 0)
        self._stages_ns: tuple[int, ...] = ()
        self._finished: tuple[tuple[int, ...], int, int, int] = ((), 0, 0, 0)

    @property
    def ticks(self) -> int:
        return self._ring.count

    @property
    def drops(self) -> int:
        return self._telemetry.drops

    def records(self) -> NDArray[np.void]:
        """Return a copy of the latest records, oldest first."""
        return self._ring.ordered()

    def bus_faults(self) -> dict[str, int]:
        """Return the number of ticks by bus status, without OK."""
        return {s.name.lower(): n for s, n in self._statuses.items()}

    def feedback(self, reason: str) -> FeedbackUse:
        """Return in how many ticks of the motion feedback was on, and in how many it was lost."""
        lost = self._lost_feedback
        return FeedbackUse(
            ticks=self._with_feedback, lost_ticks=lost, reason=reason if lost else ""
        )

    def start(self) -> None:
        """Start to count the thread's run-queue delay."""
        self._run_delay_ns = self._counters.run_delay_ns()

    def start_computing(self) -> None:
        """Mark the end of the wait for the bus: from here on the tick only computes."""
        self._counters.start_computing()

    def hand_over(self) -> None:
        """Count the previous tick and send its record.

        This belongs to the log stage, whose time is in the record: sending takes a good part of
        that stage. So a record is complete, and can be sent, only after the end of its own tick.
        """
        if self._ring.count:
            self.timing.add(*self._finished)
            self._telemetry.put(self._ring.latest())

    def append(self, tick: Tick) -> None:
        """Add the record of a tick; `close` completes it."""
        run_delay_ns, steal_ns = self._counters.delays_ns()
        self._delays_ns = delays_ns = (run_delay_ns - self._run_delay_ns, steal_ns)
        self._run_delay_ns = run_delay_ns
        stages_ns = tuple(map(sub, tick.marks_ns[1:], tick.marks_ns))
        joints = zip(
            tick.goal_rad.tolist(), tick.angle_rad.tolist(), tick.current_a.tolist(), strict=True
        )
        estimate, prediction, in_range = tick.estimate, tick.prediction, tick.prediction.in_range
        self._ring.append((
            tick.slot, tick.slot * self._period_s, tick.marks_ns[0], *chain.from_iterable(joints),
            estimate.payload_kg, estimate.di, *prediction.tip_m.tolist(),
            *prediction.half_width_m.tolist(), in_range, tick.state, tick.trust,
            tick.status, tick.stale_ticks, tick.alert, *stages_ns, 0, 0, tick.bus_wait_ns,
            stages_ns[0], tick.sample_late_ns, *delays_ns, tick.missed,
        ))  # fmt: skip
        if tick.status is not BusStatus.OK:
            self._statuses[tick.status] += 1
            self.held_up += not tick.status.fresh and sum(delays_ns) > _HELD_UP_NS
        self.out_of_range += not in_range
        if tick.trust and tick.slot >= 0 and tick.state < SafetyState.STOPPING:
            self._with_feedback += 1
            self._lost_feedback += tick.trust is not TrustState.TRUSTED
        self._stages_ns, self._tick = stages_ns, tick

    def close(self, end_ns: int) -> None:
        """Complete the latest record at the end of its tick, a time of the loop's clock."""
        bus_wait_ns, marks_ns = self._tick.bus_wait_ns, self._tick.marks_ns
        lateness_ns, busy_ns = self._stages_ns[0], end_ns - marks_ns[1]
        log_ns = end_ns - marks_ns[-1]
        self._ring.amend("log_ns", log_ns)
        self._ring.amend("busy_ns", busy_ns)
        self._finished = ((*self._stages_ns, log_ns), lateness_ns, busy_ns, bus_wait_ns)
        if (excess_ns := end_ns - marks_ns[0] - self._period_ns) > 0:
            # Lateness beyond the thread's delays means that the whole machine was suspended.
            host_ns = max(sum(self._delays_ns), lateness_ns)
            self.timing.miss(
                -(-excess_ns // self._period_ns),
                cause_of_miss(excess_ns, host_ns, busy_ns, bus_wait_ns),
            )
