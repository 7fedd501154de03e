"""Fitted values at their bounds."""

import numpy as np
import pytest

from models.gap.estimation.gauss_newton import FitPoint
from models.gap.residuals.fit_parameters import effect_fit_parameters, nuisance_fit_parameters
from models.gap.search.refused_effect import values_at_bounds
from models.gap.settings import DEFAULT_SETTINGS
from models.plant.plant import read_plant


def found_at(parameters, values):
    free = np.ones(len(parameters), bool)
    point = FitPoint(np.array(values), 0.0, [])
    return values_at_bounds(read_plant(), parameters, point, free, DEFAULT_SETTINGS)


@pytest.mark.parametrize(
    ("strength", "names"),
    [
        (0.0, ["hardening_share"]), (0.002, ["hardening_share"]), (0.02, []),
        (3.0, ["hardening_share"]),
    ],
)  # fmt: skip
def test_a_strength_that_fell_to_zero_or_reached_its_bound_is_found(strength, names):
    parameters = effect_fit_parameters(read_plant(), "stiffness_hardening", 1)
    assert [row.name for row in found_at(parameters, [strength])] == names


@pytest.mark.parametrize(("strength", "words"), [
    (0.002, "where it began, at 0"), (-0.002, "where it began, at 0"), (-0.02, None), (0.02, None),
    (-0.8, "at its lower bound of -0.8"), (3.0, "at its upper bound of 3"),
])  # fmt: skip
def test_a_strength_of_either_sign_that_stayed_at_zero_is_found(strength, words):
    """However small the noise: a thousandth of its range is none of it."""
    parameters = effect_fit_parameters(read_plant(), "position_gain_change", 1)
    said = [row.said for row in found_at(parameters, [strength])]
    assert said == ([] if words is None else [f"position_gain_change_1 ended {words}"])


@pytest.mark.parametrize(("shares", "count"), [((0.3, 0.0), 0), ((0.0, 0.001), 2)])
def test_a_strength_may_be_zero_in_one_of_two_planes(shares, count):
    plant = read_plant().with_values({"hysteresis_share_1": 0.0, "hysteresis_share_2": 0.0})
    parameters = effect_fit_parameters(plant, "hysteresis", 2)
    strengths = dict(zip(("hysteresis_share_1", "hysteresis_share_2"), shares, strict=True))
    values = [strengths.get(q.name, 0.0) for q in parameters]
    assert len(found_at(parameters, values)) == count


def test_nuisance_that_did_not_move_is_not_at_a_bound():
    parameters = nuisance_fit_parameters(read_plant(), 1)
    assert found_at(parameters, [0.0] * len(parameters)) == []
