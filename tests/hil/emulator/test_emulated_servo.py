"""Registers as the bus sees them: rights, ranges, torque, protection, resolution."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_py.bus.registers import Register
from firmware_py.bus.servo_models import MODELS
from hil.emulator import packets
from hil.emulator.emulated_servo import BAUD_OF_CODE, EmulatedServo
from hil.emulator.packets import ALERT, BROADCAST, Instruction, Parser, StatusError

LEGACY, PRO_A, X = 54024, 54025, 1020
MS = 1_000_000


def ask(chain, frame, now_ns=0):
    """Instruction in, (id, error, data) of every answer out."""
    [packet] = Parser().feed(frame)
    answers = [Parser().feed(reply.frame)[0] for reply in chain.execute(packet, now_ns)]
    return [(a.id, a.parameters[0], a.parameters[1:]) for a in answers]


def write(chain, register, raw, now_ns=0, servo=0):
    cell = chain.servos[servo].model.table[register]
    frame = packets.write(chain.servos[servo].id, cell.address, cell.encode(raw))
    [(_, error, _)] = ask(chain, frame, now_ns)
    return error


def read(chain, register, now_ns=0, servo=0):
    cell = chain.servos[servo].model.table[register]
    [(_, error, data)] = ask(
        chain, packets.read(chain.servos[servo].id, cell.address, cell.size), now_ns
    )
    assert error & ~ALERT == 0
    return cell.decode(data)


@pytest.mark.parametrize("number", sorted(MODELS))
def test_ping_tells_the_model(chain_of, number):
    chain = chain_of(number)
    [(servo_id, error, data)] = ask(chain, packets.encode(1, Instruction.PING))
    assert (servo_id, error) == (1, 0)
    assert int.from_bytes(data[:2], "little") == number == read(chain, Register.MODEL_NUMBER)


def test_everyone_answers_a_broadcast_ping_and_nobody_a_stranger(chain_of):
    chain = chain_of(ids=(3, 7))
    assert [a[0] for a in ask(chain, packets.encode(BROADCAST, Instruction.PING))] == [3, 7]
    assert ask(chain, packets.encode(5, Instruction.PING)) == []


@pytest.mark.parametrize("number", [LEGACY, PRO_A, X])
def test_it_moves_only_with_torque_on(chain_of, number):
    chain = chain_of(number)
    goal = chain.servos[0].model.position_raw(0.3)
    at_rest = read(chain, Register.PRESENT_POSITION)
    assert write(chain, Register.GOAL_POSITION, goal) == StatusError.NONE
    assert read(chain, Register.PRESENT_POSITION, 1000 * MS) == at_rest
    assert write(chain, Register.TORQUE_ENABLE, 1, 1000 * MS) == StatusError.NONE
    assert read(chain, Register.GOAL_POSITION, 1000 * MS) == at_rest, "no jump at switching on"
    write(chain, Register.GOAL_POSITION, goal, 1000 * MS)
    assert abs(read(chain, Register.PRESENT_CURRENT, 1010 * MS)) > 0
    assert read(chain, Register.PRESENT_POSITION, 3000 * MS) == goal
    moved_back = chain.servos[0].model.position_raw(0.0)
    write(chain, Register.GOAL_POSITION, moved_back, 3000 * MS)
    write(chain, Register.TORQUE_ENABLE, 0, 3000 * MS)
    assert read(chain, Register.PRESENT_POSITION, 5000 * MS) == goal, "the gear holds"
    assert read(chain, Register.PRESENT_CURRENT, 5000 * MS) == 0


@given(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0), st.floats(-8.0, 8.0))
def test_present_registers_are_within_half_a_step_of_the_plant(angle, velocity, current):
    servo = EmulatedServo(MODELS[LEGACY])
    servo.put(Register.TORQUE_ENABLE, 1)
    servo.observe(angle, velocity, current)
    model = servo.model
    for register, value, lsb in (
        (Register.PRESENT_POSITION, angle, 2 * math.pi / 501_923),
        (Register.PRESENT_CURRENT, current, 33 / 2048),
        (Register.PRESENT_VELOCITY, velocity, 0.00199234 * 2 * math.pi / 60),
    ):
        assert abs(servo.get(register) * lsb - value) <= 0.5 * lsb * (1 + 1e-9)
    assert model.pulses_per_turn == 501_923


def test_a_current_beyond_the_register_is_clipped_not_wrapped():
    servo = EmulatedServo(MODELS[PRO_A])
    servo.put(Register.TORQUE_ENABLE, 1)
    servo.observe(0.0, 0.0, 1e3)
    assert servo.get(Register.PRESENT_CURRENT) == 32767
    servo.observe(0.0, 0.0, -1e3)
    assert servo.get(Register.PRESENT_CURRENT) == -32768


@pytest.mark.parametrize(
    ("register", "raw", "error"),
    [
        (Register.PRESENT_POSITION, 0, StatusError.ACCESS),
        (Register.HARDWARE_ERROR, 0, StatusError.ACCESS),
        (Register.TORQUE_ENABLE, 2, StatusError.DATA_RANGE),
        (Register.OPERATING_MODE, 0, StatusError.DATA_RANGE),
        (Register.RETURN_DELAY, 255, StatusError.DATA_RANGE),
        (Register.GOAL_POSITION, 501_924, StatusError.DATA_LIMIT),
        (Register.GOAL_POSITION, 501_923, StatusError.NONE),
    ],
)
def test_a_write_that_is_not_allowed_changes_nothing(chain_of, register, raw, error):
    chain = chain_of(PRO_A)
    before = read(chain, register)
    assert write(chain, register, raw) == error
    assert read(chain, register) == (before if error else raw)


def test_eeprom_is_locked_while_torque_is_on(chain_of):
    chain = chain_of()
    write(chain, Register.TORQUE_ENABLE, 1)
    assert write(chain, Register.RETURN_DELAY, 0) == StatusError.ACCESS
    write(chain, Register.TORQUE_ENABLE, 0)
    assert write(chain, Register.RETURN_DELAY, 0) == StatusError.NONE
    assert chain.servos[0].return_delay_ns == 0


def test_limits_do_not_bind_in_extended_mode(chain_of):
    chain = chain_of(PRO_A)
    write(chain, Register.OPERATING_MODE, 4)
    assert write(chain, Register.GOAL_POSITION, 10_000_000) == StatusError.NONE


@pytest.mark.parametrize(
    ("frame", "error"),
    [
        (packets.write(1, 564, b"\x01\x02"), StatusError.DATA_LENGTH),
        (packets.write(1, 564, b""), StatusError.DATA_LENGTH),
        (packets.write(1, 565, b"\x01"), StatusError.ACCESS),
        (packets.read(1, 1020, 10), StatusError.ACCESS),
        (packets.read(1, 0, 0), StatusError.DATA_LENGTH),
        (packets.encode(1, Instruction.READ, b"\x00"), StatusError.DATA_LENGTH),
        (packets.encode(1, Instruction.WRITE, b""), StatusError.DATA_LENGTH),
        (packets.encode(1, 0x77), StatusError.INSTRUCTION),
        (packets.encode(1, Instruction.ACTION), StatusError.INSTRUCTION),
        (packets.encode(1, Instruction.PING)[:-1] + b"\x00", StatusError.CRC),
    ],
)
def test_what_is_wrong_with_an_instruction_is_named(chain_of, frame, error):
    assert ask(chain_of(), frame) == [(1, error, b"")]


def test_nobody_complains_about_a_broken_broadcast(chain_of):
    frame = packets.sync_write(564, {1: bytes(4)})
    assert ask(chain_of(), frame[:-1] + bytes((frame[-1] ^ 1,))) == []


def test_one_write_can_span_several_registers_or_none(chain_of):
    chain = chain_of(PRO_A)
    velocity_and_position = (5).to_bytes(4, "little") + (77).to_bytes(4, "little")
    assert ask(chain, packets.write(1, 560, velocity_and_position)) == [(1, 0, b"")]
    assert (read(chain, Register.PROFILE_VELOCITY), read(chain, Register.GOAL_POSITION)) == (5, 77)
    beyond = (6).to_bytes(4, "little") + (10**8).to_bytes(4, "little")
    assert ask(chain, packets.write(1, 560, beyond))[0][1] == StatusError.DATA_LIMIT
    assert read(chain, Register.PROFILE_VELOCITY) == 5


def test_registered_writes_wait_for_action(chain_of):
    chain = chain_of(PRO_A)
    frame = packets.encode(1, Instruction.REG_WRITE, bytes((564 & 0xFF, 564 >> 8, 9, 0, 0, 0)))
    assert ask(chain, frame) == [(1, 0, b"")]
    assert read(chain, Register.GOAL_POSITION) == 0
    assert ask(chain, packets.encode(BROADCAST, Instruction.ACTION)) == []
    assert read(chain, Register.GOAL_POSITION) == 9


def test_sync_read_answers_in_the_order_asked_until_one_is_missing(chain_of):
    chain = chain_of(ids=(1, 2))
    assert [a[0] for a in ask(chain, packets.sync_read((2, 1), 574, 10))] == [2, 1]
    assert [a[0] for a in ask(chain, packets.sync_read((1, 9, 2), 574, 10))] == [1]


def test_sync_write_reaches_each_servo_with_its_own_goal(chain_of):
    chain = chain_of(PRO_A, ids=(1, 2))
    frame = packets.sync_write(564, {1: b"\x05\0\0\0", 2: b"\xfb\xff\xff\xff", 9: bytes(4)})
    assert ask(chain, frame) == []
    assert [read(chain, Register.GOAL_POSITION, servo=k) for k in (0, 1)] == [5, -5]


@pytest.mark.parametrize(("level", "answers"), [(0, 1), (1, 2), (2, 3)])
def test_status_return_level(chain_of, level, answers):
    chain = chain_of()
    chain.servos[0].put(Register.STATUS_RETURN_LEVEL, level)
    frames = (
        packets.encode(1, Instruction.PING),
        packets.read(1, 0, 2),
        packets.write(1, 564, bytes(4)),
    )
    assert sum(len(ask(chain, frame)) for frame in frames) == answers


def test_a_fatal_hardware_error_stops_the_motor_until_a_reboot(chain_of):
    chain = chain_of(PRO_A)
    write(chain, Register.TORQUE_ENABLE, 1)
    write(chain, Register.GOAL_POSITION, 10_000)
    chain.servos[0].fail(1 << 5)
    assert ask(chain, packets.encode(1, Instruction.PING))[0][1] == ALERT
    assert read(chain, Register.TORQUE_ENABLE) == 0
    assert write(chain, Register.TORQUE_ENABLE, 1) == StatusError.RESULT_FAIL | ALERT
    assert read(chain, Register.PRESENT_POSITION, 1000 * MS) == 0
    ask(chain, packets.encode(1, Instruction.REBOOT), 1000 * MS)
    assert read(chain, Register.HARDWARE_ERROR, 1000 * MS) == 0
    assert write(chain, Register.TORQUE_ENABLE, 1, 1000 * MS) == StatusError.NONE


def test_a_hardware_error_outside_the_shutdown_mask_only_alerts(chain_of):
    chain = chain_of(PRO_A)
    write(chain, Register.TORQUE_ENABLE, 1)
    chain.servos[0].fail(1 << 3)  # encoder; shutdown is 52 = bits 2, 4, 5
    assert read(chain, Register.TORQUE_ENABLE) == 1
    assert ask(chain, packets.encode(1, Instruction.PING))[0][1] == ALERT


@pytest.mark.parametrize("number", [PRO_A, X])
def test_the_watchdog_stops_a_servo_that_hears_nothing(chain_of, number):
    chain = chain_of(number)
    write(chain, Register.TORQUE_ENABLE, 1)
    write(chain, Register.BUS_WATCHDOG, 3)
    goal = chain.servos[0].model.position_raw(1.0)
    write(chain, Register.GOAL_POSITION, goal)
    assert read(chain, Register.BUS_WATCHDOG, 59 * MS) == 3, "any instruction feeds it"
    assert read(chain, Register.BUS_WATCHDOG, 118 * MS) == 3
    assert read(chain, Register.BUS_WATCHDOG, 1000 * MS) == -1
    stopped = read(chain, Register.PRESENT_POSITION, 2000 * MS)
    # The lag plant stood at 1 - exp(-178/50) when the 60 ms were over.
    expected = chain.servos[0].model.position_raw(1.0 - math.exp(-178 / 50))
    assert abs(stopped - expected) <= 1
    assert write(chain, Register.GOAL_POSITION, goal, 2000 * MS) == StatusError.DATA_RANGE
    assert write(chain, Register.BUS_WATCHDOG, 0, 2000 * MS) == StatusError.NONE
    assert write(chain, Register.GOAL_POSITION, goal, 2000 * MS) == StatusError.NONE
    assert read(chain, Register.PRESENT_POSITION, 4000 * MS) == goal


def test_the_watchdog_sleeps_without_torque_and_legacy_has_none(chain_of):
    chain = chain_of(PRO_A)
    write(chain, Register.BUS_WATCHDOG, 1)
    assert read(chain, Register.BUS_WATCHDOG, 1000 * MS) == 1
    assert Register.BUS_WATCHDOG not in chain_of(LEGACY).servos[0].model.table


def test_homing_offset_shifts_position_and_goal_alike(chain_of):
    chain = chain_of(PRO_A)
    write(chain, Register.HOMING_OFFSET, 1000)
    assert read(chain, Register.PRESENT_POSITION, 20 * MS) == 1000
    write(chain, Register.TORQUE_ENABLE, 1, 20 * MS)
    write(chain, Register.GOAL_POSITION, 1000, 20 * MS)
    chain.advance(1000 * MS)
    assert chain.physics.angle_rad[0] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(("code", "baud"), BAUD_OF_CODE.items())
def test_the_baud_register_sets_the_rate(chain_of, code, baud):
    chain = chain_of()
    write(chain, Register.BAUD_RATE, code)
    assert chain.servos[0].baud == baud


# --- fast sync read, indirect addresses -----------------------------------------------------------


def together(chain, ids, address, length):
    """(id, error, data) of every block of the one answer; the block CRCs are the codec's affair."""
    [packet] = Parser().feed(packets.sync_read(ids, address, length, fast=True))
    replies = chain.execute(packet, 0)
    if not replies:
        return None
    [reply] = replies
    blocks, stride = reply.frame[8:], length + 4
    assert int.from_bytes(reply.frame[5:7], "little") == 1 + len(ids) * stride
    cut = [blocks[k : k + stride] for k in range(0, len(blocks), stride)]
    return [(block[1], block[0], block[2:-2]) for block in cut]


