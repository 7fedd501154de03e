"""When the faults of a row act, and the parts of line and robot on which they act.

The seed sets the start. A `FaultSchedule` counts exchanges, which are the synchronous reads of the
loop from torque on; the emulated line and servos ask it. `HostFaults` counts ticks; the faulty
estimator, predictor, feedback, clock, transport and goal program ask it. Delays use the clock of
the run, so a fault is the same in simulated and in real time.
"""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any, ClassVar, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from firmware_py.bus.codec import Instruction, Packet
from firmware_py.bus.transport import Transport
from firmware_py.config import RobotConfig
from firmware_py.goals.goal_channel import GoalMessage, StatusMessage, encode_goal
from firmware_py.goals.goal_map import GoalMap, PayloadMap
from firmware_py.goals.outside_goals import OutsideGoals
from firmware_py.goals.tip_feedback import TipFeedback
from firmware_py.inference.bundle import ModelBundle
from firmware_py.inference.estimator import DeformationEstimator, Estimate
from firmware_py.inference.predictor import NO_SIGNALS, Prediction, Predictor
from firmware_py.link.link_facts import STUDY_FACTS
from firmware_py.system.clock import SimClock
from hil.emulator.emulated_servo import EmulatedServo
from hil.emulator.line_faults import Arrivals, FaultPlan
from hil.faults.fault_kinds import Host, Place
from hil.faults.fault_row import Injection

Array = NDArray[np.float64]
FIRST_EXCHANGE: Final = (40, 110)
"""Range from which the seed draws the first exchange with a fault. The arm moves during it."""
_REACH_M: Final = 0.9
"""Largest tip coordinate in the goal map of a case."""


class FaultSchedule(FaultPlan):
    """Seeded schedule of injections: faults of a `Line` and of the servos on a `LoggedBus`."""

    def __init__(self, injections: Sequence[Injection], seed: int) -> None:
        super().__init__(seed=seed)
        self._of: dict[Place, list[Injection]] = {}
        for injection in injections:
            self._of.setdefault(injection.does.where, []).append(injection)
        self._chance = random.Random(seed)
        self.start = self._chance.randrange(*FIRST_EXCHANGE)
        self.exchange = 0
        self.began_ns: int | None = None
        self._writes: Counter[int] = Counter()
        self._now_ns = 0

    def of(self, where: Place) -> list[Injection]:
        """Injections that act at a place."""
        return self._of.get(where, [])

    def begin_exchange(self, servos: Sequence[EmulatedServo], now_ns: int) -> None:
        """Count an exchange, and start and end the servo faults that are due in it."""
        self.exchange += 1
        self._now_ns = now_ns
        for injection in self.of("servo"):
            first = self.start + injection.after
            if self.exchange not in (first, first + injection.times):
                continue
            for joint, servo in enumerate(servos):
                if injection.joint in (None, joint):
                    injection.does.act(servo, injection.value, self.exchange == first)
                    self._note_begin()

    def loses(self, packet: Packet) -> bool:
        """Whether an instruction is lost; only writes to a single servo can be."""
        due = [i for i in self.of("instruction") if self.exchange >= self.start + i.after]
        if not due or packet.instruction != Instruction.WRITE:
            return False
        self._writes[packet.id] += 1
        lost = self._writes[packet.id] <= max(i.times for i in due)
        if lost:
            self._note_begin()
        return lost

    def apply(self, frame: bytes) -> Arrivals:
        """Return what arrives instead of a status packet."""
        arrivals: Arrivals = [(0, frame)]
        for injection in self.of("reply"):
            if injection.active(self.exchange, self.start):
                self._note_begin()
                arrivals = [
                    (delay_ns + more_ns, damaged)
                    for delay_ns, piece in arrivals
                    for more_ns, damaged in injection.does.act(piece, injection.value, self._chance)
                ]
        return arrivals

    def _note_begin(self) -> None:
        if self.began_ns is None:
            self.began_ns = self._now_ns


class HostFaults(Host):
    """Scheduled faults of the robot's software."""

    def __init__(
        self, script: FaultSchedule, now_ns: Callable[[], int], take: Callable[[float], None]
    ) -> None:
        super().__init__(now_ns, take)
        self._script = script
        self.tick = 0
        self.began_ns: int | None = None

    def due(self, where: Place) -> Iterator[Callable[..., Any]]:
        """Yield the functions of the faults that act at a place in this tick."""
        for injection in self._script.of(where):
            if injection.active(self.tick, self._script.start):
                if self.began_ns is None:
                    self.began_ns = self.now_ns()
                yield partial(injection.does.act, self, injection.value)

    def unplugged(self) -> bool:
        """Whether the port is missing now."""
        for fault in self.due("port"):
            fault()
        return self.port_back_ns is not None and self.now_ns() < self.port_back_ns


