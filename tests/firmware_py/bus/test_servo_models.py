"""Servo models: their tables, and conversions against exact arithmetic and published figures."""

import itertools
import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_py.bus.registers import (
    STOPPED_BY_WATCHDOG,
    TORQUE_LOST,
    Register,
    describe_alert,
)
from firmware_py.bus.servo_models import MODELS, check_servo, read_models
from firmware_py.core.errors import InputError

SERVOS = (Path(__file__).parents[3] / "firmware_py/bus/servos.toml").read_text(encoding="utf-8")
ROW = """
[models."new"]
number = 9
family = "X"
motor = "H54"
pulses_per_turn = 4096
zero_pulse = 2048
current_a_per_lsb = 2.69e-3
velocity_rpm_per_lsb = 0.229
"""
models = st.sampled_from(list(MODELS.values()))
EVERY_MODEL = pytest.mark.parametrize("model", MODELS.values(), ids=lambda m: m.name)


@EVERY_MODEL
def test_a_model_is_whole_and_its_registers_do_not_overlap(model):
    table = model.table
    aliases = {(Register.GOAL_VELOCITY, Register.PROFILE_VELOCITY)}
    cells = sorted(table.cells.items(), key=lambda item: item[1].address)
    for (first, a), (second, b) in itertools.pairwise(cells):
        assert a.address + a.size <= b.address or (first, second) in aliases
    assert table.feedback.size <= 12, "one contiguous block"
    assert all(register in table for register in model.factory)
    check_servo(model.preset, model.name)
    no_load_nm = model.preset.coulomb_friction_nm
    no_load_nm += model.preset.viscous_friction_nm_s_rad * model.preset.speed_limit_rad_s
    assert 0.03 < no_load_nm / model.preset.torque_limit_nm < 0.45  # the rest turns a load


def test_hardware_errors_are_named_by_bit():
    assert describe_alert(0b100100) == "overheating, overload"
    assert describe_alert(0) == "none"
    both = describe_alert(0b100000 | TORQUE_LOST | STOPPED_BY_WATCHDOG)
    assert all(word in both for word in ("overload", "torque", "watchdog"))


@given(models, st.floats(-3.0, 3.0))
def test_a_position_is_the_nearest_pulse_and_symmetric_about_zero(model, angle_rad):
    raw = model.position_raw(angle_rad)
    assert abs(model.angle_rad(raw) - angle_rad) <= model.rad_per_pulse * (0.5 + 1e-6)
    assert model.position_raw(-angle_rad) - model.zero_pulse == -(raw - model.zero_pulse)


@EVERY_MODEL
def test_a_goal_beyond_the_register_or_without_a_number_is_refused(model):
    for value in (math.nan, math.inf):
        with pytest.raises(ValueError, match="finite"):
            model.position_raw(value)
    last = model.angle_rad(2**31 - 1)
    assert model.position_raw(last) == 2**31 - 1
    with pytest.raises(ValueError, match="does not fit"):
        model.position_raw(last + model.rad_per_pulse)


@pytest.mark.parametrize(
    ("number", "pulses"), [(54024, 41_827), (54025, 83_654), (2020, 83_654)]
)  # fmt: skip
def test_thirty_degrees_are_as_many_pulses_as_published(number, pulses):
    model = MODELS[number]
    assert model.position_raw(math.radians(30.0)) == pulses
    assert model.position_raw(math.radians(-30.0)) == -pulses


def test_a_table_of_a_further_model_is_read():
    assert read_models(SERVOS + ROW).keys() == MODELS.keys() | {9}


@pytest.mark.parametrize(
    ("written", "instead", "named"),
    [
        ("number = 9", "number = 1200", ("1200", "XL330-M288")),
        ('motor = "H54"', 'motor = "H45"', ("H45", "motors")),
        ('family = "X"', 'family = "Y"', ("Y", "families")),
        ("zero_pulse", "zero_puls", ("zero_puls",)),
        ("number = 9", "", ("number",)),
        ("number = 9", 'number = 9\nfactory = { "Goal" = 1 }', ("Goal",)),
    ],
)
def test_a_wrong_table_is_refused_by_its_name(written, instead, named):
    with pytest.raises(InputError) as refusal:
        read_models(SERVOS + ROW.replace(written, instead))
    assert all(word in str(refusal.value) for word in ("servos.toml", 'models."new"', *named))
