"""The codec against the official SDK, byte by byte, and against noise."""

import dynamixel_sdk as sdk
from hypothesis import example, given
from hypothesis import strategies as st

from firmware_py.bus import codec
from firmware_py.bus.codec import BROADCAST, MARK, Instruction, Packet, PacketSearch
from firmware_py.bus.port import DeadlinePort
from firmware_py.bus.servo_bus import BusStatus
from firmware_py.system.clock import SimClock
from tests.firmware_py.bus.tampered import TapeTransport

SDK = sdk.PacketHandler(2.0)

ids = st.integers(0, 252)
addresses = st.integers(0, 1023)
# Mostly bytes that stuffing and headers are made of.
tricky = st.lists(
    st.one_of(st.sampled_from([0xFF, 0xFF, 0xFD, 0x00]), st.integers(0, 255)), max_size=60
).map(bytes)


class SdkPort:
    """Port for the SDK: records the bytes that are written, returns those of `incoming`."""

    def __init__(self, incoming: bytes = b"") -> None:
        self.is_using = False
        self.sent, self.incoming = b"", incoming

    def clearPort(self) -> None:
        pass

    def writePort(self, packet) -> int:
        self.sent += bytes(packet)
        return len(packet)

    def readPort(self, length: int) -> list[int]:
        data, self.incoming = self.incoming[:length], self.incoming[max(0, length) :]
        return list(data)

    def setPacketTimeout(self, length: int) -> None:
        pass

    def isPacketTimeout(self) -> bool:
        return not self.incoming


def sent_by_sdk(call) -> bytes:
    port = SdkPort()
    call(port)
    return port.sent


def parsed(data: bytes) -> list[Packet]:
    """What a servo parses."""
    return PacketSearch(host=False).feed(data)


# --- built alike ------------------------------------------------------------------------------


@given(ids, addresses, st.binary(min_size=1, max_size=40), st.lists(ids, min_size=1, unique=True))
def test_every_instruction_equals_the_sdks_and_is_parsed(servo_id, address, data, many):
    size = len(data)
    blocks = {each: data for each in many}
    flat = [byte for each in many for byte in (each, *data)]
    pairs = [
        (codec.build(servo_id, Instruction.PING), lambda w: SDK.ping(w, servo_id)),
        (codec.build(servo_id, Instruction.REBOOT), lambda w: SDK.reboot(w, servo_id)),
        (codec.build(servo_id, Instruction.ACTION), lambda w: SDK.action(w, servo_id)),
        (codec.build_read(servo_id, address, size),
         lambda w: SDK.readTx(w, servo_id, address, size)),
        (codec.build_write(servo_id, address, data),
         lambda w: SDK.writeTxOnly(w, servo_id, address, size, list(data))),
        (codec.build_sync_read(many, address, size),
         lambda w: SDK.syncReadTx(w, address, size, many, len(many), False)),
        (codec.build_sync_read(many, address, size, fast=True),
         lambda w: SDK.syncReadTx(w, address, size, many, len(many), True)),
        (codec.build_sync_write(address, blocks),
         lambda w: SDK.syncWriteTxOnly(w, address, size, flat, len(flat))),
    ]  # fmt: skip
    for ours, call in pairs:
        if MARK not in ours[codec.BODY :]:  # the SDK sends without stuffing
            theirs = sent_by_sdk(call)
            assert ours == theirs
            assert [p.intact for p in parsed(theirs)] == [True]


@given(ids, tricky)
def test_stuffing_and_crc_equal_the_sdks(servo_id, parameters):
    length = len(parameters) + 3
    bare = [0] * 4 + [servo_id, length & 0xFF, length >> 8, Instruction.WRITE, *parameters, 0, 0]
    stuffed = SDK.addStuffing(bare)
    stuffed[:4] = codec.HEADER
    crc = SDK.updateCRC(0, stuffed, len(stuffed) - 2)
    stuffed[-2:] = crc & 0xFF, crc >> 8
    assert codec.build(servo_id, Instruction.WRITE, parameters) == bytes(stuffed)


@given(tricky)
def test_whatever_is_sent_arrives_and_holds_no_false_header(parameters):
    frame = codec.build(1, Instruction.WRITE, parameters)
    assert frame.find(codec.HEADER, 1) < 0
    body = frame[codec.BODY : -codec.CRC_BYTES]
    assert body.count(MARK) == body.count(codec.STUFFED)
    assert parsed(frame) == [Packet(1, Instruction.WRITE, parameters)]


