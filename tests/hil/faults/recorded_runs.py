"""Recorded runs of the loop: today's loop must give the same goals, states and end (SR-27).

`python -m tests.hil.faults.recorded_runs` adds the rows of the fault table that recorded_runs.xz
lacks, with the robot of the tests; with `--anew` it records every row of the virtual line again. It
replays each new run, and reports and omits the runs that the replay does not reproduce.
"""

import argparse
import lzma
import sys
import tempfile
from pathlib import Path
from unittest.mock import patch

import msgspec
import numpy as np

from firmware_py.bus.servo_bus import BusStatus
from firmware_py.config import RobotConfig
from firmware_py.core.errors import DropstitchError, SafetyTrip
from firmware_py.goals.goal_source import GoalTable
from firmware_py.inference.estimator import Estimate
from firmware_py.inference.predictor import Prediction
from firmware_py.loop import ControlLoop
from firmware_py.safety.states import SafetyState
from firmware_py.safety.supervisor import SafetySupervisor
from firmware_py.system.clock import SimClock
from firmware_py.system.service import Service
from hil.faults import case_robot, virtual_case
from hil.faults.fault_table import ROWS
from hil.faults.faults_document import FaultCase
from hil.faults.virtual_case import case_goals, run_virtual
from tests.hil.faults.toy_robot import ToyPhysics, toy_robot

FILE = Path(__file__).with_name("recorded_runs.xz")
STAGES = ("estimate_ns", "predict_ns", "command_ns", "check_ns", "write_ns")
OF_THE_LOG = ("tick", "di", "predicted_tip_x_m", "predicted_tip_y_m", "predicted_tip_z_m",
              "state", "lateness_ns", "read_ns", *STAGES, "busy_ns")  # fmt: skip
OF_A_JOINT = ("goal_{}_rad", "angle_{}_rad", "current_{}_a")
OF_THE_BUS = ("read_status", "write_status", "read_alert")
SAME_RAD = 1e-9
"""Largest difference of goals that counts as rounding; a pulse of the finest servo is 6 µrad."""


class RecordedRun(msgspec.Struct, frozen=True, kw_only=True):
    """Configuration, events, ticks and end of a run."""

    name: str  # Of the case in the campaign
    config: RobotConfig
    number: int  # Model number of the servos
    through_pulse: int | None  # Goal in pulses of a motion other than the configured one
    slots: int
    connected_rad: list[list[float]]  # Angles at each connection of the servos
    torque: list[tuple[int, int]]  # Status and alert bits after each switch of the torque
    requested: str  # Reason for a requested stop; empty if none was requested
    ended: str
    reason: str
    columns: dict[str, list[int | float]]  # A part of the log's, and `OF_THE_BUS`

    @property
    def row(self):
        return self.name.rpartition(" (virtual")[0]

    @property
    def ticks(self):
        return len(self.columns["tick"])


def write_runs(path, runs):
    path.write_bytes(lzma.compress(msgspec.msgpack.encode(runs), preset=9))


def read_runs(path):
    content = lzma.decompress(path.read_bytes())
    return msgspec.msgpack.decode(content, type=list[RecordedRun])


# --- replay ---------------------------------------------------------------------------------------


class _RunsOnError(DropstitchError):
    """The loop reads a tick after the recorded end."""


