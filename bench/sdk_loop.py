"""Comparison of the robot's loop with the same loop on dynamixel-sdk as shipped.

All variants drive the same emulated servos (transmission time, return delay, latency timer, lost
replies) with the same bundle and period, in turns, under the same CPU load. The variants with the
SDK read, estimate, predict and write; they do not supervise or log.

ours, socket   the robot's loop over a socket, as for timing verdicts
ours, pty      the same over a pseudo-terminal, the only port that the SDK as shipped can open
SDK            group sync read and write as shipped, normal scheduler, absolute deadlines
SDK, FIFO      the same with the real-time rights of the robot's loop

Writes OUT/loop.json; exit 1 if the robot's loop misses more slots than the SDK.

    python -m bench.sdk_loop --bundle build/bundle_2dof --fmu build/twin_2dof.fmu
"""

from __future__ import annotations

import argparse
import contextlib
import json
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final, NamedTuple

import dynamixel_sdk as sdk
import numpy as np

from firmware_py.bus.registers import Register
from firmware_py.bus.servo_models import Model, model_named
from firmware_py.core.console import DONE, NEGATIVE, Progress
from firmware_py.core.motion import STUDY_AMPLITUDE_RAD, STUDY_PERIOD_S
from firmware_py.inference.bundle import ModelBundle
from firmware_py.system.clock import DeadlineClock, RealTimeOptions, real_time
from hil.emulator.emulator import Emulator, EmulatorSpecification
from hil.sil import LineKind, SilOptions, run_sil
from hil.sil.processors import assign_processors, cpu_load, pinned_to

BAUD: Final = 1_000_000
MODEL: Final = "PH54-200-S500-R"
_PROTOCOL: Final = 2.0


class Turn(NamedTuple):
    """Measurements of one variant in one turn; arrays have one row per tick."""

    taken_ns: np.ndarray
    lateness_ns: np.ndarray
    slots: int
    stale: int
    cpu_s: float
    wall_s: float


class Setting(NamedTuple):
    """Settings common to all variants."""

    bundle: ModelBundle
    fmu: Path
    model: Model
    seconds: float
    lost: float
    load: int
    scratch: Path


def measure(setting: Setting, rounds: int) -> dict[str, dict[str, Any]]:
    """Figures of every variant, which take turns."""
    variants: dict[str, Callable[[Setting], Turn]] = {
        "ours, socket": lambda setting: robot_turn(setting, "socket"),
        "ours, pty": lambda setting: robot_turn(setting, "pty"),
        "SDK": lambda setting: sdk_turn(setting, priority=0),
        "SDK, FIFO": lambda setting: sdk_turn(setting, priority=RealTimeOptions().priority),
    }
    turns: dict[str, list[Turn]] = {name: [] for name in variants}
    progress = Progress("loop and SDK", rounds * len(variants))
    for _ in range(rounds):
        for name, variant in variants.items():
            turns[name].append(variant(setting))
            progress.step(name)
    return {name: figures_of_turns(each) for name, each in turns.items()}


