"""Parts that runs on every kind of line share: the robot's loop, its recorder, the result."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from datetime import UTC, datetime
from typing import Any, Final, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from firmware_py.bus.bus_plan import Plan
from firmware_py.bus.servo_bus import ServoBus
from firmware_py.config import RobotConfig
from firmware_py.goals.for_robot import (
    GOALS_NOTE,
    feedback_of_plan,
    goals_of_plan,
    log_facts,
    outside_facts,
)
from firmware_py.goals.goal_source import GoalSource
from firmware_py.inference.range_check import RangeWatch
from firmware_py.log.recorder import recording
from firmware_py.log.recording import SLOTS_KEY
from firmware_py.log.telemetry import SocketTelemetry, Telemetry
from firmware_py.loop import ControlLoop
from firmware_py.robot import build_loop, log_metadata
from firmware_py.summary import RangeReasons, RunSummary
from firmware_py.system.clock import Clock
from firmware_py.system.kernel_counters import Counters
from hil.emulator.emulator import EmulatorOutcome
from hil.sil.cpu_accounts import ProbeRecord
from hil.sil.processors import host_environment
from hil.sil.sil_options import SilOptions
from hil.sil.timing_document import SilEnvironment

LOG_NAME: Final = "ticks.mcap"
_STOP_TICKS: Final = 200
"""Ticks reserved in the record for the controlled stop."""


class SilResult(NamedTuple):
    """Result of a run in software: the loop's summary and everything measured during the run.

    Attributes
    ----------
    summary : RunSummary
        The loop's own summary.
    outcome : EmulatorOutcome
        The emulator's record: true tip, release times, injected faults.
    loop_cpu, line_cpu : ProbeRecord
        Wake-up jitter probes on the processors of loop and emulator; empty on the virtual line.
    wall_s : float
        Wall-clock time of the run.
    environment : SilEnvironment
        Machine, scheduler, load and line.
    plan : Plan
        Bus plan by which the servos were read.
    out_of_range : RangeReasons
        Why ticks were out of the predictor's range.
    link : dict of str to Any, optional
        Trial conditions given by the link: size, pressure, markers, gravity; empty if the plant
        does not describe a link.
    """

    summary: RunSummary
    outcome: EmulatorOutcome
    loop_cpu: ProbeRecord
    line_cpu: ProbeRecord
    wall_s: float
    environment: SilEnvironment
    plan: Plan
    out_of_range: RangeReasons = RangeReasons()
    link: dict[str, Any] | None = None

    @property
    def records(self) -> NDArray[np.void]:
        """Every tick of the run, in order, with the fields of `tick_dtype`."""
        return self.summary.records


def build_sil_loop(
    options: SilOptions,
    watch: RangeWatch,
    config: RobotConfig,
    bus: ServoBus,
    clock: Clock,
    telemetry: Telemetry,
    counters: Counters,
) -> ControlLoop:
    """Return the robot's loop, with memory for every tick of the run.

    `watch`: predictor of the bundle that counts why ticks are out of range.
    """
    slots = options.slots
    options.bundle.assume_payload(config.payload_kg)
    goals: GoalSource | None = options.goals
    correction, plan = None, options.plan
    if plan is not None:
        goals = planned = goals_of_plan(plan, config, options.bundle)
        correction = feedback_of_plan(plan, planned, config, options.bundle)
    lead = goals.lead if goals is not None else 0
    return build_loop(
        config, watch, bus, clock, goals=goals, correction=correction, slots=slots,
        telemetry=telemetry, counters=counters, keep=lead + slots + _STOP_TICKS,
    )  # fmt: skip


@contextlib.contextmanager
def sil_recording(options: SilOptions, config: RobotConfig) -> Iterator[SocketTelemetry]:
    """Run the robot's recorder during the block."""
    # The payload is recorded for the import of the log, even if the observer has to estimate it.
    metadata = log_metadata(config, options.bundle, datetime.now(UTC)) | {
        "payload_kg": repr(options.payload_kg),
        "source": "sil",
        SLOTS_KEY: str(options.slots),
    }
    if options.plan is not None:
        metadata |= log_facts(options.plan, config)
    if options.goals is not None:
        metadata |= outside_facts()
    if note := options.goals_note:
        metadata[GOALS_NOTE] = note
    path = options.out / LOG_NAME
    path.unlink(missing_ok=True)  # the log of an earlier run
    with recording(path, options.dof, time.time_ns(), metadata) as telemetry:
        yield telemetry


def sil_environment(options: SilOptions, scheduler: str, **more: Any) -> SilEnvironment:
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
