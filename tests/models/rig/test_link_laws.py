"""The laws of both engines against what any inflated link obeys, and each against its parts."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from models.rig.drawn import rig_named
from models.rig.hinged import BendLaw, relaxation_spectrum
from models.rig.parameters import read_parameters
from models.rig.rod import SectionLaw
from tests.models.rig.rigs import EVEN, NO_MEMORY, UNLIMITED

STEP_S, SECTIONS = 1e-3, 8
PLAIN = {**NO_MEMORY, **EVEN, "stiffness.damping_s": 0.0}
EFFECTS = ("directional_stiffness", "stiffness_softening", "stiffness_hardening", "hysteresis",
           "creep", "cross_axis_coupling")  # fmt: skip
LIMIT_NM = read_parameters()["stiffness.root_limit_nm"]
ENGINES = ("default", "chain", "rod")
"""Structures of the hinged link, the second with a wall that wrinkles, and the rod."""


def law_of(engine, hidden=None, **values):
    """Function (bends (9, 2), leaking_s) -> moments (9, 2) against them, one step later."""
    rig = rig_named("default" if engine == "rod" else engine).hide(hidden or {})
    rig = rig.changed(**{"stiffness.prebend_rad": 0.0} | values)
    if engine == "rod":
        law = SectionLaw(rig, STEP_S, SECTIONS)
        return lambda bend, leaking_s=0.0: law.advance(bend, leaking_s)[0]
    law, hinges = BendLaw(rig, STEP_S), rig.structure.hinges

    def moment_nm(bend, leaking_s=0.0):
        spread = np.zeros((hinges + 1, 2))
        spread[0], spread[1:] = bend[0], bend[1:].sum(axis=0) / hinges
        moment_nm = -law.torque_nm(spread, leaking_s)
        return np.concatenate([moment_nm, moment_nm[-1:].repeat(SECTIONS, axis=0)])[: SECTIONS + 1]

    return moment_nm


def bends(root, span=(0.0, 0.0)):
    """Bend of the root, and of the whole span; a number is a bend towards +x."""
    bend = np.zeros((SECTIONS + 1, 2))
    bend[0] = root if np.ndim(root) else (root, 0.0)
    bend[1:] = np.array(span if np.ndim(span) else (span, 0.0)) / SECTIONS
    return bend


def work_j(law, path_rad):
    """Work put into every hinge or section along a path, after every step (trapezoidal rule)."""
    moment = np.array([law(angle) for angle in path_rad])
    middle = 0.5 * (moment[1:] + moment[:-1])
    return np.cumsum(np.sum(middle * np.diff(path_rad, axis=0), axis=2), axis=0)


def closed_path(seed, scale_rad, steps=3000):
    """From rest to a path of three sinusoids that is run twice; the same in every section."""
    rng = np.random.default_rng(seed)
    time = np.linspace(0.0, 1.0, steps)[:, None]
    cycle = sum(
        rng.normal(size=2) / k * np.sin(2 * np.pi * (k * time + rng.random(2))) for k in (1, 3, 8)
    )
    cycle *= scale_rad / np.abs(cycle).max()
    start = np.linspace(0.0, 1.0, 200)[:, None] * cycle[0]
    path = np.concatenate([start, cycle, cycle[1:]])
    return np.stack([bends(root, root) for root in path])


@pytest.mark.slow
@settings(max_examples=25, deadline=None)
@given(
    engine=st.sampled_from((*ENGINES, "memory", "test_a", "test_b")),
    seed=st.integers(0, 2**32 - 1),
    scale_rad=st.sampled_from([0.01, 0.05, 0.3]),
    strengths=st.fixed_dictionaries({name: st.floats(0.0, 0.4) for name in EFFECTS}),
)
def test_no_path_draws_energy_from_the_link(engine, seed, scale_rad, strengths):
    """Neither from rest nor in a closed cycle, whatever is hidden and however near to folding."""
    work = work_j(law_of(engine, strengths), closed_path(seed, scale_rad))
    assert np.all(work.min(axis=0) > -1e-3 * work.max(axis=0))
    cycle = (len(work) - 200) // 2
    assert np.all(work[-1] - work[-1 - cycle] > -1e-3 * work.max(axis=0))


@pytest.mark.slow
@pytest.mark.parametrize("engine", ENGINES)
def test_a_closed_loop_costs_energy_only_with_memory(engine):
    path = closed_path(5, 0.1)
    elastic = work_j(law_of(engine, **NO_MEMORY, **{"stiffness.damping_s": 0.0}), path)
    cycle = (len(path) - 200) // 2
    assert np.all(np.abs(elastic[-1] - elastic[-1 - cycle]) < 1e-4 * elastic.max(axis=0))
    memory = work_j(law_of(engine), path)
    assert np.all(memory[-1] - memory[-1 - cycle] > 0.05 * memory.max(axis=0))


@pytest.mark.parametrize("engine", ENGINES)
def test_the_whole_moment_stays_below_its_limit(engine):
    """A bend of 0.2 rad within 20 ms, with creep and friction that would add half of the limit."""
    hidden = {"creep": 0.3, "hysteresis": 0.3, "stiffness_hardening": 1.0}
    law = law_of(engine, hidden, **{"stiffness.directional_share": 0.0})
    for k in range(1, 21):
        moment = law(bends(0.01 * k * np.array([0.6, -0.8]), 0.01 * k * np.array([0.6, -0.8])))
        size = np.linalg.norm(moment, axis=1)
        assert size[0] < LIMIT_NM and np.all(size[1:] < 46.0)
    assert size[0] > 0.8 * LIMIT_NM


@pytest.mark.parametrize("engine", ENGINES)
def test_the_moment_opposes_the_bend_and_levels_off(engine):
    law = law_of(engine, **PLAIN)
    moment = np.array([law(bends(bend))[0, 0] for bend in (1e-5, 0.01, 0.05, 0.2, 10.0)])
    secant = moment / [1e-5, 0.01, 0.05, 0.2, 10.0]
    assert secant[0] == pytest.approx(350.0, rel=1e-4)
    assert np.all(np.diff(moment) > 0) and np.all(np.diff(secant[2:]) < 0)
    assert moment[-1] == pytest.approx(LIMIT_NM, rel=5e-3)


@pytest.mark.parametrize("engine", ["chain", "rod"])
def test_a_wall_is_linear_until_it_wrinkles(engine):
    bend = 0.99 * LIMIT_NM / 2 / 350.0
    assert law_of(engine, **PLAIN)(bends(bend))[0, 0] == pytest.approx(350.0 * bend, rel=1e-9)


@pytest.mark.parametrize("engine, pressure_pa", [("default", 80_000.0), ("rod", 20_000.0)])
def test_pressure_adds_stiffness_by_prestress_and_limits_in_proportion(engine, pressure_pa):
    def root_nm(bend):
        return law_of(engine, **PLAIN, **{"stiffness.pressure_pa": pressure_pa})(bends(bend))[0, 0]

    gained = (pressure_pa - 41_300.0) * 0.15**4 / 6
    assert root_nm(1e-6) / 1e-6 == pytest.approx(350.0 * (1 + gained / 135.0), rel=1e-6)
    assert root_nm(1e4) == pytest.approx(LIMIT_NM * pressure_pa / 41_300.0, rel=1e-3)


@pytest.mark.parametrize("engine", ENGINES)
def test_positive_bends_are_stiffer_by_the_directional_share(engine):
    law = law_of(engine, **{**PLAIN, "stiffness.directional_share": 0.2})
    stiff, soft = law(bends(0.02))[0, 0] / 0.02, -law(bends(-0.02))[0, 0] / 0.02
    assert (stiff - soft) / 350.0 == pytest.approx(0.4, rel=0.15)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("effect, ratio", [("softening", 0.7), ("hardening", 1.3)])
def test_softening_and_hardening_are_strengths_at_a_tenth_of_a_radian(engine, effect, ratio):
    far = {**PLAIN, **UNLIMITED}
    plain = law_of(engine, **far)(bends(0.1, 0.1))[:, 0]
    changed = law_of(engine, **far, **{f"stiffness.{effect}_share": 0.3})(bends(0.1, 0.1))[:, 0]
    np.testing.assert_allclose(changed, ratio * plain, rtol=1e-6)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_leak_takes_its_share_of_the_moment_in_ten_seconds(engine):
    tight = law_of(engine)(bends(0.1, 0.1), 10.0)
    leaking = law_of(engine, **{"stiffness.leak_share": 0.25})(bends(0.1, 0.1), 10.0)
    np.testing.assert_allclose(leaking, 0.75 * tight)


def test_a_constant_bend_relaxes_by_the_relaxing_share():
    soon = {f"memory.relaxation_{b}_s": 0.05 for b in (1, 2, 3)}
    law = law_of("default", **{**PLAIN, **soon, "memory.relaxing_share": 0.3})
    at_once, *_, later = (law(bends(1e-4)) for _ in range(1000))
    # A step within one step of integration has already relaxed by half of it, 1 % of 50 ms.
    np.testing.assert_allclose(at_once[0, 0] / later[0, 0], 1.3, rtol=0.01)


def test_a_power_law_loses_torque_by_a_constant_factor_per_decade():
    p = rig_named("memory")
    times_s, fractions = relaxation_spectrum(p)
    assert fractions.sum() == pytest.approx(p["memory.relaxing_share"])
    torque = [np.sum(fractions * np.exp(-t / times_s)) for t in (0.2, 2.0, 20.0)]
    lost = -np.diff(torque)
    assert lost[1] / lost[0] == pytest.approx(10 ** -p["memory.power_exponent"], rel=0.05)


# ---- parts of the rod's law ----------------------------------------------------------------------


def test_creep_of_the_rod_relaxes_its_share_over_decades():
    law = law_of("rod", **{**PLAIN, "memory.relaxing_share": 0.24})
    moments = [law(bends(0.01))[0, 0] / 3.5 for _ in range(10_000)]
    assert moments[0] == pytest.approx(1.24, abs=0.005)
    # Every factor of ten in time takes about as much as the one before, as a logarithm does.
    first, second = moments[0] - moments[999], moments[999] - moments[9999]
    assert 0.02 < first < 0.12 and 0.02 < second < 0.12


@pytest.mark.parametrize(
    "values, size",
    [({}, 0.2), ({"stiffness.softening_share": 0.3}, 0.05),
     ({"stiffness.hardening_share": 1.0}, 0.2), ({"stiffness.coupling_share": 0.4}, 0.05)],
)  # fmt: skip
def test_tangent_of_the_rod_is_the_derivative_of_the_moment(values, size):
    bend = size * np.array([[0.8, -0.6], *[[0.1, -0.075]] * SECTIONS])
    law = SectionLaw(read_parameters().changed(**{**PLAIN, **values}), STEP_S, SECTIONS)
    _, tangent = law.advance(bend)
    for plane in range(2):
        nudge = np.zeros_like(bend)
        nudge[:, plane] = 1e-7
        slope = (law.advance(bend + nudge)[0] - law.advance(bend - nudge)[0]) / 2e-7
        np.testing.assert_allclose(tangent[:, :, plane], slope, rtol=1e-5, atol=1e-3)


# ---- friction of the skin ------------------------------------------------------------------------


@pytest.mark.parametrize(
    "engine, reversal", [("default", 1.0), ("test_a", 2.0), ("memory", 1.0), ("rod", 1.0)]
)
def test_friction_has_its_stiffness_its_limit_and_its_slope_after_a_reversal(engine, reversal):
    """Bouc-Wen, Dahl, Maxwell slip, sliders; of Dahl dz/du = (1 - z sgn du) / u_y = 2 / u_y."""
    share, p = 0.2, rig_named("default" if engine == "rod" else engine)
    stiffness, yield_rad = p["stiffness.root_nm_rad"], p["memory.root_yield_rad"]
    small = 1e-3 * yield_rad
    forwards = np.linspace(small, 20 * yield_rad, 1000)
    path = [0.0, *forwards, forwards[-1] - small]
    with_it, without = (
        np.array([law(bends(bend))[0, 0] for bend in path])
        for law in (
            law_of(engine, **{**PLAIN, **UNLIMITED, "memory.hysteresis_share": s})
            for s in (share, 0.0)
        )
    )
    friction = with_it - without
    assert friction[1] == pytest.approx(share * stiffness * small, rel=2e-3)
    assert friction.max() == pytest.approx(share * stiffness * yield_rad, rel=1e-3)
    slope = (friction[-2] - friction[-1]) / small
    assert slope == pytest.approx(reversal * share * stiffness, rel=5e-3)
