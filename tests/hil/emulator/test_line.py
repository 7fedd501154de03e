"""Timing of the line, and its three ports, used by the SDK and by our bus."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_py.bus import codec
from firmware_py.bus.bus_plan import plans
from firmware_py.bus.codec import Instruction, PacketSearch
from firmware_py.bus.dynamixel import DynamixelBus
from firmware_py.bus.port import SETUP_TIMEOUT_NS
from firmware_py.bus.registers import Register
from firmware_py.bus.servo_bus import BusStatus
from firmware_py.bus.servo_models import MODELS
from firmware_py.bus.servo_setup import ServoSetup
from firmware_py.core.errors import InputError
from firmware_py.system.clock import SimClock
from hil.emulator.line import (
    USB_PACKET_BYTES,
    Line,
    VirtualTransport,
    socket_endpoint,
)
from hil.emulator.line_faults import FaultPlan, parse_rates

MS = 1_000_000


def bus_on(transport, clock, number=54025, ids=(1, 2)) -> DynamixelBus:
    servos = [ServoSetup(servo_id, MODELS[number], -1.0, 1.0) for servo_id in ids]
    return DynamixelBus(transport, servos, clock, period_s=0.017)


@pytest.fixture
def driven(bus_of):
    """Build a virtual line and a bus on it that is connected and drives: (clock, line, bus)."""

    def build(number=54025, ids=(1,)):
        clock, line = SimClock(), Line(bus_of(number, ids))
        bus = bus_on(VirtualTransport(line, clock), clock, number, ids)
        bus.connect()
        assert bus.torque(True) is BusStatus.OK
        return clock, line, bus

    return build


@pytest.mark.parametrize("baud", [57_600, 1_000_000, 4_000_000])
@pytest.mark.parametrize("servos", [1, 2, 4])
def test_every_plan_takes_the_transmission_time_that_was_calculated(bus_of, baud, servos):
    """The line plays packets bit by bit; the plan counts bytes on paper."""
    ids = tuple(range(1, servos + 1))
    for plan in plans(MODELS[54025].table, servos, baud):
        line, block = Line(bus_of(54025, ids, baud=baud), latency_s=0.0), plan.block
        answers = line.receive(
            0, codec.build_sync_read(ids, block.address, block.size, fast=plan.fast)
        )
        assert sum(len(data) for _, data in answers) == plan.answer_bytes
        assert answers[-1][0] * 1e-9 == pytest.approx(plan.read_s, rel=1e-4)
        line.receive(answers[-1][0], codec.build_sync_write(564, {i: bytes(4) for i in ids}))
        assert line._free_ns * 1e-9 == pytest.approx(plan.total_s, rel=1e-4)


def test_the_latency_timer_hands_bytes_over_at_its_ticks(bus_of):
    ping = codec.build(1, Instruction.PING)
    prompt = Line(bus_of(), latency_s=0.0).receive(0, ping)
    timed = Line(bus_of(), latency_s=16e-3).receive(0, ping)
    assert timed == [(16 * MS, prompt[0][1])]
    assert Line(bus_of(), latency_s=1e-3).receive(0, ping)[0][0] == 1 * MS


def test_a_full_adapter_does_not_wait_for_its_timer(bus_of):
    answers = Line(bus_of(), latency_s=16e-3).receive(0, codec.build_read(1, 0, 100))
    assert len(answers[0][1]) == USB_PACKET_BYTES
    # Instruction 14 bytes, return delay, 62 bytes, at 10 µs each.
    assert answers[0][0] == (14 + 62) * 10_000 + 500_000
    assert answers[1][0] == answers[0][0] + 16 * MS, "the timer starts anew"
    [status] = PacketSearch(host=False).feed(b"".join(data for _, data in answers))
    assert len(status.parameters) == 101


@settings(max_examples=30)
@given(st.lists(st.integers(0, 60 * MS), max_size=20), st.sampled_from([0.0, 1e-3, 16e-3]))
def test_no_answer_is_readable_before_it_was_transmitted(bus_of, gaps, latency):
    line = Line(bus_of(1020), latency_s=latency)
    now = 0
    for gap in gaps:
        now += gap
        [(release_ns, data)] = line.receive(now, codec.build_read(1, 126, 10))
        earliest = now + (14 + len(data)) * 10_000 + 500_000
        assert earliest <= release_ns <= earliest + latency * 1e9
        now = release_ns


@pytest.mark.parametrize("number", sorted(MODELS))
def test_our_bus_drives_the_virtual_line(driven, number):
    clock, line, bus = driven(number, (1, 2))
    goal = np.array([0.4, -0.3])
    for _ in range(60):
        clock.advance(17 * MS)
        assert bus.read(clock.now_ns() + 10 * MS) == BusStatus.OK
        assert bus.write(goal, clock.now_ns() + 10 * MS) == BusStatus.OK
    half_pulse = 0.5 * MODELS[number].rad_per_pulse
    np.testing.assert_allclose(bus.angle_rad, goal, rtol=0, atol=2.01 * half_pulse)
    np.testing.assert_allclose(line.bus.physics.angle_rad, goal, rtol=0, atol=1.01 * half_pulse)


def test_an_instruction_that_is_not_heard_changes_nothing_and_is_not_answered(driven):
    clock, line, bus = driven()
    line.faults = FaultPlan({"unheard": 1.0})
    assert bus.read(clock.now_ns() + 8 * MS) is BusStatus.TIMEOUT
    assert bus.torque(False) is BusStatus.TIMEOUT
    assert line.bus.driven
    assert set(line.faults.injected) == {"unheard"}
    line.faults = FaultPlan()
    assert bus.torque(False) is BusStatus.OK
    assert not line.bus.driven


@pytest.mark.parametrize("kind", ["lost", "late", "truncated", "corrupt", "duplicated", "noise"])
def test_each_fault_changes_its_packets_and_never_becomes_data(driven, kind):
    clock, line, bus = driven()
    bus.write(np.array([0.5]), clock.now_ns() + 8 * MS)
    for _ in range(60):
        clock.advance(17 * MS)
        assert bus.read(clock.now_ns() + 8 * MS) == BusStatus.OK
    truth = bus.angle_rad.copy()
    line.faults = FaultPlan({kind: 1.0}, seed=1)
    status = bus.read(clock.now_ns() + 8 * MS)
    harmless = kind in {"duplicated", "noise"}
    assert line.faults.injected[kind] == (1 if harmless else 2)
    assert status.fresh == harmless
    np.testing.assert_array_equal(bus.angle_rad, truth)
    line.faults = FaultPlan()
    clock.advance(17 * MS)
    assert bus.read(clock.now_ns() + 8 * MS) == BusStatus.OK, "the next tick is not disturbed"


class Scripted(FaultPlan):
    """Does to one status packet after the other what stands in a list, then nothing."""

    def __init__(self, *fates):
        super().__init__()
        self.fates = list(fates)

    def apply(self, frame):
        return self.fates.pop(0)(frame) if self.fates else [(0, frame)]


FATES = {
    "lost": lambda frame: [],
    "damaged": lambda frame: [(0, frame[:-1] + bytes([frame[-1] ^ 1]))],
    "late": lambda frame: [(5 * MS, frame)],
    "good": lambda frame: [(0, frame)],
}


def test_what_the_first_read_brought_serves_where_the_second_brings_nothing(driven):
    """Late by 5 ms for good: both answers of the first read come while the second waits."""
    clock, line, bus = driven(54024, (1, 2))
    line.faults = Scripted(*[FATES["late"]] * 40)
    for tick in range(10):
        clock.sleep_until(10**9 + 17 * MS * tick)
        assert bus.read(clock.now_ns() + 8 * MS) is BusStatus.RETRIED
        assert clock.now_ns() == 10**9 + 17 * MS * tick + 8 * MS, "the second was waited for"
        assert bus.late_ns == 0, "measured by the first"


@pytest.mark.parametrize(
    ("fates", "expected"),
    [
        (("good", "lost", "lost", "good"), BusStatus.RETRIED),
        (("lost", "good", "good", "damaged"), BusStatus.RETRIED),
        (("good", "lost", "good", "lost"), BusStatus.TIMEOUT),
        (("damaged", "good", "damaged", "good"), BusStatus.CORRUPT),
    ],
)
def test_two_reads_make_one_measurement_where_every_servo_answered_one(driven, fates, expected):
    clock, line, bus = driven(54024, (1, 2))
    before_rad = bus.angle_rad.copy()
    bus.write(np.array([0.2, 0.3]), clock.now_ns() + 8 * MS)
    clock.advance(1000 * MS)
    line.faults = Scripted(*(FATES[fate] for fate in fates))
    assert bus.read(clock.now_ns() + 8 * MS) is expected
    if expected.fresh:
        assert bus.angle_rad == pytest.approx([0.2, 0.3], abs=1e-3)
        assert 0 < bus.late_ns < 4 * MS, "the mean of a joint of each read"
    else:
        np.testing.assert_array_equal(bus.angle_rad, before_rad)


class LateOnce(VirtualTransport):
    """Its first answer to a write comes when the program has written again and asks on."""

    late_ns = SETUP_TIMEOUT_NS + MS // 2

    def write(self, data: bytes) -> int:
        count = super().write(data)
        if data[7] == Instruction.WRITE and self.late_ns:
            [(time_ns, order, answer)] = self._pending
            self._pending = [(time_ns + self.late_ns, order, answer)]
            self.late_ns = 0
        return count


def test_a_late_answer_to_a_write_is_not_taken_for_data(bus_of):
    clock = SimClock()
    emulated = bus_of(54024)
    bus = bus_on(LateOnce(Line(emulated), clock), clock, 54024, ids=(1,))
    bus.connect()  # as data, the CRC of the late answer would be a hardware error
    (settings,) = bus.read_settings()
    version = Register.FIRMWARE_VERSION
    assert settings[version.value] == emulated.servos[0].get(version)


def test_fault_rates_are_met():
    plan = FaultPlan({"lost": 0.2, "late": 0.1}, seed=5)
    frame = codec.build_status(1, 0, bytes(10))
    results = [plan.apply(frame) for _ in range(5000)]
    lost = sum(r == [] for r in results)
    late = sum(len(r) == 1 and r[0][0] > 0 for r in results)
    # Five standard deviations of a binomial count.
    assert abs(lost - 1000) < 5 * (5000 * 0.2 * 0.8) ** 0.5
    assert abs(late - 500) < 5 * (5000 * 0.1 * 0.9) ** 0.5
    assert sum(r == [(0, frame)] for r in results) == 5000 - lost - late


@pytest.mark.parametrize("word", ["nonsense=0.1", "lost", "lost=x", "lost=1.5", "late=-1"])
def test_a_fault_that_cannot_be_is_refused(word):
    with pytest.raises(Exception, match="--faults"):
        parse_rates([word])


@pytest.mark.parametrize("name", ["no_directory/x.sock", "x" * 200])
def test_a_path_where_no_socket_can_be_is_named(tmp_path, name):
    with (
        pytest.raises(InputError, match=r"--path .*x.* cannot be opened .*at most 107 bytes"),
        socket_endpoint(tmp_path / name, 0),
    ):
        pass
