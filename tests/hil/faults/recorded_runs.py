"""Recorded runs of the loop: today's loop must give the same goals, states and end (SR-27).

`python -m tests.hil.faults.recorded_runs` adds the rows of the fault table that recorded_runs.xz
lacks, with the robot of the tests; with `--anew` it records every row of the virtual line again. It
replays each new run, and reports and omits the runs that the replay does not reproduce.
"""

from __future__ import annotations

import argparse
import io
import lzma
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, Final, NamedTuple
from unittest.mock import patch

import msgspec
import numpy as np
from numpy.typing import NDArray

from firmware_py.bus.servo_bus import BusStatus
from firmware_py.config import RobotConfig
from firmware_py.core.errors import DropstitchError, SafetyTrip
from firmware_py.core.units import FILE_SIZE
from firmware_py.goals.goal_source import GoalTable
from firmware_py.inference.estimator import Estimate
from firmware_py.inference.predictor import Prediction
from firmware_py.loop import ControlLoop
from firmware_py.safety.states import SafetyState
from firmware_py.safety.supervisor import SafetySupervisor
from firmware_py.system.clock import SimClock
from firmware_py.system.service import Service
from hil.faults import case_robot, virtual_case
from hil.faults.case_robot import CaseRobot
from hil.faults.fault_row import FaultRow
from hil.faults.fault_table import ROWS
from hil.faults.faults_document import FaultCase
from hil.faults.virtual_case import case_goals, run_virtual
from tests.hil.faults.toy_robot import ToyPhysics, toy_robot

Array = NDArray[np.float64]
FILE: Final = Path(__file__).with_name("recorded_runs.xz")
Columns = Mapping[str, NDArray[Any]]
_FACTS: Final = "facts"
_MEASURED: Final = ("current_", "di", "predicted_")
"""Columns stored with 32 bits, which is enough: the loop only compares them with limits."""


class TapeFacts(msgspec.Struct, frozen=True, kw_only=True):
    """Configuration, outcome and events of a recorded run; its ticks are stored apart."""

    name: str  # Name of the case in the campaign
    config: RobotConfig
    number: int  # Model number of the servos
    through_pulse: int | None  # Goal in pulses of a motion other than the configured one
    slots: int
    connected_rad: list[list[float]]  # Angles at each connection of the servos
    torque: list[tuple[int, int]]  # Status and alert bits after each switch of the torque
    requested: str  # Reason for a requested stop; empty if none was requested
    ended: str
    reason: str
    ticks: int  # Number of rows


class RunTape(NamedTuple):
    facts: TapeFacts
    columns: Columns  # Ticks by column, see `column_names`


def column_names(dof: int) -> tuple[str, ...]:
    """Columns of a run: a part of the log's, and the statuses of reads and writes."""
    joints = [f"{n}_{j}_{u}" for j in range(1, dof + 1)
              for n, u in (("goal", "rad"), ("angle", "rad"), ("current", "a"))]  # fmt: skip
    return (
        "tick", *joints, "di", "predicted_tip_x_m", "predicted_tip_y_m", "predicted_tip_z_m",
        "state", "lateness_ns", "read_ns", "estimate_ns", "predict_ns", "command_ns", "check_ns",
        "write_ns", "busy_ns", "read_status", "write_status", "read_alert",
    )  # fmt: skip


def write_runs(path: Path, runs: Sequence[RunTape]) -> None:
    """Write runs of the same number of joints; a column holds the ticks of all runs in sequence."""
    names = column_names(runs[0].facts.config.dof)
    facts = np.frombuffer(msgspec.json.encode([run.facts for run in runs]), np.uint8)
    arrays = {_FACTS: facts}
    for name in names:
        column = np.concatenate([run.columns[name] for run in runs])
        arrays[name] = column.astype(np.float32) if name.startswith(_MEASURED) else column
    buffer = io.BytesIO()
    np.savez(buffer, allow_pickle=False, **arrays)
    path.write_bytes(lzma.compress(buffer.getvalue(), preset=9))


def read_runs(path: Path) -> list[RunTape]:
    with np.load(io.BytesIO(lzma.decompress(path.read_bytes())), allow_pickle=False) as file:
        facts = msgspec.json.decode(file[_FACTS].tobytes(), type=list[TapeFacts])
        columns = {name: file[name] for name in column_names(facts[0].config.dof)}
    runs, first = [], 0
    for one in facts:
        part = slice(first, first + one.ticks)
        runs.append(RunTape(one, {name: column[part] for name, column in columns.items()}))
        first += one.ticks
    return runs


# --- replay

SAME_RAD = 1e-9
"""Largest difference of goals that counts as rounding; a pulse of the finest servo is 6 µrad."""


class _RunsOnError(DropstitchError):
    """The loop reads a tick after the recorded end."""


