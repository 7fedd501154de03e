"""Port and packet handlers of the SDK, bounded by a deadline.

Differences from dynamixel-sdk 4.1.0 as shipped (docs/sources.md, "Dynamixel SDK"):

- A read blocks in the kernel until bytes arrive. As shipped it polls, which uses 13–31 % of a
  processor and under SCHED_FIFO keeps the kernel's worker from delivering the bytes.
- The deadline of the caller is the only timeout. As shipped one lost answer costs 34 ms.
- The deadline also holds while bytes keep coming. After it the port is read once more, for bytes
  that arrived in time, and an exchange takes `EXCHANGE_BYTES` at most. As shipped a flood is read
  for ever.
- Time is monotonic, or simulated. As shipped it is the wall clock.
- A status packet is searched in whole byte strings, not byte by byte, which saves about 20 µs in
  every tick.
- `txPacket` sends the stuffed packet. As shipped the result of the stuffing is discarded, so that a
  payload with FF FF FD is sent as a false header. `removeStuffing` examines the received bytes. As
  shipped it examines its own output, so that after one stuffed header a second FF FD FD loses a
  byte.

The bytes go through a `firmware_py.bus.transport.Transport`.
"""

from __future__ import annotations

from typing import Any, Final

from dynamixel_sdk import Protocol2PacketHandler
from dynamixel_sdk.port_handler import PortHandler
from dynamixel_sdk.robotis_def import (
    BROADCAST_ID,
    COMM_PORT_BUSY,
    COMM_RX_CORRUPT,
    COMM_RX_TIMEOUT,
    COMM_SUCCESS,
    COMM_TX_ERROR,
    COMM_TX_FAIL,
    MAX_ID,
)

from firmware_py.bus.transport import Transport
from firmware_py.system.clock import Clock

EXCHANGE_BYTES: Final = 4096
"""Most bytes of one exchange; a line of 4 Mbaud delivers 3200 in the 8 ms of a tick."""
_READ_SIZE: Final = 1024
"""Bytes of one read. They are parsed without a look at the clock, which takes 1 ms at worst."""
_MAX_PACKET: Final = 1024
_LONGEST_WAIT_NS: Final = 1_000_000_000
HEADER: Final = b"\xff\xff\xfd"
"""Start of a packet; byte stuffing keeps it out of the body."""
_STUFFED: Final = HEADER + b"\xfd"
_RESERVED, _ID, _LENGTH, INSTRUCTION = 3, 4, 5, 7
_STATUS: Final = 0x55
_SHORTEST: Final = 11
"""Bytes of a status packet without data."""


class DeadlinePort(PortHandler):  # type: ignore[misc]  # the SDK is untyped
    """Port of the SDK over a `Transport`, bounded by a deadline.

    `baud`: bits per second, for information only: the transport is already open.
    """

    def __init__(
        self, transport: Transport, clock: Clock, name: str = "", baud: int = 1_000_000
    ) -> None:
        super().__init__(name)
        self.baudrate = baud
        self.is_open = True
        self.deadline_ns = 0
        self.wait_ns = 0
        self._transport, self._clock = transport, clock
        self._begin_exchange()

    def _begin_exchange(self) -> None:
        self._received, self._room, self._read_late = b"", EXCHANGE_BYTES, False

    def openPort(self) -> bool:
        """Report that the transport is open, which it is from the start."""
        return True

    def closePort(self) -> None:
        """Close the transport."""
        self._transport.close()
        self.is_open = False

    def replace(self, transport: Transport) -> None:
        """Continue with another transport after a disconnect."""
        self._transport = transport
        self._begin_exchange()
        self.is_open, self.is_using = True, False

    def clearPort(self) -> None:
        """Drop bytes received before a new instruction."""
        self._begin_exchange()
        self._transport.discard_input()

    def setBaudRate(self, baudrate: int) -> bool:
        """Return whether this is the rate of the open transport, which is not changed."""
        return bool(baudrate == self.baudrate)

    def getBytesAvailable(self) -> int:
        """Return the number of bytes received but not yet read."""
        return len(self._received)

    def readPort(self, length: int) -> bytes:
        """Return up to `length` bytes, waiting for the first one until the deadline.

        The first read after the deadline returns the bytes that are there, further ones none.
        """
        if length <= 0:  # negative if a damaged packet names a wrong length
            return b""
        if not self._received:
            self._receive()
        data, self._received = self._received[:length], self._received[length:]
        return data

    def _receive(self) -> None:
        start_ns = self._clock.now_ns()
        late = not 0 < self.deadline_ns - start_ns <= _LONGEST_WAIT_NS
        if (late and self._read_late) or self._room <= 0:
            return
        self._read_late = late
        self._received = self._transport.read(min(_READ_SIZE, self._room), self.deadline_ns)
        self._room -= len(self._received)
        self.wait_ns += self._clock.now_ns() - start_ns

    def writePort(self, packet: bytes) -> int:
        """Send a packet."""
        return self._transport.write(packet)

    def setPacketTimeout(self, packet_length: int) -> None:
        """Do nothing: only `deadline_ns` counts."""

    def setPacketTimeoutMillis(self, msec: float) -> None:
        """Do nothing: only `deadline_ns` counts."""

    def isPacketTimeout(self) -> bool:
        """Return whether the exchange is over: deadline, clock set back, or too many bytes."""
        remaining_ns = self.deadline_ns - self._clock.now_ns()
        over = self._room <= 0 or not 0 < remaining_ns <= _LONGEST_WAIT_NS
        return not self._received and over

    def getCurrentTime(self) -> float:
        """Return the clock in milliseconds, the SDK's unit."""
        return self._clock.now_ns() * 1e-6


