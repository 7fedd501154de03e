"""Forms of hysteresis and creep against their closed solutions and the laws of any material."""

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from models.rig.forms import hysteresis_form, relaxation_spectrum
from models.rig.parameters import read_parameters, read_rig

YIELD_RAD, STIFFNESS, FRACTION = 0.01, 350.0, 0.2
TORQUE_NM = FRACTION * STIFFNESS * YIELD_RAD
"""Of the slider in full motion."""

FORMS = ("bouc_wen", "dahl", "maxwell_slip")
RIGS = {"bouc_wen": "default", "dahl": "test_a", "maxwell_slip": "memory"}


class OneSection:
    """A form with its memory, for one section."""

    def __init__(self, form):
        memory = [ca.SX.sym("z", 2, 1) for _ in range(form.springs)]
        du = ca.SX.sym("du", 2, 1)
        after, torque_nm = form.advance(memory, du)
        self._step = ca.Function("step", [ca.horzcat(*memory), du], [ca.horzcat(*after), torque_nm])
        self._memory = ca.DM.zeros(2, form.springs)

    def torque_nm(self, du):
        """Torque after a further bend, both of shape (1, 2)."""
        self._memory, torque_nm = self._step(self._memory, du.T)
        return torque_nm.full().T


def form(kind, **values):
    rig = read_rig(RIGS[kind])
    assert rig.structure.hysteresis == kind
    rig = rig.changed(**{"memory.hysteresis_share": FRACTION} | values)
    return OneSection(hysteresis_form(rig, np.array([YIELD_RAD]), np.array([STIFFNESS])))


def along_x(built, path_rad):
    """Torque along a path in one plane that starts at rest."""
    steps = np.diff(path_rad, prepend=0.0)
    return np.array([built.torque_nm(np.array([[du, 0.0]]))[0, 0] for du in steps])


def work_j(path_rad, torque_nm):
    """Work put in along a path, after every step (trapezoidal rule)."""
    middle = 0.5 * (torque_nm[1:] + torque_nm[:-1])
    return np.cumsum(middle * np.diff(path_rad))


def cycles(amplitude_rad, count=2, samples=4000):
    return amplitude_rad * np.sin(np.linspace(0.0, 2 * np.pi * count, count * samples))


@pytest.mark.parametrize(
    "kind, solution",
    [
        ("bouc_wen", lambda x: np.tanh(x)),
        ("dahl", lambda x: 1.0 - np.exp(-x)),
    ],
)
def test_first_loading_follows_the_closed_solution(kind, solution):
    path = np.linspace(0.0, 5 * YIELD_RAD, 5001)
    torque = along_x(form(kind), path)
    np.testing.assert_allclose(torque, TORQUE_NM * solution(path / YIELD_RAD), atol=2e-3)


def test_first_loading_of_maxwell_slip_is_the_sum_of_its_sliders():
    p = read_rig("memory")
    path = np.linspace(0.0, 10 * YIELD_RAD, 1001)
    yields = np.geomspace(1.0, p["memory.slip_range"], round(p["memory.slip_elements"]))
    yields *= YIELD_RAD / yields.mean()
    sliders = np.minimum(path[:, None], yields).mean(axis=1) * FRACTION * STIFFNESS
    np.testing.assert_allclose(along_x(form("maxwell_slip"), path), sliders, atol=1e-9)


@pytest.mark.parametrize("kind", FORMS)
def test_a_small_bend_meets_the_fraction_of_the_stiffness(kind):
    bend = 1e-3 * YIELD_RAD
    torque = along_x(form(kind), np.array([0.0, bend]))
    assert torque[-1] == pytest.approx(FRACTION * STIFFNESS * bend, rel=2e-3)


@pytest.mark.parametrize("kind", FORMS)
def test_torque_never_exceeds_that_of_the_slider(kind):
    torque = along_x(form(kind), cycles(20 * YIELD_RAD))
    assert np.abs(torque).max() <= TORQUE_NM * (1 + 1e-9)
    assert np.abs(torque).max() == pytest.approx(TORQUE_NM, rel=1e-3)


