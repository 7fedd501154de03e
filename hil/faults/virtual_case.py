"""A case on the virtual line: simulated time, so that the same seed gives the same run."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from firmware_py.bus.servo_models import MODELS
from firmware_py.bus.transport import Transport
from firmware_py.errors import InputError
from firmware_py.realtime.clock import SimClock
from hil.emulator.fmu_physics import FmuPhysics
from hil.emulator.line import Line, VirtualTransport
from hil.faults.case_robot import CaseRobot, drive, goals_of, lean, robot_config, servos_of
from hil.faults.fault_table import Row
from hil.faults.host_faults import FaultyTransport, Host, SteppedClock
from hil.faults.injection import Script
from hil.faults.observation import CaseObservation, observe
from hil.faults.servo_log import LoggedBus

SLOTS: Final = 300
"""Slots of a case's motion: 5.1 s, which leaves room for a stop, a replug and a recovery."""
SETTLE_NS: Final = 500_000_000
"""How long the servos are looked at after the loop has ended."""


class _DeafLine(Line):
    """A line whose host speaks at another baud rate: the servos hear only noise."""

    def receive(self, now_ns: int, data: bytes) -> list[tuple[int, bytes]]:
        """See `Line.receive`."""
        return super().receive(now_ns, bytes(byte & 0x55 for byte in data))


def run_virtual(rig: CaseRobot, row: Row, number: int, seed: int) -> CaseObservation:
    """Run one case.

    Parameters
    ----------
    rig : CaseRobot
        What the campaign has in common.
    row : Row
        What to try.
    number, seed : int
        Model of the servos; moment and bits of the fault.
    """
    physics = FmuPhysics(rig.unit, rig.dof)
    try:
        return _run(rig, row, number, seed, physics)
    finally:
        physics.unit.close()


def _run(rig: CaseRobot, row: Row, number: int, seed: int, physics: FmuPhysics) -> CaseObservation:
    setup = dict(row.setup)
    true_clock = SimClock()
    clock, script = SteppedClock(true_clock), Script(row.injections, seed)
    host = clock.host = Host(
        script, row.injections, true_clock.now_ns, lambda s: true_clock.advance(round(s * 1e9))
    )
    servos = servos_of(rig.dof, row, number)
    if "lean_rad" in setup:
        lean(physics, setup["lean_rad"])
    chain = LoggedBus(servos, physics, script)
    if "lean_rad" in setup:  # switched on where they stand
        for servo in servos:
            servo.reboot()
    line = (_DeafLine if "baud" in setup else Line)(chain, setup.get("latency_s", 1e-3), script)

    def opener() -> Transport:
        if host.unplugged():
            raise InputError("virtual", "is missing", "plug it in")
        return FaultyTransport(VirtualTransport(line, true_clock), clock, host)

    config = robot_config(rig, row, number, "virtual")
    goals_rad = goals_of(config, setup, number)
    outcome, columns = drive(rig, config, goals_rad, SLOTS, clock, host, opener)
    testimony = chain.testify(true_clock.now_ns() + SETTLE_NS)
    if (pulse := setup.get("through_pulse")) is not None:
        wanted_rad = MODELS[number].angle_rad(int(pulse))
        if not np.any(np.all(testimony.goal_rad == wanted_rad, axis=1)):
            outcome = replace(outcome, ended="goal lost", reason="the goal never arrived")
    began = [t for t in (host.began_ns, testimony.began_ns) if t is not None]
    return observe(
        outcome, columns, testimony, min(began, default=None), SLOTS, config.period_s,
        config.limits_in_force.rate_rad_s,
        stepped_in_tick=script.start if any(i.kind == "clock" for i in row.injections) else None,
    )  # fmt: skip
