"""Run in software: the robot's own `ControlLoop` against emulated servos and a simulated plant.

Loop, bus, estimator, predictor, supervisor and recorder are those of the robot, unmodified. Only
the port that they open belongs to the emulator. On the virtual line the clock is simulated as well,
and equal options give equal ticks. In real time the loop runs in this process, the others run in
their own::

    processor A   loop (FIFO 50) · probe (FIFO 80)
    processor B   emulator (FIFO 60) · recorder · probe (FIFO 80) · declared load
"""

from __future__ import annotations

import contextlib
import hashlib
import time
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final, Literal

import msgspec

from firmware_py.config import RobotConfig, check_config
from firmware_py.core.errors import InputError
from firmware_py.core.output_files import locked_directory, make_directory
from firmware_py.goals.for_robot import (
    RunGoals,
    goals_of_motion,
    goals_of_plan,
    goals_of_program,
)
from firmware_py.inference.bundle import ModelBundle
from firmware_py.inference.fmu_instance import FmuInstance
from firmware_py.inference.range_check import RangeWatch
from firmware_py.link.link_description import STUDY_LINK
from firmware_py.log.recorder import recording
from firmware_py.log.recording import SLOTS_KEY
from firmware_py.log.telemetry import SocketTelemetry
from firmware_py.robot import build_bus, build_loop, log_metadata, open_bus
from firmware_py.system.clock import DeadlineClock, SimClock, real_time
from firmware_py.system.kernel_counters import KernelCounters
from hil.emulator.emulator import (
    Emulator,
    EmulatorOutcome,
    EmulatorSpecification,
    Releases,
    build_line,
)
from hil.emulator.line import VirtualTransport
from hil.emulator.physics import RigSource, build_twin
from hil.sil.probe import Probe, ProbeRecord
from hil.sil.processors import (
    assign_processors,
    cpu_load,
    host_environment,
    pinned_to,
    scheduling_policy,
)
from hil.sil.sil_options import SilOptions, sil_config
from hil.sil.sil_results import SilResult
from hil.sil.timing_document import SilEnvironment
from models.plant.document import read_plant_document

LOG_NAME: Final = "ticks.mcap"
_STOP_TICKS: Final = 200
"""Ticks reserved in the record for the controlled stop."""
_LOAD: Final = "declared host load, normal priority, on the emulator's processor"
_SIZES: Final = ("base_offset_m", "link_length_m", "link_width_m")


def run_sil(
    bundle: ModelBundle | Path | str | SilOptions, out: Path | str | None = None, **options: Any
) -> SilResult:
    """Run the robot's loop in software against emulated servos.

    Parameters
    ----------
    bundle : ModelBundle, Path, str or SilOptions
        Bundle of the robot, or its directory; or all options in one object.
    out : Path or str, optional
        Directory for the log and for `SilResult.write`; by default no file is written.
    **options
        Further fields of `SilOptions`, such as `line`, `seconds`, `rig` or `payload_kg`.

    Returns
    -------
    SilResult
        The loop's summary and everything measured during the run.

    Raises
    ------
    InputError
        If the bundle, the FMU or the options cannot be used.

    Examples
    --------
    The twin of the bundle's plant stands behind the servos. On the virtual line the clock is
    simulated as well.

    >>> import dropstitch
    >>> bundle = "docs/notebooks/bundle_1dof"
    >>> run = dropstitch.run_sil(bundle, line="virtual", seconds=2.0)
    >>> str(run.timing.verdict), len(run.records) >= 117
    ('pass', True)
    """
    with TemporaryDirectory(prefix="dropstitch-sil-") as scratch:
        if isinstance(bundle, SilOptions):
            chosen = bundle
        else:
            if not isinstance(bundle, ModelBundle):
                bundle = ModelBundle.load(bundle)
            place = Path(scratch) / "out" if out is None else Path(out)
            log = options.pop("log", out is not None or options.get("line") != "virtual")
            chosen = SilOptions(bundle=bundle, out=place, log=log, **options)
        return _run(chosen, Path(scratch))


def _run(options: SilOptions, scratch: Path) -> SilResult:
    source = options.rig or options.fmu
    if source is None:
        plant = options.bundle.directory / "plant.json"
        if not plant.is_file():
            raise InputError(
                plant, "is missing", "copy the whole bundle, or name a twin with --fmu"
            )
        source = build_twin(plant, options.dof, scratch)
    specification = options.emulator(source)
    check_config(sil_config(options, options.line), "--baud")
    make_directory(options.out, "name another --out")
    with locked_directory(options.out):
        if options.line == "virtual":
            result = _run_on_virtual_line(options, specification)
        else:
            result = _run_in_real_time(options, options.line, specification, scratch)
    return replace(result, link=_link_conditions(source, options))


def _run_on_virtual_line(options: SilOptions, specification: EmulatorSpecification) -> SilResult:
    """Run the loop and the emulated servos on one simulated clock."""
    clock = SimClock()
    line, truth_log = build_line(specification)
    config = sil_config(options, "virtual")
    bus = build_bus(config, VirtualTransport(line, clock), clock)
    goals, watch = _goals(options, config), RangeWatch(options.bundle)
    loop = build_loop(
        config, watch, bus, clock, goals=goals.source, correction=goals.correction,
        slots=options.slots, keep=_ticks(options, goals),
    )  # fmt: skip
    start_s, start_busy_s = time.perf_counter(), time.process_time()
    summary = loop.run()
    wall_s, busy_s = time.perf_counter() - start_s, time.process_time() - start_busy_s
    if options.log:
        # The recorder works in real time, so it gets the ticks after the simulated run.
        with _recording(options, config, goals) as telemetry:
            for record in summary.records:
                _put(telemetry, record.tobytes())
    truth = truth_log.truth()
    digest = hashlib.sha256(summary.records.tobytes() + truth.tip_m.tobytes())
    environment = _environment(
        options,
        "none: simulated time",
        speed_up=clock.now_ns() * 1e-9 / wall_s,
        speed_up_by_processor_time=clock.now_ns() * 1e-9 / busy_s,
        records_sha256=digest.hexdigest(),
    )
    return SilResult(
        options,
        summary,
        EmulatorOutcome(truth, Releases(), dict(line.faults.injected)),
        ProbeRecord(),
        ProbeRecord(),
        wall_s,
        environment,
        bus.plan,
        watch.reasons(),
    )


