"""Access to single registers outside the loop, with retries."""

from __future__ import annotations

from typing import Final

from dynamixel_sdk.robotis_def import COMM_SUCCESS

from firmware_py.bus.bus_plan import STATUS_OVERHEAD
from firmware_py.bus.feedback import ALERT_BIT, DATA, ERROR, ERROR_NUMBER, ID
from firmware_py.bus.port import DeadlinePort, PacketHandler
from firmware_py.bus.registers import RegisterField
from firmware_py.system.clock import Clock

SETUP_TIMEOUT_NS: Final = 50_000_000
"""Longest wait for one answer outside the loop."""
SETUP_ATTEMPTS: Final = 3


class RegisterAccess:
    """Reader and writer of registers through the SDK."""

    def __init__(self, port: DeadlinePort, packets: PacketHandler, clock: Clock) -> None:
        self._port, self._packets, self._clock = port, packets, clock
        self.alert = False

    def ask(self, id_: int, cell: RegisterField) -> int | None:
        """Read a register once.

        The SDK's `readTxRx` accepts a late answer to an earlier write and takes its CRC for data.
        Here an answer of another length is dropped. None means a timeout or a refused read.
        """
        result = self._packets.readTx(self._port, id_, cell.address, cell.size)
        while result == COMM_SUCCESS:
            packet, result = self._packets.rxPacket(self._port, False)
            if result != COMM_SUCCESS or packet[ID] != id_:
                continue
            if len(packet) == STATUS_OVERHEAD + cell.size:
                return cell.decode(packet, DATA)
            if packet[ERROR] & ERROR_NUMBER:
                return None
        return None

    def ping(self, id_: int) -> bool:
        """Return whether a servo answers a ping, which works at every status return level."""
        self._port.deadline_ns = self._clock.now_ns() + SETUP_TIMEOUT_NS
        try:
            result: int = self._packets.ping(self._port, id_)[1]
        except OSError:
            self._port.is_using = False
            return False
        return result == int(COMM_SUCCESS)

    def get(self, id_: int, cell: RegisterField) -> int | None:
        """Read a register in up to three attempts; None if all fail or the port is disconnected."""
        for _ in range(SETUP_ATTEMPTS):
            self._port.deadline_ns = self._clock.now_ns() + SETUP_TIMEOUT_NS
            try:
                if (raw := self.ask(id_, cell)) is not None:
                    return raw
            except OSError:
                self._port.is_using = False
                return None
        return None

    def put(self, id_: int, cell: RegisterField, raw: int) -> bool:
        """Write a register in up to three attempts; return whether the servo confirmed it."""
        data = list(cell.encode(raw))
        for _ in range(SETUP_ATTEMPTS):
            self._port.deadline_ns = self._clock.now_ns() + SETUP_TIMEOUT_NS
            try:
                if (error := self._tell(id_, cell, data)) is None:
                    continue
            except OSError:
                self._port.is_using = False
                return False
            self.alert |= bool(error & ALERT_BIT)
            if not error & ERROR_NUMBER:
                return True
        return False

    def _tell(self, id_: int, cell: RegisterField, data: list[int]) -> int | None:
        """Write once; return the error byte of the answer, None without an answer.

        The SDK's `writeTxRx` accepts a late answer to an earlier read, and so may report torque off
        for a servo that never received the instruction. The answer to a write carries no data.
        """
        packets, port = self._packets, self._port
        if packets.writeTxOnly(port, id_, cell.address, cell.size, data) != COMM_SUCCESS:
            return None
        while True:
            packet, result = packets.rxPacket(port, False)
            if result != COMM_SUCCESS:
                return None
            if packet[ID] == id_ and len(packet) == STATUS_OVERHEAD:
                return int(packet[ERROR])