class _Playback(Service):
    """Bus, clock, estimator, predictor and service of a recorded run."""

    waits_for_fresh = False

    def __init__(self, run, supervisor):
        self.run, self.supervisor, self.dof = run, supervisor, run.config.dof
        self.angle_rad, self.current_a = np.zeros(self.dof), np.zeros(self.dof)
        self.alert, self.wait_ns, self.late_ns, self.row = 0, 0, 0, 0
        self._connections, self._switches, self._in_tick = 0, 0, False
        self._clock, self._wake_ns = SimClock(), 0
        self._last_tick = self._last_lateness_ns = 0
        self._period_ns = round(run.config.period_s * 1e9)
        self.loop = None

    def _at(self, name):
        return self.run.columns[name][self.row]

    def _set_clock(self, time_ns):
        self._clock.advance(time_ns - self._clock.now_ns())

    def now_ns(self):
        return self._clock.now_ns()

    def sleep_until(self, deadline_ns):
        """Wake with the recorded lateness; while the port is missing, at the deadline."""
        if self.supervisor.state is SafetyState.OFF:
            self._clock.sleep_until(deadline_ns)
        elif self.row < self.run.ticks:
            self._wake_ns = deadline_ns + self._at("lateness_ns")
            self._set_clock(self._wake_ns)

    def connect(self):
        """Set the recorded angles of this connection."""
        known = self.run.connected_rad
        self.angle_rad[:] = known[min(self._connections, len(known) - 1)]
        if self._connections:  # the port came back: continue in the recorded slot
            start_ns = self._wake_ns - self._last_lateness_ns - self._last_tick * self._period_ns
            self._set_clock(start_ns + self._at("tick") * self._period_ns - 1)
        self._connections += 1
        self.alert = 0

    def reopen(self):
        """Return whether the port came back in the recorded run."""
        return self.row < self.run.ticks

    def read(self, deadline_ns):
        if self.row >= self.run.ticks:
            raise _RunsOnError("the loop goes on after the recorded end")
        if self.run.requested and self._at("state") >= SafetyState.STOPPING:
            self.loop.stop(self.run.requested)
        self._in_tick = True
        self._last_tick, self._last_lateness_ns = self._at("tick"), self._at("lateness_ns")
        for j in range(self.dof):
            self.angle_rad[j] = self._at(f"angle_{j + 1}_rad")
            self.current_a[j] = self._at(f"current_{j + 1}_a")
        self.alert = self._at("read_alert")
        self._clock.advance(self._at("read_ns"))
        return BusStatus(self._at("read_status"))

    def write(self, goal_rad, deadline_ns):
        if not self._in_tick:
            return BusStatus.OK
        self._clock.advance(sum(map(self._at, ("command_ns", "check_ns", "write_ns"))))
        return BusStatus(self._at("write_status"))

    def torque(self, on):
        known = self.run.torque
        status, self.alert = known[min(self._switches, len(known) - 1)]
        self._switches += 1
        return BusStatus(status)

    def close(self):
        pass

    reset = close

    def update(self, angle_rad, current_a, step_s):
        self._clock.advance(self._at("estimate_ns"))
        return Estimate(self._at("di"), float("nan"))

    def predict(self, *_):
        self._clock.advance(self._at("predict_ns"))
        tip_m = np.array([self._at(f"predicted_tip_{axis}_m") for axis in "xyz"])
        return Prediction(tip_m, np.ones(1), np.zeros(3))

    def alive(self):
        """End the tick at the recorded time."""
        if self._in_tick:
            self._set_clock(self._wake_ns + self._at("busy_ns"))
            self._in_tick = False
            self.row += 1


def replay_run(run):
    """First difference of today's loop on these measurements in goals, states or end, or ""."""
    config = run.config
    supervisor = SafetySupervisor(config.limits_in_force, config.dof, config.period_s)
    played = _Playback(run, supervisor)
    played.loop = ControlLoop(
        played, played, played, supervisor,
        GoalTable(case_goals(config, run.through_pulse, run.number)), played,
        slots=run.slots, period_s=config.period_s, reply_timeout_s=config.bus.reply_timeout_s,
        replug_s=config.bus.replug_s, service=played, keep=2 * run.ticks + 1,
    )  # fmt: skip
    try:
        summary = played.loop.run()
    except (_RunsOnError, SafetyTrip) as error:
        return str(error)
    records, ended, reason = summary.records, summary.ended.value, summary.reason
    count = min(len(records), run.ticks)
    for name in ("tick", "state", *(f"goal_{j}_rad" for j in range(1, config.dof + 1))):
        then, now = np.array(run.columns[name][:count]), records[name][:count]
        differs = np.abs(now - then) > (SAME_RAD if name.endswith("_rad") else 0)
        if differs.any():
            row = int(np.argmax(differs))
            return f"{name} of row {row} is {now[row]}, it was {then[row]}"
    if len(records) != run.ticks:
        return f"there are {len(records)} ticks, there were {run.ticks}"
    if (ended, reason) != (run.ended, run.reason):
        return f"the end is {ended} ({reason}), it was {run.ended} ({run.reason})"
    return ""


