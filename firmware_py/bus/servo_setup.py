"""Set-up of a servo: its configuration, and its checks and preparation before a run."""

from __future__ import annotations

import math
from typing import NamedTuple

from firmware_py.bus.register_access import RegisterAccess
from firmware_py.bus.registers import (
    POSITION_MODE,
    RETURN_DELAY_STEP_S,
    Register,
    RegisterField,
    describe_alert,
)
from firmware_py.bus.servo_models import MODELS, Model, round_half_away
from firmware_py.errors import InputError

__all__ = ["ServoPreparation", "ServoSetup"]


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


class ServoPreparation:
    """Checks and preparation of servos before a run.

    Parameters
    ----------
    registers : RegisterAccess
        Access to the registers of the servos.
    name : str
        Name of the port in messages.
    return_delay_s : float or None
        Return delay to write to every servo that has a different one; None writes nothing.
    """

    def __init__(self, registers: RegisterAccess, name: str, return_delay_s: float | None) -> None:
        self._registers, self._name, self._return_delay_s = registers, name, return_delay_s

    def prepare(self, servo: ServoSetup) -> int:
        """Check and prepare one servo, torque off; return its firmware version.

        Parameters
        ----------
        servo : ServoSetup
            The servo.

        Raises
        ------
        InputError
            If it is silent, is a different model, reports a hardware error, is not in position mode
            or has narrower limits than the configuration.
        """
        table = servo.model.table
        number = self._get(servo, Register.MODEL_NUMBER)
        if number != servo.model.number:
            found = MODELS[number].name if number in MODELS else f"model number {number}"
            raise self.unfit(
                f"servo {servo.id} is {found}, not {servo.model.name}",
                "correct the model in the configuration",
            )
        self._set(servo, Register.TORQUE_ENABLE, 0)
        if Register.BUS_WATCHDOG in table:
            self._set(servo, Register.BUS_WATCHDOG, 0)  # a tripped one locks the goals
        if bits := self._get(servo, Register.HARDWARE_ERROR):
            raise self.unfit(
                f"servo {servo.id} reports a hardware error ({describe_alert(bits)})",
                "remove its cause, then switch the servo off and on",
            )
        if (mode := self._get(servo, Register.OPERATING_MODE)) != POSITION_MODE:
            raise self.unfit(
                f"servo {servo.id} is in operating mode {mode}",
                f"set register Operating Mode to {POSITION_MODE} (position control)",
            )
        low = servo.model.angle_rad(self._get(servo, Register.MIN_POSITION_LIMIT))
        high = servo.model.angle_rad(self._get(servo, Register.MAX_POSITION_LIMIT))
        if servo.min_angle_rad < low or servo.max_angle_rad > high:
            raise self.unfit(
                f"servo {servo.id} allows {low:.3f} to {high:.3f} rad, the configuration "
                f"{servo.min_angle_rad:.3f} to {servo.max_angle_rad:.3f} rad",
                "narrow limits.angle_rad, or widen the servo's position limits",
            )
        if self._return_delay_s is not None:
            delay = round_half_away(self._return_delay_s / RETURN_DELAY_STEP_S)
            if self._get(servo, Register.RETURN_DELAY) != delay:
                self._set(servo, Register.RETURN_DELAY, delay)
        if Register.BUS_WATCHDOG not in table and math.isfinite(servo.max_rate_rad_s):
            lsb = servo.model.velocity_rad_s_per_lsb
            self._set(servo, Register.PROFILE_VELOCITY, math.ceil(servo.max_rate_rad_s / lsb))
        return self._get(servo, Register.FIRMWARE_VERSION)

    def gather(self, servo: ServoSetup) -> bool:
        """Point the first indirect addresses of a servo to the registers that a tick reads.

        They lie in EEPROM, so they are written only where they differ.

        Returns
        -------
        bool
            Whether the servo confirmed them.
        """
        table = servo.model.table
        entries = [a.to_bytes(2, "little") for a in table.gathered_addresses]
        cell, raw = RegisterField(table.indirect.address, 2 * len(entries)), b"".join(entries)
        wanted = cell.decode(raw)
        registers, id_ = self._registers, servo.id
        return registers.get(id_, cell) == wanted or (
            registers.put(id_, cell, wanted) and registers.get(id_, cell) == wanted
        )

    def unfit(self, what: str, remedy: str) -> InputError:
        """Return the refusal of a servo or of the whole bus.

        Parameters
        ----------
        what, remedy : str
            See `firmware_py.errors.InputError`.
        """
        return InputError(self._name, what, remedy)

    def _get(self, servo: ServoSetup, register: Register) -> int:
        if (raw := self._registers.get(servo.id, servo.model.table[register])) is None:
            raise self._silent(servo, f"read {register.value}")
        return raw

    def _set(self, servo: ServoSetup, register: Register, raw: int) -> None:
        if not self._registers.put(servo.id, servo.model.table[register], raw):
            raise self._silent(servo, f"write {register.value}")

    def _silent(self, servo: ServoSetup, attempt: str) -> InputError:
        return self.unfit(
            f"servo {servo.id} gives no valid answer to '{attempt}'",
            "check its power, cable and id, and that the baud rate is the servo's",
        )
