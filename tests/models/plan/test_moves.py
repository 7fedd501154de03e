"""Moves from rest to rest: limits, shaping, a free decay; the map of places at rest."""

import math

import numpy as np
import pytest

from firmware_py.errors import InputError
from firmware_py.goals.outside.goal_map import RestGoals
from firmware_py.safety.limits import Limits
from firmware_py.signals import PERIOD_S
from models.plan import planning
from models.plan.moves import rate_limited, shaped, zvd_impulses
from models.plan.paths import PathOptions, built_in_path
from models.plan.planning import PlanRequest, plan_path, shortest_move_s
from models.plan.rest_map import map_rest
from models.plant.linear_twin import LinearMode, LinearTwins, resting_modes

LIMITS = Limits(rate_rad_s=1.0, acceleration_rad_s2=20.0)


@pytest.mark.parametrize("distance", [0.4, 0.03, -0.2, 0.0])
def test_a_rate_limited_move_uses_the_limits_and_keeps_them(distance):
    start, end = np.array([0.1, 0.0]), np.array([0.1 + distance, 0.5 * distance])
    goals = np.vstack([start, start, rate_limited(start, end, LIMITS, PERIOD_S), end, end])
    assert goals[-3] == pytest.approx(end)
    rate = np.diff(goals, axis=0) / PERIOD_S
    acceleration = np.diff(rate, axis=0) / PERIOD_S
    assert np.abs(rate).max() <= LIMITS.rate_rad_s + 1e-9
    assert np.abs(acceleration).max() <= LIMITS.acceleration_rad_s2 + 1e-6
    if abs(distance) > 0.1:
        assert np.abs(rate).max() == pytest.approx(LIMITS.rate_rad_s)
        shortest_s = abs(distance) / LIMITS.rate_rad_s + 1.0 / 20.0
        assert (len(goals) - 4) * PERIOD_S == pytest.approx(shortest_s, abs=PERIOD_S)


def test_a_shaped_step_leaves_an_oscillator_at_rest():
    """The exact response of a damped oscillator to the impulses, after the last of them."""
    mode = LinearMode(2.0 * math.pi * 1.3, 0.08)
    impulses = zvd_impulses(mode)
    assert sum(weight for _, weight in impulses) == pytest.approx(1.0)
    damped = mode.frequency_rad_s * math.sqrt(1 - mode.damping**2)
    pole = complex(-mode.damping * mode.frequency_rad_s, damped)
    left = sum(weight * np.exp(-pole * delay) for delay, weight in impulses)
    assert abs(left) < 1e-12
    slope = sum(-delay * weight * np.exp(-pole * delay) for delay, weight in impulses)
    assert abs(slope) < 1e-12, "and its derivative by the frequency"
    step = np.concatenate([np.zeros(5), np.ones(200)])
    own = shaped(step, impulses, PERIOD_S)
    assert own[4] == 0.0
    assert own[5] == pytest.approx(impulses[0][1])
    assert own[-1] == pytest.approx(1.0)


def test_the_first_mode_is_that_of_a_free_decay(plant, twin):
    linear = LinearTwins(plant, 1, PERIOD_S)
    (mode,) = resting_modes(linear, 1.0)
    goals = np.zeros((400, 1))
    goals[1:] = 1e-2
    tip = twin.tip_m(twin.run(goals, 1.0))[60:, 0]
    tip = tip - np.mean(tip[-100:])
    crossings = np.flatnonzero(np.diff(np.sign(tip[:150]))) * PERIOD_S
    assert np.mean(np.diff(crossings)) == pytest.approx(mode.half_period_s, rel=0.1)
    (heavy,) = resting_modes(linear, 2.0)
    assert heavy.frequency_rad_s < mode.frequency_rad_s
    assert 0.02 < heavy.damping < 0.2


@pytest.fixture(scope="module")
def path():
    options = PathOptions(size_m=0.1, centre_m=(0.1,), seconds=8.0, move_s=0.9)
    return built_in_path("point_to_point", 1, PERIOD_S, options)


def test_shaped_moves_swing_less_than_rigid_ones_and_inverted_ones_least(plant, twin, path):
    swing, plans = {}, {}
    for method in ("rigid", "zvd", "inverse"):
        request = PlanRequest(plant, 1, PERIOD_S, LIMITS, (1.5,), method=method)
        plan = plans[method] = plan_path(path, request)
        assert plan.method == method
        first, over, after = plan.moves[0]
        tip = np.transpose(plan.payloads[0].tip_m)[over:after]
        swing[method] = float(np.ptp(tip))
        assert plan.moves[1][0] == after
        assert plan.moves[1][2] - after == pytest.approx(after - first, abs=1)
    assert swing["zvd"] < swing["rigid"] / 5
    assert swing["inverse"] < swing["rigid"] / 50
    goals = plans["rigid"].goals_rad()[0]
    assert np.abs(np.diff(goals, axis=0)).max() / PERIOD_S == pytest.approx(1.0, rel=1e-3)


def test_a_rest_that_is_too_short_for_the_shaped_move_is_refused(plant):
    options = PathOptions(size_m=0.1, seconds=1.4, move_s=0.4)
    short = built_in_path("point_to_point", 1, PERIOD_S, options)
    with pytest.raises(InputError, match="leaves no rest after a move"):
        plan_path(short, PlanRequest(plant, 1, PERIOD_S, LIMITS, (1.5,), method="zvd"))


def test_the_shortest_move_is_the_shortest_that_keeps_the_limits(plant, monkeypatch):
    def fake(path, request):
        if path < 0.83:
            raise InputError("row 3", "moves too fast", "make it slower")
        own = type("Own", (), {"residual_rms_m": 1e-4})
        return type("Plan", (), {"payloads": (own,)})

    monkeypatch.setattr(planning, "plan_path", fake)
    request = PlanRequest(plant, 1, PERIOD_S, LIMITS, (0.0, 2.0))
    assert 0.83 <= shortest_move_s(lambda s: s, request) <= 0.83 * (1 + planning.MOVE_STEP)
    with pytest.raises(InputError, match="moves too fast"):
        shortest_move_s(lambda s: 0.0, request)


def approached(twin, goals, payload_kg):
    """Tip of the twin after a ramp of 4 s from upright and a hold of 10 s."""
    ramp = np.minimum(np.arange(round(14.0 / PERIOD_S) + 1) * PERIOD_S / 4.0, 1.0)
    return twin.tip_m(twin.run(np.outer(ramp, goals), payload_kg))[-1]


def test_the_tip_of_the_twin_comes_to_rest_where_the_map_says(plant, twin):
    found, modes = map_rest(plant, 1, PERIOD_S, (0.0, 2.0), 0.6)
    rest = RestGoals(found)
    for payload_kg in (0.0, 2.0):
        for place in (-0.55, 0.0, 0.123, 0.5):
            goals = rest.goals_rad((place,), payload_kg)
            assert approached(twin, goals, payload_kg) == pytest.approx(place, abs=1e-3)
    assert rest.goals_rad((0.61,), 1.0) is None
    light, heavy = (rest.mode(kg)[0][0] for kg in (0.0, 2.0))
    assert 0.1 < light < heavy < 0.5
    assert [own[0].half_period_s for own in modes] == pytest.approx([light, heavy], abs=1e-5)