class FaultyEstimator:
    """Estimator with faults. It counts the ticks, because the loop calls it once in each."""

    waits_for_fresh: ClassVar[bool] = False

    def __init__(self, inner: DeformationEstimator, host: HostFaults) -> None:
        self._inner, self._host = inner, host

    def reset(self) -> None:
        self._inner.reset()

    def update(self, angle_rad: Array, current_a: Array, step_s: float) -> Estimate:
        self._host.tick += 1
        for fault in self._host.due("tick"):
            fault()
        estimate = self._inner.update(angle_rad, current_a, step_s)
        for fault in self._host.due("estimate"):
            estimate = fault(estimate)
        return estimate


class FaultyPredictor:
    def __init__(self, inner: Predictor, host: HostFaults) -> None:
        self._inner, self._host = inner, host

    def predict(
        self, angle_rad: Array, current_a: Array, di: float, signals: Array = NO_SIGNALS,
        age_s: float = 0.0,
    ) -> Prediction:  # fmt: skip
        for fault in self._host.due("predict"):
            fault()
        prediction = self._inner.predict(angle_rad, current_a, di, signals, age_s)
        for fault in self._host.due("prediction"):
            prediction = fault(prediction)
        return prediction


class FaultyModels:
    """Estimator and predictor of a bundle, with faults of the host."""

    def __init__(self, bundle: ModelBundle, host: HostFaults) -> None:
        self.estimator = FaultyEstimator(bundle.estimator, host)
        self.predictor = FaultyPredictor(bundle.predictor, host)


class FaultyFeedback(TipFeedback):
    """Feedback of the tip with faults of its innovation."""

    def __init__(self, host: HostFaults, *arguments: Any) -> None:
        super().__init__(*arguments)
        self._host = host

    def innovation_a(self, estimate: Estimate) -> float:
        innovation_a = super().innovation_a(estimate)
        for fault in self._host.due("innovation"):
            innovation_a = fault(innovation_a)
        return innovation_a


class SteppedClock(SimClock):
    """Simulated clock that faults set forward or back."""

    def __init__(self, true: SimClock, host: HostFaults) -> None:
        super().__init__()
        self._true, self._host = true, host

    @property
    def step_ns(self) -> int:
        """Time by which the clock is ahead of the true time."""
        return sum(fault() for fault in self._host.due("clock"))

    def now_ns(self) -> int:
        return self._true.now_ns() + self.step_ns

    def sleep_until(self, deadline_ns: int) -> None:
        self._true.sleep_until(deadline_ns - self.step_ns)

    def advance(self, duration_ns: int) -> None:
        self._true.advance(duration_ns)


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
        for fault in self._host.due("read"):
            flood: bytes = fault(size)
            return flood
        return self._inner.read(size, deadline_ns - self._clock.step_ns)

    def write(self, data: bytes) -> int:
        self._check()
        return self._inner.write(data)

    def discard_input(self) -> None:
        self._check()
        self._inner.discard_input()

    def close(self) -> None:
        self._inner.close()


class GoalProgram:
    """Program in memory that answers each status of the robot with the next row of its goals.

    It is the `GoalChannel` of the robot. Shapes: `goals_rad` (n, dof).
    """

    def __init__(self, goals_rad: Array, host: HostFaults) -> None:
        self._goals, self._host = goals_rad, host
        self._waiting: list[bytes] = []
        self.gone = False
        self._latest = b""

    def receive(self, most: int) -> list[bytes]:
        taken, self._waiting = self._waiting[:most], self._waiting[most:]
        return taken

    def send(self, data: bytes) -> None:
        if self.gone:
            return
        tick = msgspec.json.decode(data, type=StatusMessage).tick
        goal = GoalMessage(tick, tuple(self._goals[(tick + 1) % len(self._goals)].tolist()))
        for fault in self._host.due("goals"):
            messages: list[bytes] | None = fault(self._latest, goal)
            self.gone = messages is None
            self._waiting += messages or []
            return
        self._latest = encode_goal(goal)
        self._waiting.append(self._latest)


def program_goals(config: RobotConfig, goals_rad: Array, host: HostFaults) -> OutsideGoals:
    """Return a source of goals that a program sends; shape of `goals_rad`: (n, dof).

    Its goal map is that of a rigid link of 1 m without vibration; both steps of a goal take one
    period.
    """
    dof, period_s = config.dof, config.period_s
    places = np.linspace(-_REACH_M, _REACH_M, 7)
    grid = np.stack(np.meshgrid(*[places] * dof, indexing="ij"), axis=-1).reshape(-1, dof)
    payload = PayloadMap(
        payload_kg=1.0, goals_rad=tuple(tuple(c) for c in np.arcsin(grid).T.tolist()),
        half_period_s=(period_s,) * dof, decay=(0.5,) * dof,
    )  # fmt: skip
    goal_map = GoalMap(
        schema=GoalMap.VERSION, dof=dof, period_s=period_s, places_m=tuple(places.tolist()),
        payloads=(payload,), plant_sha256="", link=STUDY_FACTS,
    )  # fmt: skip
    channel = GoalProgram(goals_rad, host)
    return OutsideGoals(channel, config.limits_in_force, dof, period_s, goal_map)
