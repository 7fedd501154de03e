"""An effect that stands in for another needs another strength in each signal and payload."""

import numpy as np
import pytest

from models.gap.diagnosis import all_fit_parameters
from models.gap.estimation.gauss_newton import GaussNewton
from models.gap.estimation.noise_floor_fit import noise_floor_of
from models.gap.residuals.residuals import Residuals
from models.gap.search.strength_consistency import strength_consistency_of
from models.plant.effects import EFFECTS as CATALOGUE

EFFECTS = ("dead_time", "viscous_friction", "current_bias", "unmodelled_payload")


@pytest.fixture(scope="module")
def of(plant, trials_of):
    """Function (hidden parameter and strength, named effect) -> constancy of its strength."""

    def fitted(hidden, strength, named, seed=11):
        full = plant.with_effects(*EFFECTS)
        value = full.parameters[hidden].value + strength
        trials = trials_of(full.with_values({hidden: value}), seed)
        problem = Residuals(plant, trials.trials, all_fit_parameters(plant, trials, EFFECTS))
        estimator = GaussNewton(problem, noise_floor_of(plant, 1))
        own = np.array([k.effect == named for k in problem.knobs])
        free = own | np.array([k.kind != "effect" for k in problem.knobs])
        point = estimator.fit(estimator.at(np.zeros(len(free))), free)
        return strength_consistency_of(estimator, point, free, own, CATALOGUE[named].port)

    return fitted


@pytest.mark.parametrize(
    ("hidden", "strength", "named"),
    [
        ("dead_time_1_s", 0.02, "dead_time"),
        ("viscous_friction_1_nm_s_rad", 3.0, "viscous_friction"),
        ("current_bias_1_a", 0.2, "current_bias"),
    ],
)
def test_the_strength_of_what_is_there_is_the_same_everywhere(of, hidden, strength, named):
    for seed in (11, 12, 13):
        found = of(hidden, strength, named, seed)
        assert found.holds
        assert found.spread < 0.1


def test_the_strength_of_a_stand_in_is_not(of):
    late = of("dead_time_1_s", 0.02, "viscous_friction")
    heavy = of("unmodelled_payload_kg", 0.3, "viscous_friction")
    assert not late.holds
    assert late.spread > 0.4
    assert not heavy.holds


def test_noise_alone_does_not_break_a_strength(of):
    """Nothing hidden: whatever small strength is fitted may differ, but not beyond chance."""
    assert all(of("current_bias_1_a", 0.0, "current_bias", seed).holds for seed in range(20, 26))
