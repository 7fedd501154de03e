"""Case on the virtual line: time is simulated, so equal seeds give equal runs."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from firmware_py.bus.servo_models import MODELS
from firmware_py.bus.transport import Transport
from firmware_py.core.errors import InputError
from firmware_py.system.clock import SimClock
from hil.emulator.line import Line, VirtualTransport
from hil.emulator.physics import FmuPhysics
from hil.faults.cases.case_robot import (
    CaseRobot,
    case_config,
    case_goals,
    case_servos,
    case_source,
    lean_arm,
    run_case_loop,
)
from hil.faults.fault_row import FaultRow
from hil.faults.host_faults import FaultyTransport, HostFaults, SteppedClock
from hil.faults.injection import FaultSchedule
from hil.faults.observation import CaseObservation, observe_case
from hil.faults.servo_log import LoggedBus

SLOTS: Final = 300
"""Slots of the long motion: 5.1 s, enough for a stop, a replug and a recovery."""
FEWER_SLOTS: Final = 200
"""Slots of the short motion: the last fault begins before the 140th, and a stop takes 35."""
_SOON_TICKS: Final = 10
"""Longest detection time of a fault that the short motion can test."""
SETTLE_NS: Final = 500_000_000
"""Time for which the servos are observed after the loop has ended."""


class _DeafLine(Line):
    """Line whose host sends at another baud rate: the servos receive noise."""

    def receive(self, now_ns: int, data: bytes) -> list[tuple[int, bytes]]:
        return super().receive(now_ns, bytes(byte & 0x55 for byte in data))


def slots_of(row: FaultRow) -> int:
    """Return the number of slots that a row's motion takes."""
    long = row.setup.replug_s or row.setup.through_pulse is not None
    return SLOTS if long or (row.must.within or 0) > _SOON_TICKS else FEWER_SLOTS


def run_virtual(robot: CaseRobot, row: FaultRow, number: int, seed: int) -> CaseObservation:
    """Run one case, with servos of model `number`; the seed sets the fault's time and bits."""
    physics = FmuPhysics(robot.fmu, robot.dof)
    try:
        return _run(robot, row, number, seed, physics)
    finally:
        physics.fmu.close()


def _run(
    robot: CaseRobot, row: FaultRow, number: int, seed: int, physics: FmuPhysics
) -> CaseObservation:
    setup = row.setup
    true_clock = SimClock()
    clock, script = SteppedClock(true_clock), FaultSchedule(row.injections, seed)
    host = clock.host = HostFaults(
        script, row.injections, true_clock.now_ns, lambda s: true_clock.advance(round(s * 1e9))
    )
    servos = case_servos(robot.dof, row, number)
    if setup.lean_rad is not None:
        lean_arm(physics, setup.lean_rad)
    bus = LoggedBus(servos, physics, script)
    if setup.lean_rad is not None:  # the servos are switched on at this angle
        for servo in servos:
            servo.reboot()
    line = (_DeafLine if setup.wrong_baud else Line)(bus, setup.latency_s, script)

    def opener() -> Transport:
        if host.unplugged():
            raise InputError("virtual", "is missing", "plug it in")
        return FaultyTransport(VirtualTransport(line, true_clock), clock, host)

    config = case_config(robot, row, number, "virtual")
    goals_rad = case_goals(config, setup, number)
    goals = case_source(robot, config, goals_rad, setup, host)
    slots = slots_of(row)
    outcome, columns = run_case_loop(robot, config, goals, slots, clock, host, opener)
    servo_log = bus.log(true_clock.now_ns() + SETTLE_NS)
    if (pulse := setup.through_pulse) is not None:
        wanted_rad = MODELS[number].angle_rad(pulse)
        if not np.any(np.all(servo_log.goal_rad == wanted_rad, axis=1)):
            outcome = replace(outcome, ended="goal lost", reason="the goal never arrived")
    began = [t for t in (host.began_ns, servo_log.began_ns) if t is not None]
    return observe_case(
        outcome, columns, servo_log, min(began, default=None), slots, config.period_s,
        config.limits_in_force.rate_rad_s,
        stepped_in_tick=script.start if any(i.kind == "clock" for i in row.injections) else None,
    )  # fmt: skip
