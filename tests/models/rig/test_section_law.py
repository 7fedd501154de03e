"""The rod's section law against what its parts are made of, without the rod."""

from itertools import pairwise

import numpy as np
import pytest

from models.rig.rod import SectionLaw

STEP_S, SECTIONS = 1e-3, 8
PLAIN = {
    "memory.hysteresis_share": 0.0, "memory.relaxing_share": 0.0, "stiffness.damping_s": 0.0,
    "stiffness.directional_share": 0.0, "stiffness.prebend_rad": 0.0,
}  # fmt: skip


def law_of(parameters, **values):
    return SectionLaw(parameters.changed(**{**PLAIN, **values}), STEP_S, SECTIONS)


def root_bend(x_rad, y_rad=0.0):
    bend = np.zeros((SECTIONS + 1, 2))
    bend[0] = x_rad, y_rad
    return bend


def held_nm(law, x_rad, seconds):
    """Moment of the root after a jump to a bend that is held."""
    for _ in range(round(seconds / STEP_S)):
        moment, _ = law.advance(root_bend(x_rad))
    return moment[0, 0]


def test_the_root_is_linear_until_it_wrinkles_and_ends_at_its_limit(parameters):
    law = law_of(parameters)
    below, above = 0.99 * 14.0 / 350.0, 10.0
    assert law.advance(root_bend(below))[0][0, 0] == pytest.approx(350.0 * below, rel=1e-9)
    assert 27.8 < law.advance(root_bend(above))[0][0, 0] < 28.0


@pytest.mark.parametrize(
    "values",
    [{}, {"stiffness.softening_share": 0.3}, {"stiffness.hardening_share": 1.0},
     {"stiffness.coupling_share": 0.4}],
)  # fmt: skip
@pytest.mark.parametrize("size", [0.01, 0.05])
def test_tangent_is_the_derivative_of_the_moment(parameters, values, size):
    bend = size * np.array([[0.8, -0.6], *[[0.1, -0.075]] * SECTIONS])
    law = law_of(parameters, **values, **{"stiffness.span_limit_nm": 1e3})
    _, tangent = law.advance(bend)
    for plane in range(2):
        nudge = np.zeros_like(bend)
        nudge[:, plane] = 1e-7
        slope = (law.advance(bend + nudge)[0] - law.advance(bend - nudge)[0]) / 2e-7
        np.testing.assert_allclose(tangent[:, :, plane], slope, rtol=1e-5, atol=1e-4)


@pytest.mark.parametrize("effect, ratio", [("softening", 1.0 - 0.3), ("hardening", 1.0 + 0.3)])
def test_strength_is_the_stiffness_at_the_reference_bend(parameters, effect, ratio):
    far = {"stiffness.root_limit_nm": 1e6}
    plain = law_of(parameters, **far).advance(root_bend(0.1))[0][0, 0]
    changed = law_of(parameters, **far, **{f"stiffness.{effect}_share": 0.3})
    assert changed.advance(root_bend(0.1))[0][0, 0] == pytest.approx(ratio * plain, rel=1e-9)


def test_positive_bends_are_stiffer_by_the_directional_share(parameters):
    stiffness = [
        law_of(parameters, **{"stiffness.directional_share": 0.2}).advance(root_bend(side))[0][0, 0]
        / side
        for side in (0.03, -0.03)
    ]
    assert (stiffness[0] - stiffness[1]) / 350.0 == pytest.approx(0.4, rel=0.05)


def test_creep_relaxes_its_share_of_the_stiffness_over_decades(parameters):
    law = law_of(parameters, **{"memory.relaxing_share": 0.24})
    moments = [held_nm(law, 0.01, seconds) / 3.5 for seconds in (0.001, 0.999, 9.0)]
    assert moments[0] == pytest.approx(1.24, abs=0.005)
    # Every factor of ten in time takes about as much as the one before, as a logarithm does.
    first, second = moments[0] - moments[1], moments[1] - moments[2]
    assert 0.02 < first < 0.12 and 0.02 < second < 0.12


def test_sliders_hold_their_share_and_yield(parameters):
    """Stiffness of the skin at first, then a constant moment: its stiffness times the yield."""
    law = law_of(parameters, **{"memory.hysteresis_share": 0.2})
    stuck = law.advance(root_bend(1e-5))[0][0, 0]
    assert stuck == pytest.approx(1.2 * 350.0 * 1e-5, rel=1e-6)
    slipping = law.advance(root_bend(0.03))[0][0, 0] - 350.0 * 0.03
    assert slipping == pytest.approx(0.2 * 350.0 * 0.01, rel=1e-6)


def test_a_closed_path_costs_work(parameters):
    """Whatever the path in both planes, the law never gives work back that it did not take."""
    law = SectionLaw(parameters.changed(**{"stiffness.coupling_share": 0.3}), STEP_S, SECTIONS)
    rng = np.random.default_rng(4)
    phase = 2 * np.pi * rng.random((3, SECTIONS + 1, 2))
    time = np.linspace(0.0, 1.0, 4001)
    path = sum(
        0.01 / k * np.sin(2 * np.pi * k * time[:, None, None] + phase[k - 1]) for k in (1, 2, 3)
    )
    path -= path[0]
    work, before = 0.0, law.advance(path[0])[0]
    for start, end in pairwise(path):
        moment, _ = law.advance(end)
        work += np.sum(0.5 * (before + moment) * (end - start))
        before = moment
    assert work > 0.0


def test_a_leak_takes_its_share_in_ten_seconds(parameters):
    law = law_of(parameters, **{"stiffness.leak_share": 0.25})
    whole, _ = law.advance(root_bend(0.01))
    left, _ = law.advance(root_bend(0.01), leaking_s=10.0)
    assert left[0, 0] == pytest.approx(0.75 * whole[0, 0], rel=1e-9)
