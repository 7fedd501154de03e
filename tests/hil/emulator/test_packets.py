"""The codec against the official SDK, and the parser against noise."""

from __future__ import annotations

import pytest
from dynamixel_sdk import Protocol2PacketHandler
from hypothesis import assume, example, given
from hypothesis import strategies as st

from hil.emulator import packets
from hil.emulator.packets import Instruction, Packet, PacketParser

SDK = Protocol2PacketHandler()

ids = st.integers(0, 0xFC)
# Mostly bytes that stuffing and headers are made of.
tricky = st.lists(
    st.one_of(st.sampled_from([0xFF, 0xFF, 0xFD, 0x00]), st.integers(0, 255)), max_size=60
).map(bytes)


class SdkPort:
    """Port for the SDK: keeps the bytes that are written, returns those that were given."""

    def __init__(self, incoming: bytes = b"") -> None:
        self.is_using = False
        self.sent, self.incoming = b"", incoming

    def clearPort(self) -> None:
        pass

    def writePort(self, packet) -> int:
        self.sent += bytes(packet)
        return len(packet)

    def readPort(self, length: int) -> list[int]:
        data, self.incoming = self.incoming[:length], self.incoming[length:]
        return list(data)

    def setPacketTimeout(self, length: int) -> None:
        pass

    def isPacketTimeout(self) -> bool:
        return not self.incoming


@given(st.binary(max_size=300))
def test_crc_is_the_sdks(data):
    assert packets.crc16(data) == SDK.updateCRC(0, data, len(data))


def test_crc_of_the_protocols_own_example():
    # e-Manual, Protocol 2.0, "Ping": FF FF FD 00 01 03 00 01 194E.
    assert packets.encode_packet(1, Instruction.PING) == bytes.fromhex("FFFFFD0001030001194E")


@given(ids, tricky)
def test_encoding_equals_the_sdks_stuffing_and_crc(servo_id, parameters):
    length = len(parameters) + 3
    plain = [0] * 4 + [servo_id, length & 0xFF, length >> 8, Instruction.WRITE, *parameters, 0, 0]
    stuffed = SDK.addStuffing(plain)
    stuffed[:4] = packets.HEADER
    crc = SDK.updateCRC(0, stuffed, len(stuffed) - 2)
    stuffed[-2:] = crc & 0xFF, crc >> 8
    assert packets.encode_packet(servo_id, Instruction.WRITE, parameters) == bytes(stuffed)


@given(tricky)
def test_stuffing_hides_every_header_and_comes_off_again(body):
    stuffed = packets.stuff(body)
    assert packets.HEADER not in stuffed
    assert packets.unstuff(stuffed) == body


@given(ids, st.integers(0, 255), tricky)
def test_the_sdk_reads_our_status_packets(servo_id, error, parameters):
    # The SDK's removeStuffing looks at bytes that it has already moved: a second FF FD FD behind
    # a stuffed FF FF FD loses a byte. Everything else it reads right.
    assume(b"\xff\xfd\xfd" not in bytes((error,)) + parameters)
    rxpacket, result = SDK.rxPacket(
        SdkPort(packets.status_packet(servo_id, error, parameters)), False
    )
    assert result == 0
    assert (rxpacket[4], rxpacket[8]) == (servo_id, error)
    assert bytes(rxpacket[9 : 9 + len(parameters)]) == parameters


@given(st.lists(st.tuples(ids, st.integers(0, 255)), min_size=1, max_size=6), st.data())
def test_the_sdk_reads_our_fast_status_packets(servos, data):
    """Several servos, one packet: every block ends with the CRC of all in front of it."""
    size = data.draw(st.integers(1, 20))
    content = [data.draw(st.binary(min_size=size, max_size=size)) for _ in servos]
    blocks = [(i, error, block) for (i, error), block in zip(servos, content, strict=True)]
    frame = packets.fast_status_packet(len(blocks), blocks)
    raw, result, _ = SDK.fastSyncReadRx(SdkPort(frame), packets.BROADCAST, len(blocks) * (size + 4))
    assert result == 0
    for k, (servo_id, error, block) in enumerate(blocks):
        start = k * (size + 4)
        assert bytes(raw[start : start + 2 + size]) == bytes((error, servo_id)) + block
        end = 8 + start + 2 + size
        assert int.from_bytes(frame[end : end + 2], "little") == SDK.updateCRC(0, frame, end)


