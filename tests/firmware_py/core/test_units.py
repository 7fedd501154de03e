import math

import numpy as np
import pytest

from firmware_py.core import units


def test_numbers_are_shown_in_the_unit_with_its_decimals():
    assert units.LENGTH.text(0.01234) == "12.3\u00a0mm"
    assert units.LENGTH.text(0.01234, 2) == "12.34\u00a0mm"
    assert units.FRACTION.text(0.951) == "95\u00a0%"
    assert units.TICK_TIME.number(17_000_000) == "17.000"
    assert units.ANGLE.significant(math.pi / 6) == "30\u00a0deg"
    assert units.LENGTH.label("tip x") == "tip x in mm"


def test_arrays_are_scaled():
    np.testing.assert_allclose(units.ANGLE.shown([0.0, math.pi]), [0.0, 180.0])


@pytest.mark.parametrize(
    ("unit", "value", "error"),
    [("rad", "deg", "mrad"), ("m", "mm", "mm"), ("1", "", "%"), ("A", "A", "A"),
     ("N.m/rad", "N·m/rad", "N·m/rad"), ("kg.m2", "kg·m²", "kg·m²")],
)  # fmt: skip
def test_values_and_errors_have_units_of_their_own(unit, value, error):
    assert units.value_unit(unit).name == value
    assert units.error_unit(unit).name == error


def test_a_unit_without_a_name_is_not_printed():
    assert units.value_unit("1").significant(0.25) == "0.25"
    assert units.value_unit("1").label("in range") == "in range"


@pytest.mark.parametrize(
    ("signal", "words", "unit"),
    [("tip_x_m", "tip x", "mm"), ("angle_1_rad", "angle 1", "deg"), ("di", "DI", "%"),
     ("current_1_a", "current 1", "A"), ("in_range", "in range", "")],
)  # fmt: skip
def test_signals_are_named_and_shown_by_their_suffix(signal, words, unit):
    assert units.signal_words(signal) == words
    assert units.signal_unit(signal).name == unit
