"""The bending law against what any real material obeys."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from models.rig.hinged import BendLaw
from models.rig.parameters import DEFAULT_STRUCTURE, read_parameters

SPAN_HINGES = DEFAULT_STRUCTURE.hinges
HINGES = SPAN_HINGES + 1
EFFECTS = ("directional_stiffness", "stiffness_softening", "stiffness_hardening", "hysteresis",
           "creep", "cross_axis_coupling")  # fmt: skip


def work_j(law, path_rad):
    """Work put into the law along a path, summed up after every step."""
    torque = np.array([law.torque_nm(angle) for angle in path_rad])
    middle = -0.5 * (torque[1:] + torque[:-1])
    return np.cumsum(np.sum(middle * np.diff(path_rad, axis=0), axis=(1, 2)))


def relaxed(**values):
    """The law in a bend at ease at zero."""
    return BendLaw(read_parameters().changed(**{"stiffness.prebend_rad": 0.0} | values), 1e-3)


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    strengths=st.fixed_dictionaries({name: st.floats(0.0, 0.4) for name in EFFECTS}),
)
def test_no_path_draws_energy_from_the_link(seed, strengths):
    """From rest at ease, whatever the path and whatever is hidden, the work is never negative."""
    rng = np.random.default_rng(seed)
    parameters = read_parameters().hide(strengths).changed(**{"stiffness.prebend_rad": 0.0})
    time = np.linspace(0.0, 1.0, 1500)[:, None, None]
    scale = np.array([0.05, *[0.01] * SPAN_HINGES])[:, None]
    path = sum(
        scale * rng.normal(size=(HINGES, 2)) / k * np.sin(2 * np.pi * k * time) for k in (1, 3, 8)
    )
    work = work_j(BendLaw(parameters, 1e-3), path)
    assert work.min() > -1e-4 * work.max()


def test_torque_opposes_bend_and_levels_off_at_the_limit():
    law = relaxed(**{"memory.hysteresis_share": 0.0, "memory.relaxing_share": 0.0})
    bends = np.zeros((4, HINGES, 2))
    bends[:, 0, 0] = [0.01, 0.05, 0.2, 1.0]
    torque = np.array([-law.torque_nm(bend)[0, 0] for bend in bends])
    assert np.all(np.diff(torque) > 0)
    secant = torque / bends[:, 0, 0]
    assert np.all(np.diff(secant) < 0)
    limit = read_parameters()["stiffness.root_limit_nm"]
    slope = 1 + 0.5 * read_parameters()["stiffness.directional_share"]
    assert torque[-1] == pytest.approx(limit * slope, rel=0.01)


def test_negative_bend_is_softer():
    bend = np.full((HINGES, 2), 0.02)
    stiff, soft = -relaxed().torque_nm(bend), relaxed().torque_nm(-bend)
    assert np.all(stiff > soft * 1.1)
    even = {"stiffness.directional_share": 0.0}
    np.testing.assert_array_equal(
        -relaxed(**even).torque_nm(bend), relaxed(**even).torque_nm(-bend)
    )


def test_a_held_bend_relaxes_by_the_relaxing_share():
    share = 0.3
    values = {
        "memory.relaxing_share": share,
        "memory.hysteresis_share": 0.0,
        "stiffness.directional_share": 0.0,
        "memory.relaxation_3_s": 0.05,  # so that all three branches relax within the test
        "memory.relaxation_2_s": 0.05,
        "memory.relaxation_1_s": 0.05,
    }
    law = relaxed(**values)
    bend = np.full((HINGES, 2), 1e-4)
    at_once = -law.torque_nm(bend)
    for _ in range(1000):
        later = -law.torque_nm(bend)
    # A step within one step of integration has already relaxed by half of it, 1 % of 50 ms.
    np.testing.assert_allclose(at_once / later, 1 + share, rtol=0.01)


def test_a_closed_loop_costs_energy_only_with_memory():
    turn = np.linspace(0, 4 * np.pi, 4000)[:, None, None]
    path = 0.02 * np.sin(turn) * np.ones((HINGES, 2))
    none = {"memory.hysteresis_share": 0.0, "memory.relaxing_share": 0.0}
    elastic = work_j(relaxed(**none), path)
    hysteretic = work_j(relaxed(), path)
    assert abs(elastic[-1]) < 1e-4 * elastic.max()
    assert hysteretic[-1] > 0.05 * hysteretic.max()


def test_a_leak_softens_by_its_share_in_ten_seconds():
    law = relaxed(**{"stiffness.leak_share": 0.25})
    tight = relaxed()
    bend = np.full((HINGES, 2), 0.01)
    np.testing.assert_allclose(law.torque_nm(bend, 10.0), 0.75 * tight.torque_nm(bend, 10.0))


def test_softening_and_hardening_are_given_at_a_tenth_of_a_radian():
    elastic = {
        "memory.hysteresis_share": 0.0, "memory.relaxing_share": 0.0,
        "stiffness.directional_share": 0.0, "stiffness.span_limit_nm": 1e6,
        "stiffness.root_limit_nm": 1e6,
    }  # fmt: skip
    bend = np.zeros((HINGES, 2))
    bend[0], bend[1:] = [0.1, 0.0], [0.1 / SPAN_HINGES, 0.0]
    plain = relaxed(**elastic).torque_nm(bend)[:, 0]
    soft = relaxed(**elastic, **{"stiffness.softening_share": 0.3}).torque_nm(bend)[:, 0]
    hard = relaxed(**elastic, **{"stiffness.hardening_share": 0.3}).torque_nm(bend)[:, 0]
    np.testing.assert_allclose(soft, 0.7 * plain, rtol=1e-6)
    np.testing.assert_allclose(hard, 1.3 * plain, rtol=1e-6)
