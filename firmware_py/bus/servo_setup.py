"""Set-up of a servo: its configuration, and its checks and preparation before a run."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final, NamedTuple

from firmware_py.bus.codec import MOST_ID
from firmware_py.bus.port import RegisterAccess
from firmware_py.bus.registers import (
    ANSWERS_ALL,
    POSITION_MODE,
    RETURN_DELAY_STEP_S,
    Register,
    RegisterField,
    describe_alert,
)
from firmware_py.bus.servo_models import GAINS, MODELS, Model, round_half_away
from firmware_py.core.errors import InputError

DRIVE_REVERSE: Final = 1
"""Bit of the register Drive Mode: positions count in reverse. The other bits, time-based profiles
and torque on by a goal, must be zero (docs/sources.md, "Control tables")."""


class AssumedSettings(NamedTuple):
    """Settings that the plant assumes of a servo; a run refuses others."""

    reverse: bool = False  # Whether its positions count in reverse
    homing_offset_rad: float = 0.0  # Angle that the servo adds to its encoder
    gains: Mapping[Register, int] = {}


class ServoSetup(NamedTuple):
    id: int
    model: Model
    min_angle_rad: float  # Range of the goals, within the servo's own position limits
    max_angle_rad: float
    # Largest rate of the goals. A servo without a watchdog gets it as profile velocity, so that it
    # moves no faster after the loop has died; infinity writes nothing.
    max_rate_rad_s: float = math.inf
    settings: AssumedSettings = AssumedSettings()


def check_ids(ids: Sequence[int], where: Path | str) -> None:
    """Refuse ids that no servo has, or that two servos share."""
    if len(set(ids)) < len(ids) or not all(0 <= id_ <= MOST_ID for id_ in ids):
        raise InputError(where, f"servos have the ids {ids}", f"give different ones, 0–{MOST_ID}")


def check_assumed(servo: ServoSetup, where: Path | str) -> None:
    """Refuse settings that the model of the servo does not have."""
    registers = [*servo.settings.gains, *[Register.DRIVE_MODE] * servo.settings.reverse]
    lacking = [r.value for r in registers if r not in servo.model.table]
    if lacking:
        raise InputError(
            where, f"servo {servo.id}: a {servo.model.name} has no {lacking[0]}",
            "leave the key out of [[servos]]",
        )  # fmt: skip
    if not abs(servo.settings.homing_offset_rad) <= math.pi:
        raise InputError(
            where, f"servo {servo.id}: homing_offset_rad is {servo.settings.homing_offset_rad}",
            "give an angle within half a turn, in rad",
        )  # fmt: skip


class ServoPreparation:
    """Checks and preparation of servos before a run.

    `return_delay_s`: return delay for every servo; None keeps theirs.
    """

    def __init__(self, registers: RegisterAccess, name: str, return_delay_s: float | None) -> None:
        self._registers, self._name, self._return_delay_s = registers, name, return_delay_s

    def prepare(self, servo: ServoSetup) -> None:
        """Check and prepare one servo, torque off."""
        table = servo.model.table
        self._identify(servo)
        self._set(servo, Register.TORQUE_ENABLE, 0)
        if Register.BUS_WATCHDOG in table:
            self._set(servo, Register.BUS_WATCHDOG, 0)  # a tripped watchdog locks the goals
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
        self._check_settings(servo)
        self._remove_profile(servo)

    def read_settings(self, servo: ServoSetup) -> dict[str, int]:
        """Return the settings that the plant depends on, as raw values by name of the register."""
        self._identify(servo)
        return {
            register.value: self._get(servo, register)
            for register in (Register.FIRMWARE_VERSION, Register.HOMING_OFFSET, *GAINS.values())
            if register in servo.model.table
        }

    def _identify(self, servo: ServoSetup) -> None:
        """Check that the servo is the expected model and answers reads and writes."""
        remedy = f"set register Status Return Level to {ANSWERS_ALL}, or switch it off and on"
        number = self._registers.get(servo.id, servo.model.table[Register.MODEL_NUMBER])
        if number is None and self._registers.ping(servo.id):
            raise self.unfit(
                f"servo {servo.id} answers a ping but no read: its Status Return Level is 0", remedy
            )
        if number is None:
            raise self._silent(servo, f"read {Register.MODEL_NUMBER.value}")
        if number != servo.model.number:
            actual = MODELS[number].name if number in MODELS else f"model number {number}"
            raise self.unfit(
                f"servo {servo.id} is {actual}, not {servo.model.name}",
                "correct the model in the configuration",
            )
        if (level := self._get(servo, Register.STATUS_RETURN_LEVEL)) < ANSWERS_ALL:
            raise self.unfit(
                f"servo {servo.id} has Status Return Level {level}: it confirms no write", remedy
            )

    def _check_settings(self, servo: ServoSetup) -> None:
        """Refuse a direction, zero or gain that differs from the plant's assumption."""
        table, assumed, name = servo.model.table, servo.settings, f"servo {servo.id}"
        mode = 0
        if Register.DRIVE_MODE in table:  # older firmware has no such register and refuses the read
            mode = self._registers.get(servo.id, table[Register.DRIVE_MODE]) or 0
        if mode != (DRIVE_REVERSE if assumed.reverse else 0):
            direction = (
                "reverse" if mode == DRIVE_REVERSE else "not reverse" if mode == 0 else "other"
            )
            raise self.unfit(
                f"{name} has Drive Mode {mode} ({direction})",
                f"set register Drive Mode to {int(assumed.reverse)}, or correct reverse in "
                "[[servos]]",
            )
        step_rad = servo.model.rad_per_pulse
        offset_rad = self._get(servo, Register.HOMING_OFFSET) * step_rad
        if abs(offset_rad - assumed.homing_offset_rad) > step_rad:
            raise self.unfit(
                f"{name} has a Homing Offset of {offset_rad:.4f} rad, the configuration "
                f"{assumed.homing_offset_rad:.4f} rad",
                "correct homing_offset_rad in [[servos]], or the register",
            )
        for register, wanted in assumed.gains.items():
            if (raw := self._get(servo, register)) != wanted:
                raise self.unfit(
                    f"{name} has {register.value} {raw}, the plant was identified with {wanted}",
                    "restore the register, or identify the plant anew and correct gains in "
                    "[[servos]]",
                )

    def _remove_profile(self, servo: ServoSetup) -> None:
        """Remove the motion profile; a servo without a watchdog keeps the rate limit."""
        table = servo.model.table
        wanted = {Register.PROFILE_ACCELERATION: 0, Register.PROFILE_VELOCITY: 0}
        if Register.BUS_WATCHDOG not in table:
            rate, lsb = servo.max_rate_rad_s, servo.model.velocity_rad_s_per_lsb
            del wanted[Register.PROFILE_VELOCITY]
            if math.isfinite(rate):
                wanted[Register.PROFILE_VELOCITY] = math.ceil(rate / lsb)
        for register, raw in wanted.items():
            if self._get(servo, register) != raw:
                self._set(servo, register, raw)

    def gather(self, servo: ServoSetup) -> bool:
        """Point the first indirect addresses of a servo to the registers that a tick reads.

        They lie in EEPROM, so they are written only if they differ.
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
        """Return the error that refuses a servo or the whole bus."""
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
