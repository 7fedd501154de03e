"""Record runs that every later version of the code has to reproduce.

::

    python -m hil.faults.recorded.run_recorder --bundle build/bundle_2dof \
        --fmu build/twin_2dof.fmu --out tests/hil/faults/recorded_runs.xz

The command runs every fault of the virtual line once and replays each run. It reports and omits the
runs that the replay does not reproduce.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from firmware_py.bus.dynamixel import DynamixelBus
from firmware_py.bus.servo_bus import BusStatus
from firmware_py.core.units import FILE_SIZE
from firmware_py.inference.bundle import ModelBundle
from hil.faults.campaign import cases_of
from hil.faults.cases.case_robot import CaseRobot, RunTap, case_config
from hil.faults.cases.virtual_case import run_virtual, slots_of
from hil.faults.fault_table import ROWS
from hil.faults.fault_verdict import FaultCase
from hil.faults.observation import CaseOutcome, Columns
from hil.faults.recorded.recorded_run import RunTape, TapeFacts, column_names, write_runs
from hil.faults.recorded.run_replay import replay_run

Array = NDArray[np.float64]
_REQUEST = "a request"


class RecordingTap(RunTap):
    """Tap between loop and bus that records what the log lacks."""

    def __init__(self, case: FaultCase, robot: CaseRobot) -> None:
        self._case, self._robot = case, robot
        self._connected_rad: list[list[float]] = []
        self._torque: list[tuple[int, int]] = []
        self._status: dict[str, list[int]] = {
            "read_status": [], "write_status": [], "read_alert": []
        }  # fmt: skip
        self._in_tick = self._connecting = False
        self.run: RunTape | None = None

    def wrap(self, bus: DynamixelBus) -> DynamixelBus:
        """Record the calls of the loop to its bus and their results."""
        connect, torque, read, write = bus.connect, bus.torque, bus.read, bus.write

        def connected() -> None:
            self._connecting = True  # connecting calls `read` as well
            try:
                connect()
            finally:
                self._connecting = False
            self._connected_rad.append(bus.angle_rad.tolist())

        def switched(on: bool) -> BusStatus:
            status = torque(on)
            self._torque.append((int(status), bus.alert))
            return status

        def measured(deadline_ns: int) -> BusStatus:
            status = read(deadline_ns)
            if self._connecting:
                return status
            self._status["read_status"].append(int(status))
            self._status["read_alert"].append(bus.alert)
            self._in_tick = True
            return status

        def sent(goal_rad: Array, deadline_ns: int) -> BusStatus:
            status = write(goal_rad, deadline_ns)
            if self._in_tick:
                self._status["write_status"].append(int(status))
            self._in_tick = False
            return status

        replaced = {"connect": connected, "torque": switched, "read": measured, "write": sent}
        for name, method in replaced.items():
            setattr(bus, name, method)
        return bus

    def end(self, outcome: CaseOutcome, columns: Columns) -> None:
        """Store the run, unless the robot was refused."""
        if not len(columns.get("tick", ())):
            return
        case = self._case
        config = case_config(self._robot, case.row, case.number, "virtual")
        facts = TapeFacts(
            name=case.name, config=config, number=case.number,
            through_pulse=case.row.setup.through_pulse, slots=slots_of(case.row),
            connected_rad=self._connected_rad, torque=self._torque,
            requested=_REQUEST if outcome.reason.startswith(_REQUEST) else "",
            ended=outcome.ended, reason=outcome.reason, ticks=len(columns["tick"]),
        )  # fmt: skip
        noted = {name: np.array(values) for name, values in self._status.items()}
        every = {**columns, **noted}
        self.run = RunTape(facts, {name: every[name] for name in column_names(config.dof)})


def record_case(case: FaultCase, robot: CaseRobot) -> RunTape | None:
    """Run a case on the virtual line; return its run, or None if the robot was refused."""
    tap = RecordingTap(case, robot)
    run_virtual(replace(robot, tap=tap), case.row, case.number, case.seed)
    return tap.run


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--bundle", type=Path, required=True)
    parser.add_argument("--fmu", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args(argv)
    robot = CaseRobot(ModelBundle.load(args.bundle), args.fmu)
    runs, named = [], set()
    # Feedback of the tip needs the prediction interval, which is not recorded.
    replayed = [row for row in ROWS if row.setup.feedback == "none"]
    for case in cases_of(robot.dof, ("virtual",), [args.seed], replayed):
        if (case.row.fault, case.row.how) in named or (run := record_case(case, robot)) is None:
            continue
        named.add((case.row.fault, case.row.how))
        if difference := replay_run(run):
            print(f"{case.name}: left out: {difference}", file=sys.stderr)
        else:
            runs.append(run)
    write_runs(args.out, runs)
    print(f"{args.out}: {len(runs)} runs, {FILE_SIZE.number(args.out.stat().st_size)} kB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
