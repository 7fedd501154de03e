"""Bus of Dynamixel servos, driven through the official SDK."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_py.bus.bus_plan import FACTORY_RETURN_DELAY_S, Plan, plain, plans
from firmware_py.bus.feedback import FeedbackReader
from firmware_py.bus.goal_writer import GoalWriter
from firmware_py.bus.port import DeadlinePort, PacketHandler
from firmware_py.bus.register_access import SETUP_ATTEMPTS, SETUP_TIMEOUT_NS, RegisterAccess
from firmware_py.bus.registers import (
    POSITION_MODE,
    RETURN_DELAY_STEP_S,
    WATCHDOG_STEP_S,
    Register,
    RegisterField,
    describe_alert,
)
from firmware_py.bus.servo_bus import BusStatus
from firmware_py.bus.servo_models import MODELS, Model, round_half_away
from firmware_py.bus.transport import Transport
from firmware_py.errors import InputError
from firmware_py.realtime.clock import Clock

__all__ = ["DynamixelBus", "ServoSetup", "watchdog_steps"]

Array = NDArray[np.float64]

_TRIAL_READS: Final = 5
_WATCHDOG_PERIODS: Final = 3


class ServoSetup(NamedTuple):
    """Configuration of one servo.

    Attributes
    ----------
    id : int
        Id on the bus.
    model : Model
        Expected model.
    min_angle_rad, max_angle_rad : float
        Range of the goals; the servo's own position limits must contain it.
    max_rate_rad_s : float
        Largest rate of the goals. It is written as profile velocity to a servo without a watchdog,
        so that the servo moves no faster when the loop has died; infinity writes nothing.
    """

    id: int
    model: Model
    min_angle_rad: float
    max_angle_rad: float
    max_rate_rad_s: float = math.inf


class DynamixelBus:
    """Servos of one control table on one bus; implements `firmware_py.bus.servo_bus.ServoBus`.

    Parameters
    ----------
    transport : Transport
        Byte stream to the servos, see `firmware_py.bus.transport.open_transport`.
    servos : sequence of ServoSetup
        One per joint, in joint order.
    clock : Clock
        Clock of the deadlines.
    period_s : float
        Control period; the servos' watchdog is set to at least three periods.
    return_delay_s : float, optional
        Return delay to write to every servo that has a different one; None writes nothing.
    name : str
        Name of the port in messages.
    baud : int
        Bits per second of the line.
    reply_timeout_s : float, optional
        Longest wait for the servos in a tick; `connect` refuses servos that are slower.
    opener : callable, optional
        Opens the transport anew, or raises InputError; without it a port that has gone stays gone.

    Attributes
    ----------
    plan : Plan
        Plan by which the servos are read, chosen by `connect`.
    firmware_versions : tuple of int
        Of the servos in joint order, read by `connect`.

    Raises
    ------
    InputError
        If the servos do not share one control table.
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
        self.firmware_versions: tuple[int, ...] = ()
        self._servos, self._name, self._clock = tuple(servos), name, clock
        self._period_s, self._return_delay_s = period_s, return_delay_s
        self._port = DeadlinePort(transport, clock, name, baud)
        self._packets = PacketHandler()
        self._registers = RegisterAccess(self._port, self._packets, clock)
        self._models = {servo.id: servo.model for servo in servos}
        self._table = servos[0].model.table
        self._goals = GoalWriter(self._port, self._packets, self._models)
        self._driven = False  # torque may be on
        self._driving = False  # every servo has confirmed torque on
        self._reply_timeout_s, self._opener = reply_timeout_s, opener
        delay_s = FACTORY_RETURN_DELAY_S if return_delay_s is None else return_delay_s
        self._plans = plans(self._table, self.dof, baud, delay_s)
        self._follow(plain(self._plans))

    @property
    def wait_ns(self) -> int:
        """Time spent waiting for the servos since the start."""
        return self._port.wait_ns

    # In the loop -------------------------------------------------------------------------------

    def read(self, deadline_ns: int) -> BusStatus:
        """Measure all servos with one sync read, or two; all are fresh or none is.

        Parameters
        ----------
        deadline_ns : int
            End of the wait for the answers, on the bus's clock.
        """
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
            self._port.is_using = False
            return BusStatus.PORT_GONE

    def _note_alert(self) -> None:
        """Read the cause of an alert once, within the deadline of the read."""
        if self._feedback.alert and self.alert == 0:
            cell = self._table[Register.HARDWARE_ERROR]
            for id_ in self._models:
                self.alert |= self._registers.ask(id_, cell) or 0
        if self._driving:
            self.alert |= self._feedback.standing

    def write(self, goal_rad: Array, deadline_ns: int) -> BusStatus:
        """Send all goals with one sync write, which no servo answers.

        Parameters
        ----------
        goal_rad : ndarray, shape (dof,)
            Goal angles.
        deadline_ns : int
            End of the slot, on the bus's clock.

        Raises
        ------
        ValueError
            If a goal is not finite or does not fit the register: an error of the caller, whose
            supervisor admits only goals within limits.
        """
        self._port.deadline_ns = deadline_ns
        try:
            return self._goals.put(goal_rad)
        except OSError:
            self._port.is_using = False
            return BusStatus.PORT_GONE

    # Around the loop ---------------------------------------------------------------------------

    def connect(self) -> None:
        """Check and prepare every servo, torque off; choose the plan.

        Raises
        ------
        InputError
            If a servo is silent, is a different model, reports a hardware error, is not in position
            mode, has narrower limits than the configuration, or answers too slowly.
        """
        self.alert, self._driving = 0, False
        self.firmware_versions = tuple(self._prepare(servo) for servo in self._servos)
        if (status := self._choose_plan()) > BusStatus.RETRIED:
            raise self._unfit(f"first measurement failed ({status.name})", "check the cabling")
        self._check_replies()

    def _follow(self, plan: Plan) -> None:
        """Read the servos by this plan from now on."""
        self.plan = plan
        self._feedback = FeedbackReader(self._port, self._packets, self._clock, self._models, plan)

    def _choose_plan(self) -> BusStatus:
        """Follow the fastest plan that the servos answer; return the status of the last attempt."""
        status = BusStatus.OK
        for plan in self._plans:
            if plan.indirect and not all(self._gather(servo) for servo in self._servos):
                continue
            self._follow(plan)
            for _ in range(SETUP_ATTEMPTS):
                status = self.read(self._clock.now_ns() + SETUP_TIMEOUT_NS)
                if status <= BusStatus.ALERT:
                    return status
        return status

    def _gather(self, servo: ServoSetup) -> bool:
        """Point the first indirect addresses of a servo to the registers that a tick reads.

        They lie in EEPROM, so they are written only where they differ.
        """
        entries = [a.to_bytes(2, "little") for a in self._table.gathered_addresses]
        cell, raw = RegisterField(self._table.indirect.address, 2 * len(entries)), b"".join(entries)
        wanted = cell.decode(raw)
        registers, id_ = self._registers, servo.id
        return registers.get(id_, cell) == wanted or (
            registers.put(id_, cell, wanted) and registers.get(id_, cell) == wanted
        )

    def _check_replies(self) -> None:
        """Measure the duration of an exchange; refuse servos or adapters that are too slow."""
        taken_ns = []
        for _ in range(_TRIAL_READS):
            start_ns = self._clock.now_ns()
            self.read(start_ns + SETUP_TIMEOUT_NS)
            taken_ns.append(self._clock.now_ns() - start_ns)
        usual_ns = self._feedback.usual_ns = sorted(taken_ns)[_TRIAL_READS // 2]
        timeout_s = self._reply_timeout_s
        if timeout_s is not None and usual_ns > round(timeout_s * 1e9):
            raise self._unfit(
                f"answers take {usual_ns / 1e6:.1f} ms, bus.reply_timeout_s allows "
                f"{timeout_s * 1e3:g} ms",
                "set the adapter's latency timer to 1 ms ('dropstitch install-service' does), or "
                "raise the baud rate",
            )

    def _prepare(self, servo: ServoSetup) -> int:
        """Check one servo; return its firmware version."""
        number = self._get(servo, Register.MODEL_NUMBER)
        if number != servo.model.number:
            found = MODELS[number].name if number in MODELS else f"model number {number}"
            raise self._unfit(
                f"servo {servo.id} is {found}, not {servo.model.name}",
                "correct the model in the configuration",
            )
        self._set(servo, Register.TORQUE_ENABLE, 0)
        if Register.BUS_WATCHDOG in self._table:
            self._set(servo, Register.BUS_WATCHDOG, 0)  # a tripped one locks the goals
        if bits := self._get(servo, Register.HARDWARE_ERROR):
            raise self._unfit(
                f"servo {servo.id} reports a hardware error ({describe_alert(bits)})",
                "remove its cause, then switch the servo off and on",
            )
        if (mode := self._get(servo, Register.OPERATING_MODE)) != POSITION_MODE:
            raise self._unfit(
                f"servo {servo.id} is in operating mode {mode}",
                f"set register Operating Mode to {POSITION_MODE} (position control)",
            )
        low = servo.model.angle_rad(self._get(servo, Register.MIN_POSITION_LIMIT))
        high = servo.model.angle_rad(self._get(servo, Register.MAX_POSITION_LIMIT))
        if servo.min_angle_rad < low or servo.max_angle_rad > high:
            raise self._unfit(
                f"servo {servo.id} allows {low:.3f} to {high:.3f} rad, the configuration "
                f"{servo.min_angle_rad:.3f} to {servo.max_angle_rad:.3f} rad",
                "narrow limits.angle_rad, or widen the servo's position limits",
            )
        if self._return_delay_s is not None:
            delay = round_half_away(self._return_delay_s / RETURN_DELAY_STEP_S)
            if self._get(servo, Register.RETURN_DELAY) != delay:
                self._set(servo, Register.RETURN_DELAY, delay)
        if Register.BUS_WATCHDOG not in self._table and math.isfinite(servo.max_rate_rad_s):
            lsb = servo.model.velocity_rad_s_per_lsb
            self._set(servo, Register.PROFILE_VELOCITY, math.ceil(servo.max_rate_rad_s / lsb))
        return self._get(servo, Register.FIRMWARE_VERSION)

    def _unfit(self, what: str, remedy: str) -> InputError:
        return InputError(self._name, what, remedy)

    def _get(self, servo: ServoSetup, register: Register) -> int:
        if (raw := self._registers.get(servo.id, self._table[register])) is None:
            raise self._silent(servo, f"read {register.value}")
        return raw

    def _set(self, servo: ServoSetup, register: Register, raw: int) -> None:
        if not self._registers.put(servo.id, self._table[register], raw):
            raise self._silent(servo, f"write {register.value}")

    def _silent(self, servo: ServoSetup, attempt: str) -> InputError:
        return self._unfit(
            f"servo {servo.id} gives no good answer to '{attempt}'",
            "check its power, cable and id, and that the baud rate is the servo's",
        )

    def torque(self, on: bool) -> BusStatus:
        """Switch the torque of every servo, and arm or disarm its watchdog.

        Every servo is tried, whatever the others answer.

        Returns
        -------
        BusStatus
            OK where every servo confirmed it, else TIMEOUT.
        """
        watchdog = watchdog_steps(self._period_s) if on else 0
        good = True
        self._driven, self._driving = self._driven or on, False
        for servo in self._servos:
            good &= self._registers.put(servo.id, self._table[Register.TORQUE_ENABLE], int(on))
        if Register.BUS_WATCHDOG in self._table:
            for servo in self._servos:
                good &= self._registers.put(servo.id, self._table[Register.BUS_WATCHDOG], watchdog)
        if good:
            self._driven = self._driving = on
        return BusStatus.OK if good else BusStatus.TIMEOUT

    def reopen(self) -> bool:
        """Open the port again after it had gone; nothing is sent to the servos yet."""
        if self._opener is None:
            return False
        with contextlib.suppress(OSError):
            self._port.closePort()
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
            self._port.closePort()


def watchdog_steps(period_s: float) -> int:
    """Return the value of the watchdog register for a control period, in steps of 20 ms."""
    return math.ceil(_WATCHDOG_PERIODS * period_s / WATCHDOG_STEP_S)
