"""Robot of a case: configuration, servos, and the loop with faults of the host."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from firmware_py.bus.servo_models import MODELS, Model, ServoGains
from firmware_py.bus.transport import Transport
from firmware_py.config import BusConfig, RobotConfig, ServoConfig
from firmware_py.core.errors import InputError
from firmware_py.core.motion import MotionConfig
from firmware_py.goals.goal_source import GoalSource
from firmware_py.goals.tip_feedback import Correction
from firmware_py.inference.bundle import ModelBundle
from firmware_py.robot import build_bus, build_loop
from firmware_py.safety.limits import Limits
from firmware_py.system.clock import Clock
from firmware_py.system.kernel_counters import Counters
from hil.faults.fault_row import FaultRow
from hil.faults.faulty_parts import FaultyModels, HostFaults
from hil.faults.observation import CaseObservation, Columns
from hil.faults.servo_log import LoggedServo

REST_S: Final = 0.3
_GAINS: Final = ServoGains(position_p=800, velocity_i=0)
"""Gains of the emulated servos."""
_RETURN_DELAY_S: Final = 500e-6
"""Return Delay Time of a servo at its default."""
_OTHER_MODEL: Final = {54025: 54024, 54024: 54025}


@dataclass(frozen=True)
class CaseRobot:
    """Bundle and twin that all cases of a campaign share."""

    bundle: ModelBundle
    fmu: Path  # Twin FMU behind the servos

    @property
    def dof(self) -> int:
        return self.bundle.manifest.dof


def case_config(robot: CaseRobot, row: FaultRow, number: int, port: str) -> RobotConfig:
    setup = row.setup
    models = [number] * robot.dof
    if setup.second_model == "declared":
        models[1] = _OTHER_MODEL[number]
    limits = Limits()
    if setup.through_pulse is not None:
        limits = Limits(angle_rad=(-0.9, 0.9))
    return RobotConfig(
        bundle=str(robot.bundle.directory.resolve()),
        bus=BusConfig(port=port, replug_s=setup.replug_s),
        servos=tuple(
            ServoConfig(id=joint, model=MODELS[model].name, gains=_GAINS)
            for joint, model in enumerate(models, start=1)
        ),
        period_s=robot.bundle.manifest.period_s,
        motion=MotionConfig(rest_s=REST_S),
        limits=limits,
    )


def _with_gains(model: Model) -> Model:
    """Return a model whose servos start with the gains that every case expects."""
    return replace(model, factory={**model.factory, **_GAINS.registers()})


def case_servos(dof: int, row: FaultRow, number: int) -> list[LoggedServo]:
    """Return the servos on the bus: of model `number`, unless the row changes it."""
    setup = row.setup
    numbers = [number] * dof
    if setup.wrong_model:
        numbers = [_OTHER_MODEL[number]] * dof
    if setup.second_model != "as the first":
        numbers[1] = _OTHER_MODEL[number]
    servos = [
        LoggedServo(_with_gains(MODELS[model]), joint, 1_000_000, _RETURN_DELAY_S)
        for joint, model in enumerate(numbers, start=1)
    ]
    if setup.refuses_indirect:
        for servo in servos:
            servo.refuses_indirect = True
    if setup.hardware_error:
        servos[0].fail(setup.hardware_error)
    if setup.setting is not None:
        servos[0].put(*setup.setting)
    if setup.rebooted:
        servos[0].reboot()
    return servos


def run_case_loop(
    robot: CaseRobot,
    config: RobotConfig,
    goals: tuple[GoalSource, Correction | None],
    slots: int,
    clock: Clock,
    host: HostFaults,
    opener: Callable[[], Transport],
    counters: Counters | None = None,
) -> tuple[CaseObservation, Columns]:
    """Run the robot's loop; return what it reported and its ticks by column.

    `goals` are the source of the goals and the correction that is added to them.
    """
    try:
        bus = build_bus(config, opener(), clock, opener)
        loop = build_loop(
            config, FaultyModels(robot.bundle, host), bus, clock, goals=goals[0],
            correction=goals[1], slots=slots, counters=counters, keep=2 * slots,
        )  # fmt: skip
        host.request_stop = loop.stop
        try:
            summary = loop.run()
        finally:
            bus.close()
    except InputError as error:
        return CaseObservation("refused", str(error)), {}
    reported = CaseObservation(
        summary.ended.value,
        summary.reason,
        replugs=summary.replugs,
        misses={cause.value: count for cause, count in summary.timing.causes.items() if count},
        held_up_ticks=summary.held_up_ticks,
    )
    records = summary.records
    return reported, {name: records[name] for name in records.dtype.names or ()}