# --- the SDK parses what a servo sends ----------------------------------------------------------


@given(st.lists(st.tuples(ids, st.integers(0, 255)), min_size=1, max_size=6), st.data())
def test_the_sdk_reads_our_common_status_packets(servos, data):
    """Several servos, one packet: every block ends with the CRC of all in front of it."""
    size = data.draw(st.integers(1, 20))
    content = [data.draw(st.binary(min_size=size, max_size=size)) for _ in servos]
    blocks = [(i, error, block) for (i, error), block in zip(servos, content, strict=True)]
    frame = codec.build_fast_status(len(blocks), blocks)
    raw, result, _ = SDK.fastSyncReadRx(SdkPort(frame), BROADCAST, len(blocks) * (size + 4))
    assert result == sdk.COMM_SUCCESS
    for k, (servo_id, error, block) in enumerate(blocks):
        start = k * (size + 4)
        assert bytes(raw[start : start + 2 + size]) == bytes((error, servo_id)) + block
        end = 8 + start + 2 + size
        assert int.from_bytes(frame[end : end + 2], "little") == SDK.updateCRC(0, frame, end)


# --- searched alike -----------------------------------------------------------------------------


class ByteByByte(type(SDK)):
    """The SDK's search for packets, without its unstuffing.

    That looks at bytes that it has already moved: a second FF FD FD behind a stuffed FF FF FD loses
    a byte.
    """

    def removeStuffing(self, packet):
        return packet


def status(data, id_=1):
    return codec.build_status(id_, 0, bytes(data))


harmless = st.binary(max_size=20).map(lambda data: data.replace(b"\xfd", b"\xfc"))
pieces = st.lists(
    st.one_of(
        harmless.map(status),
        harmless.map(lambda data: status(data, BROADCAST)),
        st.sampled_from([0x00, 0x55, 0xFD, 0xFE, 0xFF]).map(lambda byte: bytes([byte])),
        st.binary(max_size=30),
        st.just(b"\xff\xff\xfd\x00\x01"),
    ),
    max_size=8,
).map(b"".join)


@given(pieces, st.booleans(), st.data())
@example(status([])[:5] + b"\0" + status([])[6:] + status([]), False, None)
def test_packets_are_found_where_the_sdk_finds_them(stream, common, data):
    stream = bytearray(stream)
    for _ in range(data.draw(st.integers(0, 3)) if stream and data else 0):  # damage
        stream[data.draw(st.integers(0, len(stream) - 1))] = data.draw(st.integers(0, 255))
    clock, theirs = SimClock(), SdkPort(bytes(stream))
    port = DeadlinePort(TapeTransport(clock, bytes(stream)), clock)
    port.deadline_ns = 1
    for _ in range(20):
        packet, status_of_read = port.receive(common=common)
        frame, result = ByteByByte().rxPacket(theirs, common)
        assert status_of_read is {
            sdk.COMM_SUCCESS: BusStatus.OK, sdk.COMM_RX_TIMEOUT: BusStatus.TIMEOUT,
            sdk.COMM_RX_CORRUPT: BusStatus.CORRUPT,
        }[result]  # fmt: skip
        if packet is not None:
            body = bytes(frame[codec.BODY : -codec.CRC_BYTES])
            body = body if common else codec.unstuff(body)
            assert packet == Packet(frame[4], body[0], body[1:])
        if status_of_read is BusStatus.TIMEOUT:
            return


@given(
    st.lists(st.tuples(ids, st.sampled_from(list(Instruction)), tricky), max_size=5),
    st.lists(st.integers(1, 12), min_size=1, max_size=40),
)
def test_packets_survive_any_slicing_of_the_stream(messages, cuts):
    stream = b"".join(codec.build(*message) for message in messages)
    search, packets, position = PacketSearch(host=False), [], 0
    while position < len(stream):
        step = cuts[position % len(cuts)]
        packets += search.feed(stream[position : position + step])
        position += step
    assert packets == [Packet(*message) for message in messages]


@given(ids, tricky, st.data())
def test_no_packet_with_a_flipped_bit_is_taken_for_intact(servo_id, parameters, data):
    frame = bytearray(codec.build(servo_id, Instruction.WRITE, parameters))
    bit = data.draw(st.integers(0, 8 * len(frame) - 1))
    frame[bit // 8] ^= 1 << bit % 8
    assert not [p for p in parsed(bytes(frame)) if p.intact]
