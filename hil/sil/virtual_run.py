"""Run on the virtual line: time is simulated, and equal options give equal ticks."""

from __future__ import annotations

import hashlib
import time

from firmware_py.inference.range_check import RangeWatch
from firmware_py.log.telemetry import SocketTelemetry, Telemetry
from firmware_py.robot import build_bus
from firmware_py.system.clock import SimClock
from firmware_py.system.kernel_counters import Counters
from hil.emulator.emulator import EmulatorOutcome, EmulatorSpecification, Releases, build_line
from hil.emulator.line import VirtualTransport
from hil.sil.cpu_accounts import ProbeRecord
from hil.sil.sil_loop import SilResult, build_sil_loop, sil_environment, sil_recording
from hil.sil.sil_options import SilOptions, sil_config


def run_on_virtual_line(options: SilOptions, specification: EmulatorSpecification) -> SilResult:
    """Run the loop and the emulated servos on one simulated clock."""
    clock = SimClock()
    line, truth = build_line(specification)
    config = sil_config(options, "virtual")
    bus = build_bus(config, VirtualTransport(line, clock), clock)
    watch = RangeWatch(options.bundle)
    loop = build_sil_loop(options, watch, config, bus, clock, Telemetry(), Counters())
    start_s, start_busy_s = time.perf_counter(), time.process_time()
    summary = loop.run()
    wall_s, busy_s = time.perf_counter() - start_s, time.process_time() - start_busy_s
    if options.log:
        # The recorder works in real time, so it gets the ticks after the simulated run.
        with sil_recording(options, config) as telemetry:
            for record in summary.records:
                _put(telemetry, record.tobytes())
    outcome = EmulatorOutcome(truth.truth(), Releases(), dict(line.faults.injected))
    digest = hashlib.sha256(summary.records.tobytes() + outcome.truth.tip_m.tobytes())
    environment = sil_environment(
        options,
        "none: simulated time",
        speed_up=clock.now_ns() * 1e-9 / wall_s,
        speed_up_by_processor_time=clock.now_ns() * 1e-9 / busy_s,
        records_sha256=digest.hexdigest(),
    )
    return SilResult(
        summary, outcome, ProbeRecord(), ProbeRecord(), wall_s, environment, bus.plan,
        out_of_range=watch.reasons(),
    )  # fmt: skip


def _put(telemetry: SocketTelemetry, record: bytes) -> None:
    """Send a record, and retry until the recorder accepts it."""
    drops = telemetry.drops
    telemetry.put(memoryview(record))
    while telemetry.drops > drops:
        time.sleep(1e-3)
        drops = telemetry.drops
        telemetry.put(memoryview(record))
