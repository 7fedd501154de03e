"""Plans on the twin itself: the path within the stated error, symmetry, limits, what is refused."""

import numpy as np
import pytest

from firmware_py.errors import InputError
from firmware_py.safety.limits import Limits
from firmware_py.signals import PERIOD_S
from models.plan.inversion import Inverter
from models.plan.paths import DesiredPath, PathOptions, built_in_path, timeline
from models.plan.planning import PlanRequest, nearest_rest_m, plan_path
from models.plan.tip_twin import TipTwin
from models.plant.plant import read_plant
from models.plant.step_model import names

LIMITS = Limits(rate_rad_s=1.0)


def rms_m(error):
    return float(np.sqrt(np.mean(np.sum(error**2, axis=1))))


def test_the_derivatives_are_those_of_the_run(twin):
    at_s = PERIOD_S * np.arange(90)
    basis = np.exp(-(((at_s[:, None] - np.array([0.5, 1.0])) / 0.15) ** 2))
    goals = 0.2 * basis[:, :1]
    slopes = twin.slopes(goals, basis, 1.0)
    for k in range(2):
        step = 1e-5 * basis[:, k : k + 1]
        both = [twin.tip_m(twin.run(goals + sign * step, 1.0)) for sign in (1, -1)]
        assert slopes[:, :, k] == pytest.approx((both[0] - both[1]) / 2e-5, abs=2e-4)


def test_a_plan_leads_the_tip_of_the_twin_along_the_path(twin, planned):
    for own, table in zip(planned.payloads, planned.goals_rad(), strict=True):
        tip = twin.tip_m(twin.run(table, own.payload_kg))
        assert tip == pytest.approx(np.transpose(own.tip_m), abs=2e-6)
        error = rms_m(tip - planned.desired_tip_m())
        assert error == pytest.approx(own.residual_rms_m, abs=1e-6)
        assert error < own.rigid_rms_m / 25
        assert own.expected_rms_m >= own.residual_rms_m


def test_a_plan_rests_at_its_ends(planned):
    rest = round(planned.rest_s / PERIOD_S)
    for table in planned.goals_rad():
        assert not table[:rest].any()
        assert np.abs(table[-1]).max() < 1e-6
        assert np.abs(np.diff(table, axis=0)).max() / PERIOD_S <= LIMITS.rate_rad_s


def test_the_goals_bend_less_far_with_more_payload(planned):
    """A heavier tip sags further out, so the goals lean less."""
    light, heavy = np.abs(planned.goals_rad()).max(axis=(1, 2))
    assert heavy < light < np.arcsin(0.2 / 1.01) * 1.05


def test_a_symmetric_path_has_symmetric_goals(plant):
    """Without prebend and with equal stiffness both ways left is a mirror of right."""
    even = {
        n: 0.0 for n in plant.parameters if n.startswith(("prebend_", "directional_stiffness_"))
    }
    twin = TipTwin(plant.with_values(even).step_model(1), 1, PERIOD_S)
    found = []
    for sign in (1.0, -1.0):
        tip = sign * built_in_path("line", 1, PERIOD_S, PathOptions(seconds=1.5)).tip_m
        line = timeline(DesiredPath("line", tip, ()), np.zeros(1), PERIOD_S)
        found.append(Inverter(twin, line, 1.0).invert([1.0])[0].goals_rad)
    assert found[0] == pytest.approx(-found[1], abs=1e-6)


def test_a_path_out_of_reach_names_the_nearest_place(plant, twin):
    path = built_in_path("hold", 1, PERIOD_S, PathOptions(size_m=0.8, seconds=1.0))
    nearest = nearest_rest_m(twin, np.array([0.8]), 0.0, LIMITS)
    assert nearest == pytest.approx(twin.resting_tip_m(np.array([0.6]), 0.0), abs=1e-6)
    sentence = rf"row \d+ .*leads to x = 0\.800 m.*the nearest place is x = {nearest[0]:.3f} m"
    with pytest.raises(InputError, match=sentence):
        plan_path(path, PlanRequest(plant, 1, PERIOD_S, LIMITS, (0.0,)))


def test_the_nearest_place_of_two_joints_is_as_near_as_any_within_the_limits(plant):
    twin, wanted = TipTwin(plant.step_model(2), 2, PERIOD_S), np.array([0.4, 0.9])
    nearest = nearest_rest_m(twin, wanted, 1.0, LIMITS)
    for first in np.linspace(0.0, 0.6, 5):
        other = twin.resting_tip_m(np.array([first, 0.6]), 1.0)
        assert np.linalg.norm(nearest - wanted) < np.linalg.norm(other - wanted) + 2e-3


def test_a_path_whose_ways_are_out_of_reach_is_told_to_begin_slower(plant):
    """The way to a path that begins at 5 m/s takes a run-up beyond the reach of the arm."""
    tip = 0.4 * np.sin(12.0 * PERIOD_S * np.arange(60))[:, None]
    path = DesiredPath("fast", tip, ((0, 60),))
    with pytest.raises(InputError, match=r"of the way .* let the path begin and end slower"):
        plan_path(path, PlanRequest(plant, 1, PERIOD_S, LIMITS, (0.0,)))


@pytest.mark.parametrize(
    ("limits", "sentence"),
    [
        (
            {"rate_rad_s": 0.3},
            r"path line \(it begins .*\): row \d+ .*, 1 kg: the goal .* \(limits.rate_rad_s\)",
        ),
        ({"acceleration_rad_s2": 0.5}, r"row \d+ .* accelerates at"),
        ({"current_a": 0.2}, r"row \d+ .* the twin predicts that joint 1 draws"),
        ({"tip_max_m": (0.1, 1.2, 1.3)}, r"row \d+ .* predicted tip has x"),
    ],
)
def test_a_plan_that_breaks_a_limit_is_refused_with_its_row(plant, limits, sentence):
    path = built_in_path("line", 1, PERIOD_S, PathOptions(size_m=0.3, seconds=2.0))
    request = PlanRequest(
        plant, 1, PERIOD_S, Limits(**({"rate_rad_s": 2.0} | limits)), (1.0,), method="rigid"
    )
    with pytest.raises(InputError, match=sentence):
        plan_path(path, request)


@pytest.mark.parametrize(
    ("payloads", "sentence"),
    [
        ((), "are"),
        ((1.0, 0.5), "give rising masses"),
        ((-1.0,), "rising"),
        ((0.0, 9.0), "is 9 kg; give 0 to 3 kg"),
    ],
)
def test_payloads_that_cannot_be_are_refused(plant, payloads, sentence):
    path = built_in_path("line", 1, PERIOD_S, PathOptions())
    with pytest.raises(InputError, match=sentence):
        plan_path(path, PlanRequest(plant, 1, PERIOD_S, LIMITS, payloads))


def test_other_loads_than_the_link_are_refused():
    plant = read_plant("models/plant/examples/emps_identified.json")
    path = built_in_path("line", 1, PERIOD_S, PathOptions())
    with pytest.raises(InputError, match="is not the link"):
        plan_path(path, PlanRequest(plant, 1, PERIOD_S, LIMITS))


def test_the_twin_has_the_inputs_that_the_step_takes(plant):
    """The goals come first and the payload last: the one-step model relies on it."""
    assert names(plant.step_model(2).inputs) == ["goal_1_rad", "goal_2_rad", "payload_kg"]
