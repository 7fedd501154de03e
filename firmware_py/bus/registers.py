"""Control tables: the registers of a servo family, their place and format, and what values mean.

The tables themselves are data (`servos.toml`, read by `firmware_py.bus.servo_models`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Final, NamedTuple


class Register(Enum):
    """Registers that this project uses; the value is the name in the e-Manual."""

    __hash__ = object.__hash__  # every tick looks registers up; that of `Enum` is in Python
    MODEL_NUMBER = "Model Number"
    FIRMWARE_VERSION = "Firmware Version"
    ID = "ID"
    BAUD_RATE = "Baud Rate"
    RETURN_DELAY = "Return Delay Time"
    DRIVE_MODE = "Drive Mode"
    OPERATING_MODE = "Operating Mode"
    HOMING_OFFSET = "Homing Offset"
    CURRENT_LIMIT = "Current Limit"
    VELOCITY_LIMIT = "Velocity Limit"
    MAX_POSITION_LIMIT = "Max Position Limit"
    MIN_POSITION_LIMIT = "Min Position Limit"
    SHUTDOWN = "Shutdown"
    TORQUE_ENABLE = "Torque Enable"
    STATUS_RETURN_LEVEL = "Status Return Level"
    HARDWARE_ERROR = "Hardware Error Status"
    VELOCITY_I_GAIN = "Velocity I Gain"
    VELOCITY_P_GAIN = "Velocity P Gain"
    POSITION_D_GAIN = "Position D Gain"
    POSITION_I_GAIN = "Position I Gain"
    POSITION_P_GAIN = "Position P Gain"
    BUS_WATCHDOG = "Bus Watchdog"
    GOAL_CURRENT = "Goal Current"
    GOAL_VELOCITY = "Goal Velocity"
    PROFILE_ACCELERATION = "Profile Acceleration"
    PROFILE_VELOCITY = "Profile Velocity"
    GOAL_POSITION = "Goal Position"
    MOVING = "Moving"
    PRESENT_CURRENT = "Present Current"
    PRESENT_VELOCITY = "Present Velocity"
    PRESENT_POSITION = "Present Position"
    PRESENT_INPUT_VOLTAGE = "Present Input Voltage"
    PRESENT_TEMPERATURE = "Present Temperature"


class RegisterField(NamedTuple):
    """Location and format of a register (little endian, two's complement)."""

    address: int  # Address of the first byte
    size: int
    signed: bool = False  # Whether the value is signed
    writable: bool = True  # Whether a program may write it

    def decode(self, data: bytes | bytearray, offset: int = 0) -> int:
        return int.from_bytes(data[offset : offset + self.size], "little", signed=self.signed)

    def encode(self, raw: int) -> bytes:
        try:
            return raw.to_bytes(self.size, "little", signed=self.signed)
        except OverflowError:
            raise ValueError(f"{raw} does not fit a register of {self.size} bytes") from None


class Block(NamedTuple):
    """Contiguous span of registers, fetched by one read."""

    address: int
    size: int
    offsets: Mapping[Register, int]


class Indirect(NamedTuple):
    """Indirect addressing: byte k of the indirect data mirrors the address in entry k."""

    address: int  # Address of the first entry; an entry has two bytes
    data: int  # Address of the first byte of the indirect data
    entries: int

    def entry_of(self, address: int) -> int | None:
        """Return the address of the entry of a data address; None outside the data."""
        k = address - self.data
        return self.address + 2 * k if 0 <= k < self.entries else None


@dataclass(frozen=True)
class ControlTable:
    """Registers of one family of servos; the fields are explained in `servos.toml`."""

    name: str
    cells: Mapping[Register, RegisterField]  # The family has no others
    ram_start: int
    indirect: Indirect
    fast_sync_read: bool

    def __getitem__(self, register: Register) -> RegisterField:
        return self.cells[register]

    def __contains__(self, register: Register) -> bool:
        return register in self.cells

    @property
    def feedback(self) -> Block:
        """Span of present position and present current."""
        cells = {register: self[register] for register in _MEASURED}
        start = min(cell.address for cell in cells.values())
        end = max(cell.address + cell.size for cell in cells.values())
        offsets = {register: cell.address - start for register, cell in cells.items()}
        return Block(start, end - start, offsets)

    @property
    def gathered(self) -> Block:
        """Present position and current, torque enable and bus watchdog, by indirect addresses."""
        offsets, size = {}, 0
        for register in self._gathered:
            offsets[register] = size
            size += self[register].size
        return Block(self.indirect.data, size, offsets)

    @property
    def gathered_addresses(self) -> tuple[int, ...]:
        """Values of the indirect addresses for `gathered`, one per byte."""
        cells = [self[register] for register in self._gathered]
        return tuple(cell.address + k for cell in cells for k in range(cell.size))

    @property
    def _gathered(self) -> tuple[Register, ...]:
        return tuple(r for r in (*_MEASURED, *_WATCHED) if r in self)


_MEASURED: Final = (Register.PRESENT_POSITION, Register.PRESENT_CURRENT)
_WATCHED: Final = (Register.TORQUE_ENABLE, Register.BUS_WATCHDOG)


ANSWERS_ALL: Final = 2
"""Status return level at which a servo answers every instruction; below it, writes are not
confirmed."""
POSITION_MODE: Final = 3
"""Value of the operating mode register in which the goal is an angle."""

WATCHDOG_STEP_S: Final = 0.020
RETURN_DELAY_STEP_S: Final = 2e-6
"""Steps of the two registers (docs/sources.md, "Control tables")."""

MOST_WATCHDOG_STEPS: Final = 127
"""Largest value of the bus watchdog register (docs/sources.md, "Control tables")."""
WATCHDOG_TRIPPED: Final = -1
"""Value of the bus watchdog register after it has tripped."""

HARDWARE_ERRORS: Final = (
    "input voltage", "motor hall sensor", "overheating", "motor encoder", "electrical shock",
    "overload",
)  # fmt: skip
"""Meaning of the bits of the hardware error register, from bit 0 on."""
TORQUE_LOST, STOPPED_BY_WATCHDOG = 1 << 8, 1 << 9
"""Alert bits that this project adds: a servo that should hold torque does not."""
_ADDED_ALERTS: Final = {
    TORQUE_LOST: "its torque went off", STOPPED_BY_WATCHDOG: "its watchdog stopped it",
}  # fmt: skip


def describe_alert(bits: int) -> str:
    """Return the names of the hardware errors and other alerts that are set, or "none"."""
    names = [name for k, name in enumerate(HARDWARE_ERRORS) if bits >> k & 1]
    names += [name for bit, name in _ADDED_ALERTS.items() if bits & bit]
    return ", ".join(names) or "none"
