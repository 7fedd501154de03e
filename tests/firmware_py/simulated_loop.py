"""Control loop in simulated time, over a bus that fails by a script."""

import numpy as np

from firmware_py.bus.servo_bus import BusStatus
from firmware_py.core.motion import Motion
from firmware_py.core.signals import tick_dtype
from firmware_py.goals.goal_source import GoalTable
from firmware_py.inference.estimator import NoEstimator
from firmware_py.inference.predictor import Prediction
from firmware_py.loop import ControlLoop
from firmware_py.safety.limits import Limits
from firmware_py.safety.supervisor import SafetySupervisor
from firmware_py.system.clock import SimClock

PERIOD_NS = 17_000_000
GOALS = Motion().table_rad()


class Bus:
    """A bus in memory whose reads take time and fail as a script says."""

    def __init__(self, clock, dof=1):
        self.dof, self.clock = dof, clock
        self.angle_rad, self.current_a = np.zeros(dof), np.zeros(dof)
        self.alert, self.wait_ns, self.late_ns = 0, 0, 0
        self.script, self.reads = {}, 0
        self.driven, self.calls, self.sent, self.deadlines = False, [], [], []
        self._goal = np.zeros(dof)

    def connect(self):
        self.calls.append("connect")

    def read(self, deadline_ns):
        self.deadlines.append(deadline_ns - self.clock.now_ns())
        event = self.script.get(self.reads, 0)
        self.reads += 1
        if isinstance(event, BaseException):
            raise event
        if isinstance(event, BusStatus):
            return event
        self.clock.advance(event)
        self.wait_ns += event
        self.angle_rad[:] = self._goal
        return BusStatus.OK

    def write(self, goal_rad, deadline_ns):
        self.sent.append((self.clock.now_ns(), goal_rad.copy()))
        self._goal[:] = goal_rad
        return BusStatus.OK

    def torque(self, on):
        self.calls.append(f"torque {'on' if on else 'off'}")
        self.driven = on
        return BusStatus.OK

    def close(self):
        self.calls.append("close")


class Steps(NoEstimator):
    """Notes the time between the samples that it gets, and counts them in DI."""

    waits_for_fresh = True

    def __init__(self):
        self.steps_s = []

    def update(self, angle_rad, current_a, step_s):
        self.steps_s.append(step_s)
        estimate = super().update(angle_rad, current_a, step_s)
        return estimate._replace(di=float(len(self.steps_s)))


class StillPredictor:
    wanted = ()

    def __init__(self):
        self.prediction = Prediction(np.array([0.0, 0.0, 1.0]), np.ones(1), np.full(3, 0.01))
        self.fail_at, self.calls = None, 0

    def predict(self, angle_rad, current_a, di, *_):
        self.calls += 1
        if self.calls == self.fail_at:
            raise RuntimeError("the graph is broken")
        return self.prediction


class Sent:
    """Telemetry that keeps what it gets."""

    def __init__(self, dof=1):
        self.dtype, self.parts, self.drops = tick_dtype(dof), [], 0

    def put(self, record):
        self.parts.append(bytes(record))

    @property
    def records(self):
        return np.frombuffer(b"".join(self.parts), self.dtype)


def make(goals=GOALS, *, slots=None, bus=None, estimator=None, keep=4096, clock=None, **options):
    clock = clock or SimClock(123)
    bus = bus(clock) if bus else Bus(clock, goals.shape[1])
    supervisor = SafetySupervisor(Limits(), goals.shape[1])
    predictor, telemetry = StillPredictor(), Sent(goals.shape[1])
    loop = ControlLoop(
        bus, estimator or NoEstimator(), predictor, supervisor, GoalTable(goals), clock,
        slots=slots, telemetry=telemetry, keep=keep, **options,
    )  # fmt: skip
    return loop, bus, predictor, supervisor, telemetry


def leaning(angle_rad, **options):
    """A loop whose arm leans at the start."""
    loop, bus, *rest = make(**options)
    bus.angle_rad[:] = bus._goal[:] = angle_rad
    return loop, bus, *rest


class LeapingClock(SimClock):
    """Leaps once when a time is reached."""

    at_ns, by_ns = 0, 0

    def now_ns(self):
        if self.by_ns and self._now_ns >= self.at_ns:
            self._now_ns, self.by_ns = self._now_ns + self.by_ns, 0
        return super().now_ns()


class PluggedBus(Bus):
    """Its port is away for some attempts to open it."""

    away, connects = 0, 0

    def reopen(self):
        self.away -= 1
        return self.away < 0

    def connect(self):
        super().connect()
        self.connects += 1
        self.angle_rad[:] = self._goal  # it measures
        self.script = {} if self.connects > 1 else self.script
