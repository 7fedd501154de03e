"""Plans on the twin itself: error on the path, symmetry, moves, limits, the map of rest."""

import math

import numpy as np
import pytest

import models.plan.plan as planning
from firmware_py.core.errors import InputError
from firmware_py.core.signals import PERIOD_S
from firmware_py.goals.goal_map import RestGoals
from firmware_py.safety.limits import Limits
from models.plan.inversion import Inverter, rms
from models.plan.paths import DesiredPath, PathOptions, built_in_path, timeline
from models.plan.plan import (
    PlanRequest,
    nearest_rest_m,
    plan_path,
    shortest_move_s,
    zvd_impulses,
)
from models.plan.rest_map import map_rest
from models.plan.tip_twin import TipTwin
from models.plant.linear_twin import LinearMode
from models.plant.plant import read_plant

LIMITS = Limits(rate_rad_s=1.0)
MOVE_LIMITS = Limits(rate_rad_s=1.0, acceleration_rad_s2=20.0)


def test_the_derivatives_are_those_of_the_run(twin):
    at_s = PERIOD_S * np.arange(90)
    basis = np.exp(-(((at_s[:, None] - np.array([0.5, 1.0])) / 0.15) ** 2))
    goals = 0.2 * basis[:, :1]
    slopes = twin.slopes(goals, basis, 1.0)
    for k in range(2):
        step = 1e-5 * basis[:, k : k + 1]
        both = [twin.run(goals + sign * step, 1.0).tip_m for sign in (1, -1)]
        assert slopes[:, :, k] == pytest.approx((both[0] - both[1]) / 2e-5, abs=2e-4)


def test_a_plan_leads_the_tip_of_the_twin_along_the_path(twin, planned):
    for one, table in zip(planned.payloads, planned.goals_rad(), strict=True):
        tip = twin.run(table, one.payload_kg).tip_m
        assert tip == pytest.approx(np.transpose(one.tip_m), abs=2e-6)
        error = rms(tip - planned.desired_tip_m())
        assert error == pytest.approx(one.residual_rms_m, abs=1e-6)
        assert error < one.rigid_rms_m / 25
        assert not table[: round(planned.rest_s / PERIOD_S)].any()
        assert np.abs(table[-1]).max() < 1e-6
        assert np.abs(np.diff(table, axis=0)).max() / PERIOD_S <= LIMITS.rate_rad_s
    light, heavy = np.abs(planned.goals_rad()).max(axis=(1, 2))
    assert heavy < light < np.arcsin(0.2 / 1.01) * 1.05, "a heavier tip sags further out"


def test_a_symmetric_path_has_symmetric_goals(plant):
    """Without prebend and with equal stiffness both ways, one side mirrors the other."""
    even = {
        n: 0.0 for n in plant.parameters if n.startswith(("prebend_", "directional_stiffness_"))
    }
    twin = TipTwin(plant.with_values(even), 1, PERIOD_S)
    goals = []
    for sign in (1.0, -1.0):
        tip = sign * built_in_path("line", 1, PERIOD_S, PathOptions(seconds=1.5)).tip_m
        line = timeline(DesiredPath("line", tip, ()), np.zeros(1), PERIOD_S)
        goals.append(Inverter(twin, line).invert([1.0])[0].goals_rad)
    assert goals[0] == pytest.approx(-goals[1], abs=1e-6)


def test_a_path_out_of_reach_names_the_nearest_place(plant, twin):
    path = built_in_path("hold", 1, PERIOD_S, PathOptions(size_m=0.8, seconds=1.0))
    nearest = nearest_rest_m(twin, np.array([0.8]), 0.0, LIMITS)
    assert nearest == pytest.approx(twin.resting_tip_m(np.array([0.6]), 0.0), abs=1e-6)
    sentence = rf"row \d+ .*leads to x = 0\.800 m.*the nearest place is x = {nearest[0]:.3f} m"
    with pytest.raises(InputError, match=sentence):
        plan_path(path, PlanRequest(plant, 1, PERIOD_S, LIMITS, (0.0,)))


def test_a_path_whose_ways_are_out_of_reach_must_begin_slower(plant):
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
    ("plant", "payloads", "sentence"),
    [
        ("nominal.toml", (), "are"),
        ("nominal.toml", (1.0, 0.5), "give rising masses"),
        ("nominal.toml", (0.0, 9.0), "is 9 kg; give 0 to 3 kg"),
        ("examples/emps_identified.json", (0.0,), "is not the link"),
    ],
)
def test_payloads_and_plants_that_cannot_be_planned_for_are_refused(plant, payloads, sentence):
    path = built_in_path("line", 1, PERIOD_S, PathOptions())
    plant = read_plant(f"models/plant/{plant}")
    with pytest.raises(InputError, match=sentence):
        plan_path(path, PlanRequest(plant, 1, PERIOD_S, LIMITS, payloads))