class _Playback(Service):
    """Bus, clock, estimator, predictor and service of a recorded run."""

    waits_for_fresh: ClassVar[bool] = False

    def __init__(self, run: RunTape) -> None:
        facts, columns = run.facts, run.columns
        self._facts, self._columns = facts, columns
        self.dof = facts.config.dof
        joints = range(1, self.dof + 1)
        self._angles = np.stack([columns[f"angle_{j}_rad"] for j in joints], axis=1)
        self._currents = np.stack([columns[f"current_{j}_a"] for j in joints], axis=1)
        self._tips = np.stack([columns[f"predicted_tip_{a}_m"] for a in "xyz"], axis=1)
        self.angle_rad: Array = np.zeros(self.dof)
        self.current_a: Array = np.zeros(self.dof)
        self.alert, self.wait_ns, self.late_ns, self.row = 0, 0, 0, 0
        self._connections, self._switches, self._in_tick = 0, 0, False
        self._clock, self._wake_ns = SimClock(), 0
        self._last_tick = self._last_lateness_ns = 0
        self._stopping = columns["state"] >= SafetyState.STOPPING
        self._period_ns = round(facts.config.period_s * 1e9)
        self.loop: ControlLoop
        self.supervisor: SafetySupervisor

    def _at(self, name: str) -> int:
        return int(self._columns[name][self.row])

    def _set_clock(self, time_ns: int) -> None:
        self._clock.advance(time_ns - self._clock.now_ns())

    def now_ns(self) -> int:
        return self._clock.now_ns()

    def sleep_until(self, deadline_ns: int) -> None:
        """Wake with the recorded lateness; while the port is missing, at the deadline."""
        if self.supervisor.state is SafetyState.OFF:
            self._clock.sleep_until(deadline_ns)
        elif self.row < self._facts.ticks:
            self._wake_ns = deadline_ns + self._at("lateness_ns")
            self._set_clock(self._wake_ns)

    def connect(self) -> None:
        """Set the recorded angles of this connection."""
        known = self._facts.connected_rad
        self.angle_rad[:] = known[min(self._connections, len(known) - 1)]
        if self._connections:  # the port came back: continue in the recorded slot
            start_ns = self._wake_ns - self._last_lateness_ns - self._last_tick * self._period_ns
            self._set_clock(start_ns + self._at("tick") * self._period_ns - 1)
        self._connections += 1
        self.alert = 0

    def reopen(self) -> bool:
        """Return whether the port came back in the recorded run."""
        return self.row < self._facts.ticks

    def read(self, deadline_ns: int) -> BusStatus:
        if self.row >= self._facts.ticks:
            raise _RunsOnError("the loop goes on after the recorded end")
        if self._facts.requested and self._stopping[self.row]:
            self.loop.stop(self._facts.requested)
        self._in_tick = True
        self._last_tick, self._last_lateness_ns = self._at("tick"), self._at("lateness_ns")
        self.angle_rad[:], self.current_a[:] = self._angles[self.row], self._currents[self.row]
        self.alert = self._at("read_alert")
        self._clock.advance(self._at("read_ns"))
        return BusStatus(self._at("read_status"))

    def write(self, goal_rad: Array, deadline_ns: int) -> BusStatus:
        if not self._in_tick:
            return BusStatus.OK
        self._clock.advance(sum(map(self._at, ("command_ns", "check_ns", "write_ns"))))
        return BusStatus(self._at("write_status"))

    def torque(self, on: bool) -> BusStatus:
        known = self._facts.torque
        status, self.alert = known[min(self._switches, len(known) - 1)]
        self._switches += 1
        return BusStatus(status)

    def close(self) -> None:
        pass

    def reset(self) -> None:
        pass

    def update(self, angle_rad: Array, current_a: Array, step_s: float) -> Estimate:
        self._clock.advance(self._at("estimate_ns"))
        return Estimate(float(self._columns["di"][self.row]), float("nan"))

    def predict(self, *_: Any) -> Prediction:
        self._clock.advance(self._at("predict_ns"))
        return Prediction(self._tips[self.row].astype(np.float64), np.ones(1), np.zeros(3))

    def alive(self) -> None:
        """End the tick at the recorded time."""
        if self._in_tick:
            self._set_clock(self._wake_ns + self._at("busy_ns"))
            self._in_tick = False
            self.row += 1


def replay_run(run: RunTape) -> str:
    """First difference of today's loop on these measurements in goals, states or end, or ""."""
    facts, config, played = run.facts, run.facts.config, _Playback(run)
    goals = case_goals(config, facts.through_pulse, facts.number)
    supervisor = SafetySupervisor(config.limits_in_force, config.dof, config.period_s)
    played.supervisor = supervisor
    played.loop = loop = ControlLoop(
        played, played, played, supervisor, GoalTable(goals), played,
        slots=facts.slots, period_s=config.period_s, reply_timeout_s=config.bus.reply_timeout_s,
        replug_s=config.bus.replug_s, service=played, keep=2 * facts.ticks + 1,
    )  # fmt: skip
    try:
        summary = loop.run()
    except (_RunsOnError, SafetyTrip) as error:
        return str(error)
    return _difference(facts, run, summary.records, summary.ended.value, summary.reason)


