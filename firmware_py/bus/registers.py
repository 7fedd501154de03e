"""Control tables of the servo families: registers, addresses and sizes as data.

The name "PRO" covers two incompatible tables: the legacy `-R` models and the later `-R(A)` and P
models. A servo is therefore identified by its model number (`firmware_py.bus.servo_models`), never
by its name. Addresses: docs/sources.md, "Control tables"; the tables of ROBOTIS'
dynamixel-workbench agree.
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

    def decode(self, data: bytes | bytearray | list[int], offset: int = 0) -> int:
        return int.from_bytes(data[offset : offset + self.size], "little", signed=self.signed)

    def encode(self, raw: int) -> bytes:
        try:
            return raw.to_bytes(self.size, "little", signed=self.signed)
        except OverflowError:
            raise ValueError(f"{raw} does not fit a register of {self.size} bytes") from None


@dataclass(frozen=True)
class Block:
    """Contiguous span of registers, fetched by one read."""

    address: int  # Address of the first byte
    size: int  # Number of bytes
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
    """Registers of one family of servos."""

    name: str  # Family, as the e-Manual groups it
    # Registers of the family; it has no others
    cells: Mapping[Register, RegisterField]
    # First address of the RAM area; below it is EEPROM, which is locked while torque is on
    ram_start: int
    indirect: Indirect
    # Whether some firmware answers a fast sync read. ROBOTIS publishes the first such version for
    # some models only, so `DynamixelBus.connect` tries it.
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


def _table(
    name: str,
    ram_start: int,
    indirect: Indirect,
    rows: Mapping[Register, RegisterField | tuple[int, int]],
    *,
    fast_sync_read: bool = True,
) -> ControlTable:
    cells = {register: RegisterField(*cell) for register, cell in rows.items()}
    return ControlTable(name, cells, ram_start, indirect, fast_sync_read)


def _with_ram_at(
    ram_start: int, table: ControlTable, name: str, indirect: Indirect
) -> ControlTable:
    """Return a table with the registers of another, with the RAM area moved to an address."""
    shift = ram_start - table.ram_start
    cells = {
        register: cell._replace(address=cell.address + shift * (cell.address >= table.ram_start))
        for register, cell in table.cells.items()
    }
    return ControlTable(name, cells, ram_start, indirect, table.fast_sync_read)


_SIGNED, _READ_ONLY = True, False

LEGACY_PRO: Final = _table(
    "legacy PRO",
    562,
    Indirect(49, 634, 256),
    {
        Register.MODEL_NUMBER: RegisterField(0, 2, False, _READ_ONLY),
        Register.FIRMWARE_VERSION: RegisterField(6, 1, False, _READ_ONLY),
        Register.ID: (7, 1),
        Register.BAUD_RATE: (8, 1),
        Register.RETURN_DELAY: (9, 1),
        Register.OPERATING_MODE: (11, 1),
        Register.HOMING_OFFSET: RegisterField(13, 4, _SIGNED),
        Register.CURRENT_LIMIT: (30, 2),
        Register.VELOCITY_LIMIT: (32, 4),
        Register.MAX_POSITION_LIMIT: RegisterField(36, 4, _SIGNED),
        Register.MIN_POSITION_LIMIT: RegisterField(40, 4, _SIGNED),
        Register.SHUTDOWN: (48, 1),
        Register.TORQUE_ENABLE: (562, 1),
        Register.VELOCITY_I_GAIN: (586, 2),
        Register.VELOCITY_P_GAIN: (588, 2),
        Register.POSITION_P_GAIN: (594, 2),
        Register.GOAL_POSITION: RegisterField(596, 4, _SIGNED),
        Register.GOAL_VELOCITY: RegisterField(600, 4, _SIGNED),
        Register.GOAL_CURRENT: RegisterField(604, 2, _SIGNED),
        Register.PROFILE_VELOCITY: RegisterField(600, 4, _SIGNED),  # the goal velocity limits it
        Register.PROFILE_ACCELERATION: (606, 4),  # the e-Manual calls it goal acceleration
        Register.MOVING: RegisterField(610, 1, False, _READ_ONLY),
        Register.PRESENT_POSITION: RegisterField(611, 4, _SIGNED, _READ_ONLY),
        Register.PRESENT_VELOCITY: RegisterField(615, 4, _SIGNED, _READ_ONLY),
        Register.PRESENT_CURRENT: RegisterField(621, 2, _SIGNED, _READ_ONLY),
        Register.PRESENT_INPUT_VOLTAGE: RegisterField(623, 2, False, _READ_ONLY),
        Register.PRESENT_TEMPERATURE: RegisterField(625, 1, False, _READ_ONLY),
        Register.STATUS_RETURN_LEVEL: (891, 1),
        Register.HARDWARE_ERROR: RegisterField(892, 1, False, _READ_ONLY),
    },
    fast_sync_read=False,  # docs/sources.md, "Control tables"
)
"""H54 and H42 `-R`: no bus watchdog, and only a proportional position gain."""

PRO_P: Final = _table(
    "PRO(A) and P",
    512,
    Indirect(168, 634, 128),
    {
        Register.MODEL_NUMBER: RegisterField(0, 2, False, _READ_ONLY),
        Register.FIRMWARE_VERSION: RegisterField(6, 1, False, _READ_ONLY),
        Register.ID: (7, 1),
        Register.BAUD_RATE: (8, 1),
        Register.RETURN_DELAY: (9, 1),
        Register.DRIVE_MODE: (10, 1),
        Register.OPERATING_MODE: (11, 1),
        Register.HOMING_OFFSET: RegisterField(20, 4, _SIGNED),
        Register.CURRENT_LIMIT: (38, 2),
        Register.VELOCITY_LIMIT: (44, 4),
        Register.MAX_POSITION_LIMIT: RegisterField(48, 4, _SIGNED),
        Register.MIN_POSITION_LIMIT: RegisterField(52, 4, _SIGNED),
        Register.SHUTDOWN: (63, 1),
        Register.TORQUE_ENABLE: (512, 1),
        Register.STATUS_RETURN_LEVEL: (516, 1),
        Register.HARDWARE_ERROR: RegisterField(518, 1, False, _READ_ONLY),
        Register.VELOCITY_I_GAIN: (524, 2),
        Register.VELOCITY_P_GAIN: (526, 2),
        Register.POSITION_D_GAIN: (528, 2),
        Register.POSITION_I_GAIN: (530, 2),
        Register.POSITION_P_GAIN: (532, 2),
        Register.BUS_WATCHDOG: RegisterField(546, 1, _SIGNED),
        Register.GOAL_CURRENT: RegisterField(550, 2, _SIGNED),
        Register.GOAL_VELOCITY: RegisterField(552, 4, _SIGNED),
        Register.PROFILE_ACCELERATION: (556, 4),
        Register.PROFILE_VELOCITY: (560, 4),
        Register.GOAL_POSITION: RegisterField(564, 4, _SIGNED),
        Register.MOVING: RegisterField(570, 1, False, _READ_ONLY),
        Register.PRESENT_CURRENT: RegisterField(574, 2, _SIGNED, _READ_ONLY),
        Register.PRESENT_VELOCITY: RegisterField(576, 4, _SIGNED, _READ_ONLY),
        Register.PRESENT_POSITION: RegisterField(580, 4, _SIGNED, _READ_ONLY),
        Register.PRESENT_INPUT_VOLTAGE: RegisterField(592, 2, False, _READ_ONLY),
        Register.PRESENT_TEMPERATURE: RegisterField(594, 1, False, _READ_ONLY),
    },
)
"""H54 and H42 `-R(A)`, PH54 and PH42."""

X_SERIES: Final = _with_ram_at(64, PRO_P, "X", Indirect(168, 224, 28))
"""X series (XM430): the table of the P with the RAM area at addresses 448 lower."""

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
