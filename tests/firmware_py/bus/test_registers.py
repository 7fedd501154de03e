"""Control tables, against the SDK's byte order and the published addresses."""

import itertools

import pytest
from dynamixel_sdk import robotis_def as sdk
from hypothesis import given
from hypothesis import strategies as st

from firmware_py.bus.registers import (
    LEGACY_PRO,
    PRO_P,
    STOPPED_BY_WATCHDOG,
    TORQUE_LOST,
    X_SERIES,
    Register,
    RegisterField,
    describe_alert,
)
from firmware_py.bus.servo_models import X330

TABLES = (LEGACY_PRO, PRO_P, X_SERIES, X330)
int32 = st.integers(-(2**31), 2**31 - 1)
int16 = st.integers(-(2**15), 2**15 - 1)


@given(int32)
def test_four_bytes_are_in_the_order_of_the_sdk(raw):
    data = list(RegisterField(0, 4, True).encode(raw))
    low, high = sdk.DXL_LOWORD(raw), sdk.DXL_HIWORD(raw)
    assert data == [
        sdk.DXL_LOBYTE(low), sdk.DXL_HIBYTE(low), sdk.DXL_LOBYTE(high), sdk.DXL_HIBYTE(high)
    ]  # fmt: skip
    unsigned = sdk.DXL_MAKEDWORD(
        sdk.DXL_MAKEWORD(data[0], data[1]), sdk.DXL_MAKEWORD(data[2], data[3])
    )
    assert RegisterField(0, 4).decode(data) == unsigned
    assert RegisterField(0, 4, True).decode(data) == raw


@given(int16, st.integers(0, 5))
def test_two_bytes_are_in_the_order_of_the_sdk_at_any_offset(raw, offset):
    data = [0] * offset + [sdk.DXL_LOBYTE(raw), sdk.DXL_HIBYTE(raw)]
    assert RegisterField(0, 2, True).decode(data, offset) == raw


@pytest.mark.parametrize(
    ("cell", "raw"),
    [
        (RegisterField(0, 1), 256),
        (RegisterField(0, 1), -1),
        (RegisterField(0, 2, True), 2**15),
        (RegisterField(0, 4, True), -(2**32)),
    ],
)
def test_a_value_that_does_not_fit_its_register_is_refused(cell, raw):
    with pytest.raises(ValueError, match="does not fit"):
        cell.encode(raw)


def test_feedback_is_the_one_contiguous_block_of_each_family():
    assert (LEGACY_PRO.feedback.address, LEGACY_PRO.feedback.size) == (611, 12)
    assert (PRO_P.feedback.address, PRO_P.feedback.size) == (574, 10)
    assert (X_SERIES.feedback.address, X_SERIES.feedback.size) == (126, 10)


@pytest.mark.parametrize("table", TABLES, ids=lambda t: t.name)
def test_no_two_registers_overlap_but_a_stated_alias(table):
    aliases = {(Register.GOAL_VELOCITY, Register.PROFILE_VELOCITY)}
    cells = sorted(table.cells.items(), key=lambda item: item[1].address)
    for (first, a), (second, b) in itertools.pairwise(cells):
        assert a.address + a.size <= b.address or (first, second) in aliases


def test_only_the_legacy_family_lacks_a_bus_watchdog():
    assert [Register.BUS_WATCHDOG in table for table in TABLES] == [False, True, True, True]


def test_hardware_errors_are_named_by_bit():
    assert describe_alert(0b100100) == "overheating, overload"
    assert describe_alert(0) == "none"
    both = describe_alert(0b100000 | TORQUE_LOST | STOPPED_BY_WATCHDOG)
    assert all(word in both for word in ("overload", "torque", "watchdog"))


@pytest.mark.parametrize(
    ("table", "size", "addresses"),
    [(LEGACY_PRO, 7, [611, 612, 613, 614, 621, 622, 562]),
     (PRO_P, 8, [580, 581, 582, 583, 574, 575, 512, 546])],
)  # fmt: skip
def test_gathered_are_position_current_and_what_tells_of_the_torque(table, size, addresses):
    assert table.gathered.size == size == len(addresses)
    assert list(table.gathered_addresses) == addresses


@pytest.mark.parametrize(
    ("register", "address"),
    [(Register.MIN_POSITION_LIMIT, 52), (Register.SHUTDOWN, 63), (Register.TORQUE_ENABLE, 64),
     (Register.HARDWARE_ERROR, 70), (Register.BUS_WATCHDOG, 98), (Register.GOAL_POSITION, 116),
     (Register.PRESENT_CURRENT, 126), (Register.PRESENT_POSITION, 132),
     (Register.PRESENT_TEMPERATURE, 146)],
)  # fmt: skip
def test_the_registers_of_the_xm430_lie_where_its_manual_has_them(register, address):
    assert X_SERIES[register].address == address
