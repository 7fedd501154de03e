"""Packets of DYNAMIXEL Protocol 2.0, implemented from its specification, without the SDK.

::

    FF FF FD 00 | id | length (2, little-endian) | instruction | parameters ... | CRC-16 (2)

`length` counts the bytes after it. The CRC covers all bytes before it, after stuffing: inside a
body (instruction and parameters) the sequence FF FF FD is followed by one more FD, so that a header
never occurs there. A status packet is instruction 0x55 with the error byte as first parameter.
Source: ROBOTIS e-Manual, "DYNAMIXEL Protocol 2.0".

The tests compare this codec with the SDK. SDK 4.1.0 has two errors that this codec avoids: it sends
a goal of -131073 unstuffed, and unstuffs FF FF FD FD .. FF FD FD once too often (docs/sources.md,
"Dynamixel SDK").
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from enum import IntEnum
from typing import Final, NamedTuple

__all__ = [
    "Instruction",
    "Packet",
    "PacketParser",
    "StatusError",
    "crc16",
    "encode_packet",
    "fast_status_packet",
    "read_packet",
    "status_packet",
    "stuff",
    "sync_read_packet",
    "sync_write_packet",
    "unstuff",
    "write_packet",
]

HEADER: Final = b"\xff\xff\xfd\x00"
MARK: Final = HEADER[:3]
"""Bytes that an FD must follow inside a body."""
BROADCAST: Final = 0xFE
ALERT: Final = 0x80
"""Bit of the error byte that is set while the servo's hardware error status is not zero."""
MAX_LENGTH: Final = 1024
"""Longest plausible `length` field; a longer one is noise."""
_OVERHEAD = 7  # header, id, length


class Instruction(IntEnum):
    PING = 0x01
    READ = 0x02
    WRITE = 0x03
    REG_WRITE = 0x04
    ACTION = 0x05
    REBOOT = 0x08
    STATUS = 0x55
    SYNC_READ = 0x82
    SYNC_WRITE = 0x83
    FAST_SYNC_READ = 0x8A


class StatusError(IntEnum):
    """Error number of a status packet (its lower seven bits)."""

    NONE = 0
    RESULT_FAIL = 1
    INSTRUCTION = 2
    CRC = 3
    DATA_RANGE = 4
    DATA_LENGTH = 5
    DATA_LIMIT = 6
    ACCESS = 7


class Packet(NamedTuple):
    """Packet as received, unstuffed."""

    id: int  # Servo that the packet is for; for a status packet, its sender
    instruction: int
    parameters: bytes  # Of a status packet, the first is the error byte
    intact: bool = True  # False if the frame was complete but its CRC or stuffing was wrong


def _crc_table() -> tuple[int, ...]:
    table = []
    for byte in range(256):
        crc = byte << 8
        for _ in range(8):
            crc = (crc << 1) ^ (0x8005 if crc & 0x8000 else 0)
        table.append(crc & 0xFFFF)
    return tuple(table)


_CRC_TABLE = _crc_table()


def crc16(data: bytes) -> int:
    """CRC-16 of polynomial x^16 + x^15 + x^2 + 1, start value 0, most significant bit first."""
    crc, table = 0, _CRC_TABLE
    for byte in data:
        crc = (crc << 8 & 0xFF00) ^ table[crc >> 8 ^ byte]
    return crc


def stuff(body: bytes) -> bytes:
    """Insert an FD after every FF FF FD."""
    return body.replace(MARK, MARK + b"\xfd")


def unstuff(body: bytes) -> bytes:
    """Inverse of `stuff`."""
    if MARK not in body:
        return body
    head, *rest = body.split(MARK)
    if any(not part.startswith(b"\xfd") for part in rest):
        raise ValueError("the body holds a header that is not stuffed")
    return MARK.join([head, *(part[1:] for part in rest)])


def encode_packet(servo_id: int, instruction: int, parameters: bytes = b"") -> bytes:
    """Frame a packet, with stuffing and CRC."""
    body = stuff(bytes((instruction,)) + parameters)
    packet = HEADER + bytes((servo_id,)) + (len(body) + 2).to_bytes(2, "little") + body
    return packet + crc16(packet).to_bytes(2, "little")


