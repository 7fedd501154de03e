"""Real servos at a port that the environment names, driven slowly and left without torque.

    DROPSTITCH_HITL_PORT     serial device; without it every test here is skipped
    DROPSTITCH_HITL_BAUD     default 1000000
    DROPSTITCH_HITL_IDS      one per joint, like "1" (default) or "1,2"
    DROPSTITCH_HITL_MODEL    default H54-200-S500-R

The arm moves by ±3° about its zero at 0.2 rad/s at most, and goals beyond ±5° are refused, so bring
it there first and keep clear of it. `make hitl-emulated` runs the same against emulated servos.
"""

import math
import os
from collections import Counter

import dynamixel_sdk as sdk
import msgspec
import numpy as np
import pytest

from firmware_py.bus.registers import Register
from firmware_py.bus.servo_models import model_named
from firmware_py.config import BusConfig, RobotConfig, ServoConfig, check_config
from firmware_py.core.motion import MotionConfig
from firmware_py.core.signals import PERIOD_S
from firmware_py.goals.goal_source import GoalTable
from firmware_py.robot import NoModels, build_loop, open_bus
from firmware_py.safety.limits import Limits
from firmware_py.system.clock import DeadlineClock, RealTimeOptions, real_time

REACH_RAD = math.radians(5.0)
AMPLITUDE_RAD = math.radians(3.0)
RATE_RAD_S = 0.2


class StopAt:
    """Telemetry that asks for a stop after some ticks, as SIGTERM would."""

    drops = 0

    def __init__(self, ticks):
        self.countdown, self.loop = ticks, None

    def put(self, record):
        self.countdown -= 1
        if self.countdown == 0:
            self.loop.stop("SIGTERM")


class Hardware:
    """What a test may do with the servos; it counts what goes wrong."""

    def __init__(self, config):
        self.config, self.clock = config, DeadlineClock()
        self.faults = Counter()

    def bus(self):
        """The servos, for a with statement; torque off at its end."""
        return open_bus(self.config, self.clock)

    def deadline_ns(self):
        return self.clock.now_ns() + round(self.config.period_s * 1e9)

    def read(self, bus):
        """Measure once, with a whole period to answer in."""
        status = bus.read(self.deadline_ns())
        self.faults[status.name] += 1
        return status

    def run(self, limits=None, stop_at=0):
        """Summary of the robot's own loop over the motion."""
        config, goals = self.config, GoalTable(self.config.goals_rad())
        if limits is not None:
            config = msgspec.structs.replace(config, limits=limits)
        stop = StopAt(stop_at)
        with self.bus() as bus, real_time(config.real_time):
            stop.loop = build_loop(config, NoModels(), bus, self.clock, goals=goals, telemetry=stop)
            summary = stop.loop.run()
        self.faults.update(summary.bus_faults)
        return summary

    def column(self, summary, name):
        joints = range(1, self.config.dof + 1)
        return np.column_stack([summary.records[f"{name}_{j}_rad"] for j in joints])

    def registers(self, register, value=None):
        """Read a register of every servo, or write it, by the SDK as it comes."""
        port, packets = sdk.PortHandler(self.config.bus.port), sdk.PacketHandler(2.0)
        cell = model_named(self.config.servos[0].model).table[register]
        assert port.openPort() and port.setBaudRate(self.config.bus.baud)
        try:
            return [self._ask(packets, port, s.id, cell, value) for s in self.config.servos]
        finally:
            port.closePort()

    def _ask(self, packets, port, id_, cell, value):
        for _ in range(20):  # the SDK gives up after 34 ms, which on a busy machine proves nothing
            if value is None:
                data, result, _ = packets.readTxRx(port, id_, cell.address, cell.size)
            else:
                data = list(value.to_bytes(cell.size, "little"))
                result, _ = packets.writeTxRx(port, id_, cell.address, cell.size, data)
            if result == sdk.COMM_SUCCESS:
                return cell.decode(bytes(data), 0)
        raise AssertionError(f"servo {id_} does not answer")


def configured():
    """The configuration that the environment describes, or a skip."""
    port = os.environ.get("DROPSTITCH_HITL_PORT")
    if not port:
        pytest.skip("set DROPSTITCH_HITL_PORT to the port of a real servo")
    model = os.environ.get("DROPSTITCH_HITL_MODEL", "H54-200-S500-R")
    ids = os.environ.get("DROPSTITCH_HITL_IDS", "1").split(",")
    config = RobotConfig(
        bundle="none",
        bus=BusConfig(
            port=port, baud=int(os.environ.get("DROPSTITCH_HITL_BAUD", "1000000")),
            reply_timeout_s=PERIOD_S,  # servos are under test here, not this machine's timing
        ),
        servos=tuple(ServoConfig(id=int(id_), model=model) for id_ in ids),
        motion=MotionConfig(amplitude_rad=AMPLITUDE_RAD, period_s=2.176, rest_s=0.2),
        limits=Limits(
            angle_rad=(-REACH_RAD, REACH_RAD), rate_rad_s=RATE_RAD_S, following_error_rad=0.1,
            hold_s=0.2,
        ),
        real_time=RealTimeOptions(),
    )  # fmt: skip
    check_config(config, "the environment")
    return config


@pytest.fixture
def hardware():
    """The servos; every test must end without an error and without torque."""
    hardware = Hardware(configured())
    assert not any(hardware.registers(Register.TORQUE_ENABLE)), "release them first"
    yield hardware
    driven = any(hardware.registers(Register.TORQUE_ENABLE))
    if driven:
        hardware.registers(Register.TORQUE_ENABLE, 0)
    assert not driven, "torque is off"
    assert not any(hardware.registers(Register.HARDWARE_ERROR))
    hardware.faults.pop("OK", None)
    assert not hardware.faults
