"""Access to single registers outside the loop, with repeated attempts."""

from __future__ import annotations

from typing import Final

from dynamixel_sdk.robotis_def import COMM_SUCCESS

from firmware_py.bus.bus_plan import STATUS_OVERHEAD
from firmware_py.bus.feedback import ALERT_BIT, DATA, ERROR, ERROR_NUMBER, ID
from firmware_py.bus.port import DeadlinePort, PacketHandler
from firmware_py.bus.registers import RegisterField
from firmware_py.realtime.clock import Clock

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

        The SDK's own `readTxRx` accepts a late answer to an earlier write: its CRC then passes for
        data. Here an answer of a different length is dropped.

        Returns raw value; None where no valid answer came before the port's deadline.
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
        """Return whether a servo answers a ping, which it does at every status return level."""
        self._port.deadline_ns = self._clock.now_ns() + SETUP_TIMEOUT_NS
        try:
            result: int = self._packets.ping(self._port, id_)[1]
        except OSError:
            self._port.is_using = False
            return False
        return result == int(COMM_SUCCESS)

    def get(self, id_: int, cell: RegisterField) -> int | None:
        """Read a register, up to three times.

        Returns raw value; None where every attempt failed or the port has gone.
        """
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
        """Write a register, up to three times."""
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
        """Write once; return the error byte of the answer, None without one.

        The SDK's own `writeTxRx` accepts a late answer to an earlier read, so that a servo passes
        for switched off that never heard of it. The answer to a write carries no data.
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
