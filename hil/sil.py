"""The rig in software: the robot's own `ControlLoop`, an emulated line, a plant behind it.

The loop, its bus, estimator, predictor, supervisor and recorder are the robot's, unmodified; only
the port that they open belongs to an emulator. On the virtual line the clock is simulated as well.

::

    processor A   loop (FIFO 50) · probe, cyclictest (FIFO 80)
    processor B   emulator (FIFO 60) · recorder · probe (FIFO 80) · declared load
"""

from __future__ import annotations

import contextlib
import hashlib
import math
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_py.bus.bus_plan import Plan
from firmware_py.bus.servo_bus import ServoBus
from firmware_py.bus.servo_models import Model
from firmware_py.config import BusConfig, MotionConfig, RobotConfig, ServoConfig, check_config
from firmware_py.errors import InputError
from firmware_py.inference.bundle import ModelBundle
from firmware_py.inference.fmu_instance import FmuInstance
from firmware_py.log.recorder import recording
from firmware_py.log.telemetry import NoTelemetry, SocketTelemetry, Telemetry
from firmware_py.loop import ControlLoop
from firmware_py.realtime.clock import Clock, DeadlineClock, RealTimeOptions, SimClock, real_time
from firmware_py.realtime.timing import Counters, KernelCounters, NoCounters
from firmware_py.robot import build_bus, build_loop, log_metadata, open_bus
from firmware_py.summary import RunSummary
from hil.emulator.emulator import Emulator, EmulatorOutcome, Specification, build_line
from hil.emulator.line import VirtualTransport
from hil.emulator.physics import RigSource
from hil.emulator.twin_fmu import build_twin
from hil.timing.cpu_accounts import (
    ProbeRecord,
    Releases,
    assign_processors,
    cpu_load,
    host_environment,
    pinned_to,
    scheduling_policy,
)
from hil.timing.cyclictest import cyclictest
from hil.timing.probe import Probe

LineKind = Literal["pty", "socket", "virtual"]
LOG_NAME: Final = "ticks.mcap"
_STOP_TICKS: Final = 200
"""Room for the ticks of the controlled stop."""
_GEOMETRY: Final = ("base_offset_m", "link_length_m", "link_width_m")


