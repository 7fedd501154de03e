"""Sums that no real body has are found, whatever plant they belong to."""

import pytest

from models.plant.parameter import impossible_sums
from models.plant.plant import read_plant


def values_of(plant, **changed):
    return {name: q.value for name, q in plant.parameters.items()} | changed


@pytest.mark.parametrize("path", ["nominal.toml", "examples/xl330_pendulum.toml"])
def test_a_plant_as_shipped_is_possible(path):
    plant = read_plant(f"models/plant/{path}")
    full = plant.with_effects(*plant.applicable())
    assert impossible_sums(values_of(full), [0.0, 2.0]) == []


def test_a_payload_below_zero_is_possible_only_where_something_else_weighs_more():
    full = read_plant().with_effects("unmodelled_payload")
    light = values_of(full, tip_mass_kg=0.144, unmodelled_payload_kg=-0.2)
    (found,) = impossible_sums(light, [0.0, 1.0])
    assert found.value == pytest.approx(0.144 - 0.2)
    assert set(found.parameters) == {"tip_mass_kg", "unmodelled_payload_kg"}
    assert impossible_sums(light, [1.0, 2.0]) == []


@pytest.mark.parametrize(
    ("changed", "what"),
    [
        ({"coulomb_friction_1_nm": 1.0, "stribeck_friction_1_nm": -1.5}, "friction at standstill"),
        ({"coulomb_friction_1_n": -0.1}, "friction at standstill"),
        ({"viscous_friction_2_nm_s_rad": -0.1}, "viscous friction of joint 2"),
        ({"root_stiffness_1_nm_rad": 0.0}, "root stiffness"),
        ({"directional_stiffness_1": -1.2}, "other side"),
        ({"current_limit_1_a": 3.0, "current_saturation_1_a": 3.0}, "current limit"),
    ],
)
def test_each_kind_of_sum_is_found(changed, what):
    assert [what in row.what for row in impossible_sums(changed)] == [True]


def test_no_friction_at_all_is_possible():
    assert impossible_sums({"coulomb_friction_1_nm": 0.0, "viscous_friction_1_nm_s_rad": 0.0}) == []
