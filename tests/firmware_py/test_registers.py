"""Control tables and conversions, against the SDK's own byte order and the published figures."""

import itertools
import math
from fractions import Fraction

import pytest
from dynamixel_sdk import robotis_def as sdk
from hypothesis import given
from hypothesis import strategies as st

from firmware_py.errors import InputError
from firmware_py.registers import (
    LEGACY_PRO,
    MODELS,
    PRO_P,
    X_SERIES,
    Cell,
    Register,
    describe_hardware_error,
    model_named,
    round_half_away,
)

TABLES = (LEGACY_PRO, PRO_P, X_SERIES)
models = st.sampled_from(list(MODELS.values()))
int32 = st.integers(-(2**31), 2**31 - 1)
int16 = st.integers(-(2**15), 2**15 - 1)


@given(models, int32)
def test_every_position_survives_the_way_to_an_angle_and_back(model, raw):
    assert model.position_raw(model.angle_rad(raw)) == raw


@given(models, int16)
def test_every_current_survives_the_way_to_amperes_and_back(model, raw):
    assert model.current_raw(model.current_a(raw)) == raw


@given(models, int32)
def test_every_velocity_survives_the_way_to_rad_s_and_back(model, raw):
    assert model.velocity_raw(model.velocity_rad_s(raw)) == raw


@given(models, st.floats(-3.0, 3.0))
def test_a_position_is_the_nearest_pulse_and_symmetric_about_zero(model, angle_rad):
    raw = model.position_raw(angle_rad)
    assert abs(model.angle_rad(raw) - angle_rad) <= model.rad_per_pulse * (0.5 + 1e-6)
    assert model.position_raw(-angle_rad) - model.zero_pulse == -(raw - model.zero_pulse)


@given(st.floats(-1e15, 1e15))
def test_rounding_is_exact_with_halves_away_from_zero(value):
    exact = Fraction(value)
    away = int(abs(exact) + Fraction(1, 2))
    assert round_half_away(value) == (-away if exact < 0 else away)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_goal_that_is_no_number_is_refused(value):
    with pytest.raises(ValueError, match="finite"):
        MODELS[54024].position_raw(value)


@pytest.mark.parametrize("model", MODELS.values(), ids=lambda m: m.name)
def test_a_goal_beyond_the_register_is_refused(model):
    last = model.angle_rad(2**31 - 1)
    assert model.position_raw(last) == 2**31 - 1
    with pytest.raises(ValueError, match="does not fit"):
        model.position_raw(last + model.rad_per_pulse)
    with pytest.raises(ValueError, match="does not fit"):
        model.current_raw(model.current_a(2**15))


@given(int32)
def test_four_bytes_are_in_the_order_of_the_sdk(raw):
    data = list(Cell(0, 4, True).encode(raw))
    low, high = sdk.DXL_LOWORD(raw), sdk.DXL_HIWORD(raw)
    assert data == [
        sdk.DXL_LOBYTE(low), sdk.DXL_HIBYTE(low), sdk.DXL_LOBYTE(high), sdk.DXL_HIBYTE(high)
    ]  # fmt: skip
    unsigned = sdk.DXL_MAKEDWORD(
        sdk.DXL_MAKEWORD(data[0], data[1]), sdk.DXL_MAKEWORD(data[2], data[3])
    )
    assert Cell(0, 4).decode(data) == unsigned
    assert Cell(0, 4, True).decode(data) == raw


@given(int16, st.integers(0, 5))
def test_two_bytes_are_in_the_order_of_the_sdk_at_any_offset(raw, offset):
    data = [0] * offset + [sdk.DXL_LOBYTE(raw), sdk.DXL_HIBYTE(raw)]
    assert Cell(0, 2, True).decode(data, offset) == raw


@pytest.mark.parametrize(
    ("cell", "raw"),
    [(Cell(0, 1), 256), (Cell(0, 1), -1), (Cell(0, 2, True), 2**15), (Cell(0, 4, True), -(2**32))],
)
def test_a_value_that_does_not_fit_its_register_is_refused(cell, raw):
    with pytest.raises(ValueError, match="does not fit"):
        cell.encode(raw)


@pytest.mark.parametrize(
    ("number", "pulses"), [(54024, 41_827), (54025, 83_654), (2020, 83_654)]
)  # fmt: skip
def test_thirty_degrees_are_as_many_pulses_as_published(number, pulses):
    model = MODELS[number]
    assert model.position_raw(math.radians(30.0)) == pulses
    assert model.position_raw(math.radians(-30.0)) == -pulses


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
    assert [Register.BUS_WATCHDOG in table for table in TABLES] == [False, True, True]


def test_an_unknown_model_is_refused_with_the_known_ones():
    with pytest.raises(InputError, match="XM430-W350"):
        model_named("H54-200-S500")


def test_hardware_errors_are_named_by_bit():
    assert describe_hardware_error(0b100100) == "overheating, overload"
    assert describe_hardware_error(0) == "none"