def main(argv: Sequence[str] | None = None) -> int:
    """Run the comparison."""
    parser = argparse.ArgumentParser(
        prog="python -m bench.sdk_loop", description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    parser.add_argument("--bundle", type=Path, required=True)
    parser.add_argument("--fmu", type=Path, required=True, help="twin of the same dof")
    parser.add_argument("--out", type=Path, default=Path("build/bench"))
    parser.add_argument("--model", default=MODEL, help="servo (%(default)s)")
    parser.add_argument("--seconds", type=float, default=8.0, help="of a turn (8)")
    parser.add_argument("--rounds", type=int, default=2, help="turns of each (2)")
    parser.add_argument("--lost", type=float, default=0.01, help="fraction of lost replies (0.01)")
    parser.add_argument("--load", type=int, default=1, help="processes that load the PC (1)")
    args = parser.parse_args(argv)
    with TemporaryDirectory(prefix="dropstitch-bench-") as scratch:
        setting = Setting(
            ModelBundle.load(args.bundle), args.fmu, model_named(args.model), args.seconds,
            args.lost, args.load, Path(scratch),
        )  # fmt: skip
        rows = measure(setting, args.rounds)
    print(figures_table(rows))
    args.out.mkdir(parents=True, exist_ok=True)
    (args.out / "loop.json").write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    good = rows["ours, socket"]["missed_slots"] <= rows["SDK"]["missed_slots"]
    return DONE if good else NEGATIVE


def robot_turn(setting: Setting, line: LineKind) -> Turn:
    """One turn of the robot's loop."""
    options = SilOptions(
        bundle=setting.bundle, model=setting.model, out=setting.scratch / "ours",
        fmu=setting.fmu, line=line,
        seconds=setting.seconds, baud=BAUD, load=setting.load, faults={"lost": setting.lost},
    )  # fmt: skip
    result = run_sil(options)
    records = result.records
    return Turn(
        records["lateness_ns"] + records["busy_ns"], records["lateness_ns"],
        int(np.ptp(records["tick"])) + 1, int((records["stale_ticks"] > 0).sum()),
        float((records["busy_ns"] - records["bus_wait_ns"]).sum()) * 1e-9, result.wall_s,
    )  # fmt: skip


def sdk_turn(setting: Setting, priority: int) -> Turn:
    """One turn with the SDK as shipped."""
    bundle, loop_cpu, other_cpus = setting.bundle, *assign_processors()
    dof = bundle.manifest.dof
    specification = EmulatorSpecification(
        setting.fmu, setting.model.number, tuple(range(1, dof + 1)), BAUD,
        faults={"lost": setting.lost},
    )  # fmt: skip
    options = RealTimeOptions(priority=priority, cpu=loop_cpu)
    with pinned_to(other_cpus), contextlib.ExitStack() as stack:
        emulator = stack.enter_context(
            contextlib.closing(Emulator(specification, "pty", setting.scratch, max(other_cpus)))
        )
        stack.enter_context(cpu_load(setting.load, other_cpus))
        servos = ShippedServos(emulator.name, setting.model, dof)
        stack.callback(servos.close)
        stack.enter_context(real_time(options))
        turn = _pace(setting, servos, dof)
        emulator.stop()
    return turn


class ShippedServos:
    """Two servos through the SDK's own port, packet handler and groups."""

    def __init__(self, name: str, model: Model, dof: int) -> None:
        self._model, self._ids, table = model, range(1, dof + 1), model.table
        self._block, self._goal = table.feedback, table[Register.GOAL_POSITION]
        self._port, self._packets = sdk.PortHandler(name), sdk.PacketHandler(_PROTOCOL)
        self._port.openPort()
        self._port.setBaudRate(BAUD)
        self._read = sdk.GroupSyncRead(
            self._port, self._packets, self._block.address, self._block.size
        )
        self._write = sdk.GroupSyncWrite(
            self._port, self._packets, self._goal.address, self._goal.size
        )
        torque = table[Register.TORQUE_ENABLE].address
        for servo_id in self._ids:
            self._read.addParam(servo_id)
            self._packets.write1ByteTxRx(self._port, servo_id, torque, 1)

    def read(self, angle_rad: np.ndarray, current_a: np.ndarray) -> bool:
        """Measure into the arrays; False where that failed."""
        if self._read.txRxPacket() != sdk.COMM_SUCCESS:
            return False
        table = self._model.table
        for values, register, convert in (
            (angle_rad, Register.PRESENT_POSITION, self._model.angle_rad),
            (current_a, Register.PRESENT_CURRENT, self._model.current_a),
        ):
            cell = table[register]
            for joint, servo_id in enumerate(self._ids):
                raw = self._read.getData(servo_id, cell.address, cell.size)
                values[joint] = convert(raw - (1 << 8 * cell.size) * (raw >> 8 * cell.size - 1))
        return True

    def write(self, goal_rad: np.ndarray) -> None:
        """Send the goals."""
        self._write.clearParam()
        for servo_id, angle in zip(self._ids, goal_rad.tolist(), strict=True):
            self._write.addParam(servo_id, self._goal.encode(self._model.position_raw(angle)))
        self._write.txPacket()

    def close(self) -> None:
        """Close the port."""
        self._port.closePort()


def _pace(setting: Setting, servos: ShippedServos, dof: int) -> Turn:
    bundle, clock = setting.bundle, DeadlineClock()
    period_ns = round(bundle.manifest.period_s * 1e9)
    angle, current = np.zeros(dof), np.zeros(dof)
    taken, lateness, stale, slot = [], [], 0, 0
    slots = round(setting.seconds * 1e9) // period_ns
    bundle.estimator.reset()
    start_cpu_s, start_ns = time.thread_time(), clock.now_ns() + period_ns
    while slot < slots:
        deadline_ns = start_ns + slot * period_ns
        clock.sleep_until(deadline_ns)
        wake_ns = clock.now_ns()
        stale += not servos.read(angle, current)
        estimate = bundle.estimator.update(angle, current, bundle.manifest.period_s)
        bundle.predictor.predict(angle, current, estimate.di, estimate.signals)
        phase = 2 * np.pi * slot * bundle.manifest.period_s / STUDY_PERIOD_S
        servos.write(np.full(dof, STUDY_AMPLITUDE_RAD * np.sin(phase)))
        end_ns = clock.now_ns()
        lateness.append(wake_ns - deadline_ns)
        taken.append(end_ns - deadline_ns)
        slot = max(slot + 1, -((start_ns - end_ns) // period_ns))
    wall_s = (clock.now_ns() - start_ns) * 1e-9
    cpu_s = time.thread_time() - start_cpu_s
    return Turn(np.array(taken), np.array(lateness), max(slot, slots), stale, cpu_s, wall_s)


def figures_of_turns(turns: Sequence[Turn]) -> dict[str, Any]:
    """Figures of all turns of one variant."""
    taken_us = np.concatenate([turn.taken_ns for turn in turns]) / 1e3
    late_us = np.concatenate([turn.lateness_ns for turn in turns]) / 1e3
    slots = sum(turn.slots for turn in turns)
    return {
        "slots": slots,
        "missed_slots": slots - len(taken_us),
        "ticks_without_data": sum(turn.stale for turn in turns),
        **{f"tick_p{q}_us": float(np.percentile(taken_us, q)) for q in (50, 99)},
        "tick_max_us": float(taken_us.max()),
        **{f"lateness_p{q}_us": float(np.percentile(late_us, q)) for q in (50, 99)},
        "cpu_fraction": sum(turn.cpu_s for turn in turns) / sum(turn.wall_s for turn in turns),
    }


def figures_table(rows: dict[str, dict[str, Any]]) -> str:
    """The figures as text."""
    head = f"{'':14}{'slots':>7}{'missed':>8}{'no data':>9}"
    lines = [head + f"{'tick p50':>10}{'p99':>8}{'max, µs':>9}{'late p99':>10}{'CPU':>7}"]
    for name, row in rows.items():
        counts = f"{row['slots']:7d}{row['missed_slots']:8d}{row['ticks_without_data']:9d}"
        tick = f"{row['tick_p50_us']:10.0f}{row['tick_p99_us']:8.0f}{row['tick_max_us']:9.0f}"
        lines.append(
            f"{name:14}{counts}{tick}{row['lateness_p99_us']:10.0f}{row['cpu_fraction']:7.1%}"
        )
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
