"""Faults of the host: parts of the robot's software, disturbed at a scheduled tick.

The estimator counts the ticks, because the loop calls it once in each. Delays use the clock that is
passed in, so the same fault works in simulated and in real time.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from firmware_py.bus.transport import Transport
from firmware_py.goals.tip_feedback import TipFeedback
from firmware_py.inference.estimator import DeformationEstimator, Estimate
from firmware_py.inference.predictor import NO_SIGNALS, Prediction, Predictor
from firmware_py.system.clock import SimClock
from hil.faults.injection import FAULT_KINDS, FaultSchedule, Injection, OnHost

Array = NDArray[np.float64]
_GARBAGE_CYCLES: Final = 300
_FLOOD: Final = b"\xff\xff\xfd\x00\x01\xf0\x03\x55"
"""Header of a long status packet, the bytes that take a parser longest."""


class HostFaults:
    """Schedule of the host's faults; `take` spends a time in s on the clock of the run."""

    def __init__(
        self,
        script: FaultSchedule,
        injections: Sequence[Injection],
        now_ns: Callable[[], int],
        take: Callable[[float], None],
    ) -> None:
        self._script, self._now_ns, self.take = script, now_ns, take
        self._injections = {
            name: [i for i in injections if i.kind == name]
            for name, kind in FAULT_KINDS.items()
            if isinstance(kind, OnHost)
        }
        self.tick = 0
        self.began_ns: int | None = None
        self.request_stop: Callable[[str], None] = _request_nothing
        self._back_ns: float | None = None

    def value(self, kind: str) -> float | None:
        """Return the value of a fault that is active in this tick; None if it is not."""
        for injection in self._injections[kind]:
            if self._script.active(injection, self.tick):
                if self.began_ns is None:
                    self.began_ns = self._now_ns()
                return injection.value
        return None

    def unplugged(self) -> bool:
        """Return whether the port is missing now."""
        if self._back_ns is None and (away_s := self.value("port")) is not None:
            self._back_ns = self._now_ns() + away_s * 1e9
        return self._back_ns is not None and self._now_ns() < self._back_ns


def _request_nothing(reason: str) -> None:
    """Do nothing, as long as there is no loop."""


class FaultyEstimator:
    """Estimator that stalls, leaves garbage, or returns a wrong value. It counts the ticks."""

    waits_for_fresh: ClassVar[bool] = False  # it must be called in every tick

    def __init__(self, inner: DeformationEstimator, host: HostFaults) -> None:
        self._inner, self._host = inner, host

    def reset(self) -> None:
        self._inner.reset()

    def update(self, angle_rad: Array, current_a: Array, step_s: float) -> Estimate:
        host = self._host
        host.tick += 1
        if (stall_s := host.value("stall")) is not None:
            host.take(stall_s)
        if host.value("request") is not None:
            host.request_stop("a request")
        if host.value("garbage") is not None:
            _litter()
        estimate = self._inner.update(angle_rad, current_a, step_s)
        wrong = host.value("estimator")
        return estimate if wrong is None else estimate._replace(di=wrong)


def _litter() -> None:
    """Create reference cycles, which only the garbage collector can free."""
    for _ in range(_GARBAGE_CYCLES):
        cycle: list[object] = []
        cycle.append(cycle)


class FaultyPredictor:
    """Predictor that is slow or returns a wrong value."""

    def __init__(self, inner: Predictor, host: HostFaults) -> None:
        self._inner, self._host = inner, host
        self._wrong = Prediction(np.zeros(3), np.zeros(1), np.zeros(3))

    def predict(
        self,
        angle_rad: Array,
        current_a: Array,
        di: float,
        signals: Array = NO_SIGNALS,
        age_s: float = 0.0,
    ) -> Prediction:
        if (slow_s := self._host.value("slow predictor")) is not None:
            self._host.take(slow_s)
        prediction = self._inner.predict(angle_rad, current_a, di, signals, age_s)
        wrong = self._host.value("predictor")
        if wrong is None and self._host.value("range") is None:
            return prediction
        self._wrong.tip_m[:] = prediction.tip_m if wrong is None else wrong
        return self._wrong


class FaultyFeedback(TipFeedback):
    """Feedback of the tip with a wrong innovation."""

    host: HostFaults | None = None

    def innovation_a(self, estimate: Estimate) -> float:
        wrong = self.host.value("innovation") if self.host else None
        return super().innovation_a(estimate) if wrong is None else wrong


class SteppedClock(SimClock):
    """Simulated clock that is set forward or back in a scheduled tick."""

    def __init__(self, true: SimClock) -> None:
        super().__init__()
        self.true = true
        self.host: HostFaults | None = None

    @property
    def step_ns(self) -> int:
        """Time by which the clock is ahead of the true time."""
        step_s = self.host.value("clock") if self.host else None
        return round((step_s or 0.0) * 1e9)

    def now_ns(self) -> int:
        return self.true.now_ns() + self.step_ns

    def sleep_until(self, deadline_ns: int) -> None:
        self.true.sleep_until(deadline_ns - self.step_ns)

    def advance(self, duration_ns: int) -> None:
        self.true.advance(duration_ns)


class FaultyTransport:
    """Transport that keeps true time while the loop's clock is stepped; it can be unplugged."""

    def __init__(self, inner: Transport, clock: SteppedClock, host: HostFaults) -> None:
        self._inner, self._clock, self._host = inner, clock, host
        self._dead = False

    def _check(self) -> None:
        self._dead = self._dead or self._host.unplugged()
        if self._dead:
            raise ConnectionResetError("the adapter is unplugged")

    def read(self, size: int, deadline_ns: int) -> bytes:
        self._check()
        if (bytes_per_s := self._host.value("flood")) is not None:
            self._clock.advance(round(size / bytes_per_s * 1e9))
            return (_FLOOD * size)[:size]
        return self._inner.read(size, deadline_ns - self._clock.step_ns)

    def write(self, data: bytes) -> int:
        self._check()
        return self._inner.write(data)

    def discard_input(self) -> None:
        self._check()
        self._inner.discard_input()

    def close(self) -> None:
        self._inner.close()
