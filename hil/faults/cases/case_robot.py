"""Robot of a case: configuration, servos, and the loop with injected host faults."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from firmware_py.bus.dynamixel import DynamixelBus
from firmware_py.bus.servo_models import MODELS, Model, ServoGains
from firmware_py.bus.transport import Transport
from firmware_py.config import BusConfig, RobotConfig, ServoConfig
from firmware_py.core.errors import InputError
from firmware_py.core.motion import MotionConfig
from firmware_py.goals.for_robot import innovation_places
from firmware_py.goals.goal_source import GoalSource, GoalTable
from firmware_py.goals.plan_goals import PlanGoals
from firmware_py.goals.tip_feedback import Correction
from firmware_py.goals.tip_plan import FeedbackDesign, PayloadPlan, RateFilter, TipPlan
from firmware_py.inference.bundle import ModelBundle
from firmware_py.link.link_facts import STUDY_FACTS
from firmware_py.robot import build_bus, build_loop
from firmware_py.safety.estimate_trust import TrustOptions
from firmware_py.safety.limits import Limits
from firmware_py.summary import RunSummary
from firmware_py.system.clock import Clock
from firmware_py.system.kernel_counters import Counters
from hil.emulator.physics import Physics
from hil.faults.cases.goal_program import program_goals
from hil.faults.fault_row import FaultRow, Setup
from hil.faults.host_faults import (
    FaultyEstimator,
    FaultyFeedback,
    FaultyPredictor,
    HostFaults,
)
from hil.faults.observation import CaseOutcome, Columns
from hil.faults.servo_log import LoggedServo

Array = NDArray[np.float64]
REST_S: Final = 0.3
GAINS: Final = ServoGains(position_p=800, velocity_i=0)
"""Gains of the emulated servos."""
_LEAN_STEP_S: Final = 0.05
_OTHER_MODEL: Final = {54025: 54024, 54024: 54025}


class RunTap(Protocol):
    """Listener between the loop of a case and its bus."""

    def wrap(self, bus: DynamixelBus) -> DynamixelBus:
        """Return the bus to pass to the loop instead of `bus`."""
        ...

    def end(self, outcome: CaseOutcome, columns: Columns) -> None:
        """Receive the outcome and the ticks of the run."""
        ...


@dataclass(frozen=True)
class CaseRobot:
    """Bundle and twin that all cases of a campaign share."""

    bundle: ModelBundle
    fmu: Path  # Twin FMU behind the servos
    tap: RunTap | None = None  # Listener between loop and bus

    @property
    def dof(self) -> int:
        """Number of joints."""
        return self.bundle.manifest.dof


class FaultyModels:
    """Estimator and predictor of a bundle, with injected host faults."""

    def __init__(self, bundle: ModelBundle, host: HostFaults) -> None:
        self.estimator = FaultyEstimator(bundle.estimator, host)
        self.predictor = FaultyPredictor(bundle.predictor, host)


def case_config(robot: CaseRobot, row: FaultRow, number: int, port: str) -> RobotConfig:
    """Return the configuration of a case's robot."""
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
            ServoConfig(id=joint, model=MODELS[model].name, gains=GAINS)
            for joint, model in enumerate(models, start=1)
        ),
        period_s=robot.bundle.manifest.period_s,
        motion=MotionConfig(rest_s=REST_S),
        limits=limits,
    )


def _with_gains(model: Model) -> Model:
    """Return a model whose servos start with the gains that every case expects."""
    return replace(model, factory={**model.factory, **GAINS.registers()})


