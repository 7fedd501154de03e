"""Packets of DYNAMIXEL Protocol 2.0: built, searched and parsed for robot and emulator alike.

::

    FF FF FD 00 | id | length (2, little-endian) | instruction | parameters ... | CRC-16 (2)

`length` counts the bytes after it. The CRC covers all bytes before it, after stuffing: inside a
body (instruction and parameters) the sequence FF FF FD is followed by one more FD, so that a header
never occurs there. A status packet is instruction 0x55 with the error byte as first parameter.
Source: ROBOTIS e-Manual, "DYNAMIXEL Protocol 2.0".

The tests compare this codec with the official SDK byte by byte. dynamixel-sdk 4.1.0 has two errors
that this codec avoids (docs/sources.md, "Dynamixel SDK"): it sends a goal of -131073 unstuffed, and
unstuffs FF FF FD FD .. FF FD FD once too often.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from enum import IntEnum
from typing import Final, NamedTuple

MARK: Final = b"\xff\xff\xfd"
"""Start of a packet; inside a body one more FD follows it."""
STUFFED: Final = MARK + b"\xfd"
HEADER: Final = MARK + b"\x00"
BROADCAST: Final = 0xFE
MOST_ID: Final = 252
"""Largest id of a servo; the protocol needs the others."""
BODY: Final = 7
"""Offset of the instruction, which begins the body."""
CRC_BYTES: Final = 2
STATUS_OVERHEAD: Final = 11
"""Bytes of a status packet around its data: header, id, length, instruction, error, CRC."""
ALERT: Final = 0x80
"""Bit of the error byte that is set while the servo's hardware error status is not zero."""
ERROR_NUMBER: Final = 0x7F
"""Bits of the error byte that hold a `StatusError`."""

_LONGEST: Final = 1024
"""Longest plausible `length` field; a longer one is noise."""
_SHORTEST: Final = BODY + 1 + CRC_BYTES


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
    """Error number of a status packet."""

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
    intact: bool = True  # False if the frame was complete but its CRC was wrong


def _crc_table() -> tuple[int, ...]:
    table = []
    for byte in range(256):
        crc = byte << 8
        for _ in range(8):
            crc = (crc << 1) ^ (0x8005 if crc & 0x8000 else 0)
        table.append(crc & 0xFFFF)
    return tuple(table)


_CRC_TABLE: Final = _crc_table()


def crc16(data: bytes | bytearray, crc: int = 0) -> int:
    """CRC-16 of polynomial x^16 + x^15 + x^2 + 1, most significant bit first.

    `crc`: CRC of the bytes before `data`.
    """
    table = _CRC_TABLE
    for byte in data:
        crc = (crc << 8 & 0xFF00) ^ table[crc >> 8 ^ byte]
    return crc


def stuff(body: bytes) -> bytes:
    """Insert an FD after every FF FF FD."""
    return body.replace(MARK, STUFFED)


def unstuff(body: bytes) -> bytes:
    """Inverse of `stuff`."""
    return body.replace(STUFFED, MARK)


# Build --------------------------------------------------------------------------------------------


def build(servo_id: int, instruction: int, parameters: bytes = b"") -> bytes:
    """Frame a packet, with stuffing and CRC."""
    body = stuff(bytes((instruction,)) + parameters)
    packet = HEADER + bytes((servo_id,)) + _words(len(body) + CRC_BYTES) + body
    return packet + _words(crc16(packet))


def build_status(servo_id: int, error: int = 0, data: bytes = b"") -> bytes:
    """Frame a status packet."""
    return build(servo_id, Instruction.STATUS, bytes((error,)) + data)


def build_read(servo_id: int, address: int, length: int) -> bytes:
    """Frame a read of one servo."""
    return build(servo_id, Instruction.READ, _words(address, length))


def build_write(servo_id: int, address: int, data: bytes) -> bytes:
    """Frame a write to one servo."""
    return build(servo_id, Instruction.WRITE, _words(address) + data)


def build_sync_read(ids: Iterable[int], address: int, length: int, *, fast: bool = False) -> bytes:
    """Frame a read of the same registers of several servos.

    With `fast`, all servos reply in one packet instead of one packet each.
    """
    instruction = Instruction.FAST_SYNC_READ if fast else Instruction.SYNC_READ
    return build(BROADCAST, instruction, _words(address, length) + bytes(ids))


def build_sync_write(address: int, data: Mapping[int, bytes]) -> bytes:
    """Frame a write of the same registers of several servos; no servo replies."""
    length = len(next(iter(data.values())))
    blocks = b"".join(bytes((servo_id,)) + block for servo_id, block in data.items())
    return build(BROADCAST, Instruction.SYNC_WRITE, _words(address, length) + blocks)


def build_fast_status(count: int, blocks: Iterable[tuple[int, int, bytes]]) -> bytes:
    """Frame the common reply to a fast sync read, from (id, error, data) of each servo.

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


def _words(*values: int) -> bytes:
    return b"".join(value.to_bytes(2, "little") for value in values)


def word(data: bytes | bytearray, offset: int) -> int:
    """Return the two bytes at an offset as a number."""
    return data[offset] | data[offset + 1] << 8


# Parse --------------------------------------------------------------------------------------------


class PacketSearch:
    """Search for packets in a byte stream, as the SDK does it: bytes before a packet are dropped.

    A host searches for status packets only; other instructions are noise to it. A packet with a
    wrong CRC is returned as not intact, and the search continues behind it.
    """

    def __init__(self, *, host: bool) -> None:
        self.pending = b""
        self._host = host
        self._shortest = STATUS_OVERHEAD if host else _SHORTEST

    def feed(self, data: bytes) -> list[Packet]:
        """Append bytes to `pending` and return all complete packets."""
        self.pending += data
        return list(iter(self.next, None))

    def next(self, *, common: bool = False) -> Packet | None:
        """Return the first complete packet of `pending` and remove it; None if there is none.

        `common`: the reply to a fast sync read, which has the broadcast id and is not stuffed.
        """
        data, host = self.pending, self._host
        highest_id = MOST_ID if host and not common else BROADCAST
        while len(data) >= self._shortest:
            if not (
                data.startswith(HEADER)
                and data[4] <= highest_id
                and word(data, 5) <= _LONGEST
                and (data[BODY] == Instruction.STATUS or not host)
            ):
                start = data.find(MARK, 1)
                data = data[start if start > 0 else max(1, len(data) - len(MARK)) :]
                continue
            end = BODY + word(data, 5)
            taken = max(end, self._shortest)
            if len(data) < taken:
                break
            frame, self.pending = data[:taken], data[taken:]
            packet = _parse(frame, stuffed=not common, strict=not host)
            return packet if taken == end else packet._replace(intact=False)
        self.pending = data
        return None


def _parse(frame: bytes, *, stuffed: bool, strict: bool) -> Packet:
    """Parse a whole frame; a strict one with a mark that is not stuffed is not intact."""
    body = frame[BODY:-CRC_BYTES]
    intact = crc16(frame[:-CRC_BYTES]) == word(frame, len(frame) - CRC_BYTES)
    if stuffed and MARK in body:
        plain = unstuff(body)
        intact = intact and not (strict and stuff(plain) != body)
        body = plain
    return Packet(frame[4], body[0], body[1:], intact)
