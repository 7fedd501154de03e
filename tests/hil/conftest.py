"""Plant without a compiler: every joint follows its goal like a first-order lag."""

import math

import dynamixel_sdk as sdk
import numpy as np
import pytest

from firmware_py.bus.servo_models import MODELS
from hil.emulator.emulated_bus import EmulatedBus
from hil.emulator.emulated_servo import EmulatedServo


class LagPlant:
    """Exact solution of angle' = (goal - angle) / tau; the current follows the goal's distance."""

    TAU_S = 0.05

    def __init__(self, dof: int = 1) -> None:
        self.dof = dof
        self.angle_rad, self.current_a = np.zeros(dof), np.zeros(dof)
        self.tip_m = np.array([0.0, 0.0, 1.0])
        self.elapsed_s = 0.0

    def advance(self, goal_rad, step_s) -> None:
        goal = np.array(goal_rad)
        self.angle_rad += (goal - self.angle_rad) * (1.0 - math.exp(-step_s / self.TAU_S))
        self.current_a[:] = 2.0 * (goal - self.angle_rad)
        self.tip_m[:] = math.sin(self.angle_rad[0]), 0.0, math.cos(self.angle_rad[0])
        self.elapsed_s += step_s


@pytest.fixture(scope="session")
def bus_of():
    """Build a bus of servos of one model over a lag plant."""

    def build(number: int = 54025, ids=(1,), **options) -> EmulatedBus:
        servos = [EmulatedServo(MODELS[number], servo_id, **options) for servo_id in ids]
        return EmulatedBus(servos, LagPlant(len(ids)))

    return build


@pytest.fixture(scope="session")
def patient():
    """Repeat calls of the SDK that time out after 34 ms, as they may on a busy machine."""

    def call(method, *arguments):
        for _ in range(20):
            answer = method(*arguments)
            results = [answer] if isinstance(answer, int) else [a for a in answer if type(a) is int]
            if not {sdk.COMM_RX_TIMEOUT, sdk.COMM_RX_CORRUPT} & set(results):
                return answer
        return pytest.fail(f"{method.__name__} was never answered")

    return call
