"""Case in real time over a socket: the loop in this process, the servos in another."""

from __future__ import annotations

import contextlib
import gc
import time
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import msgspec

from firmware_py.bus.transport import Transport, open_transport
from firmware_py.goals.goal_source import GoalTable
from firmware_py.system.clock import DeadlineClock, RealTimeOptions, real_time
from firmware_py.system.kernel_counters import KernelCounters
from hil.faults.cases.case_robot import CaseRobot, case_config, run_case_loop
from hil.faults.cases.servo_process import ServoProcess, ServoProcessTask
from hil.faults.fault_row import FaultRow
from hil.faults.host_faults import HostFaults
from hil.faults.injection import FaultSchedule
from hil.faults.observation import CaseObservation, observe_case
from hil.sil.processors import assign_processors, pinned_to

SLOTS: Final = 150
"""Slots of the motion: 2.6 s. The fault begins before the 110th."""


def run_real_time(robot: CaseRobot, row: FaultRow, number: int, seed: int) -> CaseObservation:
    """Run one case in real time; see `hil.faults.cases.virtual_case.run_virtual`."""
    loop_cpu, other_cpus = assign_processors()
    clock = DeadlineClock()
    with contextlib.ExitStack() as stack:
        scratch = Path(stack.enter_context(TemporaryDirectory(prefix="dropstitch-faults-")))
        stack.enter_context(pinned_to(other_cpus))
        task = ServoProcessTask(
            robot.fmu, robot.dof, row, number, seed, "socket", scratch / "line", max(other_cpus)
        )
        servo_process = stack.enter_context(contextlib.closing(ServoProcess(task)))
        config = case_config(robot, row, number, f"unix:{task.port}")
        config = msgspec.structs.replace(config, real_time=RealTimeOptions(cpu=loop_cpu))
        script = FaultSchedule(row.injections, seed)
        host = HostFaults(script, row.injections, clock.now_ns, time.sleep)
        goals_rad = config.goals_rad(repeated=True)

        def opener() -> Transport:
            return open_transport(config.bus.port, config.bus.baud, clock)

        with contextlib.closing(KernelCounters()) as counters, real_time(config.real_time):
            before = _collections()
            outcome, columns = run_case_loop(
                robot, config, (GoalTable(goals_rad), None), SLOTS, clock, host, opener, counters
            )  # fmt: skip
            collections = _collections() - before
        servo_log = servo_process.stop()
    if collections:
        outcome = replace(outcome, ended="collected", reason=f"{collections} garbage collections")
    began = [t for t in (host.began_ns, servo_log.began_ns) if t is not None]
    return observe_case(
        outcome, columns, servo_log, min(began, default=None), SLOTS, config.period_s,
        config.limits_in_force.rate_rad_s,
    )  # fmt: skip


def _collections() -> int:
    return sum(int(generation["collections"]) for generation in gc.get_stats())
