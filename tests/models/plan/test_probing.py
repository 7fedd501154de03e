"""Probing motion: stiffness and payload from the currents of the plant's twin; limits."""

import numpy as np
import pytest

from firmware_py.core.errors import InputError
from firmware_py.core.signals import PERIOD_S
from firmware_py.goals.stiffness_estimate import ProbeEstimate, wrong_in_probe
from firmware_py.safety.limits import Limits
from models.plan.paths import PathOptions, built_in_path
from models.plan.plan import PlanRequest, plan_path
from models.plan.probing import CORRELATION, NOISE_A, design_probe, expected_deviation
from models.plant.linear_twin import STIFFNESS


@pytest.fixture(scope="module")
def probe(plant, twin):
    return design_probe(plant, twin, (0.0, 1.0, 2.0), Limits())


def currents(twin, probe, changes, payload_kg, seed=1):
    """Currents of a twin with other parameters, and the noise that the design assumes."""
    goals = np.transpose(probe.goals_rad)
    clean = twin.scaled(changes).run(goals, payload_kg).current_a
    noise, last = np.zeros(len(goals)), 0.0
    for k, white in enumerate(np.random.default_rng(seed).standard_normal(len(goals))):
        last = CORRELATION * last + np.sqrt(1 - CORRELATION**2) * white
        noise[k] = NOISE_A * last
    return clean + noise[:, None]


def estimated(probe, table, known_kg=None):
    estimate = ProbeEstimate(probe, known_kg)
    for row, current in enumerate(table):
        estimate.take(row, True, current)
    return estimate.result()


def sag(stiffness, payload_kg):
    """Mass over stiffness, with 0.65 kg for the link and the tip's parts.

    A stiffness and a payload that are both too small hardly change it, and the mode neither.
    """
    return (payload_kg + 0.65) / (1.0 + stiffness)


@pytest.mark.parametrize(("factor", "payload_kg"), [(0.85, 0.4), (1.0, 1.3), (1.25, 1.3)])
def test_stiffness_and_payload_are_estimated_together(twin, probe, factor, payload_kg):
    table = currents(twin, probe, {STIFFNESS: factor}, payload_kg)
    unknown, known = estimated(probe, table), estimated(probe, table, payload_kg)
    assert unknown.certain and known.certain
    assert 1.0 + known.stiffness == pytest.approx(factor, abs=0.05)
    assert abs(1.0 + unknown.stiffness - factor) < 2.0 * unknown.deviation
    assert sag(*unknown[:2]) == pytest.approx(sag(factor - 1.0, payload_kg), rel=0.04)


@pytest.mark.parametrize(
    "names", [("coulomb_friction_", "viscous_friction_"), ("root_damping", "span_damping")]
)
def test_friction_and_damping_are_not_taken_for_stiffness(twin, probe, names):
    table = currents(twin, probe, {names: 1.3}, 1.3)
    unknown, known = estimated(probe, table), estimated(probe, table, 1.3)
    assert abs(known.stiffness) < 0.04
    assert abs(unknown.stiffness) < 2.5 * unknown.deviation
    assert sag(*unknown[:2]) == pytest.approx(sag(0.0, 1.3), rel=0.04)


def test_the_expected_deviation_is_that_of_the_estimate(twin, probe):
    """Forty draws of the noise alone: it is smaller, because no parameter is wrong in them."""
    tables = [currents(twin, probe, {}, 1.0, seed) for seed in range(40)]
    for known in (False, True):
        expected = expected_deviation(probe, 1.0, known=known)
        drawn = np.std([estimated(probe, t, 1.0 if known else None).stiffness for t in tables])
        assert drawn < expected < 0.1


def test_the_motion_begins_and_ends_at_rest_and_leaves_little_swing(twin, probe):
    goals = np.transpose(probe.goals_rad)
    assert wrong_in_probe(probe, 1) == ""
    assert np.all(goals[[0, -1]] == 0.0)
    assert len(goals) * PERIOD_S < 5.5
    assert np.max(np.abs(np.diff(goals, axis=0))) / PERIOD_S < 0.6
    still = np.flatnonzero(np.any(goals != 0.0, axis=1))[-1]
    assert 1.5 < (len(goals) - still) * PERIOD_S < 3.0
    goals = np.concatenate([goals, np.zeros((60, 1))])
    for payload_kg in (0.0, 0.7, 2.0):
        tip = twin.run(goals, payload_kg).tip_m
        assert np.max(np.abs(tip[probe.rows :] - tip[0])) < 8e-3


@pytest.mark.slow
@pytest.mark.parametrize(
    ("limits", "sentence"),
    [
        ({"current_a": 1.5}, r"takes \d\.\d\d A of current with .* limits\.current_a, 1\.5"),
        ({"following_error_rad": 0.02}, "rad of following error .* limits.following_error_rad"),
        ({"acceleration_rad_s2": 15.0}, "needs feedback of the tip"),
        ({"rate_rad_s": 0.4}, "probing motion: the goal of joint 1 moves at"),
    ],
)
def test_a_probe_that_breaks_a_limit_is_refused(plant, limits, sentence):
    path = built_in_path("line", 1, PERIOD_S, PathOptions(size_m=0.05, seconds=4.0))
    with pytest.raises(InputError, match=sentence):
        plan_path(path, PlanRequest(plant, 1, PERIOD_S, Limits(**limits), (1.0,), probe=True))


def test_a_plan_contains_its_probe_beside_the_rows_of_the_path(plant):
    path = built_in_path("line", 1, PERIOD_S, PathOptions(size_m=0.05, seconds=4.0))
    plan = plan_path(path, PlanRequest(plant, 1, PERIOD_S, Limits(), (1.0,), probe=True))
    assert plan.probe is not None and wrong_in_probe(plan.probe, 1) == ""
    assert plan.rows * PERIOD_S < 10.0