def _crc_table() -> tuple[int, ...]:
    """CRC-16 of Protocol 2.0: polynomial 0x8005, most significant bit first, start 0."""
    table = []
    for byte in range(256):
        crc = byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ 0x8005 if crc & 0x8000 else crc << 1) & 0xFFFF
        table.append(crc)
    return tuple(table)


_CRC_TABLE: Final = _crc_table()


def _begins_status(packet: bytes, highest_id: int) -> bool:
    """Whether a status packet may begin with these bytes."""
    return (
        packet.startswith(HEADER)
        and packet[_RESERVED] == 0
        and packet[_ID] <= highest_id
        and packet[_LENGTH] | packet[_LENGTH + 1] << 8 <= _MAX_PACKET
        and packet[INSTRUCTION] == _STATUS
    )


def _next_header(packet: bytes) -> int:
    """Return the offset, beyond the first byte, at which the next header may begin."""
    start = packet.find(HEADER, 1)
    return start if start > 0 else max(1, len(packet) - len(HEADER))


class PacketHandler(Protocol2PacketHandler):  # type: ignore[misc]  # the SDK is untyped
    """Protocol 2.0 of the SDK on byte strings, with correct stuffing."""

    def updateCRC(self, crc_accum: int, data_blk_ptr: Any, data_blk_size: int) -> int:
        """Continue a CRC over the first bytes; the SDK would rebuild its table on every call."""
        for byte in data_blk_ptr[:data_blk_size]:
            crc_accum = (crc_accum << 8 & 0xFFFF) ^ _CRC_TABLE[crc_accum >> 8 ^ byte]
        return crc_accum

    def rxPacket(self, port: DeadlinePort, fast_option: bool) -> tuple[bytes, int]:
        """Receive the next status packet; bytes before it are dropped."""
        highest_id = BROADCAST_ID if fast_option else MAX_ID
        packet, wanted, result = b"", _SHORTEST, int(COMM_RX_CORRUPT)
        while True:
            packet += port.readPort(wanted - len(packet))
            if len(packet) < wanted:
                if not port.isPacketTimeout():
                    continue
                result = int(COMM_RX_CORRUPT if packet else COMM_RX_TIMEOUT)
                break
            if not _begins_status(packet, highest_id):
                packet, wanted = packet[_next_header(packet) :], _SHORTEST
                continue
            wanted = INSTRUCTION + (packet[_LENGTH] | packet[_LENGTH + 1] << 8)
            if len(packet) < wanted:
                continue
            crc = packet[wanted - 2] | packet[wanted - 1] << 8
            if wanted >= _SHORTEST and self.updateCRC(0, packet, wanted - 2) == crc:
                result = int(COMM_SUCCESS)
            break
        port.is_using = False
        if result == COMM_SUCCESS and not fast_option:
            packet = self.removeStuffing(packet)
        return packet, result

    def addStuffing(self, packet: list[int]) -> list[int]:
        """Insert FD after every FF FF FD from the instruction on, and correct the length.

        Header and CRC are not changed: `txPacket` fills them in.
        """
        body = bytes(packet[INSTRUCTION:-2]).replace(HEADER, HEADER + b"\xfd")
        length = len(body) + 2
        return [*packet[:_LENGTH], length & 0xFF, length >> 8, *body, 0, 0]

    def removeStuffing(self, packet: bytes) -> bytes:
        """Return a received packet without stuffing, length corrected."""
        if _STUFFED not in packet:
            return packet
        body = packet[INSTRUCTION:-2].replace(_STUFFED, HEADER)
        return packet[:_LENGTH] + (len(body) + 2).to_bytes(2, "little") + body + packet[-2:]

    def txPacket(self, port: DeadlinePort, txpacket: list[int]) -> int:
        """Send an instruction; `txpacket` itself is not changed."""
        return self.send(port, self.finished(txpacket))

    def finished(self, txpacket: list[int]) -> bytes:
        """Return an instruction as bytes to send, with header, stuffing and CRC filled in."""
        packet = self.addStuffing(txpacket)
        packet[:4] = (*HEADER, 0)
        crc = self.updateCRC(0, packet, len(packet) - 2)
        packet[-2:] = (crc & 0xFF, crc >> 8)
        return bytes(packet)

    def send(self, port: DeadlinePort, packet: bytes) -> int:
        """Send a finished instruction that expects an answer; drop bytes received before.

        Returns COMM_SUCCESS or another result of the SDK.
        """
        if not port.is_using:
            port.clearPort()
        return self._write(port, packet)

    def tell(self, port: DeadlinePort, packet: bytes) -> int:
        """Send a finished instruction that no servo answers; return the result of the SDK."""
        result = self._write(port, packet)
        if result == COMM_SUCCESS:
            port.is_using = False
        return result

    def _write(self, port: DeadlinePort, packet: bytes) -> int:
        if port.is_using:
            return int(COMM_PORT_BUSY)
        if len(packet) > _MAX_PACKET:
            return int(COMM_TX_ERROR)
        port.is_using = True
        if port.writePort(packet) != len(packet):
            port.is_using = False
            return int(COMM_TX_FAIL)
        return int(COMM_SUCCESS)