def test_the_three_impulses_leave_an_oscillator_at_rest():
    """The exact response of a damped oscillator to the impulses, after the last of them."""
    mode = LinearMode(2.0 * math.pi * 1.3, 0.08)
    impulses = zvd_impulses(mode)
    assert sum(weight for _, weight in impulses) == pytest.approx(1.0)
    damped = mode.frequency_rad_s * math.sqrt(1 - mode.damping**2)
    pole = complex(-mode.damping * mode.frequency_rad_s, damped)
    assert abs(sum(weight * np.exp(-pole * delay) for delay, weight in impulses)) < 1e-12
    slope = sum(-delay * weight * np.exp(-pole * delay) for delay, weight in impulses)
    assert abs(slope) < 1e-12, "and its derivative by the frequency"


def test_shaped_moves_swing_less_than_rigid_ones_and_inverted_ones_least(plant):
    options = PathOptions(size_m=0.1, centre_m=(0.1,), seconds=8.0, move_s=0.9)
    path, swing_m = built_in_path("point_to_point", 1, PERIOD_S, options), {}
    for method in ("rigid", "zvd", "inverse"):
        request = PlanRequest(plant, 1, PERIOD_S, MOVE_LIMITS, (1.5,), method=method)
        plan = plan_path(path, request)
        first, over, after = plan.moves[0]
        swing_m[method] = np.ptp(np.transpose(plan.payloads[0].tip_m)[over:after])
        assert (plan.method, plan.moves[1][0]) == (method, after)
        assert plan.moves[1][2] - after == pytest.approx(after - first, abs=1)
        rates = np.diff(plan.goals_rad()[0], axis=0) / PERIOD_S
        accelerations = np.diff(rates, axis=0) / PERIOD_S
        if method == "rigid":
            assert np.abs(rates).max() == pytest.approx(MOVE_LIMITS.rate_rad_s, rel=1e-3)
            most = MOVE_LIMITS.acceleration_rad_s2
            assert np.abs(accelerations).max() == pytest.approx(most, rel=1e-3)
    assert swing_m["zvd"] < swing_m["rigid"] / 5
    assert swing_m["inverse"] < swing_m["rigid"] / 50


def test_a_rest_that_is_too_short_for_the_shaped_move_is_refused(plant):
    options = PathOptions(size_m=0.1, seconds=1.4, move_s=0.4)
    short = built_in_path("point_to_point", 1, PERIOD_S, options)
    with pytest.raises(InputError, match="leaves no rest after a move"):
        plan_path(short, PlanRequest(plant, 1, PERIOD_S, MOVE_LIMITS, (1.5,), method="zvd"))


def test_the_shortest_move_is_the_shortest_that_keeps_the_limits(plant, monkeypatch):
    def fake(path, request):
        if path < 0.83:
            raise InputError("row 3", "moves too fast", "make it slower")
        payload = type("Payload", (), {"residual_rms_m": 1e-4})
        return type("Plan", (), {"payloads": (payload,)})

    monkeypatch.setattr(planning, "plan_path", fake)
    request = PlanRequest(plant, 1, PERIOD_S, LIMITS, (0.0, 2.0))
    assert 0.83 <= shortest_move_s(lambda s: s, request) <= 0.83 * (1 + planning.MOVE_STEP)
    with pytest.raises(InputError, match="moves too fast"):
        shortest_move_s(lambda s: 0.0, request)


def test_the_tip_of_the_twin_comes_to_rest_where_the_map_says(plant, twin):
    """After a ramp of 4 s from upright and a hold of 10 s."""
    goal_map, modes = map_rest(plant, 1, PERIOD_S, (0.0, 2.0), 0.6)
    rest = RestGoals(goal_map)
    ramp = np.minimum(np.arange(round(14.0 / PERIOD_S) + 1) * PERIOD_S / 4.0, 1.0)
    for payload_kg in (0.0, 2.0):
        for place in (-0.55, 0.0, 0.123, 0.5):
            goals = np.outer(ramp, rest.goals_rad((place,), payload_kg))
            assert twin.run(goals, payload_kg).tip_m[-1] == pytest.approx(place, abs=1e-3)
    assert rest.goals_rad((0.61,), 1.0) is None
    light, heavy = (rest.mode(kg)[0][0] for kg in (0.0, 2.0))
    assert 0.1 < light < heavy < 0.5
    assert [by_joint[0].half_period_s for by_joint in modes] == pytest.approx(
        [light, heavy], abs=1e-5
    )
