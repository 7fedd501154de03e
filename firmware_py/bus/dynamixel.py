"""Bus of DYNAMIXEL servos: connecting, reading and writing in the loop, torque, replugging."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from firmware_py.bus.bus_plan import FACTORY_RETURN_DELAY_S, Plan, plain, plans
from firmware_py.bus.exchange import FeedbackReader, GoalWriter
from firmware_py.bus.port import (
    SETUP_ATTEMPTS,
    SETUP_TIMEOUT_NS,
    DeadlinePort,
    RegisterAccess,
)
from firmware_py.bus.registers import (
    MOST_WATCHDOG_STEPS,
    WATCHDOG_STEP_S,
    Register,
    RegisterField,
    describe_alert,
)
from firmware_py.bus.servo_bus import BusStatus
from firmware_py.bus.servo_setup import ServoPreparation, ServoSetup
from firmware_py.bus.transport import Transport
from firmware_py.core.errors import InputError
from firmware_py.core.units import DURATION, TICK_TIME
from firmware_py.system.clock import Clock

__all__ = ["DynamixelBus", "watchdog_steps"]

Array = NDArray[np.float64]

_TRIAL_READS: Final = 12
_WATCHDOG_PERIODS: Final = 3


class DynamixelBus:
    """Servos of one control table on one bus; implements `firmware_py.bus.servo_bus.ServoBus`.

    `period_s`: control period; the servos' watchdog is set to at least three periods.
    `return_delay_s`: return delay for every servo; None keeps theirs.
    `reply_timeout_s`: longest wait for the servos in a tick; `connect` refuses slower servos.
    `opener`: opens the transport again after a disconnect, or raises InputError; without it,
    `reopen` returns False.
    """

    def __init__(
        self,
        transport: Transport,
        servos: Sequence[ServoSetup],
        clock: Clock,
        *,
        period_s: float,
        return_delay_s: float | None = None,
        name: str = "bus",
        baud: int = 1_000_000,
        reply_timeout_s: float | None = None,
        opener: Callable[[], Transport] | None = None,
    ) -> None:
        tables = {servo.model.table.name for servo in servos}
        if len(tables) > 1:
            raise InputError(
                name, f"servos of different control tables ({', '.join(sorted(tables))}) share it",
                "use one family per bus: one synchronous read needs one address",
            )  # fmt: skip
        self.dof = len(servos)
        self.angle_rad = np.zeros(self.dof)
        self.current_a = np.zeros(self.dof)
        self.alert = 0
        self._servos, self._clock = tuple(servos), clock
        self._port = DeadlinePort(transport, clock)
        self._registers = RegisterAccess(self._port, clock)
        self._models = {servo.id: servo.model for servo in servos}
        self._table = servos[0].model.table
        self._preparation = ServoPreparation(self._registers, name, return_delay_s)
        self._goals = GoalWriter(self._port, self._models)
        self._watchdog = 0
        if Register.BUS_WATCHDOG in self._table:
            self._watchdog = watchdog_steps(period_s)
        self._driven = False  # torque may be on
        self._driving = False  # every servo has confirmed torque on
        self._reply_timeout_s, self._opener = reply_timeout_s, opener
        delay_s = FACTORY_RETURN_DELAY_S if return_delay_s is None else return_delay_s
        self._plans = plans(self._table, self.dof, baud, delay_s)
        self._follow(plain(self._plans))

    @property
    def late_ns(self) -> int:
        """Delay of the last measurement after the start of its read; see `ServoBus`."""
        return self._feedback.late_ns

    @property
    def wait_ns(self) -> int:
        return self._port.wait_ns

    # In the loop -------------------------------------------------------------------------------

    def read(self, deadline_ns: int) -> BusStatus:
        """Measure all servos with one sync read and at most one retry; all are fresh or none is."""
        feedback = self._feedback
        try:
            status = feedback.take(deadline_ns)
            if not status.fresh:
                return status
            self.angle_rad[:] = feedback.angle_rad
            self.current_a[:] = feedback.current_a
            if feedback.alert or (self._driving and feedback.standing):
                self._note_alert()
                return BusStatus.ALERT
            return status
        except OSError:
            return BusStatus.PORT_GONE

    def _note_alert(self) -> None:
        """Read the cause of an alert once, within the deadline of the read."""
        if self._feedback.alert and self.alert == 0:
            self.alert = self._hardware_errors(self._registers.read_once)
        if self._driving:
            self.alert |= self._feedback.standing

    def _hardware_errors(self, read: Callable[[int, RegisterField], int | None]) -> int:
        """Return the bitwise or of the hardware errors of all servos."""
        bits = 0
        for id_ in self._models:
            bits |= read(id_, self._table[Register.HARDWARE_ERROR]) or 0
        return bits

    def write(self, goal_rad: Array, deadline_ns: int) -> BusStatus:
        """Send all goals, shape (dof,), with one sync write, which no servo answers."""
        self._port.deadline_ns = deadline_ns
        try:
            return self._goals.put(goal_rad)
        except OSError:
            return BusStatus.PORT_GONE

    # Around the loop ---------------------------------------------------------------------------

    def connect(self) -> None:
        """Check and prepare every servo, torque off, and choose the plan of the reads."""
        self.alert, self._driving = 0, False
        for servo in self._servos:
            self._preparation.prepare(servo)
        if (status := self._choose_plan()) > BusStatus.RETRIED:
            raise self._preparation.unfit(
                f"first measurement failed ({status.name})", "check the cabling"
            )
        self._check_replies()
        if self.alert:
            raise self._preparation.unfit(
                f"a servo raises an alert ({describe_alert(self.alert)})",
                "remove its cause, then switch the servo off and on",
            )

    def read_settings(self) -> tuple[dict[str, int], ...]:
        """Return the servo settings that the plant depends on, without writing any."""
        return tuple(map(self._preparation.read_settings, self._servos))

    def _follow(self, plan: Plan) -> None:
        """Use a plan for all further reads."""
        self.plan = plan
        self._feedback = FeedbackReader(self._port, self._clock, self._models, plan)

    def _choose_plan(self) -> BusStatus:
        """Use the fastest plan that the servos answer; return the status of the last attempt."""
        status = BusStatus.OK
        for plan in self._plans:
            if plan.indirect and not all(map(self._preparation.gather, self._servos)):
                continue
            self._follow(plan)
            for _ in range(SETUP_ATTEMPTS):
                status = self.read(self._clock.now_ns() + SETUP_TIMEOUT_NS)
                if status <= BusStatus.ALERT:
                    return status
        return status

    def _check_replies(self) -> None:
        """Measure the duration of an exchange; refuse servos or adapters that are too slow.

        The lower quartile decides: a slow adapter delays every exchange, a busy computer only some.
        """
        taken_ns = []
        for _ in range(_TRIAL_READS):
            start_ns = self._clock.now_ns()
            self.read(start_ns + SETUP_TIMEOUT_NS)
            taken_ns.append(self._clock.now_ns() - start_ns)
        taken_ns.sort()
        self._feedback.usual_ns = taken_ns[_TRIAL_READS // 2]
        quick_ns, timeout_s = taken_ns[_TRIAL_READS // 4], self._reply_timeout_s
        if timeout_s is not None and quick_ns > round(timeout_s * 1e9):
            raise self._preparation.unfit(
                f"answers take {TICK_TIME.number(quick_ns, 1)} ms, bus.reply_timeout_s allows "
                f"{DURATION.factor * timeout_s:g} ms",
                "set the adapter's latency timer to 1 ms ('dropstitch install-service' does), or "
                "raise the baud rate",
            )

    def torque(self, on: bool) -> BusStatus:
        """Switch the torque of every servo, and arm or disarm its watchdog.

        Every servo is switched, even if another one fails. A servo counts as off once it has
        confirmed the instruction and then reports torque off. The result is OK or TIMEOUT.
        """
        good = True
        self._driven, self._driving = self._driven or on, False
        self._registers.alert = False
        for servo in self._servos:
            good &= self._switch(servo.id, on)
        if Register.BUS_WATCHDOG in self._table:
            for servo in self._servos:
                cell = self._table[Register.BUS_WATCHDOG]
                good &= self._registers.put(servo.id, cell, self._watchdog if on else 0)
        if good:
            self._driven = self._driving = on
        if self._registers.alert and self.alert == 0:
            self.alert = self._hardware_errors(self._registers.get)
        return BusStatus.OK if good else BusStatus.TIMEOUT

    def _switch(self, id_: int, on: bool) -> bool:
        """Switch the torque of one servo; return whether the servo confirmed it."""
        registers, cell = self._registers, self._table[Register.TORQUE_ENABLE]
        for _ in range(SETUP_ATTEMPTS):
            if not registers.put(id_, cell, int(on)):
                return False
            if on or registers.get(id_, cell) == 0:
                return True
        return False

    def reopen(self) -> bool:
        """Open a disconnected port again, if it is back; nothing is sent to the servos yet."""
        if self._opener is None:
            return False
        with contextlib.suppress(OSError):
            self._port.close()
        try:
            self._port.replace(self._opener())
        except InputError:
            return False
        return True

    def close(self) -> None:
        """Switch the torque off if it may be on, and close the port; never raises."""
        with contextlib.suppress(OSError):
            if self._driven:
                self.torque(False)
        with contextlib.suppress(OSError):
            self._port.close()


def watchdog_steps(period_s: float, where: Path | str = "robot") -> int:
    """Return the value of the watchdog register for a control period, in steps of 20 ms.

    `where`: source of the period, named where the register cannot hold three periods.
    """
    steps = math.ceil(_WATCHDOG_PERIODS * period_s / WATCHDOG_STEP_S)
    if steps > MOST_WATCHDOG_STEPS:
        most_s = MOST_WATCHDOG_STEPS * WATCHDOG_STEP_S / _WATCHDOG_PERIODS
        raise InputError(
            where, f"period_s is {period_s:g} s, too long for the bus watchdog of these servos",
            f"give at most {math.floor(1e3 * most_s) / 1e3:g} s",
        )  # fmt: skip
    return steps
