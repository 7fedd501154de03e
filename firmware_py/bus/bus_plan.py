"""Transmission time of a tick, and the plans by which a tick can read its servos.

A tick moves three packets: the instruction to read, the answers, the goals. Protocol 2.0 frames
(ROBOTIS e-Manual), bytes for n servos and a block of b bytes of feedback:

========================= ============================ =====================================
packet                    bytes                        composition
========================= ============================ =====================================
sync read instruction     14 + n                       header 4, id 1, length 2, instruction
                                                       1, address 2, size 2, CRC 2; ids
answers to a sync read    n (11 + b)                   a packet from every servo
answer to a fast one      8 + n (4 + b)                one packet; each servo appends error,
                                                       id, data, CRC
sync write of the goals   14 + n (1 + 4)               no answer
========================= ============================ =====================================

A byte takes ten bits. Every servo waits for its return delay before it answers a sync read; a fast
one costs a single delay, since the other servos append to the packet of the first. The latency
timer of the USB adapter comes on top (`dropstitch doctor` checks it).

The options:

sync read or fast sync read
    The fast one saves 7 n - 8 bytes and n - 1 return delays, hence nothing for a single servo.
    One silent servo makes the whole packet unusable.
direct or indirect block
    The velocity lies between position and current (10 bytes, 12 on a legacy PRO). Indirect
    addresses gather the two into 6 bytes. Two more bytes, torque enable and bus watchdog, show in
    every tick whether the servo holds torque (7 bytes in all on a legacy PRO, which has no
    watchdog). Offered only if the indirect addresses lie in EEPROM: those of the X series are lost
    in a reboot, and the block would then hold zeros that look like data.
goals and the next read in one burst
    Not offered. Protocol 2.0 has no instruction that writes and reads, so the burst has as many
    bytes as its two packets, and every goal would be one period older.

`DynamixelBus.connect` tries the plans in order and uses the fastest that the servos answer.

A read that fails is retried in the same tick (`firmware_py.bus.exchange`). With 2 % of the answers
of two servos lost or damaged, three consecutive ticks without data, which stop the robot, occur
every 15,000 ticks without a retry and every 10^9 ticks with it. The first attempt ends early enough
to leave the retry the time that an exchange took at start-up; if both do not fit, the first attempt
has all of the time.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final, NamedTuple

from firmware_py.bus.codec import STATUS_OVERHEAD
from firmware_py.bus.registers import Block, ControlTable
from firmware_py.core.errors import InputError
from firmware_py.core.units import BAUD_RATE, DURATION

BITS_PER_BYTE: Final = 10
"""Eight data bits between start and stop bit."""
FACTORY_RETURN_DELAY_S: Final = 500e-6
RESERVE_NS: Final = 2_000_000
"""Part of a slot that is reserved for the rest of the tick."""
RETRY_MARGIN_NS: Final = 2_000_000
"""Margin of a retry beyond its usual duration: one period of the adapter's latency timer, 1 ms, and
another 1 ms for the host."""
SERVO_BAUD_RATES: Final = (57_600, 115_200, 1_000_000, 2_000_000, 3_000_000, 4_000_000)
"""Baud rates of the servos, from the PRO's factory setting up."""

_INSTRUCTION_OVERHEAD: Final = 14
_GOAL_BYTES: Final = 1 + 4
_FAST_OVERHEAD, _FAST_BLOCK_OVERHEAD = 8, 4


class Plan(NamedTuple):
    """One way to read the servos and to send their goals."""

    fast: bool  # Fast sync read instead of sync read
    indirect: bool  # Block gathered by indirect addresses
    block: Block  # Registers read from every servo
    servos: int
    baud: int
    return_delay_s: float  # Delay of a servo before it answers

    @property
    def name(self) -> str:
        return ("fast " if self.fast else "") + "sync read" + (", indirect" * self.indirect)

    @property
    def answer_bytes(self) -> int:
        """Bytes of the answers of all servos."""
        if self.fast:
            return _FAST_OVERHEAD + self.servos * (_FAST_BLOCK_OVERHEAD + self.block.size)
        return self.servos * (STATUS_OVERHEAD + self.block.size)

    @property
    def read_s(self) -> float:
        """Time from the first bit of the instruction to the last bit of the answers."""
        sent = _INSTRUCTION_OVERHEAD + self.servos + self.answer_bytes
        return sent * BITS_PER_BYTE / self.baud + self.pause_s

    @property
    def read_twice_s(self) -> float:
        """Time of a read and its retry."""
        return 2 * self.read_s + RETRY_MARGIN_NS * 1e-9

    @property
    def pause_s(self) -> float:
        """Sum of the return delays within `read_s`."""
        return self.return_delay_s * (1 if self.fast else self.servos)

    @property
    def write_s(self) -> float:
        """Transmission time of the goals."""
        return (_INSTRUCTION_OVERHEAD + self.servos * _GOAL_BYTES) * BITS_PER_BYTE / self.baud

    @property
    def total_s(self) -> float:
        """Transmission time of one tick."""
        return self.read_s + self.write_s


def plans(
    table: ControlTable, servos: int, baud: int, return_delay_s: float = FACTORY_RETURN_DELAY_S
) -> list[Plan]:
    """Return every plan for servos of one control table, fastest first.

    The plain sync read of the direct block, which every servo answers, is always among them.
    """
    blocks = {False: table.feedback}
    if table.indirect.address < table.ram_start:
        blocks[True] = table.gathered
    possible = [
        Plan(fast, indirect, block, servos, baud, return_delay_s)
        for fast in ((False, True) if table.fast_sync_read else (False,))
        for indirect, block in blocks.items()
    ]
    return sorted(possible, key=lambda plan: (plan.total_s, plan.fast, plan.indirect))


def plain(candidates: list[Plan]) -> Plan:
    """Return the plan that every servo answers: plain sync read, direct block."""
    return next(plan for plan in candidates if not plan.fast and not plan.indirect)


def available_s(period_s: float, reply_timeout_s: float) -> float:
    """Return the time that a tick can spend on transmission."""
    return min(reply_timeout_s, period_s - RESERVE_NS * 1e-9)


def require_any(candidates: list[Plan], budget_s: float, where: Path | str) -> None:
    """Refuse a list of plans, fastest first, if none fits the budget."""
    if candidates[0].total_s > budget_s:
        require_time(plain(candidates), budget_s, where)


def require_time(plan: Plan, budget_s: float, where: Path | str) -> None:
    """Refuse a plan whose transmission takes longer than the budget."""
    if plan.total_s <= budget_s:
        return
    enough = (b for b in SERVO_BAUD_RATES if plan._replace(baud=b).total_s <= budget_s)
    baud = next(enough, None)
    raise InputError(
        where,
        f"{plan.servos} servos at {plan.baud:,} baud need {DURATION.number(plan.total_s)} ms of "
        "transmission in every tick, bus.reply_timeout_s and period_s leave "
        f"{DURATION.number(budget_s)} ms",
        f"use ≥ {_readable(baud)}, here and in the servos" if baud else
        "use fewer servos on the bus, a shorter return delay or a longer period",
    )  # fmt: skip


def _readable(baud: int) -> str:
    return (
        f"{BAUD_RATE.factor * baud:g} {BAUD_RATE.name}" if baud >= 1_000_000 else f"{baud:,} baud"
    )
