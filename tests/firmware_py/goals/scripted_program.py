"""Programs in memory that send goals to a loop in simulated time, and a map that is linear."""

import json

import numpy as np

from firmware_py.core.signals import PERIOD_S
from firmware_py.goals.goal_map import GoalMap, PayloadMap
from firmware_py.goals.outside_goals import OutsideGoals
from firmware_py.inference.estimator import NoEstimator
from firmware_py.link.link_facts import STUDY_FACTS
from firmware_py.loop import ControlLoop
from firmware_py.safety.limits import Limits
from firmware_py.safety.supervisor import SafetySupervisor
from firmware_py.system.clock import SimClock
from tests.firmware_py.simulated_loop import Bus, StillPredictor

LIMITS = Limits()


class Program:
    """Answers each status with what a function of it returns: messages, as objects or bytes."""

    def __init__(self, answer):
        self.answer, self.inbox, self.statuses, self.gone = answer, [], [], False

    def receive(self, most):
        taken, self.inbox = self.inbox[:most], self.inbox[most:]
        return taken

    def send(self, data):
        status = json.loads(data)
        self.statuses.append(status)
        for message in self.answer(status):
            if message is None:
                self.gone = True
            elif not self.gone:
                raw = message if isinstance(message, bytes) else json.dumps(message).encode()
                self.inbox.append(raw)


def swinging(status, amplitude_rad=0.2, dof=1):
    """Joint goals along a sinusoid of two seconds, faded in."""
    seconds = status["time_s"]
    value = amplitude_rad * np.sin(np.pi * seconds) * min(seconds, 1.0)
    return {"tick": status["tick"], "joint_rad": [float(value)] * dof}


def linear_map(dof=1, half_period_s=0.17, slope=1.0, gap=False):
    """Goals are the places, times 1 with 0 kg and times 2 with 2 kg, where the slope is 1."""
    places = tuple(np.linspace(-0.5, 0.5, 11).tolist())
    grid = np.stack(np.meshgrid(*[places] * dof, indexing="ij"), axis=-1).reshape(-1, dof)

    def payload_map(payload_kg):
        columns = (slope * (1.0 + 0.5 * payload_kg) * grid).T.tolist()
        if gap:
            columns = [[None if v > 0.45 else v for v in column] for column in columns]
        return PayloadMap(
            payload_kg=payload_kg, goals_rad=tuple(map(tuple, columns)),
            half_period_s=(half_period_s,) * dof, decay=(0.8,) * dof,
        )  # fmt: skip

    return GoalMap(
        schema=1, dof=dof, period_s=PERIOD_S, places_m=places,
        payloads=(payload_map(0.0), payload_map(2.0)),
        plant_sha256="", link=STUDY_FACTS,
    )  # fmt: skip


def run(channel, *, goal_map=None, payload_kg=None, slots=120, dof=1, bus=None):
    """Run the loop with the goals of a channel; return summary, bus and goals."""
    clock = SimClock(123)
    goals = OutsideGoals(channel, LIMITS, dof, PERIOD_S, goal_map, payload_kg)
    servos = bus(clock) if bus else Bus(clock, dof)
    loop = ControlLoop(
        servos, NoEstimator(), StillPredictor(), SafetySupervisor(LIMITS, dof), goals, clock,
        slots=slots,
    )  # fmt: skip
    return loop.run(), servos, goals