def case_servos(dof: int, row: FaultRow, number: int) -> list[LoggedServo]:
    """Return the servos on the bus: of model `number`, unless the row changes it."""
    setup = row.setup
    numbers = [number] * dof
    if setup.wrong_model:
        numbers = [_OTHER_MODEL[number]] * dof
    if setup.second_model != "as the first":
        numbers[1] = _OTHER_MODEL[number]
    servos = [
        LoggedServo(_with_gains(MODELS[model]), joint, 1_000_000, setup.return_delay_s)
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


def lean_arm(physics: Physics, angle_rad: float) -> None:
    """Move the arm slowly to an angle and let it come to rest."""
    x = np.linspace(0.0, 1.0, 100)
    way_rad = angle_rad * x**3 * (10.0 + x * (6.0 * x - 15.0))
    for goal_rad in (*way_rad.tolist(), *[angle_rad] * 100):
        physics.advance([goal_rad] * physics.dof, _LEAN_STEP_S)


def run_case_loop(
    robot: CaseRobot,
    config: RobotConfig,
    goals: tuple[GoalSource, Correction | None],
    slots: int,
    clock: Clock,
    host: HostFaults,
    opener: Callable[[], Transport],
    counters: Counters | None = None,
) -> tuple[CaseOutcome, Columns]:
    """Run the robot's loop; return its outcome and its ticks by column.

    `goals` are the source of the goals and the correction that is added to them.
    """
    try:
        bus = build_bus(config, opener(), clock, opener)
        if robot.tap is not None:
            bus = robot.tap.wrap(bus)
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
        return CaseOutcome("refused", str(error)), {}
    records, outcome = summary.records, case_outcome(summary)
    columns = {name: records[name] for name in records.dtype.names or ()}
    if robot.tap is not None:
        robot.tap.end(outcome, columns)
    return outcome, columns


def case_source(
    robot: CaseRobot, config: RobotConfig, goals_rad: Array, setup: Setup, host: HostFaults
) -> tuple[GoalSource, Correction | None]:
    """Return the goals as a table, a program that sends them, or a plan with feedback.

    The plan has half of `goals_rad`, shape (n, dof). Its desired tip is that of a rigid link, so
    that there is always an error to correct; its filter is a gain of 1/s.
    """
    if setup.outside:
        return program_goals(config, goals_rad, host), None
    if setup.feedback == "none":
        return GoalTable(goals_rad), None
    columns = tuple(tuple(c) for c in (0.5 * goals_rad).T.tolist())
    still = tuple((0.0,) * len(goals_rad) for _ in range(robot.dof))
    own = RateFilter(a=((0.0,),), b=((0.0,),), c=((0.0,),), d=((1.0,),))
    plan = TipPlan(
        schema=TipPlan.VERSION, path="case", method="rigid", dof=robot.dof,
        period_s=config.period_s, rest_s=REST_S, start_row=0, end_row=len(goals_rad), drawn=(),
        desired_m=columns,
        payloads=(PayloadPlan(payload_kg=1.0, goals_rad=columns, tip_m=columns, current_a=still,
                              residual_rms_m=0.0, rigid_rms_m=0.0, expected_rms_m=0.0),),
        payload_rate_kg_s=0.5, plant_error_rms_m=None, plant_sha256="", bundle_sha256="",
        link=STUDY_FACTS,
        feedback=FeedbackDesign(filters=((own,) * robot.dof,), margins=(), size_rad=0.03,
                                rate_rad_s=0.16, innovation_a=0.8),
    )  # fmt: skip
    source = PlanGoals(plan, 1.0)
    places = innovation_places(robot.bundle.signal_names, robot.dof)
    correction = FaultyFeedback(plan, source, TrustOptions(when_lost=setup.feedback), places)
    correction.host = host
    return source, correction


def case_goals(config: RobotConfig, setup: Setup, number: int) -> Array:
    """Return the study's motion, or a slow motion to the goal `through_pulse` and back."""
    if setup.through_pulse is None:
        return config.goals_rad(repeated=True)
    angle_rad = MODELS[number].angle_rad(setup.through_pulse)
    x = np.linspace(0.0, 1.0, 130)
    way = angle_rad * x**3 * (10.0 + x * (6.0 * x - 15.0))
    column = np.concatenate([way, np.full(30, angle_rad), way[::-1]])
    return np.repeat(column[:, None], config.dof, axis=1)


def case_outcome(summary: RunSummary) -> CaseOutcome:
    """Return the outcome of a run from its summary."""
    causes = summary.timing.causes
    return CaseOutcome(
        summary.ended.value, summary.reason, summary.replugs, summary.telemetry_drops,
        {cause.value: count for cause, count in causes.items() if count},
        held_up_ticks=summary.held_up_ticks,
    )  # fmt: skip
