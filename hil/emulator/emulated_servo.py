"""Emulated DYNAMIXEL servo: its registers, their access rights and their effect.

The servo has no dynamics of its own: the plant contains the closed servo loop. The servo converts
its registers into the goal of the plant (`goal_rad`), and the plant's state (`observe`) into
registers with the model's resolution.

Semantics follow the e-Manual's control tables and its Protocol 2.0 (docs/sources.md, "Control
tables"). Where the manual is silent, this is assumed:

- With the torque off the gear holds the angle (502:1, friction above the link's torque) and the
  current reads 0.
- Only the position modes exist (3 position, 4 extended); another mode is a data range error.
- Profile registers have no effect: the loop sends a goal every 17 ms.
- A reboot takes no time.
"""

from __future__ import annotations

from typing import Final

from firmware_py.bus.codec import ALERT, MOST_ID, StatusError, word
from firmware_py.bus.registers import (
    ANSWERS_ALL,
    MOST_WATCHDOG_STEPS,
    POSITION_MODE,
    RETURN_DELAY_STEP_S,
    WATCHDOG_STEP_S,
    WATCHDOG_TRIPPED,
    Register,
    RegisterField,
)
from firmware_py.bus.servo_models import Model

EXTENDED_POSITION_MODE: Final = 4
BAUD_OF_CODE: Final = {
    0: 9600, 1: 57_600, 2: 115_200, 3: 1_000_000, 4: 2_000_000, 5: 3_000_000, 6: 4_000_000,
}  # fmt: skip
"""Baud rate for each value of its register (assumed; the legacy PRO has 2400 instead of 9600)."""

_GOALS = (Register.GOAL_POSITION, Register.GOAL_VELOCITY, Register.GOAL_CURRENT)
_FIRMWARE_VERSION = 46
_VOLTAGE_RAW, _TEMPERATURE_DEGC = 240, 35
_MEMORY_BYTES: Final = 1024

_RANGES: Final = {
    Register.ID: (0, MOST_ID),
    Register.BAUD_RATE: (min(BAUD_OF_CODE), max(BAUD_OF_CODE)),
    Register.RETURN_DELAY: (0, 254),
    Register.OPERATING_MODE: (POSITION_MODE, EXTENDED_POSITION_MODE),
    Register.TORQUE_ENABLE: (0, 1),
    Register.STATUS_RETURN_LEVEL: (0, ANSWERS_ALL),
    Register.BUS_WATCHDOG: (0, MOST_WATCHDOG_STEPS),
}
"""Values that a register accepts; a register that is not listed accepts any that fits its bytes."""