@dataclass(frozen=True)
class SilOptions:
    """What to run.

    Attributes
    ----------
    bundle : ModelBundle
        What the robot runs.
    model : Model
        Servo to emulate.
    out : Path
        Directory of the log.
    fmu : Path, optional
        Twin to put behind the servos; by default it is built from the bundle's plant.
    rig : RigSource, optional
        Laboratory to put there instead of a twin, on the virtual line.
    line : {"pty", "socket", "virtual"}
        See `hil.emulator.line`.
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
    fmu: Path | None = None
    rig: RigSource | None = None
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


class SilResult(NamedTuple):
    """A run and everything that was seen beside it.

    Attributes
    ----------
    summary : RunSummary
        The loop's own account.
    outcome : EmulatorOutcome
        The emulator's.
    loop_cpu, line_cpu : ProbeRecord
        The probes'.
    wall_s : float
        Time that the run took.
    environment : dict
        Machine, scheduler, load, line.
    plan : Plan
        How the servos were read.
    reference : dict or None
        Wake-up jitter by cyclictest, where it is installed.
    geometry : dict of str to float
        The link's base_offset_m, link_length_m and link_width_m, as far as the plant has them.
    """

    summary: RunSummary
    outcome: EmulatorOutcome
    loop_cpu: ProbeRecord
    line_cpu: ProbeRecord
    wall_s: float
    environment: dict[str, Any]
    plan: Plan
    reference: dict[str, Any] | None = None
    geometry: dict[str, float] | None = None

    @property
    def records(self) -> NDArray[np.void]:
        """Every tick, in order."""
        return self.summary.records


def run_sil(options: SilOptions) -> SilResult:
    """Run the loop against the emulated servos.

    Raises
    ------
    InputError
        If bundle, FMU or options cannot be used.
    """
    if not 0 < options.seconds < math.inf:
        raise InputError("--seconds", f"is {options.seconds:g}", "give a positive duration")
    if options.load < 0:
        raise InputError("--load", f"is {options.load}", "give a number of processes, 0 for none")
    if options.rig and (options.fmu or options.line != "virtual"):
        raise InputError(
            "--rig", "stands in a twin's place and keeps no real time", "take --line virtual alone"
        )
    with TemporaryDirectory(prefix="dropstitch-sil-") as scratch:
        source = options.rig or options.fmu
        if source is None:
            source = build_twin(_plant(options), options.dof, Path(scratch))
        specification = Specification(
            source, options.model.number, _ids(options), options.baud,
            latency_s=options.latency_s, payload_kg=options.payload_kg,
            faults=options.faults, seed=options.seed,
        )  # fmt: skip
        check_config(sil_config(options, options.line), "--baud")
        _make(options.out)
        if options.line == "virtual":
            result = _run_virtual(options, specification)
        else:
            result = _run_in_real_time(options, options.line, specification, Path(scratch))
        return result._replace(geometry=_geometry(source))


def _make(directory: Path) -> None:
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            directory, f"cannot be made a directory ({error.strerror})", "name another --out"
        ) from None


def _ids(options: SilOptions) -> tuple[int, ...]:
    return tuple(range(1, options.dof + 1))


def _plant(options: SilOptions) -> Path:
    path = options.bundle.directory / "plant.json"
    if not path.is_file():
        raise InputError(path, "is missing", "copy the whole bundle, or name a twin with --fmu")
    return path


def _geometry(source: Path | RigSource) -> dict[str, float]:
    if isinstance(source, RigSource):
        from hil.emulator.rig_physics import rig_geometry  # loads MuJoCo

        return rig_geometry()
    with FmuInstance(source) as opened:
        known = [name for name in _GEOMETRY if f"parameters.{name}" in opened.variables]
        return dict(
            zip(known, opened.get([f"parameters.{n}" for n in known]).tolist(), strict=True)
        )


def sil_config(options: SilOptions, port: str, cpu: int | None = None) -> RobotConfig:
    """The configuration that the robot would have."""
    return RobotConfig(
        bundle=str(options.bundle.directory),
        bus=BusConfig(port=port, baud=options.baud),
        servos=tuple(ServoConfig(id=i, model=options.model.name) for i in _ids(options)),
        period_s=options.period_s,
        motion=options.motion,
        real_time=RealTimeOptions(cpu=cpu),
    )


def _run_virtual(options: SilOptions, specification: Specification) -> SilResult:
    clock = SimClock()
    line, truth = build_line(specification)
    config = sil_config(options, "virtual")
    bus = build_bus(config, VirtualTransport(line, clock), clock)
    loop = _loop(options, config, bus, clock, NoTelemetry(), NoCounters())
    start_s, start_busy_s = time.perf_counter(), time.process_time()
    summary = loop.run()
    wall_s, busy_s = time.perf_counter() - start_s, time.process_time() - start_busy_s
    with _recording(options, config) as telemetry:  # afterwards: the recorder runs in real time
        for record in summary.records:
            _put(telemetry, record.tobytes())
    outcome = EmulatorOutcome(truth.truth(), Releases(), dict(line.faults.injected))
    digest = hashlib.sha256(summary.records.tobytes() + outcome.truth.tip_m.tobytes())
    facts = {
        "scheduler": "none: simulated time",
        "speed_up": clock.now_ns() * 1e-9 / wall_s,
        "speed_up_by_processor_time": clock.now_ns() * 1e-9 / busy_s,
        "records_sha256": digest.hexdigest(),
    }
    return SilResult(
        summary, outcome, ProbeRecord(), ProbeRecord(), wall_s,
        host_environment() | _line_facts(options) | facts, bus.plan,
    )  # fmt: skip


def _put(telemetry: SocketTelemetry, record: bytes) -> None:
    """Hand a record over, again and again until the recorder has room for it."""
    drops = telemetry.drops
    telemetry.put(memoryview(record))
    while telemetry.drops > drops:
        time.sleep(1e-3)
        drops = telemetry.drops
        telemetry.put(memoryview(record))


def _run_in_real_time(
    options: SilOptions,
    kind: Literal["pty", "socket"],
    specification: Specification,
    scratch: Path,
) -> SilResult:
    loop_cpu, other_cpus = assign_processors()
    line_cpu = max(other_cpus)
    clock = DeadlineClock()
    with pinned_to(other_cpus), contextlib.ExitStack() as stack:
        enter = stack.enter_context
        emulator = enter(contextlib.closing(Emulator(specification, kind, scratch, line_cpu)))
        config = sil_config(options, emulator.name, loop_cpu)
        telemetry = enter(_recording(options, config))
        enter(cpu_load(options.load, other_cpus))
        # On a single processor the emulator is a neighbour of the loop, else nobody is.
        neighbours = (emulator.pid,) if line_cpu == loop_cpu else ()
        loop_probe = enter(contextlib.closing(Probe(loop_cpu, neighbours)))
        line_probe = enter(contextlib.closing(Probe(line_cpu)))
        reference = enter(cyclictest(loop_cpu, options.period_s, scratch))
        with (
            open_bus(config, clock) as bus,
            contextlib.closing(KernelCounters()) as counters,
            real_time(config.real_time) as refused,
        ):
            loop = _loop(options, config, bus, clock, telemetry, counters)
            start_s = time.perf_counter()
            summary = loop.run()
            wall_s = time.perf_counter() - start_s
            policy = scheduling_policy()
        watches = loop_probe.stop(), line_probe.stop()
        facts = {
            "scheduler": policy,
            "refused": refused,
            "loop_processor": loop_cpu,
            "line_processor": line_cpu,
            "load_processes": options.load,
            "load_is": "declared host load, normal priority, on the emulator's processor",
        }
        facts = host_environment() | _line_facts(options) | facts
        return SilResult(
            summary, emulator.stop(), *watches, wall_s, facts, bus.plan, reference.stop()
        )


def _loop(
    options: SilOptions,
    config: RobotConfig,
    bus: ServoBus,
    clock: Clock,
    telemetry: Telemetry,
    counters: Counters,
) -> ControlLoop:
    slots = round(options.seconds / config.period_s)
    return build_loop(
        config, options.bundle, bus, clock, slots=slots, telemetry=telemetry, counters=counters,
        keep=slots + _STOP_TICKS,
    )  # fmt: skip


@contextlib.contextmanager
def _recording(options: SilOptions, config: RobotConfig) -> Iterator[SocketTelemetry]:
    # The observer is not told the payload, but whoever imports the log may know it.
    metadata = log_metadata(config, options.bundle, datetime.now(UTC)) | {
        "payload_kg": repr(options.payload_kg)
    }
    path = options.out / LOG_NAME
    with recording(path, options.dof, time.time_ns(), metadata) as telemetry:
        yield telemetry


def _line_facts(options: SilOptions) -> dict[str, Any]:
    return {
        "line": options.line,
        "baud": options.baud,
        "latency_timer_ns": round(options.latency_s * 1e9),
        "servo": options.model.name,
        "faults": options.faults,
        "payload_kg": options.payload_kg,
        "behind_the_servos": "rig" if options.rig else "twin",
        "hidden": dict(options.rig.hidden) if options.rig else {},
    }
