"""Case on the virtual line: time is simulated, so equal seeds give equal runs."""

from __future__ import annotations

from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from firmware_py.bus.servo_models import MODELS
from firmware_py.bus.transport import Transport
from firmware_py.config import RobotConfig
from firmware_py.core.errors import InputError
from firmware_py.goals.for_robot import innovation_places
from firmware_py.goals.goal_source import GoalSource, GoalTable
from firmware_py.goals.plan_goals import PlanGoals
from firmware_py.goals.tip_feedback import Correction
from firmware_py.goals.tip_plan import FeedbackDesign, PayloadPlan, RateFilter, TipPlan
from firmware_py.link.link_facts import STUDY_FACTS
from firmware_py.safety.estimate_trust import TrustOptions
from firmware_py.system.clock import SimClock
from hil.emulator.line import Line, VirtualTransport
from hil.emulator.physics import FmuPhysics, Physics
from hil.faults.case_robot import (
    REST_S,
    CaseRobot,
    case_config,
    case_servos,
    run_case_loop,
)
from hil.faults.fault_row import FaultRow
from hil.faults.faulty_parts import (
    FaultSchedule,
    FaultyFeedback,
    FaultyTransport,
    HostFaults,
    SteppedClock,
    program_goals,
)
from hil.faults.observation import CaseObservation, observe_case
from hil.faults.servo_log import LoggedBus

Array = NDArray[np.float64]
SLOTS: Final = 300
"""Slots of the long motion: 5.1 s, enough for a stop, a replug and a recovery."""
FEWER_SLOTS: Final = 200
"""Slots of the short motion: the last fault begins before the 140th, and a stop takes 35."""
_SOON_TICKS: Final = 10
"""Longest detection time of a fault that the short motion can test."""
_SETTLE_NS: Final = 500_000_000
"""Time for which the servos are observed after the loop has ended."""
_LEAN_STEP_S: Final = 0.05


class _DeafLine(Line):
    """Line whose host sends at another baud rate: the servos receive noise."""

    def receive(self, now_ns: int, data: bytes) -> list[tuple[int, bytes]]:
        return super().receive(now_ns, bytes(byte & 0x55 for byte in data))


def slots_of(row: FaultRow) -> int:
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
    script = FaultSchedule(row.injections, seed)
    host = HostFaults(
        script, true_clock.now_ns, lambda time_s: true_clock.advance(round(time_s * 1e9))
    )
    clock = SteppedClock(true_clock, host)
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
    goals_rad = case_goals(config, setup.through_pulse, number)
    goals = case_source(robot, config, goals_rad, row, host)
    slots = slots_of(row)
    reported, columns = run_case_loop(robot, config, goals, slots, clock, host, opener)
    servo_log = bus.log(true_clock.now_ns() + _SETTLE_NS)
    if (pulse := setup.through_pulse) is not None:
        wanted_rad = MODELS[number].angle_rad(pulse)
        if not np.any(np.all(servo_log.goal_rad == wanted_rad, axis=1)):
            reported = msgspec.structs.replace(
                reported, ended="goal lost", reason="the goal never arrived"
            )
    return observe_case(
        reported, columns, servo_log, (host.began_ns, servo_log.began_ns), slots, config,
        stepped_in_tick=script.start if row.injects("clock") else None,
    )  # fmt: skip


def lean_arm(physics: Physics, angle_rad: float) -> None:
    """Move the arm slowly to an angle and let it come to rest."""
    way_rad = _way_rad(angle_rad, 100)
    for goal_rad in (*way_rad.tolist(), *[angle_rad] * 100):
        physics.advance([goal_rad] * physics.dof, _LEAN_STEP_S)


def case_source(
    robot: CaseRobot, config: RobotConfig, goals_rad: Array, row: FaultRow, host: HostFaults
) -> tuple[GoalSource, Correction | None]:
    """Return the goals as a table, a program that sends them, or a plan with feedback.

    The plan has half of `goals_rad`, shape (n, dof). Its desired tip is that of a rigid link, so
    that there is always an error to correct; its filter is a gain of 1/s.
    """
    if row.injects("goals"):
        return program_goals(config, goals_rad, host), None
    if row.setup.feedback == "none":
        return GoalTable(goals_rad), None
    columns = tuple(tuple(c) for c in (0.5 * goals_rad).T.tolist())
    still = tuple((0.0,) * len(goals_rad) for _ in range(robot.dof))
    gain = RateFilter(a=((0.0,),), b=((0.0,),), c=((0.0,),), d=((1.0,),))
    plan = TipPlan(
        schema=TipPlan.VERSION, path="case", method="rigid", dof=robot.dof,
        period_s=config.period_s, rest_s=REST_S, start_row=0, end_row=len(goals_rad), drawn=(),
        desired_m=columns,
        payloads=(PayloadPlan(payload_kg=1.0, goals_rad=columns, tip_m=columns, current_a=still,
                              residual_rms_m=0.0, rigid_rms_m=0.0, expected_rms_m=0.0),),
        payload_rate_kg_s=0.5, plant_error_rms_m=None, plant_sha256="", bundle_sha256="",
        link=STUDY_FACTS,
        feedback=FeedbackDesign(filters=((gain,) * robot.dof,), margins=(), size_rad=0.03,
                                rate_rad_s=0.16, innovation_a=0.8),
    )  # fmt: skip
    source = PlanGoals(plan, 1.0)
    places = innovation_places(robot.bundle.signal_names, robot.dof)
    correction = FaultyFeedback(
        host, plan, source, TrustOptions(when_lost=row.setup.feedback), places
    )
    return source, correction


def case_goals(config: RobotConfig, through_pulse: int | None, number: int) -> Array:
    """Return the study's motion, or a slow motion to the goal `through_pulse` and back."""
    if through_pulse is None:
        return config.goals_rad(repeated=True)
    angle_rad = MODELS[number].angle_rad(through_pulse)
    way_rad = _way_rad(angle_rad, 130)
    column = np.concatenate([way_rad, np.full(30, angle_rad), way_rad[::-1]])
    return np.repeat(column[:, None], config.dof, axis=1)


def _way_rad(angle_rad: float, count: int) -> Array:
    """Way from zero to an angle that starts and ends at rest, without a step of acceleration."""
    x = np.linspace(0.0, 1.0, count)
    return angle_rad * x**3 * (10.0 + x * (6.0 * x - 15.0))
