"""Run in real time: the loop in this process; emulator, recorder and probes in their own.

::

    processor A   loop (FIFO 50) · probe (FIFO 80)
    processor B   emulator (FIFO 60) · recorder · probe (FIFO 80) · declared load
"""

from __future__ import annotations

import contextlib
import time
from pathlib import Path
from typing import Literal

from firmware_py.inference.range_check import RangeWatch
from firmware_py.robot import open_bus
from firmware_py.system.clock import DeadlineClock, real_time
from firmware_py.system.kernel_counters import KernelCounters
from hil.emulator.emulator import Emulator, EmulatorSpecification
from hil.sil.probe import Probe
from hil.sil.processors import assign_processors, cpu_load, pinned_to, scheduling_policy
from hil.sil.sil_loop import SilResult, build_sil_loop, sil_environment, sil_recording
from hil.sil.sil_options import SilOptions, sil_config

_LOAD = "declared host load, normal priority, on the emulator's processor"


def run_in_real_time(
    options: SilOptions,
    kind: Literal["pty", "socket"],
    specification: EmulatorSpecification,
    scratch: Path,
) -> SilResult:
    """Run the loop in this process against an emulator in another process."""
    loop_cpu, other_cpus = assign_processors()
    line_cpu = max(other_cpus)
    clock = DeadlineClock()
    with pinned_to(other_cpus), contextlib.ExitStack() as stack:
        enter = stack.enter_context
        emulator = enter(contextlib.closing(Emulator(specification, kind, scratch, line_cpu)))
        config = sil_config(options, emulator.name, loop_cpu)
        telemetry = enter(sil_recording(options, config))
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
            loop = build_sil_loop(options, watch, config, bus, clock, telemetry, counters)
            start_s = time.perf_counter()
            summary = loop.run()
            wall_s = time.perf_counter() - start_s
            policy = scheduling_policy()
        probes = loop_probe.stop(), line_probe.stop()
        environment = sil_environment(
            options,
            policy,
            refused=tuple(refused),
            loop_processor=loop_cpu,
            line_processor=line_cpu,
            load_processes=options.load,
            load_is=_LOAD,
        )
        return SilResult(
            summary,
            emulator.stop(),
            *probes,
            wall_s,
            environment,
            bus.plan,
            watch.reasons(),
        )