class EmulatedServo:
    """Servo on the bus; `return_delay_s` is its pause before a status packet (factory: 500 µs)."""

    def __init__(
        self, model: Model, servo_id: int = 1, baud: int = 1_000_000, return_delay_s: float = 500e-6
    ) -> None:
        self.model = model
        self._table = model.table
        self._memory = bytearray(_MEMORY_BYTES)
        self._spans: dict[tuple[int, int], list[int]] = {}
        self._cell_at = {cell.address: (r, cell) for r, cell in model.table.cells.items()}
        self._present = tuple(
            model.table[register]
            for register in (
                Register.PRESENT_POSITION, Register.PRESENT_VELOCITY, Register.PRESENT_CURRENT
            )
        )  # fmt: skip
        self._hold_rad = 0.0
        self._angle_rad = 0.0
        self._fed_ns = 0
        self._refresh()
        code = next(code for code, rate in BAUD_OF_CODE.items() if rate == baud)
        turn = model.pulses_per_turn
        low, high = (0, turn - 1) if model.zero_pulse else (-turn // 2, turn // 2)
        for register, raw in {
            Register.MODEL_NUMBER: model.number,
            Register.FIRMWARE_VERSION: _FIRMWARE_VERSION,
            Register.ID: servo_id,
            Register.BAUD_RATE: code,
            Register.RETURN_DELAY: round(return_delay_s / RETURN_DELAY_STEP_S),
            Register.OPERATING_MODE: POSITION_MODE,
            Register.MAX_POSITION_LIMIT: high,
            Register.MIN_POSITION_LIMIT: low,
            Register.PRESENT_INPUT_VOLTAGE: _VOLTAGE_RAW,
            Register.PRESENT_TEMPERATURE: _TEMPERATURE_DEGC,
            **model.factory,
        }.items():
            self.put(register, raw)
        self._reset_indirect()
        self.reboot()

    # --- registers as the servo's own firmware sees them ---------------------------------------

    def get(self, register: Register) -> int:
        """Return the raw value of a register; 0 if the model lacks it."""
        cell = self._table.cells.get(register)
        return cell.decode(self._memory, cell.address) if cell else 0

    def put(self, register: Register, raw: int) -> None:
        """Set a register regardless of access rights, and apply its effect.

        No effect if the model lacks it.
        """
        if register in self._table:
            self._store(self._table[register], raw)
        if register is Register.GOAL_POSITION:
            self._follow_goal()
        else:
            self._refresh()

    def _reset_indirect(self) -> None:
        """Restore the factory setting, in which each indirect entry points at itself."""
        indirect = self._table.indirect
        for k in range(indirect.entries):
            self._store(RegisterField(indirect.address + 2 * k, 2), indirect.data + k)
        self._spans.clear()

    def _store(self, cell: RegisterField, raw: int) -> None:
        self._memory[cell.address : cell.address + cell.size] = cell.encode(raw)

    def _refresh(self) -> None:
        """Update the attributes that line and plant read in every tick."""
        self.id = self.get(Register.ID)
        self.baud = BAUD_OF_CODE[self.get(Register.BAUD_RATE)]
        self.return_delay_ns = self.get(Register.RETURN_DELAY) * round(RETURN_DELAY_STEP_S * 1e9)
        self.alert = ALERT if self.get(Register.HARDWARE_ERROR) else 0
        watchdog = self.get(Register.BUS_WATCHDOG)
        self.torque_on = bool(self.get(Register.TORQUE_ENABLE))
        self.watchdog_tripped = watchdog < 0
        armed = watchdog if self.torque_on and not self.watchdog_tripped else 0
        self._watchdog_ns = armed * round(WATCHDOG_STEP_S * 1e9)
        self._offset_raw = self.get(Register.HOMING_OFFSET)
        self._follow_goal()

    def _follow_goal(self) -> None:
        self.goal_rad = self._hold_rad
        if self.torque_on and not self.watchdog_tripped:
            self.goal_rad = self.model.angle_rad(
                self.get(Register.GOAL_POSITION) - self._offset_raw
            )

    # --- physics -------------------------------------------------------------------------------

    def observe(self, angle_rad: float, velocity_rad_s: float, current_a: float) -> None:
        """Write the plant's state into the present registers, quantised and clipped."""
        model = self.model
        self._angle_rad = angle_rad
        raws = (
            round(angle_rad / model.rad_per_pulse) + model.zero_pulse + self._offset_raw,
            round(velocity_rad_s / model.velocity_rad_s_per_lsb),
            round(current_a / model.current_a_per_lsb) if self.torque_on else 0,
        )
        for cell, raw in zip(self._present, raws, strict=True):
            limit = 1 << (8 * cell.size - 1)
            self._store(cell, max(-limit, min(limit - 1, raw)))

    # --- protection ----------------------------------------------------------------------------

    def fail(self, bits: int) -> None:
        """Set hardware error bits; those in the shutdown mask switch the torque off."""
        self.put(Register.HARDWARE_ERROR, self.get(Register.HARDWARE_ERROR) | bits)
        if self._shut_down:
            self._release()

    @property
    def _shut_down(self) -> bool:
        return bool(self.get(Register.HARDWARE_ERROR) & self.get(Register.SHUTDOWN))

    @property
    def watchdog_due_ns(self) -> int | None:
        """Time at which the bus watchdog trips unless it is fed; None if it is not armed."""
        return self._fed_ns + self._watchdog_ns if self._watchdog_ns else None

    def trip_watchdog(self) -> None:
        """Stop at the present angle and lock the goals until 0 is written to the watchdog."""
        self._hold_rad = self._angle_rad
        self.put(Register.BUS_WATCHDOG, WATCHDOG_TRIPPED)

    def feed_watchdog(self, now_ns: int) -> None:
        """Restart the watchdog, after an instruction for any servo on the bus."""
        self._fed_ns = now_ns

    def _release(self) -> None:
        self._hold_rad = self._angle_rad
        self.put(Register.TORQUE_ENABLE, 0)

    def reboot(self) -> None:
        """Set the RAM area to its initial values; keep the EEPROM."""
        self._release()
        if self._table.indirect.address >= self._table.ram_start:
            self._reset_indirect()
        for register in (Register.HARDWARE_ERROR, Register.BUS_WATCHDOG, *_GOALS):
            self.put(register, 0)
        self.put(Register.STATUS_RETURN_LEVEL, ANSWERS_ALL)
        for register, raw in self.model.factory.items():
            if self._table[register].address >= self._table.ram_start:
                self.put(register, raw)
        self.observe(self._angle_rad, 0.0, 0.0)

    # --- registers as the bus sees them --------------------------------------------------------

    def read(self, address: int, length: int) -> tuple[int, bytes]:
        """Read registers; return the error number and, if it is 0, the bytes."""
        if length == 0:
            return StatusError.DATA_LENGTH, b""
        if address + length > _MEMORY_BYTES:
            return StatusError.ACCESS, b""
        if not self._is_redirected(address, length):
            return StatusError.NONE, bytes(self._memory[address : address + length])
        memory = self._memory
        return StatusError.NONE, bytes([memory[a] for a in self._span(address, length)])

    def covers(self, address: int, length: int, register: Register) -> bool:
        """Return whether a read, through indirect addresses, covers a register's first byte."""
        wanted = self._table[register].address
        if not self._is_redirected(address, length):
            return address <= wanted < address + length
        return wanted in self._span(address, length)

    def _is_redirected(self, address: int, length: int) -> bool:
        data = self._table.indirect.data
        return address + length > data and address < data + self._table.indirect.entries

    def write(self, address: int, data: bytes) -> int:
        """Write complete registers in order; if one is refused, none changes.

        Returns the error number of the status packet.
        """
        fields = []
        indirect = self._table.indirect
        if indirect.address <= address < indirect.address + 2 * indirect.entries:
            return self._redirect(address, data)
        while data:
            address = self._referred(address)
            if address not in self._cell_at:
                return StatusError.ACCESS
            register, cell = self._cell_at[address]
            if len(data) < cell.size:
                return StatusError.DATA_LENGTH
            raw = cell.decode(data)
            if error := self._refusal(register, cell, raw):
                return error
            fields.append((register, raw))
            address, data = address + cell.size, data[cell.size :]
        if not fields:
            return StatusError.DATA_LENGTH
        for register, raw in fields:
            self._apply(register, raw)
        return StatusError.NONE

    def _redirect(self, address: int, data: bytes) -> int:
        end = self._table.indirect.address + 2 * self._table.indirect.entries
        if address < self._table.ram_start and self.torque_on:
            return StatusError.ACCESS
        if address + len(data) > end:
            return StatusError.DATA_LENGTH
        self._memory[address : address + len(data)] = data
        self._spans.clear()
        return StatusError.NONE

    def _span(self, address: int, length: int) -> list[int]:
        """Addresses that a read refers to; cached, because a program repeats it in every tick."""
        span = self._spans.get((address, length))
        if span is None:
            span = [self._referred(address + k) for k in range(length)]
            self._spans[address, length] = span
        return span

    def _referred(self, address: int) -> int:
        """Address after indirection: the content of its indirect entry, or the address itself."""
        entry = self._table.indirect.entry_of(address)
        if entry is None:
            return address
        behind = word(self._memory, entry)
        return behind if behind < _MEMORY_BYTES else address

    def _refusal(self, register: Register, cell: RegisterField, raw: int) -> int:
        if not cell.writable or (cell.address < self._table.ram_start and self.torque_on):
            return StatusError.ACCESS
        low, high = _RANGES.get(register, (raw, raw))
        if not low <= raw <= high:
            return StatusError.DATA_RANGE
        if register in _GOALS and self.watchdog_tripped:
            return StatusError.DATA_RANGE
        if register is Register.TORQUE_ENABLE and raw and self._shut_down:
            return StatusError.RESULT_FAIL
        if register is Register.GOAL_POSITION and not self._within_limits(raw):
            return StatusError.DATA_LIMIT
        return StatusError.NONE

    def _within_limits(self, raw: int) -> bool:
        if self.get(Register.OPERATING_MODE) == EXTENDED_POSITION_MODE:
            return True
        low = self.get(Register.MIN_POSITION_LIMIT)
        return low <= raw <= self.get(Register.MAX_POSITION_LIMIT)

    def _apply(self, register: Register, raw: int) -> None:
        if register is Register.TORQUE_ENABLE:
            if raw and not self.torque_on:  # the goal starts at the present position
                self.put(Register.GOAL_POSITION, self.get(Register.PRESENT_POSITION))
            elif not raw:
                self._release()
        self.put(register, raw)