def _difference(
    facts: TapeFacts, run: RunTape, records: NDArray[np.void], ended: str, reason: str
) -> str:
    count = min(len(records), facts.ticks)
    for name in ("tick", "state", *(f"goal_{j}_rad" for j in range(1, facts.config.dof + 1))):
        then, now = run.columns[name][:count], records[name][:count]
        differs = np.abs(now - then) > (SAME_RAD if name.endswith("_rad") else 0)
        if differs.any():
            row = int(np.argmax(differs))
            return f"{name} of row {row} is {now[row]}, it was {then[row]}"
    if len(records) != facts.ticks:
        return f"there are {len(records)} ticks, there were {facts.ticks}"
    if (ended, reason) != (facts.ended, facts.reason):
        return f"the end is {ended} ({reason}), it was {facts.ended} ({facts.reason})"
    return ""


# --- recording

_REQUEST: Final = "a request"


class _Listener:
    """Records what the log lacks: the results of the loop's calls to its bus."""

    def __init__(self) -> None:
        self.connected_rad: list[list[float]] = []
        self.torque: list[tuple[int, int]] = []
        names = ("read_status", "write_status", "read_alert")
        self.status: dict[str, list[int]] = {name: [] for name in names}
        self._in_tick = self._connecting = False

    def listen(self, bus: Any) -> Any:
        connect, torque, read, write = bus.connect, bus.torque, bus.read, bus.write

        def connected() -> None:
            self._connecting = True  # connecting calls `read` as well
            try:
                connect()
            finally:
                self._connecting = False
            self.connected_rad.append(bus.angle_rad.tolist())

        def switched(on: bool) -> BusStatus:
            status = torque(on)
            self.torque.append((int(status), bus.alert))
            return status

        def measured(deadline_ns: int) -> BusStatus:
            status = read(deadline_ns)
            if self._connecting:
                return status
            self.status["read_status"].append(int(status))
            self.status["read_alert"].append(bus.alert)
            self._in_tick = True
            return status

        def sent(goal_rad: Array, deadline_ns: int) -> BusStatus:
            status = write(goal_rad, deadline_ns)
            if self._in_tick:
                self.status["write_status"].append(int(status))
            self._in_tick = False
            return status

        bus.connect, bus.torque, bus.read, bus.write = connected, switched, measured, sent
        return bus


def record_case(case: FaultCase, robot: CaseRobot) -> RunTape:
    """Run a case on the virtual line; return its run."""
    listener, tapes = _Listener(), []
    build_bus, run_loop = case_robot.build_bus, virtual_case.run_case_loop

    def build(*arguments: Any) -> Any:
        return listener.listen(build_bus(*arguments))

    def run(robot: CaseRobot, config: RobotConfig, goals: Any, slots: int, *rest: Any) -> Any:
        outcome, columns = run_loop(robot, config, goals, slots, *rest)
        facts = TapeFacts(
            name=case.name, config=config, number=case.number,
            through_pulse=case.row.setup.through_pulse, slots=slots,
            connected_rad=listener.connected_rad, torque=listener.torque,
            requested=_REQUEST if outcome.reason.startswith(_REQUEST) else "",
            ended=outcome.ended, reason=outcome.reason, ticks=len(columns["tick"]),
        )  # fmt: skip
        noted = {name: np.array(values) for name, values in listener.status.items()}
        every = {**columns, **noted}
        tapes.append(RunTape(facts, {name: every[name] for name in column_names(config.dof)}))
        return outcome, columns

    with (
        patch.object(case_robot, "build_bus", build),
        patch.object(virtual_case, "run_case_loop", run),
    ):
        run_virtual(robot, case.row, case.number, case.seed)
    return tapes[0]


def replayable(row: FaultRow) -> bool:
    """Whether the robot of a row starts, and a run holds all that its goals depend on."""
    return (
        "virtual" in row.lines
        and row.must.ended != "refused"
        and row.setup.feedback == "none"  # the interval of a prediction is not recorded
        and not row.injects("goals")  # nor are the messages of a program
    )


def row_name(run: RunTape) -> str:
    return run.facts.name.rpartition(" (virtual")[0]


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--anew", action="store_true", help="record every row again")
    args = parser.parse_args(argv)
    rows = [row for row in ROWS if replayable(row)]
    names = {f"{row.fault}, {row.how}" for row in rows}
    runs = [] if args.anew else [run for run in read_runs(FILE) if row_name(run) in names]
    known = {row_name(run) for run in runs}
    with (
        tempfile.TemporaryDirectory() as scratch,
        patch.object(virtual_case, "FmuPhysics", ToyPhysics),
    ):
        robot = toy_robot(Path(scratch))
        for row in rows:
            if f"{row.fault}, {row.how}" in known:
                continue
            run = record_case(FaultCase(row, "virtual", row.models[0], seed=1), robot)
            if difference := replay_run(run):
                print(f"{run.facts.name}: left out: {difference}", file=sys.stderr)
            else:
                runs.append(run)
    write_runs(FILE, runs)
    print(f"{FILE}: {len(runs)} runs, {FILE_SIZE.number(FILE.stat().st_size)} kB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
