"""The two exchanges of a tick: a read of all servos, and the goals of all servos.

Angle and current come by one sync read or fast sync read. With indirect addresses the answer also
shows whether each servo holds torque, so that a reboot or a stop by the watchdog is detected in the
next tick. The SDK's group reader returns zeros for a missing answer and drops the alert bit. This
module does neither (docs/sources.md, "Dynamixel SDK").
"""

from __future__ import annotations

import struct
from typing import Final

import numpy as np
from numpy.typing import NDArray

from firmware_py.bus import codec
from firmware_py.bus.bus_plan import RETRY_MARGIN_NS, Plan
from firmware_py.bus.codec import ALERT, BODY, BROADCAST, CRC_BYTES, ERROR_NUMBER, MARK
from firmware_py.bus.port import DeadlinePort
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

_DISTINCT_LENGTHS: Final = 8
"""Exchanges over which a late answer is recognised: four ticks with a retry each. An adapter delays
answers by up to 16 ms."""
_PART_OVERHEAD: Final = 4
"""Bytes around the data of a servo in a common answer: error, id, CRC."""
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
        self, port: DeadlinePort, clock: Clock, models: dict[int, Model], plan: Plan
    ) -> None:
        self.angle_rad, self.current_a = np.zeros(len(models)), np.zeros(len(models))
        self.alert, self.standing, self.late_ns = False, 0, 0
        self.usual_ns = round(plan.read_s * 1e9)
        self._port, self._clock, self._plan = port, clock, plan
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
        address, size = plan.block.address, plan.block.size
        self._instructions = [
            codec.build_sync_read(self._ids, address, size + extra_bytes, fast=plan.fast)
            for extra_bytes in range(_DISTINCT_LENGTHS)
        ]

    def take(self, deadline_ns: int) -> BusStatus:
        """Read the servos; if that fails and time allows, retry once.

        The first attempt ends early enough for a retry, if there is time for both. Answers have no
        sequence number, so a late one could pass for the answer to the next read. Therefore each
        attempt after a failure requests a different number of bytes. A late answer to the first
        attempt was still measured in this tick: it is used for a servo that misses the retry.
        """
        port, now_ns, usual_ns = self._port, self._clock.now_ns, self.usual_ns
        reserved_ns = usual_ns + RETRY_MARGIN_NS
        first_ns = now_ns()
        enough = deadline_ns - first_ns >= usual_ns + reserved_ns
        port.deadline_ns = deadline_ns - reserved_ns if enough else deadline_ns
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
        status = BusStatus.TIMEOUT
        try:
            if self._port.request(self._instructions[self._extra_bytes]):
                status = self._take_together() if self._plan.fast else self._take_each()
        finally:
            if status is not BusStatus.OK:
                self._extra_bytes = (self._extra_bytes + 1) % _DISTINCT_LENGTHS
        return status

    def _take_each(self) -> BusStatus:
        bare = 1 + self._plan.block.size
        length, first_length = bare + self._extra_bytes, bare + self._first_extra_bytes
        outcome, answered, replies = BusStatus.OK, 0, 0
        while replies < len(self._ids):  # damaged answers count, those of other ids do not
            packet, status = self._port.receive()
            if status is BusStatus.TIMEOUT:
                return max(outcome, status)
            if packet is None:
                outcome, replies = max(outcome, status), replies + 1
                continue
            answer, joint = packet.parameters, self._joint_of.get(packet.id)
            refused = bool(answer[0] & ERROR_NUMBER)
            if joint is None or answered >> joint & 1:
                continue
            if refused or len(answer) == length:
                answered, replies = answered | 1 << joint, replies + 1
            elif len(answer) != first_length:
                continue  # the answer to an instruction of an earlier tick
            if refused:
                outcome = max(outcome, BusStatus.REFUSED)
            else:
                self._decode(joint, answer, 1, len(answer) == length)
            self.alert = self.alert or bool(answer[0] & ALERT)
        return outcome

    def _take_together(self) -> BusStatus:
        """Parse the common packet: error, id, data, CRC of each servo; the last CRC covers all."""
        bare = self._plan.block.size + _PART_OVERHEAD
        strides = (bare + self._extra_bytes, bare + self._first_extra_bytes)
        while True:
            packet, status = self._port.receive(common=True)
            if packet is None:
                return status
            parts = packet.parameters
            stride, rest = divmod(len(parts) + CRC_BYTES, len(self._ids))
            if packet.id != BROADCAST or rest or stride not in strides:
                continue  # the answer to an instruction of an earlier tick
            latest = stride == strides[0]
            status = self._split(parts, stride, latest)
            if latest:
                return status

    def _split(self, parts: bytes, stride: int, latest: bool) -> BusStatus:
        outcome = BusStatus.OK
        for joint, servo_id in enumerate(self._ids):
            start = joint * stride
            if parts[start + 1] != servo_id:
                return BusStatus.CORRUPT
            if parts[start] & ERROR_NUMBER:
                outcome = BusStatus.REFUSED
            else:
                self._decode(joint, parts, start + 2, latest)
            self.alert = self.alert or bool(parts[start] & ALERT)
        return outcome

    def _decode(self, joint: int, data: bytes, start: int, latest: bool) -> None:
        model, raw = self._models[joint], self._unpack(data, start)
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


_FIRST_GOAL: Final = BODY + 5
"""Offset of the first servo's id in a sync write: instruction, address and size precede."""


class GoalWriter:
    """Writer of goals to servos of one control table, by one sync write, which none answers."""

    def __init__(self, port: DeadlinePort, models: dict[int, Model]) -> None:
        self._port, self._models = port, models
        self._cell = next(iter(models.values())).table[Register.GOAL_POSITION]
        # Only goals and CRC change from tick to tick.
        address, size = self._cell[:2]
        zeros = dict.fromkeys(models, bytes(size))
        self._packet = bytearray(codec.build_sync_write(address, zeros))
        self._crc_before = codec.crc16(self._packet[:_FIRST_GOAL])

    def put(self, goal_rad: NDArray[np.float64]) -> BusStatus:
        """Send the goals, shape (dof,)."""
        cell, packet = self._cell, self._packet
        start = _FIRST_GOAL + 1
        for model, angle_rad in zip(self._models.values(), goal_rad.tolist(), strict=True):
            packet[start : start + cell.size] = cell.encode(model.position_raw(angle_rad))
            start += cell.size + 1
        if packet.find(MARK, BODY, -CRC_BYTES) >= 0:  # the goals need stuffing
            body = bytes(packet[BODY + 1 : -CRC_BYTES])
            sent = self._port.send(codec.build(BROADCAST, packet[BODY], body))
        else:
            crc = codec.crc16(packet[_FIRST_GOAL:-CRC_BYTES], self._crc_before)
            packet[-CRC_BYTES:] = crc.to_bytes(CRC_BYTES, "little")
            sent = self._port.send(bytes(packet))
        return BusStatus.OK if sent else BusStatus.TIMEOUT
