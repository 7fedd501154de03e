"""Servos in memory without physics: they answer at once and are always at their goal.

They serve to measure the computing time of a tick, the SDK's packets included: their own work is
done while the port waits for an answer.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from dynamixel_sdk.robotis_def import BROADCAST_ID

from firmware_py.bus.port import PacketHandler
from firmware_py.bus.registers import ANSWERS_ALL, POSITION_MODE, Register
from firmware_py.bus.servo_models import Model

_HEADER: Final = [0xFF, 0xFF, 0xFD, 0x00]
_PING, _READ, _WRITE, _SYNC_READ, _SYNC_WRITE, _STATUS = 0x01, 0x02, 0x03, 0x82, 0x83, 0x55
_FAST_SYNC_READ: Final = 0x8A
_LENGTH_END: Final = 7
_MEMORY_BYTES: Final = 1024


class LoopbackTransport:
    """Transport with servos in memory at its other end."""

    def __init__(self, models: Mapping[int, Model]) -> None:
        self._models = models
        self._packets = PacketHandler()
        self._pending = b""
        self._answers = b""
        self.memory = {id_: bytearray(_MEMORY_BYTES) for id_ in models}
        for id_, model in models.items():
            half_turn = model.pulses_per_turn // 2
            for register, raw in {
                Register.MODEL_NUMBER: model.number,
                Register.FIRMWARE_VERSION: 1,
                Register.OPERATING_MODE: POSITION_MODE,
                Register.STATUS_RETURN_LEVEL: ANSWERS_ALL,
                Register.MIN_POSITION_LIMIT: model.zero_pulse - half_turn,
                Register.MAX_POSITION_LIMIT: model.zero_pulse + half_turn - 1,
                Register.PRESENT_POSITION: model.zero_pulse,
            }.items():
                self.put(id_, register, raw)

    def put(self, id_: int, register: Register, raw: int) -> None:
        cell = self._models[id_].table[register]
        self.memory[id_][cell.address : cell.address + cell.size] = cell.encode(raw)

    def get(self, id_: int, register: Register) -> int:
        cell = self._models[id_].table[register]
        return cell.decode(self.memory[id_], cell.address)

    def write(self, data: bytes) -> int:
        """Accept an instruction, which the next `read` executes."""
        self._pending += data
        return len(data)

    def read(self, size: int, deadline_ns: int) -> bytes:
        """Execute the instructions written so far and return the answers."""
        while len(self._pending) > _LENGTH_END:
            end = _LENGTH_END + int.from_bytes(
                self._pending[_LENGTH_END - 2 : _LENGTH_END], "little"
            )
            packet, self._pending = self._pending[:end], self._pending[end:]
            self._execute(list(self._packets.removeStuffing(packet)))
        data, self._answers = self._answers[:size], self._answers[size:]
        return data

    def discard_input(self) -> None:
        """Execute the instructions written so far and drop the answers."""
        self.read(0, 0)
        self._answers = b""

    def close(self) -> None:
        """Do nothing."""

    def _execute(self, packet: list[int]) -> None:
        id_, instruction, parameters = packet[4], packet[7], packet[8:-2]
        if id_ not in self.memory and id_ != BROADCAST_ID:
            return
        if instruction == _PING:
            self._answer(id_, [*self._load(id_, 0, 2), self.get(id_, Register.FIRMWARE_VERSION)])
            return
        address = parameters[0] | parameters[1] << 8
        if instruction == _WRITE:
            self._store(id_, address, parameters[2:])
            self._answer(id_, [])
            return
        size = parameters[2] | parameters[3] << 8
        if instruction == _READ:
            self._answer(id_, self._load(id_, address, size))
        elif instruction == _SYNC_READ:
            for each in parameters[4:]:
                self._answer(each, self._load(each, address, size))
        elif instruction == _FAST_SYNC_READ:
            self._answer_together(parameters[4:], address, size)
        elif instruction == _SYNC_WRITE:
            for start in range(4, len(parameters), size + 1):
                self._store(parameters[start], address, parameters[start + 1 : start + 1 + size])

    def _load(self, id_: int, address: int, size: int) -> list[int]:
        """Read bytes, directly or through the indirect addresses."""
        memory, indirect = self.memory[id_], self._models[id_].table.indirect
        data = []
        for each in range(address, address + size):
            entry = indirect.entry_of(each)
            behind = 0 if entry is None else memory[entry] | memory[entry + 1] << 8
            data.append(memory[behind or each])
        return data

    def _store(self, id_: int, address: int, data: list[int]) -> None:
        self.memory[id_][address : address + len(data)] = bytes(data)
        if address == self._models[id_].table[Register.GOAL_POSITION].address:
            self.put(id_, Register.PRESENT_POSITION, self.get(id_, Register.GOAL_POSITION))

    def _answer(self, id_: int, data: list[int]) -> None:
        length = len(data) + 4
        packet = [*_HEADER, id_, length & 0xFF, length >> 8, _STATUS, 0, *data, 0, 0]
        packet = self._packets.addStuffing(packet)
        crc = self._packets.updateCRC(0, packet, len(packet) - 2)
        packet[-2:] = (crc & 0xFF, crc >> 8)
        self._answers += bytes(packet)

    def _answer_together(self, ids: list[int], address: int, size: int) -> None:
        if not all(id_ in self._models and self._models[id_].table.fast_sync_read for id_ in ids):
            return
        length = 1 + len(ids) * (size + 4)
        packet = [*_HEADER, BROADCAST_ID, length & 0xFF, length >> 8, _STATUS]
        for id_ in ids:
            packet += [0, id_, *self._load(id_, address, size)]
            crc = self._packets.updateCRC(0, packet, len(packet))
            packet += [crc & 0xFF, crc >> 8]
        self._answers += bytes(packet)
