"""Registers as the bus sees them: rights, ranges, torque, protection, resolution."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_py.bus import codec
from firmware_py.bus.codec import ALERT, BROADCAST, Instruction, PacketSearch, StatusError
from firmware_py.bus.registers import Register
from firmware_py.bus.servo_models import MODELS
from hil.emulator.emulated_servo import EmulatedServo

LEGACY, PRO_A, X = 54024, 54025, 1020
MS = 1_000_000


def ask(bus, frame, now_ns=0):
    """Instruction in, (id, error, data) of every answer out."""
    [packet] = PacketSearch(host=False).feed(frame)
    answers = [
        PacketSearch(host=False).feed(reply.frame)[0] for reply in bus.execute(packet, now_ns)
    ]
    return [(a.id, a.parameters[0], a.parameters[1:]) for a in answers]


def write(bus, register, raw, now_ns=0, servo=0):
    cell = bus.servos[servo].model.table[register]
    frame = codec.build_write(bus.servos[servo].id, cell.address, cell.encode(raw))
    [(_, error, _)] = ask(bus, frame, now_ns)
    return error


def read(bus, register, now_ns=0, servo=0):
    cell = bus.servos[servo].model.table[register]
    [(_, error, data)] = ask(
        bus, codec.build_read(bus.servos[servo].id, cell.address, cell.size), now_ns
    )
    assert error & ~ALERT == 0
    return cell.decode(data)


def test_everyone_answers_a_broadcast_and_nobody_another_id(bus_of):
    bus = bus_of(X, ids=(3, 7))
    answers = ask(bus, codec.build(BROADCAST, Instruction.PING))
    models = [(id_, int.from_bytes(data[:2], "little")) for id_, _, data in answers]
    assert models == [(3, X), (7, X)]
    assert ask(bus, codec.build(5, Instruction.PING)) == []
    assert ask(bus, codec.build_write(BROADCAST, 64, b"\x01")) == []
    assert [servo.torque_on for servo in bus.servos] == [True, True]


@pytest.mark.parametrize("number", [LEGACY, PRO_A, X])
def test_it_moves_only_with_torque_on(bus_of, number):
    bus = bus_of(number)
    goal = bus.servos[0].model.position_raw(0.3)
    at_rest = read(bus, Register.PRESENT_POSITION)
    assert write(bus, Register.GOAL_POSITION, goal) == StatusError.NONE
    assert read(bus, Register.PRESENT_POSITION, 1000 * MS) == at_rest
    assert write(bus, Register.TORQUE_ENABLE, 1, 1000 * MS) == StatusError.NONE
    assert read(bus, Register.GOAL_POSITION, 1000 * MS) == at_rest, "no jump at switching on"
    write(bus, Register.GOAL_POSITION, goal, 1000 * MS)
    assert abs(read(bus, Register.PRESENT_CURRENT, 1010 * MS)) > 0
    assert read(bus, Register.PRESENT_POSITION, 3000 * MS) == goal
    moved_back = bus.servos[0].model.position_raw(0.0)
    write(bus, Register.GOAL_POSITION, moved_back, 3000 * MS)
    write(bus, Register.TORQUE_ENABLE, 0, 3000 * MS)
    assert read(bus, Register.PRESENT_POSITION, 5000 * MS) == goal, "the gear holds"
    assert read(bus, Register.PRESENT_CURRENT, 5000 * MS) == 0


@given(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0), st.floats(-8.0, 8.0))
def test_present_registers_are_within_half_a_step_of_the_plant(angle, velocity, current):
    servo = EmulatedServo(MODELS[LEGACY])
    servo.put(Register.TORQUE_ENABLE, 1)
    servo.observe(angle, velocity, current)
    for register, value, lsb in (
        (Register.PRESENT_POSITION, angle, 2 * math.pi / 501_923),
        (Register.PRESENT_CURRENT, current, 33 / 2048),
        (Register.PRESENT_VELOCITY, velocity, 0.00199234 * 2 * math.pi / 60),
    ):
        assert abs(servo.get(register) * lsb - value) <= 0.5 * lsb * (1 + 1e-9)


def test_a_current_beyond_the_register_is_clipped_not_wrapped():
    servo = EmulatedServo(MODELS[PRO_A])
    servo.put(Register.TORQUE_ENABLE, 1)
    for current_a, raw in ((1e3, 32767), (-1e3, -32768)):
        servo.observe(0.0, 0.0, current_a)
        assert servo.get(Register.PRESENT_CURRENT) == raw


@pytest.mark.parametrize(
    ("register", "raw", "error"),
    [
        (Register.PRESENT_POSITION, 0, StatusError.ACCESS),
        (Register.HARDWARE_ERROR, 0, StatusError.ACCESS),
        (Register.TORQUE_ENABLE, 2, StatusError.DATA_RANGE),
        (Register.OPERATING_MODE, 0, StatusError.DATA_RANGE),
        (Register.RETURN_DELAY, 255, StatusError.DATA_RANGE),
        (Register.GOAL_POSITION, 501_924, StatusError.DATA_LIMIT),
    ],
)
def test_a_write_that_is_not_allowed_changes_nothing(bus_of, register, raw, error):
    bus = bus_of(PRO_A)
    before = read(bus, register)
    assert write(bus, register, raw) == error
    assert read(bus, register) == before


def test_a_goal_may_lie_at_its_limit_and_beyond_it_in_extended_mode(bus_of):
    bus = bus_of(PRO_A)
    assert write(bus, Register.GOAL_POSITION, 501_923) == StatusError.NONE
    write(bus, Register.OPERATING_MODE, 4)
    assert write(bus, Register.GOAL_POSITION, 10_000_000) == StatusError.NONE


def test_eeprom_is_locked_while_torque_is_on(bus_of):
    bus = bus_of()
    write(bus, Register.TORQUE_ENABLE, 1)
    assert write(bus, Register.RETURN_DELAY, 0) == StatusError.ACCESS
    write(bus, Register.TORQUE_ENABLE, 0)
    assert write(bus, Register.RETURN_DELAY, 0) == StatusError.NONE
    assert write(bus, Register.BAUD_RATE, 5) == StatusError.NONE
    assert (bus.servos[0].return_delay_ns, bus.servos[0].baud) == (0, 3_000_000)


@pytest.mark.parametrize(
    ("frame", "error"),
    [
        (codec.build_write(1, 564, b"\x01\x02"), StatusError.DATA_LENGTH),
        (codec.build_write(1, 564, b""), StatusError.DATA_LENGTH),
        (codec.build_write(1, 565, b"\x01"), StatusError.ACCESS),
        (codec.build_read(1, 1020, 10), StatusError.ACCESS),
        (codec.build_read(1, 0, 0), StatusError.DATA_LENGTH),
        (codec.build(1, Instruction.READ, b"\x00"), StatusError.DATA_LENGTH),
        (codec.build(1, Instruction.WRITE, b""), StatusError.DATA_LENGTH),
        (codec.build(1, 0x77), StatusError.INSTRUCTION),
        (codec.build(1, Instruction.ACTION), StatusError.INSTRUCTION),
        (codec.build(1, Instruction.PING)[:-1] + b"\x00", StatusError.CRC),
    ],
)
def test_what_is_wrong_with_an_instruction_is_named(bus_of, frame, error):
    assert ask(bus_of(), frame) == [(1, error, b"")]


def test_nobody_complains_about_a_broken_broadcast(bus_of):
    frame = codec.build_sync_write(564, {1: bytes(4)})
    assert ask(bus_of(), frame[:-1] + bytes((frame[-1] ^ 1,))) == []


def test_one_write_can_span_several_registers_or_none(bus_of):
    bus = bus_of(PRO_A)
    velocity_and_position = (5).to_bytes(4, "little") + (77).to_bytes(4, "little")
    assert ask(bus, codec.build_write(1, 560, velocity_and_position)) == [(1, 0, b"")]
    assert (read(bus, Register.PROFILE_VELOCITY), read(bus, Register.GOAL_POSITION)) == (5, 77)
    beyond = (6).to_bytes(4, "little") + (10**8).to_bytes(4, "little")
    assert ask(bus, codec.build_write(1, 560, beyond))[0][1] == StatusError.DATA_LIMIT
    assert read(bus, Register.PROFILE_VELOCITY) == 5


def test_sync_read_answers_in_the_order_asked_until_one_is_missing(bus_of):
    bus = bus_of(ids=(1, 2))
    assert [a[0] for a in ask(bus, codec.build_sync_read((2, 1), 574, 10))] == [2, 1]
    assert [a[0] for a in ask(bus, codec.build_sync_read((1, 9, 2), 574, 10))] == [1]


def test_sync_write_reaches_each_servo_with_its_own_goal(bus_of):
    bus = bus_of(PRO_A, ids=(1, 2))
    frame = codec.build_sync_write(564, {1: b"\x05\0\0\0", 2: b"\xfb\xff\xff\xff", 9: bytes(4)})
    assert ask(bus, frame) == []
    assert [read(bus, Register.GOAL_POSITION, servo=k) for k in (0, 1)] == [5, -5]


def test_a_fatal_hardware_error_stops_the_motor_until_a_reboot(bus_of):
    bus = bus_of(PRO_A)
    write(bus, Register.TORQUE_ENABLE, 1)
    write(bus, Register.GOAL_POSITION, 10_000)
    bus.servos[0].fail(1 << 5)
    assert ask(bus, codec.build(1, Instruction.PING))[0][1] == ALERT
    assert read(bus, Register.TORQUE_ENABLE) == 0
    assert write(bus, Register.TORQUE_ENABLE, 1) == StatusError.RESULT_FAIL | ALERT
    assert read(bus, Register.PRESENT_POSITION, 1000 * MS) == 0
    ask(bus, codec.build(1, Instruction.REBOOT), 1000 * MS)
    assert read(bus, Register.HARDWARE_ERROR, 1000 * MS) == 0
    assert write(bus, Register.TORQUE_ENABLE, 1, 1000 * MS) == StatusError.NONE


def test_a_hardware_error_outside_the_shutdown_mask_only_alerts(bus_of):
    bus = bus_of(PRO_A)
    write(bus, Register.TORQUE_ENABLE, 1)
    bus.servos[0].fail(1 << 3)  # encoder; shutdown is 52 = bits 2, 4, 5
    assert read(bus, Register.TORQUE_ENABLE) == 1
    assert ask(bus, codec.build(1, Instruction.PING))[0][1] == ALERT


@pytest.mark.parametrize("number", [PRO_A, X])
def test_the_watchdog_stops_a_servo_that_hears_nothing(bus_of, number):
    bus = bus_of(number)
    write(bus, Register.TORQUE_ENABLE, 1)
    write(bus, Register.BUS_WATCHDOG, 3)
    goal = bus.servos[0].model.position_raw(1.0)
    write(bus, Register.GOAL_POSITION, goal)
    assert read(bus, Register.BUS_WATCHDOG, 59 * MS) == 3, "any instruction feeds it"
    assert read(bus, Register.BUS_WATCHDOG, 118 * MS) == 3
    assert read(bus, Register.BUS_WATCHDOG, 1000 * MS) == -1
    stopped = read(bus, Register.PRESENT_POSITION, 2000 * MS)
    # The lag plant stood at 1 - exp(-178/50) when the 60 ms were over.
    expected = bus.servos[0].model.position_raw(1.0 - math.exp(-178 / 50))
    assert abs(stopped - expected) <= 1
    assert write(bus, Register.GOAL_POSITION, goal, 2000 * MS) == StatusError.DATA_RANGE
    assert write(bus, Register.BUS_WATCHDOG, 0, 2000 * MS) == StatusError.NONE
    assert write(bus, Register.GOAL_POSITION, goal, 2000 * MS) == StatusError.NONE
    assert read(bus, Register.PRESENT_POSITION, 4000 * MS) == goal


def test_the_watchdog_sleeps_without_torque_and_legacy_has_none(bus_of):
    bus = bus_of(PRO_A)
    write(bus, Register.BUS_WATCHDOG, 1)
    assert read(bus, Register.BUS_WATCHDOG, 1000 * MS) == 1
    assert Register.BUS_WATCHDOG not in bus_of(LEGACY).servos[0].model.table


def test_homing_offset_shifts_position_and_goal_alike(bus_of):
    bus = bus_of(PRO_A)
    write(bus, Register.HOMING_OFFSET, 1000)
    assert read(bus, Register.PRESENT_POSITION, 20 * MS) == 1000
    write(bus, Register.TORQUE_ENABLE, 1, 20 * MS)
    write(bus, Register.GOAL_POSITION, 1000, 20 * MS)
    bus.advance(1000 * MS)
    assert bus.physics.angle_rad[0] == pytest.approx(0.0, abs=1e-12)


# --- fast sync read, indirect addresses -----------------------------------------------------------


def together(bus, ids, address, length):
    """(id, error, data) of every block of the one answer; the block CRCs are the codec's affair."""
    [packet] = PacketSearch(host=False).feed(codec.build_sync_read(ids, address, length, fast=True))
    replies = bus.execute(packet, 0)
    if not replies:
        return None
    [reply] = replies
    blocks, stride = reply.frame[8:], length + 4
    assert int.from_bytes(reply.frame[5:7], "little") == 1 + len(ids) * stride
    cut = [blocks[k : k + stride] for k in range(0, len(blocks), stride)]
    return [(block[1], block[0], block[2:-2]) for block in cut]


