"""Conversions between raw values and SI units, against exact arithmetic and published figures."""

import math
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_py.bus.servo_models import MODELS, model_named, round_half_away
from firmware_py.core.errors import InputError

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


@pytest.mark.parametrize(
    ("number", "pulses"), [(54024, 41_827), (54025, 83_654), (2020, 83_654)]
)  # fmt: skip
def test_thirty_degrees_are_as_many_pulses_as_published(number, pulses):
    model = MODELS[number]
    assert model.position_raw(math.radians(30.0)) == pulses
    assert model.position_raw(math.radians(-30.0)) == -pulses


def test_an_unknown_model_is_refused_with_the_known_ones():
    with pytest.raises(InputError, match="XM430-W350"):
        model_named("H54-200-S500")