def test_a_fast_status_packet_announces_those_that_stay_silent():
    frame = packets.fast_status_packet(3, [(1, 0, b"abcd")])
    assert int.from_bytes(frame[5:7], "little") == 1 + 3 * 8 and len(frame) == 8 + 8


def test_the_sdk_unstuffs_once_too_often_and_we_do_not():
    data = bytes.fromhex("FFFFFD 00 FFFDFD 00")
    rxpacket, result = SDK.rxPacket(SdkPort(packets.status_packet(1, 0, data)), False)
    assert result == 0 and bytes(rxpacket[9 : 9 + len(data)]) != data
    [packet] = PacketParser().feed(packets.status_packet(1, 0, data))
    assert packet.parameters[1:] == data


def test_a_packet_that_the_sdk_leaves_unstuffed_is_refused():
    port = SdkPort()
    SDK.write4ByteTxOnly(port, 1, 564, -131073)
    assert [p.intact for p in PacketParser().feed(port.sent)] == [False]


@given(
    st.lists(st.tuples(ids, st.sampled_from(list(Instruction)), tricky), max_size=5),
    st.lists(st.integers(1, 12), min_size=1, max_size=40),
)
def test_packets_survive_any_slicing_of_the_stream(messages, cuts):
    stream = b"".join(packets.encode_packet(*message) for message in messages)
    parser, found, position = PacketParser(), [], 0
    while position < len(stream):
        step = cuts[position % len(cuts)]
        found += parser.feed(stream[position : position + step])
        position += step
    assert found == [Packet(*message) for message in messages]
    assert parser.skipped == 0


@given(ids, tricky, st.binary(max_size=40))
@example(1, b"\x01", b"\xff\xff\xfd")
def test_a_whole_packet_is_found_behind_noise(servo_id, parameters, noise):
    assume(packets.HEADER not in noise + packets.HEADER[:3])
    whole = packets.encode_packet(servo_id, Instruction.WRITE, parameters)
    assert PacketParser().feed(noise + whole) == [Packet(servo_id, Instruction.WRITE, parameters)]


@given(ids, tricky, st.data())
def test_a_whole_packet_is_found_behind_a_truncated_one(servo_id, parameters, data):
    whole = packets.encode_packet(servo_id, Instruction.WRITE, parameters)
    cut = data.draw(st.integers(1, len(whole) - 3))
    truncated = packets.encode_packet(7, Instruction.WRITE, bytes(len(whole)))[:cut]
    found = [p for p in PacketParser().feed(truncated + whole) if p.intact]
    assert found == [Packet(servo_id, Instruction.WRITE, parameters)]


@given(ids, tricky, st.data())
def test_no_packet_with_a_flipped_bit_is_taken_for_intact(servo_id, parameters, data):
    frame = bytearray(packets.encode_packet(servo_id, Instruction.WRITE, parameters))
    bit = data.draw(st.integers(0, 8 * len(frame) - 1))
    frame[bit // 8] ^= 1 << bit % 8
    assert not [p for p in PacketParser().feed(bytes(frame)) if p.intact]


@pytest.mark.parametrize(
    ("ours", "theirs"),
    [
        (packets.encode_packet(3, Instruction.PING), lambda w: SDK.ping(w, 3)),
        (packets.read_packet(3, 580, 10), lambda w: SDK.readTx(w, 3, 580, 10)),
        (packets.write_packet(3, 562, b"\x01"), lambda w: SDK.writeTxOnly(w, 3, 562, 1, [1])),
        (
            packets.sync_read_packet((1, 2), 574, 10),
            lambda w: SDK.syncReadTx(w, 574, 10, [1, 2], 2, False),
        ),
        (
            packets.sync_write_packet(564, {1: b"\1\0\0\0", 2: b"\2\0\0\0"}),
            lambda w: SDK.syncWriteTxOnly(w, 564, 4, [1, 1, 0, 0, 0, 2, 2, 0, 0, 0], 10),
        ),
        (packets.encode_packet(3, Instruction.REBOOT), lambda w: SDK.reboot(w, 3)),
    ],
)
def test_instructions_equal_the_sdks(ours, theirs):
    port = SdkPort()
    theirs(port)
    assert port.sent == ours
