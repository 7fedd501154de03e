"""The effect search: strengths far from zero, what it fits last, and candidates of each joint."""

from dataclasses import replace

import numpy as np
import pytest

from models.gap.estimation.fitted_floor import noise_floor_for
from models.gap.estimation.gauss_newton import GaussNewton
from models.gap.estimation.nuisance_fit import NuisanceFit
from models.gap.residuals.fit_parameters import all_fit_parameters, effect_candidates
from models.gap.residuals.residuals import Residuals
from models.gap.search.effect_search import EffectSearch
from models.gap.search.far_strengths import strengths_far_from_zero
from models.plant.document import Provenance
from models.plant.effects import EFFECTS
from models.plant.plant import read_plant, scope_of


def estimator_of(plant, trials, effect):
    residuals = Residuals(plant, trials, all_fit_parameters(plant, trials, [effect]))
    return GaussNewton(residuals, noise_floor_for(residuals))


@pytest.fixture(scope="module")
def far_strengths(plant, hidden):
    """Function (effect, hidden parameters) -> points far from zero, the present fit, its mask."""

    def run(effect, cost=np.inf, from_plant=True, **parameters):
        estimator = estimator_of(plant, hidden(**parameters).trials, effect)
        here = estimator.linearise(estimator.at(np.zeros(len(estimator.low))))
        mask = np.array([q.effect == effect for q in estimator.residuals.fit_parameters])
        starts = [here, here] if from_plant else [here]
        free = np.ones(len(mask), dtype=bool)
        points = strengths_far_from_zero(estimator, starts, cost, effect, mask, free, False)
        return points, here, mask

    return run


def test_the_fit_from_a_far_strength_reaches_the_hidden_one(far_strengths):
    (_, point), here, mask = far_strengths("dead_time", dead_time_1_s=0.06)
    assert point.cost < here.cost / 100
    assert point.values[mask][0] == pytest.approx(0.06, rel=0.1)


def test_nothing_is_fitted_where_no_strength_promises_a_lower_cost(far_strengths):
    (point,), here, mask = far_strengths("dead_time", cost=0.0, dead_time_1_s=0.06)
    assert np.array_equal(point.values[~mask], here.values[~mask])


def test_a_far_strength_of_the_present_fit_is_tried_beside_earlier_names_too(far_strengths):
    """A low-pass takes the saw-tooth off the current at any strength: no step leads there."""
    (point,), here, mask = far_strengths("sensor_lag", from_plant=False, sensor_lag_1_s=0.03)
    assert point.cost < here.cost
    assert point.values[mask][0] == pytest.approx(0.02)


@pytest.mark.parametrize("learned", [True, False])
def test_the_tail_is_fitted_only_where_the_noise_floor_is_learned(plant, hidden, learned):
    known = plant if learned else replace(plant, provenance=Provenance())
    trials, effect = hidden(stribeck_friction_1_nm=4.0).trials, "stribeck_friction"
    estimator = estimator_of(known, trials, effect)
    assert estimator.floor.learned is learned
    search = EffectSearch(NuisanceFit(estimator, estimator, estimator.start()))
    parameters = estimator.residuals.fit_parameters
    fitted = {q.name for q, taken in zip(parameters, search.of[effect], strict=True) if taken}
    assert ("stribeck_tail_1" in fitted) is learned
    assert {"stribeck_friction_1_nm", "stribeck_speed_1_rad_s"} <= fitted


@pytest.mark.parametrize("effect", ["sensor_lag", "dead_time"])
def test_both_servos_share_a_strength_but_each_goal_has_its_staircase(effect):
    staircase = {"sensor_lag": "sensor_lag_jump_{}", "dead_time": "dead_time_phase_{}"}[effect]
    moved = [set(q.parameters) for q in effect_candidates(read_plant(), effect, 2)[effect]]
    assert moved[0] == {f"{effect}_{j}_s" for j in (1, 2)}
    assert all({staircase.format(j)} in moved for j in (1, 2))


@pytest.mark.parametrize(
    ("effect", "in_one_servo"), [("coulomb_friction", True), ("position_gain_change", False)]
)
def test_an_effect_that_servos_share_is_a_candidate_of_each_too(effect, in_one_servo):
    plant = read_plant()
    both = set(EFFECTS[effect]().strengths(scope_of(plant.drive, plant.load, 2)))
    moved = {
        name: {n for q in parameters if q.is_strength for n in q.parameters}
        for name, parameters in effect_candidates(plant, effect, 2).items()
    }
    assert moved.pop(effect) == both
    single = {f"{effect}:{j}": {n for n in both if f"_{j}" in n} for j in (1, 2)}
    assert moved == (single if in_one_servo else {})
