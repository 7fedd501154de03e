"""Check of this PC for settings that harm the loop's timing, with remedies.

With --bus: shows the transmission time of a tick of the configured robot, for every plan that its
servos might support, fastest first (`firmware_py.bus.bus_plan`). A configuration that cannot meet
its period is refused with the numbers.

With --check-joints: asks you to turn each joint by hand, torque off, and reports which angle
changed. No other check detects exchanged ids.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_py.bus.bus_plan import Plan
from firmware_py.bus.servo_bus import ServoBus
from firmware_py.commands.doctor_checks import Severity, examine
from firmware_py.config import RobotConfig, read_config
from firmware_py.core.console import DONE, NEGATIVE, emit
from firmware_py.core.errors import InputError
from firmware_py.core.units import ANGLE, DELAY, DURATION
from firmware_py.robot import open_bus
from firmware_py.system.clock import Clock, DeadlineClock

Array = NDArray[np.float64]

LEAST_TURN_RAD: Final = 0.087
"""Smallest turn by hand: 5°, far beyond the play of a gear [assumed]."""
STILL_RAD: Final = 0.009
"""Largest change within `STILL_S` of a joint at rest [assumed]."""
STILL_S: Final = 1.0
PATIENCE_S: Final = 60.0
"""Timeout for the operator."""
_POLL_NS: Final = 50_000_000


class JointTurn(NamedTuple):
    """Joint to turn, and the joint whose angle changed."""

    joint: int  # Number of the requested joint, from 1
    turned: int  # Number of the joint whose angle changed most
    change_rad: float

    def sentence(self, ids: Sequence[int]) -> str:
        change = ANGLE.text(self.change_rad)
        if self.turned == self.joint:
            return (
                f"joint {self.joint} was turned: its angle changed by {change} "
                f"(servo {ids[self.joint - 1]})"
            )
        return (
            f"joint {self.joint} was turned, and the angle of joint {self.turned} (servo "
            f"{ids[self.turned - 1]}) changed by {change}: the servos are exchanged; correct the "
            "order of [[servos]]"
        )


def turn_joints(
    bus: ServoBus, clock: Clock, timeout_s: float, ask: Callable[[str], None]
) -> tuple[JointTurn, ...]:
    """Ask for a turn of each joint by hand, and measure which angle changes."""
    watch = _Watch(bus, clock, timeout_s)
    turns = []
    for joint in range(1, bus.dof + 1):
        start_rad = watch.still()
        ask(f"turn joint {joint} by hand, by {ANGLE.text(LEAST_TURN_RAD, 0)} or more, no other")
        change_rad = watch.turned(start_rad)
        most = int(np.argmax(np.abs(change_rad)))
        turns.append(JointTurn(joint, most + 1, float(change_rad[most])))
    return tuple(turns)


class _Watch:
    def __init__(self, bus: ServoBus, clock: Clock, timeout_s: float) -> None:
        self._bus, self._clock = bus, clock
        self._timeout_ns = round(timeout_s * 1e9)

    def _angles(self) -> Array | None:
        """Measure the angles; None if that fails."""
        self._clock.sleep_until(self._clock.now_ns() + _POLL_NS)
        status = self._bus.read(self._clock.now_ns() + self._timeout_ns)
        return self._bus.angle_rad.copy() if status.fresh else None

    def still(self) -> Array:
        """Wait until no joint moves; return the angles."""
        first, since_ns = None, self._clock.now_ns()
        deadline_ns = since_ns + round(PATIENCE_S * 1e9)
        while self._clock.now_ns() < deadline_ns:
            now = self._angles()
            if now is None:
                continue
            if first is None or np.abs(now - first).max() > STILL_RAD:
                first, since_ns = now, self._clock.now_ns()
            elif self._clock.now_ns() - since_ns >= STILL_S * 1e9:
                return now
        raise InputError(
            "doctor", f"found no second in which the joints stand still within {PATIENCE_S:g} s",
            "check cabling and power of the servos, hold the arm still and repeat",
        )  # fmt: skip

    def turned(self, start_rad: Array) -> Array:
        """Wait until a joint has turned; return the changes."""
        deadline_ns = self._clock.now_ns() + round(PATIENCE_S * 1e9)
        while self._clock.now_ns() < deadline_ns:
            now = self._angles()
            if now is not None and np.abs(now - start_rad).max() >= LEAST_TURN_RAD:
                return np.asarray(now - start_rad)
        raise InputError(
            "doctor", f"saw no joint turn by {ANGLE.text(LEAST_TURN_RAD, 0)} in {PATIENCE_S:g} s",
            "turn it further, or check that its servo is one of [[servos]]",
        )  # fmt: skip


EXAMPLE = "dropstitch doctor --bus --config robot.toml"

_MARKS = {Severity.GOOD: "  ", Severity.NOTE: "? ", Severity.SPOILS: "! ",
          Severity.UNCHECKED: "- "}  # fmt: skip


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--bus", action="store_true", help="print the bus's time budget instead")
    parser.add_argument(
        "--check-joints",
        action="store_true",
        help="ask for a turn of each joint by hand, torque off",
    )
    parser.add_argument(
        "--config", type=Path, metavar="ROBOT", help="robot.toml, for --bus or --check-joints"
    )


def run(args: argparse.Namespace) -> int:
    """Run the checks; the verdict is negative if a setting is bad or ids are exchanged."""
    if args.bus and args.check_joints:
        raise InputError("doctor", "is given --bus and --check-joints", "run one after the other")
    if (args.bus or args.check_joints) != (args.config is not None):
        raise InputError(
            "doctor", "needs --bus and --config together, or --check-joints and --config",
            f"like '{EXAMPLE}'",
        )  # fmt: skip
    if args.check_joints:
        return _joints(args, read_config(args.config))
    return _bus(args, read_config(args.config)) if args.bus else _machine(args)


def _machine(args: argparse.Namespace) -> int:
    findings = examine()
    good = all(finding.verdict is not Severity.SPOILS for finding in findings)
    lines = []
    for finding in findings:
        unchecked = "not checked: " if finding.verdict is Severity.UNCHECKED else ""
        lines.append(f"{_MARKS[finding.verdict]}{finding.name}: {unchecked}{finding.found}")
        if finding.remedy:
            lines.append(f"      {finding.remedy}")
    missing = [f.name for f in findings if f.verdict is Severity.UNCHECKED]
    verdict = (
        "nothing that was checked spoils the timing" if good else "correct what is marked with !"
    )
    lines.append(f"{verdict}; not checked: {', '.join(missing)}" if missing else verdict)
    rows = [finding._asdict() | {"verdict": finding.verdict.value} for finding in findings]
    emit(args, {"good": good, "not_checked": missing, "findings": rows}, "\n".join(lines))
    return DONE if good else NEGATIVE


def _joints(args: argparse.Namespace, config: RobotConfig) -> int:
    clock = DeadlineClock()
    ids = tuple(servo.id for servo in config.servos)
    with open_bus(config, clock) as bus:
        bus.connect()
        turns = turn_joints(
            bus, clock, config.bus.reply_timeout_s,
            lambda request: print(f"dropstitch: {request}", file=sys.stderr),
        )  # fmt: skip
    good = all(turn.turned == turn.joint for turn in turns)
    rows = [turn._asdict() for turn in turns]
    emit(args, {"good": good, "turns": rows}, "\n".join(turn.sentence(ids) for turn in turns))
    return DONE if good else NEGATIVE


def _bus(args: argparse.Namespace, config: RobotConfig) -> int:
    plans, budget_s = config.bus_plans(), config.transmission_budget_s
    lines = [
        f"{config.dof} × {config.servos[0].model} at {config.bus.baud:,} baud, return delay "
        f"{DELAY.number(plans[0].return_delay_s)} µs; ms of transmission in a tick",
        f"{'plan':26} {'block':>7} {'read':>7} {'write':>7} {'sum':>7} {'of period':>10} "
        f"{'read twice':>11}",
        *(_row(plan, config.period_s, budget_s) for plan in plans),
        f"there are {DURATION.number(budget_s)} ms; the USB latency timer adds up to its setting "
        "to the read",
        "the first plan that the servos answer at the start is used; a read that fails is repeated "
        "where there is time to read twice",
    ]
    rows = [
        {
            "plan": plan.name, "block_bytes": plan.block.size, "read_s": plan.read_s,
            "write_s": plan.write_s, "total_s": plan.total_s, "fits": plan.total_s <= budget_s,
            "read_twice_s": plan.read_twice_s, "reads_again": plan.read_twice_s <= budget_s,
        }
        for plan in plans
    ]  # fmt: skip
    emit(args, {"good": True, "budget_s": budget_s, "plans": rows}, "\n".join(lines))
    return DONE


def _row(plan: Plan, period_s: float, budget_s: float) -> str:
    times = (plan.read_s, plan.write_s, plan.total_s)
    return (
        f"{plan.name:26} {plan.block.size:5d} B "
        + " ".join(f"{DURATION.number(t, 2):>7}" for t in times)
        + f" {plan.total_s / period_s:10.1%} {DURATION.number(plan.read_twice_s, 2):>11}"
        + _remark(plan, budget_s)
    )


def _remark(plan: Plan, budget_s: float) -> str:
    if plan.total_s > budget_s:
        return "  too slow"
    return "  no time to" if plan.read_twice_s > budget_s else ""
