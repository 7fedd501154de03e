"""Options of a run in software, and the robot's configuration derived from them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, Literal

from firmware_py.bus.servo_models import Model
from firmware_py.config import BusConfig, RobotConfig, ServoConfig
from firmware_py.core.errors import InputError
from firmware_py.core.motion import GLIDE_S, MotionConfig
from firmware_py.goals.for_robot import note_on_plant
from firmware_py.goals.outside_goals import OutsideGoals
from firmware_py.goals.tip_plan import TipPlan
from firmware_py.inference.bundle import ModelBundle
from firmware_py.link.link_description import STUDY_LINK, LinkDescription
from firmware_py.safety.estimate_trust import TrustOptions
from firmware_py.safety.limits import Limits, limits_of_link
from firmware_py.system.clock import RealTimeOptions
from hil.emulator.physics import RigSource
from hil.sil.timing_verdict import MISS_RATE

LineKind = Literal["pty", "socket", "virtual"]

LONGEST_S: Final = 86_400.0
"""Longest run. Every tick stays in memory, a few GB per day."""


@dataclass(frozen=True)
class SilOptions:
    """Options of a run in software.

    Attributes
    ----------
    bundle : ModelBundle
        Bundle of the robot.
    model : Model
        Servo to emulate.
    out : Path
        Directory of the log.
    fmu : Path, optional
        Twin FMU to simulate behind the servos; by default it is built from the bundle's plant.
    rig : RigSource, optional
        Rig to simulate instead of a twin, on the virtual line only.
    link : LinkDescription
        Link of the rig or the plant; the robot's limits are derived from it.
    line : {"pty", "socket", "virtual"}
        Kind of line: two in real time, one on a simulated clock (see `hil.emulator.line`).
    seconds : float
        Duration of the run; the motion repeats until then.
    miss_rate : float
        Miss rate that the run has to bound with 95 % confidence. Time on the virtual line is
        simulated, so it bounds none.
    baud : int
        Baud rate of the bus in bits per second.
    latency_s : float
        Period of the USB adapter's latency timer.
    payload_kg : float
        Payload at the tip of the twin or the rig.
    payload_known : bool
        Whether the robot is configured with the payload; otherwise it estimates it.
    motion : MotionConfig
        Reference motion.
    plan : TipPlan, optional
        Plan of a tip path to run instead of the motion.
    goals : OutsideGoals, optional
        Goals of another program to follow instead of the motion.
    open_loop : bool
        Whether the plan runs without feedback of the estimated tip.
    load : int
        Number of processes that load the emulator's processor.
    faults : mapping of str to float
        Rate of each kind of line fault, from 0 to 1 (see `hil.emulator.line_faults`).
    seed : int
        Seed of the line faults.
    log : bool
        Whether the robot's recorder writes the run to `out`. Only a run on the virtual line can do
        without.
    """

    bundle: ModelBundle
    model: Model
    out: Path
    fmu: Path | None = None
    rig: RigSource | None = None
    link: LinkDescription = STUDY_LINK
    line: LineKind = "socket"
    seconds: float = 10.0
    miss_rate: float = MISS_RATE
    baud: int = 1_000_000
    latency_s: float = 1e-3
    payload_kg: float = 1.0
    payload_known: bool = False
    motion: MotionConfig = field(default_factory=MotionConfig)
    plan: TipPlan | None = None
    goals: OutsideGoals | None = None
    open_loop: bool = False
    load: int = 0
    faults: Mapping[str, float] = field(default_factory=dict)
    seed: int = 0
    log: bool = True

    @property
    def dof(self) -> int:
        """Number of joints."""
        return self.bundle.manifest.dof

    @property
    def period_s(self) -> float:
        """Control period."""
        return self.bundle.manifest.period_s

    @property
    def slots(self) -> int:
        """Number of control periods in the run."""
        return round(self.seconds / self.period_s)

    @property
    def ids(self) -> tuple[int, ...]:
        """Addresses of the servos, in joint order."""
        return tuple(range(1, self.dof + 1))

    @property
    def goals_note(self) -> str:
        """Warning that the goals were computed with another plant than the bundle's, or ""."""
        if self.plan is not None:
            plan = self.plan
            return note_on_plant(f"plan {plan.path}", plan.plant_sha256, plan.link, self.bundle)
        return self.goals.note if self.goals is not None else ""

    def check(self) -> None:
        """Check duration, load and rig.

        Raises
        ------
        InputError
            If the duration or the load is out of range, or the rig is combined with a twin or with
            a line in real time.
        """
        if not self.period_s <= self.seconds <= LONGEST_S:
            raise InputError(
                "--seconds", f"is {self.seconds:g}", f"give {self.period_s:g} to {LONGEST_S:g}"
            )
        if self.load < 0:
            raise InputError("--load", f"is {self.load}", "give a number of processes, 0 for none")
        if self.rig and (self.fmu or self.line != "virtual"):
            raise InputError(
                "--rig", "stands in a twin's place and keeps no real time",
                "take --line virtual alone",
            )  # fmt: skip


def sil_config(options: SilOptions, port: str, cpu: int | None = None) -> RobotConfig:
    """Return the configuration with which the robot would run."""
    link = options.link
    limits = Limits()  # the study's
    return RobotConfig(
        bundle=str(options.bundle.directory),
        bus=BusConfig(port=port, baud=options.baud),
        servos=tuple(ServoConfig(id=i, model=options.model.name) for i in options.ids),
        period_s=options.period_s,
        payload_kg=options.payload_kg if options.payload_known else None,
        motion=options.motion,
        limits=limits if link == STUDY_LINK else limits_of_link(link, limits, given=()),
        feedback=TrustOptions(use=not options.open_loop),
        real_time=RealTimeOptions(cpu=cpu),
    )


def programme_s(options: SilOptions) -> dict[str, float]:
    """Return the durations of the parts that the run repeats: rest, motion, glide back to zero."""
    if (plan := options.plan) is not None:
        rest = round(plan.rest_s / plan.period_s)
        rows = {"rest": rest, "motion": plan.end_row - rest, "glide": plan.rows - plan.end_row}
        return {name: count * plan.period_s for name, count in rows.items()}
    if options.goals is not None:
        return {"motion": options.seconds}
    motion = options.motion.motion(options.dof)
    parts_s = {"rest": options.motion.rest_s, "motion": motion.duration_s, "glide": GLIDE_S}
    period_s = options.period_s  # the loop runs whole slots
    return {name: round(part_s / period_s) * period_s for name, part_s in parts_s.items()}
