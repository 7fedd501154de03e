"""Feedback of all servos, angle and current, by one sync read or fast sync read.

With indirect addresses the answer also shows whether each servo holds torque, so that a reboot or a
stop by the watchdog is detected in the next tick.

The SDK's group reader returns zeros for a missing answer and drops the alert bit. This module
parses each answer itself and does neither (docs/sources.md, "Dynamixel SDK").
"""

from __future__ import annotations

import struct
from typing import Final

import numpy as np
from dynamixel_sdk.robotis_def import (
    BROADCAST_ID,
    COMM_RX_TIMEOUT,
    COMM_SUCCESS,
    INST_FAST_SYNC_READ,
    INST_SYNC_READ,
)

from firmware_py.bus.bus_plan import RETRY_MARGIN_NS, STATUS_OVERHEAD, Plan
from firmware_py.bus.port import DeadlinePort, PacketHandler
from firmware_py.bus.registers import (
    STOPPED_BY_WATCHDOG,
    TORQUE_LOST,
    WATCHDOG_TRIPPED,
    Block,
    ControlTable,
    Register,
)
from firmware_py.bus.servo_bus import BusStatus
from firmware_py.bus.servo_models import Model
from firmware_py.system.clock import Clock

ID, ERROR, DATA = 4, 8, 9
"""Offsets in a status packet."""
ALERT_BIT, ERROR_NUMBER = 0x80, 0x7F

_DISTINCT_LENGTHS: Final = 8
"""Exchanges over which a late answer is recognised: four ticks with a retry each. An adapter delays
answers by up to 16 ms."""
_FAST_HEADER, _FAST_FRAME = 8, 4
"""Bytes before the first servo's part; bytes of each part around its data: error, id, CRC."""
_SIGNS: Final = (
    (Register.TORQUE_ENABLE, 0, TORQUE_LOST),
    (Register.BUS_WATCHDOG, WATCHDOG_TRIPPED, STOPPED_BY_WATCHDOG),
)
"""Register, its value when a servo does not hold torque, and the alert bit for that."""
_CODES: Final = {1: "b", 2: "h", 4: "i"}
"""Format code of `struct` for a signed value, by its size."""


