"""A case on the virtual line: simulated time, so that the same seed gives the same run."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from firmware_py.bundle import ModelBundle
from firmware_py.clock import SimClock
from firmware_py.config import BusConfig, MotionConfig, RobotConfig, ServoConfig
from firmware_py.dynamixel import DynamixelBus
from firmware_py.errors import InputError
from firmware_py.loop import ControlLoop
from firmware_py.registers import MODELS
from firmware_py.safety import Limits, SafetySupervisor
from firmware_py.summary import RunSummary
from firmware_py.wire import Wire
from hil.faults.host import FaultyEstimator, FaultyPredictor, FaultyWire, Host, SteppedClock
from hil.faults.observe import Observation, Outcome, observe
from hil.faults.plan import Script
from hil.faults.table import Row
from hil.faults.witness import WatchedChain, WatchedServo
from hil.line import Line, VirtualWire
from hil.physics import UnitPhysics

Array = NDArray[np.float64]
SLOTS: Final = 300
"""Slots of a case's motion: 5.1 s, which leaves room for a stop, a replug and a recovery."""
REST_S: Final = 0.3
SETTLE_NS: Final = 500_000_000
"""How long the servos are looked at after the loop has ended."""
_OTHER_MODEL: Final = {54025: 54024, 54024: 54025}


@dataclass(frozen=True)
class Rig:
    """What every case of a campaign has in common.

    Attributes
    ----------
    bundle : ModelBundle
        What the robot runs.
    unit : Path
        Twin behind the servos.
    out : Path
        Directory for what a case leaves behind.
    """

    bundle: ModelBundle
    unit: Path
    out: Path

    @property
    def dof(self) -> int:
        """Number of joints."""
        return self.bundle.manifest.dof


def robot_config(rig: Rig, row: Row, number: int, port: str) -> RobotConfig:
    """The configuration of a case's robot."""
    setup = dict(row.setup)
    models = [number] * rig.dof
    if setup.get("mixed") == 1:
        models[1] = _OTHER_MODEL[number]
    limits = Limits()
    if "through_pulse" in setup:
        limits = Limits(angle_rad=(-0.9, 0.9))
    return RobotConfig(
        bundle=str(rig.bundle.directory.resolve()),
        bus=BusConfig(port=port, replug_s=setup.get("replug_s", 0.0)),
        servos=tuple(
            ServoConfig(id=joint, model=MODELS[model].name)
            for joint, model in enumerate(models, start=1)
        ),
        period_s=rig.bundle.manifest.period_s,
        motion=MotionConfig(rest_s=REST_S),
        limits=limits,
    )


def servos_of(rig: Rig, row: Row, number: int) -> list[WatchedServo]:
    """The servos that are really there."""
    setup = dict(row.setup)
    numbers = [number] * rig.dof
    if "found" in setup:
        numbers = [_OTHER_MODEL[number]] * rig.dof
    if "mixed" in setup:
        numbers[1] = _OTHER_MODEL[number]
    delay_s = setup.get("return_delay_s", 500e-6)
    servos = [
        WatchedServo(MODELS[model], joint, 1_000_000, delay_s)
        for joint, model in enumerate(numbers, start=1)
    ]
    if "hardware_error" in setup:
        servos[0].fail(int(setup["hardware_error"]))
    if "reboot" in setup:
        servos[0].reboot()
    return servos


class _DeafLine(Line):
    """A line whose host speaks at another baud rate: each side hears only noise."""

    def receive(self, now_ns: int, data: bytes) -> list[tuple[int, bytes]]:
        """See `Line.receive`."""
        return super().receive(now_ns, bytes(byte & 0x55 for byte in data))


def run_virtual(rig: Rig, row: Row, number: int, seed: int) -> Observation:
    """Run one case."""
    true_clock = SimClock()
    clock = SteppedClock(true_clock)
    script = Script(row.injections, seed)
    host = Host(
        script, row.injections, true_clock.now_ns, lambda s: true_clock.advance(round(s * 1e9))
    )
    clock.host = host
    setup = dict(row.setup)
    physics = UnitPhysics(rig.unit, rig.dof)
    chain = WatchedChain(servos_of(rig, row, number), physics, script)
    line = (_DeafLine if "baud" in setup else Line)(chain, setup.get("latency_s", 1e-3), script)
    try:
        return _run(rig, row, number, clock, host, line, chain, script)
    finally:
        physics.unit.close()


def _run(
    rig: Rig,
    row: Row,
    number: int,
    clock: SteppedClock,
    host: Host,
    line: Line,
    chain: WatchedChain,
    script: Script,
) -> Observation:
    config = robot_config(rig, row, number, "virtual")
    limits, period_s = config.limits_in_force, config.period_s

    def opener() -> Wire:
        if host.unplugged():
            raise InputError("virtual", "is missing", "plug it in")
        return FaultyWire(VirtualWire(line, true_clock), clock, host)

    true_clock = clock.true
    columns: dict[str, NDArray[Any]] = {}
    try:
        goals_rad = _goals_rad(config, dict(row.setup), number)
        bus = DynamixelBus(
            opener(), config.setups(), clock, period_s=period_s, name="virtual",
            reply_timeout_s=config.bus.reply_timeout_s, opener=opener,
        )  # fmt: skip
        loop = ControlLoop(
            bus, FaultyEstimator(rig.bundle.estimator, host),
            FaultyPredictor(rig.bundle.predictor, host),
            SafetySupervisor(limits, rig.dof, period_s), goals_rad, clock, slots=SLOTS,
            period_s=period_s, reply_timeout_s=config.bus.reply_timeout_s,
            replug_s=config.bus.replug_s, keep=2 * SLOTS,
        )  # fmt: skip
        summary = loop.run()
        outcome = outcome_of(summary)
        columns = columns_of(summary)
    except InputError as error:
        outcome = Outcome("refused", str(error))
    testimony = chain.testify(true_clock.now_ns() + SETTLE_NS)
    began = [t for t in (host.began_ns, testimony.began_ns) if t is not None]
    if "through_pulse" in dict(row.setup):
        wanted = MODELS[number].angle_rad(int(dict(row.setup)["through_pulse"]))
        if not np.any(np.all(testimony.goal_rad == wanted, axis=1)):
            outcome = replace(outcome, reason="the goal never arrived", ended="tripped")
    return observe(
        outcome, columns, testimony, min(began, default=None), SLOTS, period_s, limits.rate_rad_s,
        stepped_in_tick=script.start if any(i.kind == "clock" for i in row.injections) else None,
    )  # fmt: skip


def _goals_rad(config: RobotConfig, setup: dict[str, float], number: int) -> Array:
    """The study's motion, or slowly to a goal of given pulses and back."""
    if "through_pulse" not in setup:
        return config.goals_rad(repeated=True)
    angle_rad = MODELS[number].angle_rad(int(setup["through_pulse"]))
    x = np.linspace(0.0, 1.0, 130)
    way = angle_rad * x**3 * (10.0 + x * (6.0 * x - 15.0))
    column = np.concatenate([way, np.full(30, angle_rad), way[::-1]])
    return np.repeat(column[:, None], config.dof, axis=1)


def outcome_of(summary: RunSummary) -> Outcome:
    """How a run ended, by its summary."""
    causes = summary.timing.causes
    return Outcome(
        summary.ended.value, summary.reason, summary.replugs, summary.telemetry_drops,
        {cause.value: count for cause, count in causes.items() if count},
    )  # fmt: skip


def columns_of(summary: RunSummary) -> dict[str, NDArray[Any]]:
    """The ticks of a summary by column."""
    return {name: summary.records[name] for name in summary.records.dtype.names or ()}
