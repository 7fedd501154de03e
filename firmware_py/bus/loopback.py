"""Servos in memory without physics: they answer at once and are always at their goal.

They serve to measure the computing time of a tick, packets included: their own work is done while
the port waits for an answer.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from firmware_py.bus import codec
from firmware_py.bus.codec import BROADCAST, Instruction, Packet, PacketSearch, word
from firmware_py.bus.registers import ANSWERS_ALL, POSITION_MODE, Register
from firmware_py.bus.servo_models import Model

_MEMORY_BYTES: Final = 1024


class LoopbackTransport:
    """Transport with servos in memory at its other end."""

    def __init__(self, models: Mapping[int, Model]) -> None:
        self._models = models
        self._search = PacketSearch(host=False)
        self._sent = self._answers = b""
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
        self._sent += data
        return len(data)

    def read(self, size: int, deadline_ns: int) -> bytes:
        """Execute the instructions written so far and return the answers."""
        sent, self._sent = self._sent, b""
        for packet in self._search.feed(sent):
            self._execute(packet)
        data, self._answers = self._answers[:size], self._answers[size:]
        return data

    def discard_input(self) -> None:
        """Execute the instructions written so far and drop the answers."""
        self.read(0, 0)
        self._answers = b""

    def close(self) -> None:
        """Do nothing."""

    def _execute(self, packet: Packet) -> None:
        id_, instruction, parameters, _ = packet
        if id_ not in self.memory and id_ != BROADCAST:
            return
        if instruction == Instruction.PING:
            version = self.get(id_, Register.FIRMWARE_VERSION)
            self._answer(id_, self._load(id_, 0, 2) + bytes((version,)))
            return
        address = word(parameters, 0)
        if instruction == Instruction.WRITE:
            self._store(id_, address, parameters[2:])
            self._answer(id_, b"")
            return
        size, rest = word(parameters, 2), parameters[4:]
        if instruction == Instruction.READ:
            self._answer(id_, self._load(id_, address, size))
        elif instruction == Instruction.SYNC_READ:
            for each in rest:
                self._answer(each, self._load(each, address, size))
        elif instruction == Instruction.FAST_SYNC_READ:
            if all(
                each in self._models and self._models[each].table.fast_sync_read for each in rest
            ):
                blocks = [(each, 0, self._load(each, address, size)) for each in rest]
                self._answers += codec.build_fast_status(len(blocks), blocks)
        elif instruction == Instruction.SYNC_WRITE:
            for start in range(0, len(rest), size + 1):
                self._store(rest[start], address, rest[start + 1 : start + 1 + size])

    def _load(self, id_: int, address: int, size: int) -> bytes:
        """Read bytes, directly or through the indirect addresses."""
        memory, indirect = self.memory[id_], self._models[id_].table.indirect
        data = bytearray()
        for each in range(address, address + size):
            entry = indirect.entry_of(each)
            behind = 0 if entry is None else word(memory, entry)
            data.append(memory[behind or each])
        return bytes(data)

    def _store(self, id_: int, address: int, data: bytes) -> None:
        self.memory[id_][address : address + len(data)] = data
        if address == self._models[id_].table[Register.GOAL_POSITION].address:
            self.put(id_, Register.PRESENT_POSITION, self.get(id_, Register.GOAL_POSITION))

    def _answer(self, id_: int, data: bytes) -> None:
        self._answers += codec.build_status(id_, 0, data)
