import math

import pytest

from firmware_py.core import units


def test_numbers_are_shown_in_the_unit_with_its_decimals():
    assert units.LENGTH.text(0.01234) == "12.3\u00a0mm"
    assert units.LENGTH.text(0.01234, 2) == "12.34\u00a0mm"
    assert units.FRACTION.text(0.951) == "95\u00a0%"
    assert units.TICK_TIME.number(17_000_000) == "17.000"
    assert units.ANGLE.significant(math.pi / 6) == "30\u00a0deg"
    assert units.LENGTH.label("tip x") == "tip x in mm"


@pytest.mark.parametrize(
    ("signal", "words", "unit"),
    [("tip_x_m", "tip x", "mm"), ("angle_1_rad", "angle 1", "deg"), ("di", "DI", "%"),
     ("current_1_a", "current 1", "A"), ("in_range", "in range", "")],
)  # fmt: skip
def test_signals_are_named_and_shown_by_their_suffix(signal, words, unit):
    assert units.signal_words(signal) == words
    assert units.signal_unit(signal).name == unit