def status_packet(servo_id: int, error: int = 0, parameters: bytes = b"") -> bytes:
    """Frame a status packet."""
    return encode_packet(servo_id, Instruction.STATUS, bytes((error,)) + parameters)


def _words(*values: int) -> bytes:
    return b"".join(value.to_bytes(2, "little") for value in values)


def read_packet(servo_id: int, address: int, length: int) -> bytes:
    """Frame a read of one servo."""
    return encode_packet(servo_id, Instruction.READ, _words(address, length))


def write_packet(servo_id: int, address: int, data: bytes) -> bytes:
    """Frame a write to one servo."""
    return encode_packet(servo_id, Instruction.WRITE, _words(address) + data)


def sync_read_packet(ids: Iterable[int], address: int, length: int, *, fast: bool = False) -> bytes:
    """Frame a read of the same registers of several servos.

    With `fast`, all servos reply in one packet instead of one packet each.
    """
    instruction = Instruction.FAST_SYNC_READ if fast else Instruction.SYNC_READ
    return encode_packet(BROADCAST, instruction, _words(address, length) + bytes(ids))


def fast_status_packet(count: int, blocks: Iterable[tuple[int, int, bytes]]) -> bytes:
    """Frame the common reply to a fast sync read.

    The first servo sends the header, with the length of the whole reply; every servo then sends
    error, id, data and the CRC over everything before it. Nothing is stuffed. If a servo is silent,
    those after it are silent too, and there are fewer `blocks` than the `count` servos addressed.
    """
    packet = b""
    for servo_id, error, data in blocks:
        if not packet:
            length = 1 + count * (len(data) + 4)
            packet = HEADER + bytes((BROADCAST,)) + _words(length) + bytes((Instruction.STATUS,))
        packet += bytes((error, servo_id)) + data
        packet += _words(crc16(packet))
    return packet


def sync_write_packet(address: int, data: Mapping[int, bytes]) -> bytes:
    """Frame a write of the same registers of several servos; no servo replies."""
    length = len(next(iter(data.values())))
    blocks = b"".join(bytes((servo_id,)) + block for servo_id, block in data.items())
    return encode_packet(BROADCAST, Instruction.SYNC_WRITE, _words(address, length) + blocks)


class PacketParser:
    """Parser of a byte stream that resynchronises after noise.

    A header inside the body of an unfinished packet shows that the packet was truncated: the
    parser drops it at once. After a wrong CRC it continues the search just after the header, so
    that a damaged packet never hides an intact one behind it.
    """

    def __init__(self) -> None:
        self._buffer = bytearray()
        self.skipped = 0

    def feed(self, data: bytes) -> list[Packet]:
        """Append bytes; return the packets that they complete, in order."""
        buffer = self._buffer
        buffer += data
        packets: list[Packet] = []
        while True:
            start = buffer.find(HEADER)
            if start < 0:
                self._drop(max(len(buffer) - 3, 0))  # the last bytes may begin a header
                return packets
            self._drop(start)
            if len(buffer) < _OVERHEAD:
                return packets
            length = buffer[5] | buffer[6] << 8
            end = _OVERHEAD + length
            body_end = min(end - 2, len(buffer))
            if not 3 <= length <= MAX_LENGTH or buffer[4] in (0xFD, 0xFF):
                self._drop(1)
            elif buffer.find(HEADER, _OVERHEAD, body_end) >= 0:
                self._drop(buffer.find(HEADER, _OVERHEAD))
            elif len(buffer) < end:
                return packets
            else:
                packet = _decode(bytes(buffer[:end]))
                packets.append(packet)
                if packet.intact:
                    del buffer[:end]
                else:
                    self._drop(1)

    def _drop(self, count: int) -> None:
        self.skipped += count
        del self._buffer[:count]


def _decode(frame: bytes) -> Packet:
    body, crc = frame[_OVERHEAD:-2], frame[-2] | frame[-1] << 8
    intact = crc16(frame[:-2]) == crc
    try:
        body = unstuff(body)
    except ValueError:
        intact = False
    return Packet(frame[4], body[0], body[1:], intact)
