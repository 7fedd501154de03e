"""Both engines against beam theory, symmetry and energy, and against each other."""

import mujoco
import numpy as np
import pytest

from firmware_py.core.errors import InputError
from models.rig.drawn import rig_named
from models.rig.protocol import build_rig, run_case
from tests.models.rig.rigs import (
    ELASTIC,
    EVEN,
    STRENGTH,
    deflection_m,
    run,
    tip_m,
    with_structure,
)

ENGINES = ("mujoco", "cosserat")
DIFFERENT = ("default", "test_a", "test_b")
"""Structures of the hinged link that have every form between them."""
LENGTH, BENDING, SHEAR = 0.95, 135.0, 1070.0 + 41300.0 * 0.15**2
CLAMPED = {"link.frame_inertia_kg_m2": 1e5, "servo.current_limit_a": 0.0}
"""A base that nothing moves."""


@pytest.fixture(scope="module", params=ENGINES)
def numbers(request, parameters):
    """The numbers of the default rig, on each engine."""
    return with_structure(parameters, engine=request.param)


@pytest.fixture(scope="module")
def rod(parameters):
    return with_structure(parameters, engine="cosserat")


def test_markers_at_rest_are_where_the_contract_puts_them(numbers, rigid_markers):
    rig = build_rig(numbers, 2, 0.0)
    rig.step()
    np.testing.assert_allclose(rig.markers_m, rigid_markers(np.zeros((1, 2)))[0], atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("joint, axis", [(0, 0), (1, 1)])
def test_a_positive_angle_leans_the_link_towards_plus_x_or_plus_y(numbers, joint, axis):
    rig = build_rig(numbers, 2, 0.5)
    goal = np.zeros(2)
    goal[joint] = 0.2
    run(rig, 1.2, goal)
    assert tip_m(rig)[axis] > 0.15
    assert abs(tip_m(rig)[1 - axis]) < 0.02
    # Gravity pulls the leaning link further; the servo holds back, so its current is negative.
    assert deflection_m(rig)[axis] > 0
    assert rig.servos[joint].current_a < 0


@pytest.mark.slow
@pytest.mark.parametrize("root_nm_rad", [350.0, 3000.0])
def test_sag_follows_beam_theory(numbers, root_nm_rad):
    """Gravity along x, weak enough to stay linear: Timoshenko's beam on a root spring."""
    gravity, payload = 0.2, 0.5
    values = {"world.gravity_m_s2": gravity, "stiffness.root_nm_rad": root_nm_rad,
              "stiffness.damping_s": 0.03}  # fmt: skip
    rig = build_rig(
        numbers.changed(**ELASTIC | CLAMPED | values), 1, payload, gravity=(1.0, 0.0, 0.0)
    )
    run(rig, 3.5)
    tip_n, line_n_m = (0.25 + payload) * gravity, 0.9 / LENGTH * gravity
    moment_nm = tip_n * LENGTH + line_n_m * LENGTH**2 / 2
    sag = (
        tip_n * LENGTH**3 / (3 * BENDING) + line_n_m * LENGTH**4 / (8 * BENDING)
        + moment_nm / SHEAR + moment_nm / root_nm_rad * LENGTH
    )  # fmt: skip
    assert deflection_m(rig)[0] == pytest.approx(sag, rel=0.01)


@pytest.mark.slow
def test_a_payload_beside_the_axis_bends_the_link_by_its_moment(numbers):
    gravity, payload, offset = 0.2, 1.0, 0.05
    values = {"world.gravity_m_s2": gravity, "stiffness.damping_s": 0.03}
    rig = build_rig(numbers.changed(**ELASTIC | CLAMPED | values), 1, payload, (offset, 0.0))
    run(rig, 3.5)
    moment_nm = payload * gravity * offset
    bent = moment_nm * (LENGTH**2 / (2 * BENDING) + LENGTH / 350.0)
    assert deflection_m(rig)[0] == pytest.approx(bent, rel=0.01)


def test_gravity_is_a_direction(parameters):
    even = parameters.changed(**EVEN, **{"stiffness.damping_s": 0.05})  # so that it is at rest soon
    hanging = build_rig(even, 1, 1.0, gravity=(0.0, 0.0, 1.0))
    upright = build_rig(even, 1, 1.0)
    for rig in (hanging, upright):
        run(rig, 2.0, [0.3])
    # Upright the load bends the link outwards, hanging it straightens it.
    assert deflection_m(upright)[0] > 0.005
    assert deflection_m(hanging)[0] < -0.005
    assert upright.servos[0].current_a < 0 < hanging.servos[0].current_a


def test_a_symmetric_link_moves_symmetrically(numbers):
    left, right = (build_rig(numbers.changed(**EVEN), 1, 1.5) for _ in range(2))
    for k in range(60):
        goal = 0.4 * np.sin(0.05 * k)
        for rig, sign in ((left, -1), (right, 1)):
            rig.send(np.array([sign * goal]))
            for _ in range(17):
                rig.step()
    np.testing.assert_allclose(tip_m(left), tip_m(right) * [-1, 1, 1], atol=1e-9)
    assert abs(deflection_m(right)[0]) > 1e-3  # it did bend
    assert abs(tip_m(right)[1]) < 1e-9  # in its plane


def swing(rig):
    """First mode in Hz and mean deflection in m after a jump of the base."""
    run(rig, 0.3)
    x = run(rig, 2.2, [np.radians(8.0)])[500:]
    turns = np.flatnonzero(np.diff(np.sign(np.diff(x)))) * rig.step_s
    return 0.5 / np.mean(np.diff(turns)[:3]), x[-800:].mean()


@pytest.mark.slow
def test_both_engines_agree_on_first_mode_and_sag(rod, parameters):
    """The same numbers; the laws differ, so the agreement is that of engineering."""
    modes_hz = []
    for payload_kg in (0.0, 1.5):
        mode_hz, sag_m = swing(build_rig(rod, 1, payload_kg))
        hinged_mode_hz, hinged_sag_m = swing(build_rig(parameters, 1, payload_kg))
        assert mode_hz == pytest.approx(hinged_mode_hz, rel=0.15)
        assert sag_m == pytest.approx(hinged_sag_m, rel=0.15)
        modes_hz += [mode_hz, hinged_mode_hz]
    assert 1.0 < max(modes_hz[2:]) < min(modes_hz[:2]) < 5.0


def unforced(parameters):
    """Neither current nor gravity nor prebend: all energy comes from a kick."""
    return parameters.changed(**{"servo.current_limit_a": 0.0, "world.gravity_m_s2": 0.0,
                                 "stiffness.prebend_rad": 0.0})  # fmt: skip


def kinetic_j_of_rod(rig):
    """Of rod, frame and rotors; for a payload on the axis."""
    rod, inertia = rig.link.rod, rig.link.rod.mass_second_moment_of_inertia
    linear = 0.5 * np.sum(rod.mass[2:] * rod.velocity_collection[:, 2:] ** 2)
    omega = rod.omega_collection
    turning = 0.5 * np.einsum("ik,ijk,jk->", omega, inertia, omega)
    frame = 0.5 * (2 * 0.02 + 0.0018) * rig.joints.rate_rad_s[0] ** 2
    frame += 0.5 * (0.02 + 0.0018) * rig.joints.rate_rad_s[1] ** 2
    return linear + turning + frame + sum(0.5 * 0.84 * s.rotor_rad_s**2 for s in rig.servos)


def test_energy_of_the_rod_never_grows_unforced(rod):
    rig = build_rig(unforced(rod), 2, 1.0)
    rng = np.random.default_rng(1)
    rig.link.rod.velocity_collection[:, 2:] = 0.2 * rng.standard_normal((3, 9))
    rig.link.rod.omega_collection[:, 1:] = 0.2 * rng.standard_normal((3, 9))
    history = [kinetic_j_of_rod(rig)]
    for _ in range(2000):
        rig.step()
        history.append(kinetic_j_of_rod(rig))
    assert max(history) <= 1.001 * history[0]
    peaks = np.reshape(history[1:], (4, 500)).max(axis=1)
    assert np.all(np.diff(peaks) < 0)
    assert peaks[-1] < 0.05 * history[0]


@pytest.mark.parametrize("name", DIFFERENT)
def test_energy_of_the_hinged_link_never_grows_unforced(name):
    rig = build_rig(unforced(rig_named(name)), 2, 1.0)
    velocity = 0.3 * np.random.default_rng(1).standard_normal(rig.model.nv)
    velocity[rig.joints] = 0.0
    rig.data.qvel[:] = velocity

    def kinetic_j():
        mujoco.mj_energyVel(rig.model, rig.data)
        return rig.data.energy[1] + sum(0.5 * 0.84 * s.rotor_rad_s**2 for s in rig.servos)

    history = [kinetic_j()]
    for _ in range(3000):
        rig.step()
        history.append(kinetic_j())
    assert max(history[1:]) <= history[0]
    assert max(history[-500:]) < 0.05 * history[0]


@pytest.mark.slow
@pytest.mark.parametrize("name", DIFFERENT)
def test_the_hinged_link_follows_its_goal_and_bends_outwards(name):
    goal = np.array([0.3, -0.2])
    rig, swing = build_rig(rig_named(name), 2, 1.0), []
    for _ in range(235):
        rig.send(goal)
        run(rig, 0.017)
        swing.append([*deflection_m(rig), *(s.encoder_rad for s in rig.servos)])
    x_m, y_m, _, *angle_rad = np.mean(swing[-36:], axis=0)  # a period of its first mode
    np.testing.assert_allclose(angle_rad, goal, atol=0.01)
    assert 0.005 < x_m < 0.1 and -0.1 < y_m < -0.005


def leaning(parameters):
    rig = build_rig(parameters, 2, 1.0)
    rig.start_leak()
    run(rig, 0.5, [0.3, 0.2])
    return rig.markers_m.copy()


@pytest.mark.slow
def test_effects_outside_the_law_show_on_the_rod_and_none_at_strength_zero(rod):
    plain = leaning(rod)
    nothing = rod.hide(dict.fromkeys(rod.effects(), 0.0))
    np.testing.assert_array_equal(leaning(nothing), plain)
    for effect in ("unmodelled_payload", "prebend", "aerodynamic_drag", "cross_axis_coupling"):
        moved = leaning(rod.hide({effect: STRENGTH[effect]})) - plain
        assert np.sqrt(np.mean(moved[12:] ** 2)) > 2e-4, effect


@pytest.mark.slow
def test_a_trial_of_the_rod_depends_on_its_seed_alone(short_case):
    rig = rig_named("cosserat").changed(**{"world.settle_s": 0.1, "world.pause_s": 0.1})
    case = short_case(period_s=0.3)
    trial = run_case(rig, case)
    assert trial.sha256() == run_case(rig, case).sha256()
    assert np.ptp(trial.tip_m[:, 0]) > 0.05


def test_the_rod_refuses_a_choice_of_the_other_engine(rod):
    with pytest.raises(InputError, match="hysteresis = 'dahl'"):
        build_rig(with_structure(rod, hysteresis="dahl"), 1, 0.0)


def test_a_rod_that_folds_is_refused(rod, short_case):
    case = short_case(payload_kg=10.0, amplitude_rad=1.0, period_s=2.0, dof=1)
    with pytest.raises(InputError, match="the link folds"):
        run_case(rod, case)
