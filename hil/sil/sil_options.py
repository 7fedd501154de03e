"""Options of a run in software, and what follows from them for the robot."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Literal

import msgspec

from firmware_py.bus.servo_models import Model, model_named
from firmware_py.config import BusConfig, RobotConfig, ServoConfig
from firmware_py.core.errors import InputError
from firmware_py.core.input_files import read_toml
from firmware_py.core.motion import GLIDE_S, MotionConfig
from firmware_py.core.signals import PERIOD_S
from firmware_py.goals.for_robot import note_on_plant
from firmware_py.goals.outside_goals import OutsideGoals
from firmware_py.goals.tip_plan import TipPlan
from firmware_py.inference.bundle import ModelBundle
from firmware_py.link.link_description import (
    STUDY_LINK,
    LinkDescription,
    describes_link,
    read_link,
)
from firmware_py.safety.estimate_trust import TrustOptions
from firmware_py.safety.limits import Limits, limits_of_link
from firmware_py.system.clock import RealTimeOptions
from hil.emulator.emulator import EmulatorSpecification
from hil.emulator.physics import RigSource
from hil.sil.timing_verdict import MISS_RATE, slots_needed
from models.plant.document import link_of_plant

LineKind = Literal["pty", "socket", "virtual"]

LONGEST_S: Final = 86_400.0
"""Longest run. Every tick stays in memory, a few GB per day."""
SHORTEST_DEFAULT_S: Final = 10.0
DERIVED: Final[Any] = None
"""Default of an option that `SilOptions` derives from the others."""


@dataclass(frozen=True, kw_only=True)
class SilOptions:
    """Options of a run in software.

    Attributes
    ----------
    bundle : ModelBundle
        Bundle of the robot.
    out : Path
        Directory of the results.
    fmu : Path, optional
        Twin FMU to simulate behind the servos; by default it is built from the bundle's plant.
    rig : RigSource, optional
        Rig to simulate instead of a twin, on the virtual line only.
    link : LinkDescription, optional
        Link from which the robot's limits are derived; by default that of the rig or of the
        bundle's plant.
    model : Model, optional
        Servo to emulate; by default that of the link.
    line : {"socket", "pty", "virtual"}
        Kind of line: two in real time, one on a simulated clock (see `hil.emulator.line`).
    seconds : float, optional
        Duration of the run; the motion repeats until then. By default that of the runs of the
        plan; without a plan 10 s, or in real time longer if `miss_rate` needs it.
    miss_rate : float
        Miss rate that the run has to bound with 95 % confidence. Time on the virtual line is
        simulated, so it bounds none.
    baud : int
        Baud rate of the bus in bits per second.
    latency_s : float
        Period of the USB adapter's latency timer.
    payload_kg : float, optional
        Payload at the tip of the twin or the rig; by default half of the link's largest.
    payload_known : bool
        Whether the robot is configured with the payload; otherwise it estimates it.
    motion : MotionConfig
        Reference motion.
    plan : TipPlan, optional
        Plan of a tip path to run instead of the motion.
    runs : int
        Number of runs of the plan, for the default duration.
    open_loop : bool
        Whether the plan runs without feedback of the estimated tip.
    goals : OutsideGoals, optional
        Goals of another program to follow instead of the motion.
    load : int
        Number of processes that load the emulator's processor.
    faults : mapping of str to float
        Rate of each kind of line fault, from 0 to 1 (see `hil.emulator.line_faults`).
    seed : int
        Seed of the line faults.
    log : bool
        Whether the robot's recorder writes the run to `out`. Only a run on the virtual line can do
        without.

    Raises
    ------
    InputError
        If an option is out of range, or the rig is combined with a twin or with a line in real
        time.

    Examples
    --------
    >>> import dropstitch
    >>> bundle = dropstitch.ModelBundle.load("docs/notebooks/bundle_1dof")
    >>> options = SilOptions(bundle=bundle, out=Path("out"), line="virtual", seconds=4.0)
    >>> options.slots, options.payload_kg
    (235, 1.0)
    """

    bundle: ModelBundle
    out: Path
    fmu: Path | None = None
    rig: RigSource | None = None
    link: LinkDescription = DERIVED
    model: Model = DERIVED
    line: LineKind = "socket"
    seconds: float = DERIVED
    miss_rate: float = MISS_RATE
    baud: int = 1_000_000
    latency_s: float = 1e-3
    payload_kg: float = DERIVED
    payload_known: bool = False
    motion: MotionConfig = field(default_factory=MotionConfig)
    plan: TipPlan | None = None
    runs: int = 1
    open_loop: bool = False
    goals: OutsideGoals | None = None
    load: int = 0
    faults: Mapping[str, float] = field(default_factory=dict)
    seed: int = 0
    log: bool = True

    def __post_init__(self) -> None:
        self._check_choices()
        defaults: dict[str, Callable[[], Any]] = {
            "link": lambda: _link_behind(self.rig, self.bundle),
            "model": lambda: model_named(self.link.servo.model),
            "payload_kg": lambda: self.link.payload_kg / 2,
            "seconds": self._default_seconds,
        }
        for name, default in defaults.items():
            if getattr(self, name) is None:
                object.__setattr__(self, name, default())
        if not self.period_s <= self.seconds <= LONGEST_S:
            raise InputError(
                "--seconds", f"is {self.seconds:g}", f"give {self.period_s:g} to {LONGEST_S:g}"
            )

    def _check_choices(self) -> None:
        if self.runs < 1 or (self.runs > 1 and self.plan is None):
            raise InputError("--runs", f"is {self.runs}", "give 1 or more, with --plan")
        if not 1e-6 <= self.miss_rate <= 1.0:
            raise InputError("--miss-rate", f"is {self.miss_rate:g}", "give 1e-6 to 1")
        if self.load < 0:
            raise InputError("--load", f"is {self.load}", "give a number of processes, 0 for none")
        if self.rig and (self.fmu or self.line != "virtual"):
            raise InputError(
                "--rig", "replaces a twin and cannot run in real time", "use --line virtual alone"
            )

    def _default_seconds(self) -> float:
        if self.plan is None:
            needed = slots_needed(self.miss_rate) + 1 if self.line != "virtual" else 0
            return min(max(needed * self.period_s, SHORTEST_DEFAULT_S), LONGEST_S)
        if self.runs * self.plan.duration_s > LONGEST_S:
            most = int(LONGEST_S / self.plan.duration_s)
            raise InputError("--runs", f"is {self.runs}", f"give {most} at most")
        return self.runs * self.plan.duration_s

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

    @property
    def programme_s(self) -> dict[str, float]:
        """Durations of the parts that the run repeats: rest, motion, glide back to zero."""
        period_s = self.period_s
        if (plan := self.plan) is not None:
            rest = round(plan.rest_s / period_s)
            rows = {"rest": rest, "motion": plan.end_row - rest, "glide": plan.rows - plan.end_row}
            return {name: count * period_s for name, count in rows.items()}
        if self.goals is not None:
            return {"motion": self.seconds}
        motion = self.motion.motion(self.dof)
        parts_s = {"rest": self.motion.rest_s, "motion": motion.duration_s, "glide": GLIDE_S}
        # The loop runs whole slots.
        return {name: round(part_s / period_s) * period_s for name, part_s in parts_s.items()}

    def emulator(self, source: Path | RigSource) -> EmulatorSpecification:
        """Return the specification of the emulated servos with a plant behind them."""
        return EmulatorSpecification(
            source, self.model.number, self.ids, self.baud, latency_s=self.latency_s,
            payload_kg=self.payload_kg, faults=dict(self.faults), seed=self.seed,
        )  # fmt: skip


def _link_behind(rig: RigSource | None, bundle: ModelBundle) -> LinkDescription:
    """Link of the rig if its file describes one, else of the bundle's plant, else the study's."""
    if rig is not None:
        path = Path(rig.rig)
        if path.is_file() and describes_link(read_toml(path, "name a rig or a link")):
            return read_link(path)
    plant = bundle.directory / "plant.json"
    return link_of_plant(plant) if plant.is_file() else STUDY_LINK


def sil_config(options: SilOptions, port: str, cpu: int | None = None) -> RobotConfig:
    """Return the configuration with which the robot would run."""
    link, limits = options.link, Limits()  # the study's
    # The study's motion starts at full speed within one period, whatever the period is.
    shorter = max(PERIOD_S / options.period_s, 1.0)
    acceleration = shorter * limits.acceleration_rad_s2
    limits = msgspec.structs.replace(limits, acceleration_rad_s2=acceleration)
    return RobotConfig(
        bundle=str(options.bundle.directory),
        bus=BusConfig(port=port, baud=options.baud),
        servos=tuple(ServoConfig(id=i, model=options.model.name) for i in options.ids),
        period_s=options.period_s,
        payload_kg=options.payload_kg if options.payload_known else None,
        motion=options.motion,
        limits=limits if link == STUDY_LINK else limits_of_link(link, limits, stated=()),
        feedback=TrustOptions(use=not options.open_loop),
        real_time=RealTimeOptions(cpu=cpu),
    )