class FeedbackReader:
    """Reader of servos of one control table by one plan; all servos are fresh or none is."""

    def __init__(
        self,
        port: DeadlinePort,
        packets: PacketHandler,
        clock: Clock,
        models: dict[int, Model],
        plan: Plan,
    ) -> None:
        self.angle_rad, self.current_a = np.zeros(len(models)), np.zeros(len(models))
        self.alert, self.standing, self.late_ns = False, 0, 0
        self.usual_ns = round(plan.read_s * 1e9)
        self._port, self._packets, self._clock, self._plan = port, packets, clock, plan
        self._ids, self._models = list(models), list(models.values())
        self._joint_of = {servo_id: j for j, servo_id in enumerate(models)}
        order = sorted(plan.block.offsets, key=plan.block.offsets.__getitem__)
        self._unpack = _layout(self._models[0].table, plan.block, order).unpack_from
        self._position = order.index(Register.PRESENT_POSITION)
        self._current = order.index(Register.PRESENT_CURRENT)
        self._signs = [
            (order.index(register), value, bit)
            for register, value, bit in _SIGNS
            if register in order
        ]
        # Bit masks of joints: answered, answered to the latest attempt, all.
        self._answered, self._by_latest, self._all_joints = 0, 0, (1 << len(models)) - 1
        self._extra_bytes = self._first_extra_bytes = 0
        # The bytes never change; building them once saves 20 µs in every tick.
        self._instructions = [packets.finished(self._ask(k)) for k in range(_DISTINCT_LENGTHS)]

    def _ask(self, extra_bytes: int) -> list[int]:
        """Return the read instruction of the plan; the packet handler fills in header and CRC."""
        block, size = self._plan.block, self._plan.block.size + extra_bytes
        instruction = INST_FAST_SYNC_READ if self._plan.fast else INST_SYNC_READ
        parameters = [block.address & 0xFF, block.address >> 8, size & 0xFF, size >> 8, *self._ids]
        length = len(parameters) + 3
        return [
            *(0, 0, 0, 0), BROADCAST_ID, length & 0xFF, length >> 8, instruction, *parameters, 0, 0
        ]  # fmt: skip

    def take(self, deadline_ns: int) -> BusStatus:
        """Read the servos; if that fails and time allows, retry once.

        The first attempt ends early enough for a retry, if there is time for both. Answers have no
        sequence number, so a late one could pass for the answer to the next read. Therefore each
        attempt after a failure requests a different number of bytes. A late answer to the first
        attempt was still measured in this tick: it is used for a servo that misses the retry.
        """
        port, now_ns, usual_ns = self._port, self._clock.now_ns, self.usual_ns
        kept_ns = usual_ns + RETRY_MARGIN_NS
        first_ns = now_ns()
        enough = deadline_ns - first_ns >= usual_ns + kept_ns
        port.deadline_ns = deadline_ns - kept_ns if enough else deadline_ns
        self._answered, self.alert, self.standing, self.late_ns = 0, False, 0, 0
        self._first_extra_bytes = self._extra_bytes
        status = self._attempt()
        port.deadline_ns = deadline_ns
        if status is BusStatus.OK:
            return status
        second_ns = now_ns()
        if deadline_ns - second_ns < usual_ns:
            return status
        self._by_latest = 0
        status = self._attempt()
        if self._answered != self._all_joints:
            return status
        self.late_ns = (second_ns - first_ns) * self._by_latest.bit_count() // len(self._ids)
        return BusStatus.RETRIED

    def _attempt(self) -> BusStatus:
        status = BusStatus.PORT_GONE
        try:
            result = self._packets.send(self._port, self._instructions[self._extra_bytes])
            status = BusStatus.TIMEOUT
            if result == COMM_SUCCESS:
                status = self._take_together() if self._plan.fast else self._take_each()
        finally:
            if status is not BusStatus.OK:
                self._extra_bytes = (self._extra_bytes + 1) % _DISTINCT_LENGTHS
        return status

    def _take_each(self) -> BusStatus:
        bare = STATUS_OVERHEAD + self._plan.block.size
        length, first_length = bare + self._extra_bytes, bare + self._first_extra_bytes
        outcome, seen, replies = BusStatus.OK, 0, 0
        while replies < len(self._ids):  # damaged answers count, those of other ids do not
            packet, result = self._packets.rxPacket(self._port, False)
            if result == COMM_RX_TIMEOUT:
                return max(outcome, BusStatus.TIMEOUT)
            if result != COMM_SUCCESS:
                outcome, replies = max(outcome, BusStatus.CORRUPT), replies + 1
                continue
            joint = self._joint_of.get(packet[ID])
            refused = bool(packet[ERROR] & ERROR_NUMBER)
            if joint is None or seen >> joint & 1:
                continue
            if refused or len(packet) == length:
                seen, replies = seen | 1 << joint, replies + 1
            elif len(packet) != first_length:
                continue  # the answer to an instruction of an earlier tick
            if refused:
                outcome = max(outcome, BusStatus.REFUSED)
            else:
                self._decode(joint, packet, DATA, len(packet) == length)
            self.alert = self.alert or bool(packet[ERROR] & ALERT_BIT)
        return outcome

    def _take_together(self) -> BusStatus:
        """Parse the common packet: error, id, data, CRC of each servo; the last CRC covers all."""
        bare = self._plan.block.size + _FAST_FRAME
        strides = (bare + self._extra_bytes, bare + self._first_extra_bytes)
        while True:
            packet, result = self._packets.rxPacket(self._port, True)
            if result != COMM_SUCCESS:
                return BusStatus.TIMEOUT if result == COMM_RX_TIMEOUT else BusStatus.CORRUPT
            stride, rest = divmod(len(packet) - _FAST_HEADER, len(self._ids))
            if packet[ID] != BROADCAST_ID or rest or stride not in strides:
                continue  # the answer to an instruction of an earlier tick
            latest = stride == strides[0]
            status = self._split(packet, stride, latest)
            if latest:
                return status

    def _split(self, packet: bytes, stride: int, latest: bool) -> BusStatus:
        outcome = BusStatus.OK
        for joint, servo_id in enumerate(self._ids):
            start = _FAST_HEADER + joint * stride
            if packet[start + 1] != servo_id:
                return BusStatus.CORRUPT
            if packet[start] & ERROR_NUMBER:
                outcome = BusStatus.REFUSED
            else:
                self._decode(joint, packet, start + 2, latest)
            self.alert = self.alert or bool(packet[start] & ALERT_BIT)
        return outcome

    def _decode(self, joint: int, packet: bytes, start: int, latest: bool) -> None:
        model, raw = self._models[joint], self._unpack(packet, start)
        self.angle_rad[joint] = model.angle_rad(raw[self._position])
        self.current_a[joint] = model.current_a(raw[self._current])
        for index, value, bit in self._signs:
            if raw[index] == value:
                self.standing |= bit
        self._answered |= 1 << joint
        if latest:
            self._by_latest |= 1 << joint
        else:
            self._by_latest &= ~(1 << joint)


def _layout(table: ControlTable, block: Block, order: list[Register]) -> struct.Struct:
    """Return the layout of some registers, in order, in a block."""
    parts, end = "<", 0
    for register in order:
        cell, offset = table[register], block.offsets[register]
        code = _CODES[cell.size]
        parts += f"{offset - end}x" + (code if cell.signed else code.upper())
        end = offset + cell.size
    return struct.Struct(parts)