@given(st.integers(0, 600), st.integers(1, 40))
def test_a_fast_sync_read_gives_what_a_sync_read_gives(chain_of, address, length):
    chain = chain_of(PRO_A, ids=(1, 2, 3))
    chain.servos[1].fail(1)
    apart = ask(chain, packets.sync_read((3, 1, 2), address, length))
    assert together(chain, (3, 1, 2), address, length) == apart


def test_servos_behind_a_silent_one_do_not_join_the_packet(chain_of):
    chain = chain_of(PRO_A, ids=(1, 2))
    assert [block[0] for block in together(chain, (1, 9, 2), 580, 4)] == [1]
    assert together(chain, (9, 1), 580, 4) is None


def test_a_legacy_pro_does_not_know_the_fast_sync_read(chain_of):
    assert together(chain_of(LEGACY, ids=(1, 2)), (1, 2), 611, 4) is None


@pytest.mark.parametrize("number", [LEGACY, PRO_A, X])
@given(data=st.data())
def test_indirect_data_shows_and_sets_what_its_entries_name(chain_of, number, data):
    chain = chain_of(number)
    table = chain.servos[0].model.table
    goal = table[Register.GOAL_POSITION]
    readable = st.sampled_from([cell for r, cell in table.cells.items() if r is not Register.ID])
    shown = data.draw(st.lists(readable, min_size=1, max_size=4))
    addresses = [c.address + k for c in shown for k in range(c.size)]
    addresses += [goal.address + k for k in range(4)]
    entries = b"".join(address.to_bytes(2, "little") for address in addresses)
    assert ask(chain, packets.write(1, table.indirect.address, entries))[0][1] == 0
    plain = b"".join(ask(chain, packets.read(1, c.address, c.size))[0][2] for c in shown)
    start = table.indirect.data
    assert ask(chain, packets.read(1, start, len(plain)))[0][2] == plain
    raw = chain.servos[0].model.position_raw(data.draw(st.floats(-0.5, 0.5)))
    assert ask(chain, packets.write(1, start + len(plain), goal.encode(raw)))[0][1] == 0
    assert read(chain, Register.GOAL_POSITION) == raw


def test_entries_in_eeprom_are_locked_and_kept_those_in_ram_are_lost(chain_of):
    for number, kept in ((LEGACY, True), (PRO_A, True), (X, False)):
        chain = chain_of(number)
        first = chain.servos[0].model.table.indirect.address
        new = (600).to_bytes(2, "little")
        ask(chain, packets.write(1, first, new))
        ask(chain, packets.encode(1, Instruction.REBOOT))
        assert (ask(chain, packets.read(1, first, 2))[0][2] == new) is kept
        write(chain, Register.TORQUE_ENABLE, 1)
        refused = ask(chain, packets.write(1, first, new))[0][1] == StatusError.ACCESS
        assert refused is kept
