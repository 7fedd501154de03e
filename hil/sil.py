"""The rig in software: the robot's own `ControlLoop`, an emulated line, a plant behind it.

The loop, its bus, estimator, predictor, supervisor and recorder are the robot's, unmodified; only
the port that they open belongs to an emulator. On the virtual line the clock is simulated as well.

::

    processor A   loop (FIFO 50) · probe (FIFO 80)
    processor B   emulator (FIFO 60) · recorder · probe (FIFO 80) · declared load
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_py.bundle import MANIFEST, ModelBundle, sha256_of
from firmware_py.bus import DynamixelBus
from firmware_py.clock import Clock, DeadlineClock, RealTimeOptions, SimClock, real_time
from firmware_py.config import BusConfig, MotionConfig, RobotConfig, ServoConfig
from firmware_py.errors import InputError
from firmware_py.loop import ControlLoop, RunSummary
from firmware_py.port import Wire, open_wire
from firmware_py.recorder import recording
from firmware_py.registers import Model
from firmware_py.safety import SafetySupervisor
from firmware_py.telemetry import NoTelemetry, Telemetry
from firmware_py.timing import KernelCounters, NoCounters
from hil.emulator import Emulator, Outcome, Specification, assemble
from hil.host import Probe, Releases, Watch, cpu_load, environment, processors
from hil.line import VirtualWire
from hil.physics import build_twin

LineKind = Literal["pty", "socket", "virtual"]
LOG_NAME: Final = "ticks.mcap"
_STOP_TICKS: Final = 200
"""Room for the ticks of the controlled stop."""


@dataclass(frozen=True)
class Options:
    """What to run.

    Attributes
    ----------
    bundle : ModelBundle
        What the robot runs.
    model : Model
        Servo to emulate.
    out : Path
        Directory of the log.
    unit : Path, optional
        Twin to put behind the servos; by default it is built from the bundle's plant.
    line : {"pty", "socket", "virtual"}
        See `hil.line`.
    seconds : float
        Duration of the motion, which repeats.
    baud : int
        Bits per second.
    latency_s : float
        Latency timer of the USB adapter.
    payload_kg : float
        At the twin's tip.
    motion : MotionConfig
        What to drive.
    load : int
        Processes that load processor B.
    faults : dict of str to float
        Rates of the wire's faults.
    seed : int
        Of the faults.
    """

    bundle: ModelBundle
    model: Model
    out: Path
    unit: Path | None = None
    line: LineKind = "socket"
    seconds: float = 10.0
    baud: int = 1_000_000
    latency_s: float = 1e-3
    payload_kg: float = 1.0
    motion: MotionConfig = field(default_factory=MotionConfig)
    load: int = 0
    faults: dict[str, float] = field(default_factory=dict)
    seed: int = 0

    @property
    def dof(self) -> int:
        """Number of joints."""
        return self.bundle.manifest.dof

    @property
    def period_s(self) -> float:
        """Control period."""
        return self.bundle.manifest.period_s


class Result(NamedTuple):
    """A run and everything that was seen beside it.

    Attributes
    ----------
    summary : RunSummary
        The loop's own account.
    outcome : Outcome
        The emulator's.
    loop_cpu, line_cpu : Watch
        The probes'.
    wall_s : float
        Time that the run took.
    environment : dict
        Machine, scheduler, load, line.
    """

    summary: RunSummary
    outcome: Outcome
    loop_cpu: Watch
    line_cpu: Watch
    wall_s: float
    environment: dict[str, Any]

    @property
    def records(self) -> NDArray[np.void]:
        """Every tick, in order."""
        return self.summary.records


def robot_config(options: Options, port: str, cpu: int | None) -> RobotConfig:
    """The configuration that the robot would have."""
    return RobotConfig(
        bundle=str(options.bundle.directory),
        bus=BusConfig(port=port, baud=options.baud),
        servos=tuple(ServoConfig(id=j, model=options.model.name) for j in _ids(options.dof)),
        period_s=options.period_s,
        payload_kg=options.payload_kg,
        motion=options.motion,
        real_time=RealTimeOptions(cpu=cpu),
    )


def _ids(dof: int) -> tuple[int, ...]:
    return tuple(range(1, dof + 1))


def run(options: Options) -> Result:
    """Run the loop against the emulated servos.

    Raises
    ------
    InputError
        If bundle, unit or options cannot be used.
    """
    if options.seconds <= 0:
        raise InputError("--seconds", f"is {options.seconds:g}", "give a positive duration")
    options.out.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(prefix="dropstitch-sil-") as scratch:
        unit = options.unit or build_twin(
            _plant(options.bundle.directory), options.dof, Path(scratch)
        )
        specification = Specification(
            unit, options.model.number, _ids(options.dof), options.baud,
            latency_s=options.latency_s, payload_kg=options.payload_kg,
            faults=options.faults, seed=options.seed,
        )  # fmt: skip
        if options.line == "virtual":
            return _run_virtual(options, specification)
        return _run_in_real_time(options, specification, Path(scratch))


def _plant(bundle: Path) -> Path:
    path = bundle / "plant.json"
    if not path.is_file():
        raise InputError(path, "is missing", "copy the whole bundle, or name a twin with --fmu")
    return path


def _run_virtual(options: Options, specification: Specification) -> Result:
    clock = SimClock()
    line, log = assemble(specification)
    config = robot_config(options, "virtual", None)
    loop = _loop(options, config, VirtualWire(line, clock), clock, NoTelemetry())
    start_s = time.perf_counter()
    summary = loop.run()
    wall_s = time.perf_counter() - start_s
    outcome = Outcome(log.truth(), Releases(), dict(line.faults.injected))
    digest = hashlib.sha256(summary.records.tobytes() + outcome.truth.tip_m.tobytes()).hexdigest()
    facts = (
        environment()
        | _line_facts(options)
        | {
            "scheduler": "simulated time",
            "speed_up": clock.now_ns() * 1e-9 / wall_s,
            "records_sha256": digest,
        }
    )
    return Result(summary, outcome, Watch(), Watch(), wall_s, facts)


def _run_in_real_time(options: Options, specification: Specification, scratch: Path) -> Result:
    assert options.line != "virtual"
    loop_cpu, other_cpus = processors()
    line_cpu = max(other_cpus)
    clock = DeadlineClock()
    with _kept_to(other_cpus), contextlib.ExitStack() as stack:
        emulator = Emulator(specification, options.line, scratch, line_cpu)
        config = robot_config(options, emulator.name, loop_cpu)
        telemetry = stack.enter_context(
            recording(options.out / LOG_NAME, options.dof, time.time_ns(), _metadata(options))
        )
        stack.enter_context(cpu_load(options.load, other_cpus))
        # On a single processor the emulator is a neighbour of the loop, else nobody is.
        shared = (emulator.pid,) if line_cpu == loop_cpu else ()
        probes = Probe(loop_cpu, shared), Probe(line_cpu)
        with real_time(config.real_time) as refused:
            wire = open_wire(emulator.name, options.baud, clock)
            loop = _loop(options, config, wire, clock, telemetry, KernelCounters())
            start_s = time.perf_counter()
            summary = loop.run()
            wall_s = time.perf_counter() - start_s
            scheduler = _scheduler()
        seen, seen_line = (probe.stop() for probe in probes)
        facts = (
            environment()
            | _line_facts(options)
            | {
                "scheduler": scheduler,
                "refused": refused,
                "loop_processor": loop_cpu,
                "line_processor": line_cpu,
                "load_processes": options.load,
                "load_is": "declared host load, normal priority, on the emulator's processor",
            }
        )
        outcome = emulator.stop()
    return Result(summary, outcome, seen, seen_line, wall_s, facts)


def _loop(
    options: Options,
    config: RobotConfig,
    wire: Wire,
    clock: Clock,
    telemetry: Telemetry,
    counters: KernelCounters | None = None,
) -> ControlLoop:
    goals_rad = config.goals_rad(repeated=True)
    slots = round(options.seconds / options.period_s)
    bus = DynamixelBus(
        wire, config.setups(), clock,
        period_s=options.period_s, name=config.bus.port, baud=config.bus.baud,
    )  # fmt: skip
    return ControlLoop(
        bus, options.bundle.estimator, options.bundle.predictor,
        SafetySupervisor(config.limits, options.dof, options.period_s),
        goals_rad, clock,
        slots=slots, period_s=options.period_s, reply_timeout_s=config.bus.reply_timeout_s,
        telemetry=telemetry, counters=counters or NoCounters(), keep=slots + _STOP_TICKS,
    )  # fmt: skip


@contextlib.contextmanager
def _kept_to(cpus: set[int]) -> Iterator[None]:
    """Keep this process, and all that it starts, to some processors."""
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, cpus)
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


def _scheduler() -> str:
    policies = {os.SCHED_OTHER: "SCHED_OTHER", os.SCHED_FIFO: "SCHED_FIFO"}
    policy = os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK
    return f"{policies.get(policy, policy)} {os.sched_getparam(0).sched_priority}"


def _line_facts(options: Options) -> dict[str, Any]:
    return {
        "line": options.line,
        "baud": options.baud,
        "latency_timer_ns": round(options.latency_s * 1e9),
        "servo": options.model.name,
        "faults": options.faults,
        "payload_kg": options.payload_kg,
    }


def _metadata(options: Options) -> dict[str, str]:
    return {
        "source": "sil",
        "bundle_sha256": sha256_of(options.bundle.directory / MANIFEST),
        "payload_kg": str(options.payload_kg),
        "motion": options.motion.kind,
    }
