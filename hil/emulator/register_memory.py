"""Memory of an emulated servo: its control table as bytes, with indirect addresses."""

from __future__ import annotations

from typing import Final

from firmware_py.bus.registers import ControlTable, Register, RegisterField
from hil.emulator.packets import StatusError

MEMORY_BYTES: Final = 1024


class RegisterMemory:
    """Bytes of a control table."""

    def __init__(self, table: ControlTable) -> None:
        self._table = table
        self._memory = bytearray(MEMORY_BYTES)
        self._spans: dict[tuple[int, int], list[int]] = {}

    def get(self, register: Register) -> int:
        """Return the raw value of a register; 0 if the model lacks it."""
        cell = self._table.cells.get(register)
        return cell.decode(self._memory, cell.address) if cell else 0

    def put(self, register: Register, raw: int) -> None:
        """Set a register regardless of access rights; no effect if the model lacks it."""
        if register in self._table:
            self._store(self._table[register], raw)

    def _reset_indirect(self) -> None:
        """Restore the factory setting, in which each indirect entry points at itself."""
        indirect = self._table.indirect
        for k in range(indirect.entries):
            self._store(RegisterField(indirect.address + 2 * k, 2), indirect.data + k)
        self._spans.clear()

    def _store(self, cell: RegisterField, raw: int) -> None:
        self._memory[cell.address : cell.address + cell.size] = cell.encode(raw)

    def read(self, address: int, length: int) -> tuple[int, bytes]:
        """Read registers; return the error number and, if it is 0, the bytes."""
        if length == 0:
            return StatusError.DATA_LENGTH, b""
        if address + length > MEMORY_BYTES:
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

    def _write_indirect(self, address: int, data: bytes) -> None:
        self._memory[address : address + len(data)] = data
        self._spans.clear()

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
        held = self._memory[entry] | self._memory[entry + 1] << 8
        return held if held < MEMORY_BYTES else address
