"""Angle and current of every servo by one synchronous read, plain or fast.

The zeros that the SDK's group reader returns for a missing reply never appear here: replies are
taken one by one, which also keeps the alert bit that it drops (FACTS §1).
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from dynamixel_sdk.robotis_def import (
    BROADCAST_ID,
    COMM_RX_TIMEOUT,
    COMM_SUCCESS,
    INST_FAST_SYNC_READ,
    INST_SYNC_READ,
)

from firmware_py.bus import BusStatus
from firmware_py.bus_plan import STATUS_OVERHEAD, Plan
from firmware_py.port import DeadlinePort, PacketHandler
from firmware_py.registers import Register
from firmware_py.servo_models import Model

ID, ERROR, DATA = 4, 8, 9
"""Where they stand in a status packet."""
ALERT_BIT, ERROR_NUMBER = 0x80, 0x7F

_DISTINCT_LENGTHS: Final = 4
"""A late answer is told apart for so many exchanges; it is the adapter's, 16 ms at worst."""
_FAST_HEADER, _FAST_CRC = 8, 2


class Taken(NamedTuple):
    """Result of one read.

    Attributes
    ----------
    status : BusStatus
        OK where every servo answered well.
    alert : bool
        Whether a servo reports a hardware error.
    """

    status: BusStatus
    alert: bool = False


class FeedbackReader:
    """Reads servos of one control table by one plan; all are fresh or none is.

    Parameters
    ----------
    port : DeadlinePort
        Whose deadline bounds the read.
    packets : PacketHandler
        The SDK's Protocol 2.0.
    models : dict of int to Model
        Servos by id, in joint order.
    plan : Plan
        How to read them.

    Attributes
    ----------
    angle_rad, current_a : ndarray, shape (dof,)
        Of the latest read that went well; half overwritten after one that did not.
    """

    def __init__(
        self, port: DeadlinePort, packets: PacketHandler, models: dict[int, Model], plan: Plan
    ) -> None:
        self.angle_rad, self.current_a = np.zeros(len(models)), np.zeros(len(models))
        self._port, self._packets, self._plan = port, packets, plan
        self._ids, self._models = list(models), list(models.values())
        self._joint_of = {servo_id: j for j, servo_id in enumerate(models)}
        table = self._models[0].table
        self._position = table[Register.PRESENT_POSITION]
        self._current = table[Register.PRESENT_CURRENT]
        self._extra_bytes = 0
        # Always the same bytes, so they are made once: it saves 20 µs in every tick.
        self._instructions = [packets.finished(self._ask(k)) for k in range(_DISTINCT_LENGTHS)]

    def _ask(self, extra_bytes: int) -> list[int]:
        """Instruction of the plan; header and CRC are left to the packet handler."""
        block, size = self._plan.block, self._plan.block.size + extra_bytes
        instruction = INST_FAST_SYNC_READ if self._plan.fast else INST_SYNC_READ
        parameters = [block.address & 0xFF, block.address >> 8, size & 0xFF, size >> 8, *self._ids]
        length = len(parameters) + 3
        return [
            *(0, 0, 0, 0), BROADCAST_ID, length & 0xFF, length >> 8, instruction, *parameters, 0, 0
        ]  # fmt: skip

    def take(self) -> Taken:
        """Read once.

        An answer has no number, so one that comes too late would pass for the answer to the next
        read. After a read that failed the next one therefore asks for another number of bytes.

        Raises
        ------
        OSError
            If the port is gone.
        """
        taken = Taken(BusStatus.PORT_GONE)
        try:
            result = self._packets.send(self._port, self._instructions[self._extra_bytes])
            taken = Taken(BusStatus.TIMEOUT)
            if result == COMM_SUCCESS:
                taken = self._take_together() if self._plan.fast else self._take_each()
        finally:
            if not taken.status.fresh:
                self._extra_bytes = (self._extra_bytes + 1) % _DISTINCT_LENGTHS
        return taken

    def _take_each(self) -> Taken:
        length = STATUS_OVERHEAD + self._plan.block.size + self._extra_bytes
        outcome, alert, seen, replies = BusStatus.OK, False, 0, 0
        while replies < len(self._ids):  # a damaged reply stands for one; a stranger's for none
            packet, result = self._packets.rxPacket(self._port, False)
            if result == COMM_RX_TIMEOUT:
                return Taken(max(outcome, BusStatus.TIMEOUT))
            if result != COMM_SUCCESS:
                outcome, replies = max(outcome, BusStatus.CORRUPT), replies + 1
                continue
            joint = self._joint_of.get(packet[ID])
            refused = bool(packet[ERROR] & ERROR_NUMBER)
            if joint is None or seen >> joint & 1:
                continue
            if not refused and len(packet) != length:
                continue  # the answer to an earlier instruction
            seen, replies = seen | 1 << joint, replies + 1
            if refused:
                outcome = max(outcome, BusStatus.REFUSED)
            else:
                self._decode(joint, packet, DATA)
            alert = alert or bool(packet[ERROR] & ALERT_BIT)
        return Taken(outcome, alert)

    def _take_together(self) -> Taken:
        """One packet of all: error, id, data and a CRC each; the last CRC covers everything."""
        size = self._plan.block.size + self._extra_bytes
        stride = 2 + size + _FAST_CRC
        while True:
            packet, result = self._packets.rxPacket(self._port, True)
            if result != COMM_SUCCESS:
                timeout = result == COMM_RX_TIMEOUT
                return Taken(BusStatus.TIMEOUT if timeout else BusStatus.CORRUPT)
            if packet[ID] == BROADCAST_ID and len(packet) == _FAST_HEADER + stride * len(self._ids):
                break  # else the answer to an earlier instruction
        errors = 0
        for joint, servo_id in enumerate(self._ids):
            start = _FAST_HEADER + joint * stride
            errors |= packet[start]
            if packet[start + 1] != servo_id:
                return Taken(BusStatus.CORRUPT)
            self._decode(joint, packet, start + 2)
        status = BusStatus.REFUSED if errors & ERROR_NUMBER else BusStatus.OK
        return Taken(status, bool(errors & ALERT_BIT))

    def _decode(self, joint: int, packet: list[int], start: int) -> None:
        model, block = self._models[joint], self._plan.block
        position = self._position.decode(packet, start + block.position_offset)
        current = self._current.decode(packet, start + block.current_offset)
        self.angle_rad[joint] = model.angle_rad(position)
        self.current_a[joint] = model.current_a(current)
