"""The robot of a case: its configuration, its servos, its loop with the host's faults in it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from firmware_py.bus.servo_models import MODELS
from firmware_py.bus.transport import Transport
from firmware_py.config import BusConfig, MotionConfig, RobotConfig, ServoConfig
from firmware_py.errors import InputError
from firmware_py.inference.bundle import ModelBundle
from firmware_py.realtime.clock import Clock
from firmware_py.realtime.timing import Counters
from firmware_py.robot import build_bus, build_loop
from firmware_py.safety.limits import Limits
from firmware_py.summary import RunSummary
from hil.emulator.physics import Physics
from hil.faults.fault_table import Row
from hil.faults.host_faults import FaultyEstimator, FaultyPredictor, Host
from hil.faults.observation import CaseOutcome, Columns
from hil.faults.servo_log import LoggedServo

Array = NDArray[np.float64]
REST_S: Final = 0.3
_LEAN_STEP_S: Final = 0.05
_OTHER_MODEL: Final = {54025: 54024, 54024: 54025}


@dataclass(frozen=True)
class CaseRobot:
    """What every case of a campaign has in common.

    Attributes
    ----------
    bundle : ModelBundle
        What the robot runs.
    unit : Path
        Twin behind the servos.
    """

    bundle: ModelBundle
    unit: Path

    @property
    def dof(self) -> int:
        """Number of joints."""
        return self.bundle.manifest.dof


class FaultyModels:
    """Estimator and predictor of a bundle with the host's faults in them."""

    def __init__(self, bundle: ModelBundle, host: Host) -> None:
        self.estimator = FaultyEstimator(bundle.estimator, host)
        self.predictor = FaultyPredictor(bundle.predictor, host)


def robot_config(rig: CaseRobot, row: Row, number: int, port: str) -> RobotConfig:
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


def servos_of(dof: int, row: Row, number: int) -> list[LoggedServo]:
    """The servos that are really there."""
    setup = dict(row.setup)
    numbers = [number] * dof
    if "found" in setup:
        numbers = [_OTHER_MODEL[number]] * dof
    if "mixed" in setup:
        numbers[1] = _OTHER_MODEL[number]
    delay_s = setup.get("return_delay_s", 500e-6)
    servos = [
        LoggedServo(MODELS[model], joint, 1_000_000, delay_s)
        for joint, model in enumerate(numbers, start=1)
    ]
    if "direct" in setup:
        for servo in servos:
            servo.refuses_indirect = True
    if "hardware_error" in setup:
        servos[0].fail(int(setup["hardware_error"]))
    if "reboot" in setup:
        servos[0].reboot()
    return servos


def lean(physics: Physics, angle_rad: float) -> None:
    """Bring the arm slowly to where it leans, and let it come to rest there."""
    x = np.linspace(0.0, 1.0, 100)
    way_rad = angle_rad * x**3 * (10.0 + x * (6.0 * x - 15.0))
    for goal_rad in (*way_rad.tolist(), *[angle_rad] * 100):
        physics.advance([goal_rad] * physics.dof, _LEAN_STEP_S)


def drive(
    rig: CaseRobot,
    config: RobotConfig,
    goals_rad: Array,
    slots: int,
    clock: Clock,
    host: Host,
    opener: Callable[[], Transport],
    counters: Counters | None = None,
) -> tuple[CaseOutcome, Columns]:
    """Run the robot's loop; return how it ended and its ticks by column."""
    try:
        bus = build_bus(config, opener(), clock, opener)
        loop = build_loop(
            config, FaultyModels(rig.bundle, host), bus, clock, goals_rad=goals_rad, slots=slots,
            counters=counters, keep=2 * slots,
        )  # fmt: skip
        try:
            summary = loop.run()
        finally:
            bus.close()
    except InputError as error:
        return CaseOutcome("refused", str(error)), {}
    records = summary.records
    return outcome_of(summary), {name: records[name] for name in records.dtype.names or ()}


def goals_of(config: RobotConfig, setup: dict[str, float], number: int) -> Array:
    """The study's motion, or slowly to a goal of given pulses and back."""
    if "through_pulse" not in setup:
        return config.goals_rad(repeated=True)
    angle_rad = MODELS[number].angle_rad(int(setup["through_pulse"]))
    x = np.linspace(0.0, 1.0, 130)
    way = angle_rad * x**3 * (10.0 + x * (6.0 * x - 15.0))
    column = np.concatenate([way, np.full(30, angle_rad), way[::-1]])
    return np.repeat(column[:, None], config.dof, axis=1)


def outcome_of(summary: RunSummary) -> CaseOutcome:
    """How a run ended, by its summary."""
    causes = summary.timing.causes
    return CaseOutcome(
        summary.ended.value, summary.reason, summary.replugs, summary.telemetry_drops,
        {cause.value: count for cause, count in causes.items() if count},
    )  # fmt: skip