@settings(max_examples=40)
@given(st.integers(0, 600), st.integers(1, 40))
def test_a_fast_sync_read_gives_what_a_sync_read_gives(bus_of, address, length):
    bus = bus_of(PRO_A, ids=(1, 2, 3))
    bus.servos[1].fail(1)
    apart = ask(bus, codec.build_sync_read((3, 1, 2), address, length))
    assert together(bus, (3, 1, 2), address, length) == apart


def test_a_fast_answer_ends_before_a_silent_servo_and_a_legacy_pro_has_none(bus_of):
    assert together(bus_of(LEGACY, ids=(1, 2)), (1, 2), 611, 4) is None
    bus = bus_of(PRO_A, ids=(1, 2))
    assert [block[0] for block in together(bus, (1, 9, 2), 580, 4)] == [1]
    assert together(bus, (9, 1), 580, 4) is None


@pytest.mark.slow
@pytest.mark.parametrize("number", [LEGACY, PRO_A, X])
@given(data=st.data())
def test_indirect_data_shows_and_sets_what_its_entries_name(bus_of, number, data):
    bus = bus_of(number)
    table = bus.servos[0].model.table
    goal = table[Register.GOAL_POSITION]
    readable = st.sampled_from([cell for r, cell in table.cells.items() if r is not Register.ID])
    shown = data.draw(st.lists(readable, min_size=1, max_size=4))
    addresses = [c.address + k for c in shown for k in range(c.size)]
    addresses += [goal.address + k for k in range(4)]
    entries = b"".join(address.to_bytes(2, "little") for address in addresses)
    assert ask(bus, codec.build_write(1, table.indirect.address, entries))[0][1] == 0
    plain = b"".join(ask(bus, codec.build_read(1, c.address, c.size))[0][2] for c in shown)
    start = table.indirect.data
    assert ask(bus, codec.build_read(1, start, len(plain)))[0][2] == plain
    raw = bus.servos[0].model.position_raw(data.draw(st.floats(-0.5, 0.5)))
    assert ask(bus, codec.build_write(1, start + len(plain), goal.encode(raw)))[0][1] == 0
    assert read(bus, Register.GOAL_POSITION) == raw


def test_a_reboot_and_a_lock_treat_entries_as_eeprom_or_as_ram(bus_of):
    for number, eeprom in ((LEGACY, True), (PRO_A, True), (X, False)):
        bus = bus_of(number)
        first = bus.servos[0].model.table.indirect.address
        new = (600).to_bytes(2, "little")
        ask(bus, codec.build_write(1, first, new))
        ask(bus, codec.build(1, Instruction.REBOOT))
        assert (ask(bus, codec.build_read(1, first, 2))[0][2] == new) is eeprom
        write(bus, Register.TORQUE_ENABLE, 1)
        refused = ask(bus, codec.build_write(1, first, new))[0][1] == StatusError.ACCESS
        assert refused is eeprom