# --- recording ------------------------------------------------------------------------------------

REQUEST = "a request"


class _ListenedBus:
    """A bus, and what the log lacks: the results of the loop's calls."""

    def __init__(self, bus):
        self._bus, self._in_tick = bus, False
        self.connected_rad, self.switches = [], []
        self.columns = {name: [] for name in OF_THE_BUS}

    def __getattr__(self, name):
        return getattr(self._bus, name)

    def connect(self):
        self._bus.connect()
        self.connected_rad.append(self._bus.angle_rad.tolist())

    def torque(self, on):
        status = self._bus.torque(on)
        self.switches.append((int(status), self._bus.alert))
        return status

    def read(self, deadline_ns):
        status = self._bus.read(deadline_ns)
        self.columns["read_status"].append(int(status))
        self.columns["read_alert"].append(self._bus.alert)
        self._in_tick = True
        return status

    def write(self, goal_rad, deadline_ns):
        status = self._bus.write(goal_rad, deadline_ns)
        if self._in_tick:
            self.columns["write_status"].append(int(status))
        self._in_tick = False
        return status


def record_case(case, robot):
    """Run a case on the virtual line; return its run."""
    buses, runs = [], []
    build_bus, run_loop = case_robot.build_bus, virtual_case.run_case_loop

    def build(*arguments):
        buses.append(_ListenedBus(build_bus(*arguments)))
        return buses[-1]

    def run(robot, config, goals, slots, *rest):
        outcome, columns = run_loop(robot, config, goals, slots, *rest)
        bus, joints = buses[-1], range(1, config.dof + 1)
        names = [*OF_THE_LOG, *(name.format(j) for j in joints for name in OF_A_JOINT)]
        runs.append(RecordedRun(
            name=case.name, config=config, number=case.number,
            through_pulse=case.row.setup.through_pulse, slots=slots,
            connected_rad=bus.connected_rad, torque=bus.switches,
            requested=REQUEST if outcome.reason.startswith(REQUEST) else "",
            ended=outcome.ended, reason=outcome.reason,
            columns={name: columns[name].tolist() for name in names} | bus.columns,
        ))  # fmt: skip
        return outcome, columns

    with (
        patch.object(case_robot, "build_bus", build),
        patch.object(virtual_case, "run_case_loop", run),
    ):
        run_virtual(robot, case.row, case.number, case.seed)
    return runs[0]


def replayable(row):
    """Whether the robot of a row starts, and a run holds all that its goals depend on."""
    return (
        "virtual" in row.lines
        and row.must.ended != "refused"
        and row.setup.feedback == "none"  # the interval of a prediction is not recorded
        and not row.injects("goals")  # nor are the messages of a program
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--anew", action="store_true", help="record every row again")
    rows = {f"{row.fault}, {row.how}": row for row in ROWS if replayable(row)}
    runs = [] if parser.parse_args().anew else [r for r in read_runs(FILE) if r.row in rows]
    missing = rows.keys() - {run.row for run in runs}
    with (
        tempfile.TemporaryDirectory() as scratch,
        patch.object(virtual_case, "FmuPhysics", ToyPhysics),
    ):
        robot = toy_robot(Path(scratch))
        for name in sorted(missing):
            run = record_case(FaultCase(rows[name], "virtual", rows[name].models[0], 1), robot)
            if difference := replay_run(run):
                print(f"{run.name}: left out: {difference}", file=sys.stderr)
            else:
                runs.append(run)
    write_runs(FILE, runs)
    print(f"{FILE}: {len(runs)} runs")


if __name__ == "__main__":
    main()