def _put(telemetry: SocketTelemetry, record: bytes) -> None:
    """Send a record, and retry until the recorder accepts it."""
    while True:
        drops = telemetry.drops
        telemetry.put(memoryview(record))
        if telemetry.drops == drops:
            return
        time.sleep(1e-3)


def _run_in_real_time(
    options: SilOptions,
    line: Literal["pty", "socket"],
    specification: EmulatorSpecification,
    scratch: Path,
) -> SilResult:
    """Run the loop in this process against an emulator in another process."""
    loop_cpu, other_cpus = assign_processors()
    line_cpu = max(other_cpus)
    clock = DeadlineClock()
    with pinned_to(other_cpus), contextlib.ExitStack() as stack:
        enter = stack.enter_context
        emulator = enter(contextlib.closing(Emulator(specification, line, scratch, line_cpu)))
        config = sil_config(options, emulator.name, loop_cpu)
        goals = _goals(options, config)
        telemetry = enter(_recording(options, config, goals))
        enter(cpu_load(options.load, other_cpus))
        # Only on a machine with a single processor does the emulator share it with the loop.
        neighbours = (emulator.pid,) if line_cpu == loop_cpu else ()
        loop_probe = enter(contextlib.closing(Probe(loop_cpu, neighbours)))
        line_probe = enter(contextlib.closing(Probe(line_cpu)))
        with (
            open_bus(config, clock) as bus,
            contextlib.closing(KernelCounters()) as counters,
            real_time(config.real_time) as refused,
        ):
            watch = RangeWatch(options.bundle)
            loop = build_loop(
                config, watch, bus, clock, goals=goals.source, correction=goals.correction,
                slots=options.slots, telemetry=telemetry, counters=counters,
                keep=_ticks(options, goals),
            )  # fmt: skip
            start_s = time.perf_counter()
            summary = loop.run()
            wall_s = time.perf_counter() - start_s
            policy = scheduling_policy()
        probes = loop_probe.stop(), line_probe.stop()
        environment = _environment(
            options,
            policy,
            refused=tuple(refused),
            loop_processor=loop_cpu,
            line_processor=line_cpu,
            load_processes=options.load,
            load_is=_LOAD,
        )
        return SilResult(
            options, summary, emulator.stop(), *probes, wall_s, environment, bus.plan,
            watch.reasons(),
        )  # fmt: skip


def _goals(options: SilOptions, config: RobotConfig) -> RunGoals:
    """Return the goals of the run; the robot assumes its payload first."""
    options.bundle.assume_payload(config.payload_kg)
    if options.goals is not None:
        return goals_of_program(options.goals)
    if options.plan is not None:
        return goals_of_plan(options.plan, config, options.bundle)
    return goals_of_motion(config, repeated=True)


def _ticks(options: SilOptions, goals: RunGoals) -> int:
    """Return the largest number of ticks of the run, all of which stay in memory."""
    return goals.source.lead + options.slots + _STOP_TICKS


@contextlib.contextmanager
def _recording(
    options: SilOptions, config: RobotConfig, goals: RunGoals
) -> Iterator[SocketTelemetry]:
    """Run the robot's recorder during the block."""
    # The payload is recorded for the import of the log, even if the observer has to estimate it.
    metadata = (
        log_metadata(config, options.bundle, datetime.now(UTC))
        | {
            "payload_kg": repr(options.payload_kg),
            "source": "sil",
            SLOTS_KEY: str(options.slots),
        }
        | goals.metadata
    )
    path = options.out / LOG_NAME
    path.unlink(missing_ok=True)  # the log of an earlier run
    with recording(path, options.dof, time.time_ns(), metadata) as telemetry:
        yield telemetry


def _environment(options: SilOptions, scheduler: str, **more: Any) -> SilEnvironment:
    """Describe the machine and the line of a run."""
    return SilEnvironment(
        **msgspec.structs.asdict(host_environment()),
        line=options.line,
        baud=options.baud,
        latency_timer_ns=round(options.latency_s * 1e9),
        servo=options.model.name,
        faults=dict(options.faults),
        payload_kg=options.payload_kg,
        behind_the_servos="rig" if options.rig else "twin",
        hidden=dict(options.rig.hidden) if options.rig else {},
        scheduler=scheduler,
        goals_note=options.goals_note,
        **more,
    )


def _link_conditions(source: Path | RigSource, options: SilOptions) -> dict[str, Any]:
    """Trial conditions that follow from the simulated link; empty if the plant describes none."""
    if isinstance(source, RigSource):
        from hil.emulator.rig_physics import rig_conditions  # loads MuJoCo

        return rig_conditions(source)
    with FmuInstance(source) as twin:
        known = [name for name in _SIZES if f"parameters.{name}" in twin.variables]
        values = twin.get([f"parameters.{name}" for name in known]).tolist()
    if len(known) < len(_SIZES):
        return {}
    plant = options.bundle.directory / "plant.json"
    described = read_plant_document(plant).link if plant.is_file() else None
    return (described or STUDY_LINK).conditions() | dict(zip(known, values, strict=True))