@pytest.mark.parametrize("kind, factor", [("bouc_wen", 1.0), ("dahl", 2.0), ("maxwell_slip", 1.0)])
def test_the_stiffness_after_a_reversal_is_that_of_the_form(kind, factor):
    """Of Dahl's equation with full slip, dz/du = (1 - z sgn du) / u_y = 2 / u_y."""
    path = np.append(np.linspace(0.0, 20 * YIELD_RAD, 4000), (20 - 1e-3) * YIELD_RAD)
    torque = along_x(form(kind), path)
    slope = (torque[-2] - torque[-1]) / (1e-3 * YIELD_RAD)
    assert slope == pytest.approx(factor * FRACTION * STIFFNESS, rel=5e-3)


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), kind=st.sampled_from(FORMS))
def test_no_path_in_two_planes_draws_energy(seed, kind):
    rng = np.random.default_rng(seed)
    time = np.linspace(0.0, 1.0, 1500)[:, None]
    path = sum(
        YIELD_RAD * 3 * rng.normal(size=2) / k * np.sin(2 * np.pi * k * time) for k in (1, 3, 8)
    )
    built = form(kind)
    torque = np.array([built.torque_nm(du[None])[0] for du in np.diff(path, axis=0)])
    middle = 0.5 * (torque[1:] + torque[:-1])
    work = np.cumsum(np.sum(middle * np.diff(path, axis=0)[1:], axis=1))
    assert work.min() > -1e-3 * work.max()


@pytest.mark.parametrize("kind", FORMS)
def test_a_closed_cycle_costs_energy(kind):
    path = cycles(2 * YIELD_RAD)
    work = work_j(path, along_x(form(kind), path))
    first, second = work[len(path) // 2 - 1], work[-1]
    assert 0.0 < first < second


def test_the_loop_of_maxwell_slip_grows_with_the_amplitude():
    """Empty below the least yield, and a parallelogram of known area far beyond the largest."""
    areas = []
    for amplitude in (0.05, 0.3, 1.0, 3.0, 100.0):
        path = cycles(amplitude * YIELD_RAD)
        work = work_j(path, along_x(form("maxwell_slip"), path))
        areas.append(work[-1] - work[len(path) // 2 - 1])
    assert abs(areas[0]) < 1e-9
    assert np.all(np.diff(areas) > 0)
    # Each slider gives 4 k d (A - d); the mean of d is u_y.
    assert areas[-1] == pytest.approx(4 * TORQUE_NM * 100 * YIELD_RAD, rel=0.05)


def test_maxwell_slip_forgets_a_closed_minor_loop():
    up = np.linspace(0.0, 2.0, 400)
    minor = np.concatenate([np.linspace(2.0, 1.2, 200), np.linspace(1.2, 2.0, 200)])
    torque = along_x(form("maxwell_slip"), YIELD_RAD * np.concatenate([up, minor]))
    assert torque[len(up) - 1] == pytest.approx(torque[-1], rel=1e-9)


@pytest.mark.parametrize("kind", FORMS)
def test_strength_zero_is_no_torque(kind):
    built = form(kind, **{"memory.hysteresis_share": 0.0})
    assert not np.any(along_x(built, cycles(YIELD_RAD, samples=200)))


@pytest.mark.parametrize("rig", ["default", "memory"])
def test_both_spectra_sum_up_to_the_relaxing_fraction(rig):
    p = read_rig(rig).hide({"creep": 0.1})
    times_s, fractions = relaxation_spectrum(p)
    assert fractions.sum() == pytest.approx(read_parameters()["memory.relaxing_share"] + 0.1)
    assert np.all(np.diff(times_s) > 0) and np.all(fractions > 0)


def test_a_power_law_loses_torque_by_a_constant_factor_per_decade():
    p = read_rig("memory")
    times_s, fractions = relaxation_spectrum(p)
    left = [np.sum(fractions * np.exp(-t / times_s)) for t in (0.2, 2.0, 20.0)]
    lost = -np.diff(left)
    assert lost[1] / lost[0] == pytest.approx(10 ** -p["memory.power_exponent"], rel=0.05)
