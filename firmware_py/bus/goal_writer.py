"""Writer of the goals of all servos by one sync write, which no servo answers."""

from __future__ import annotations

from typing import Final

from dynamixel_sdk.robotis_def import BROADCAST_ID, COMM_SUCCESS, INST_SYNC_WRITE
from numpy import float64
from numpy.typing import NDArray

from firmware_py.bus.port import HEADER, INSTRUCTION, DeadlinePort, PacketHandler
from firmware_py.bus.registers import Register
from firmware_py.bus.servo_bus import BusStatus
from firmware_py.bus.servo_models import Model

_FIRST: Final = 12
"""Offset of the first servo's bytes: header, id, length, instruction, address and size precede."""
_CRC: Final = 2


class GoalWriter:
    """Writer of goals to servos of one control table."""

    def __init__(
        self, port: DeadlinePort, packets: PacketHandler, models: dict[int, Model]
    ) -> None:
        self._port, self._packets = port, packets
        self._models = list(models.values())
        self._cell = self._models[0].table[Register.GOAL_POSITION]
        address, size = self._cell[:2]
        length = _FIRST - INSTRUCTION + len(models) * (1 + size) + _CRC
        instruction = [
            *(0, 0, 0, 0), BROADCAST_ID, length & 0xFF, length >> 8, INST_SYNC_WRITE,
            address & 0xFF, address >> 8, size & 0xFF, size >> 8,
        ]  # fmt: skip
        self._goals: list[slice] = []
        for servo_id in models:
            start = len(instruction) + 1
            self._goals.append(slice(start, start + size))
            instruction += (servo_id, *bytes(size))
        # Only goals and CRC change from tick to tick.
        self._packet = bytearray(packets.finished([*instruction, *bytes(_CRC)]))
        self._crc_before = packets.updateCRC(0, self._packet, _FIRST)

    def put(self, goal_rad: NDArray[float64]) -> BusStatus:
        """Send the goals, shape (dof,)."""
        encode, packet, packets = self._cell.encode, self._packet, self._packets
        for model, place, angle_rad in zip(
            self._models, self._goals, goal_rad.tolist(), strict=True
        ):
            packet[place] = encode(model.position_raw(angle_rad))
        if packet.find(HEADER, INSTRUCTION, -_CRC) >= 0:
            result = packets.tell(self._port, packets.finished(list(packet)))
        else:
            goals = packet[_FIRST:-_CRC]
            crc = packets.updateCRC(self._crc_before, goals, len(goals))
            packet[-_CRC:] = crc.to_bytes(_CRC, "little")
            result = packets.tell(self._port, bytes(packet))
        return BusStatus.OK if result == COMM_SUCCESS else BusStatus.TIMEOUT
