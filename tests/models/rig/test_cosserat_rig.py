"""The rod against beam theory, and against the MuJoCo rig of the same numbers."""

import dataclasses
import math

import numpy as np
import pytest
from scipy.optimize import brentq

from firmware_py.errors import InputError
from models.rig.hinged import MujocoRig
from models.rig.parameters import RigStructure, read_rig
from models.rig.protocol import run_case
from models.rig.rod import CosseratRig
from models.shared.kinematics import rigid_tip_m

LENGTH, BENDING, SHEAR = 0.95, 135.0, 1070.0 + 41300.0 * 0.15**2
ELASTIC = {
    "memory.hysteresis_share": 0.0, "memory.relaxing_share": 0.0, "world.drag_nm": 0.0,
    "stiffness.directional_share": 0.0, "stiffness.prebend_rad": 0.0,
    "stiffness.root_limit_nm": 1e6, "stiffness.span_limit_nm": 1e6,
}  # fmt: skip
CLAMPED = {"link.frame_inertia_kg_m2": 1e5, "servo.current_limit_a": 0.0}
"""A base that nothing moves."""


@pytest.fixture(scope="module")
def rod(parameters):
    """The numbers of the default rig, on the rod."""
    return dataclasses.replace(parameters, structure=RigStructure(engine="cosserat"))


def tip_m(rig):
    return rig.markers_m[12:].mean(axis=0)


def joint_rad(rig):
    if isinstance(rig, CosseratRig):
        return np.array(rig.joints.angle_rad)
    return np.append(rig.data.qpos[rig.link.joints], 0.0)[:2]


def deflection_m(rig):
    """Tip against a rigid link on the same joints."""
    return tip_m(rig) - rigid_tip_m(joint_rad(rig)[None], 0.06, LENGTH)[0]


def advance(rig, seconds, goal=None):
    if goal is not None:
        rig.send(np.asarray(goal))
    for _ in range(round(seconds / rig.step_s)):
        rig.step()


def kinetic_j(rig):
    """Of rod, frame and rotors; for a payload on the axis."""
    rod, inertia = rig.link.rod, rig.link.rod.mass_second_moment_of_inertia
    linear = 0.5 * np.sum(rod.mass[2:] * rod.velocity_collection[:, 2:] ** 2)
    omega = rod.omega_collection
    turning = 0.5 * np.einsum("ik,ijk,jk->", omega, inertia, omega)
    frame = 0.5 * (2 * 0.02 + 0.0018) * rig.joints.rate_rad_s[0] ** 2
    frame += 0.5 * (0.02 + 0.0018) * rig.joints.rate_rad_s[1] ** 2
    return linear + turning + frame + sum(0.5 * 0.84 * s.rotor_rad_s**2 for s in rig.servos)


def test_the_rods_markers_stand_where_the_contract_puts_them(rod, rigid_markers):
    rig = CosseratRig(rod, 2, 0.0)
    np.testing.assert_allclose(rig.markers_m, rigid_markers(np.zeros((1, 2)))[0], atol=1e-12)


@pytest.mark.parametrize("joint, axis", [(0, 0), (1, 1)])
def test_the_rod_leans_with_its_joint(rod, joint, axis):
    rig = CosseratRig(rod, 2, 0.5)
    goal = np.zeros(2)
    goal[joint] = 0.2
    advance(rig, 1.2, goal)
    assert tip_m(rig)[axis] > 0.15
    assert abs(tip_m(rig)[1 - axis]) < 0.02
    assert deflection_m(rig)[axis] > 0
    assert rig.servos[joint].current_a < 0


@pytest.mark.parametrize("root_nm_rad", [350.0, 3000.0])
def test_sag_of_the_rod_follows_beam_theory(rod, root_nm_rad):
    """Gravity along x, weak enough to stay linear: Timoshenko's beam on a root spring."""
    gravity, payload = 0.2, 0.5
    values = {"world.gravity_m_s2": gravity, "stiffness.root_nm_rad": root_nm_rad,
              "stiffness.damping_s": 0.03}  # fmt: skip
    rig = CosseratRig(
        rod.changed(**{**ELASTIC, **CLAMPED, **values}), 1, payload, gravity=(1.0, 0.0, 0.0)
    )
    advance(rig, 3.5)
    tip_n, line_n_m = (0.25 + payload) * gravity, 0.9 / LENGTH * gravity
    moment_nm = tip_n * LENGTH + line_n_m * LENGTH**2 / 2
    sag = (
        tip_n * LENGTH**3 / (3 * BENDING) + line_n_m * LENGTH**4 / (8 * BENDING)
        + moment_nm / SHEAR + moment_nm / root_nm_rad * LENGTH
    )  # fmt: skip
    assert deflection_m(rig)[0] == pytest.approx(sag, rel=0.01)


def test_a_payload_beside_the_axis_bends_by_its_moment(rod):
    gravity, payload, offset = 0.2, 1.0, 0.05
    values = {"world.gravity_m_s2": gravity, "stiffness.damping_s": 0.03}
    rig = CosseratRig(rod.changed(**{**ELASTIC, **CLAMPED, **values}), 1, payload, (offset, 0.0))
    advance(rig, 3.5)
    moment_nm = payload * gravity * offset
    bent = moment_nm * (LENGTH**2 / (2 * BENDING) + LENGTH / 350.0)
    assert deflection_m(rig)[0] == pytest.approx(bent, rel=0.01)


def first_mode_of_rod_hz(rod, payload_kg, sections):
    """Free swing of an undamped rod on a stiff root, from upward crossings of the tip."""
    stiff = {"stiffness.root_nm_rad": 2e5, "stiffness.wall_shear_n": 1e5,
             "world.gravity_m_s2": 0.0, "stiffness.damping_s": 0.0}  # fmt: skip
    values = {**ELASTIC, **CLAMPED, **stiff}
    rig = CosseratRig(rod.changed(**values), 1, payload_kg, sections=sections)
    height = rig.link.rod.position_collection[2] - 0.06
    rig.link.rod.velocity_collection[0] = 0.05 * np.maximum(height / LENGTH, 0.0) ** 2
    x = []
    for _ in range(900):
        rig.step()
        x.append(tip_m(rig)[0])
    x = np.array(x)
    before = np.flatnonzero((x[:-1] <= 0.0) & (x[1:] > 0.0))
    crossings_s = (before - x[before] / (x[before + 1] - x[before])) * rig.step_s
    return 1.0 / np.mean(np.diff(crossings_s)), np.abs(x)


def beam_mode_hz(tip_kg, payload_kg=0.0):
    """Cantilever with a mass at its tip (Timoshenko, Vibration Problems in Engineering).

    Rotary inertia of sections and tip, shear and root enter by Rayleigh's quotient.
    """
    mass_kg = tip_kg + payload_kg
    ratio = mass_kg / 0.9
    root = brentq(
        lambda b: 1 + math.cos(b) * math.cosh(b)
        + ratio * b * (math.cos(b) * math.sinh(b) - math.sin(b) * math.cosh(b)), 0.3, 1.9,
    )  # fmt: skip
    x = np.linspace(0.0, 1.0, 2001)
    shape, slope = 0.5 * x**2 * (3.0 - x), 1.5 * (2.0 * x - x**2) / LENGTH
    moving = 0.9 * np.mean(shape**2) + mass_kg
    block, cube = 0.15**2 / 12.0, 0.08**2 / 6.0
    turning = (
        0.9 * block * np.mean(slope**2) + (tip_kg * block + payload_kg * cube) * slope[-1] ** 2
    )
    shear = 3.0 * BENDING / ((1e5 + 41300.0 * 0.15**2) * LENGTH**2)
    patch = 3.0 * BENDING / (2e5 * LENGTH)
    slender_hz = root**2 / (2 * math.pi * LENGTH**2) * math.sqrt(BENDING / (0.9 / LENGTH))
    return slender_hz / math.sqrt((1.0 + turning / moving) * (1.0 + shear + patch))


def test_first_mode_of_the_rod_follows_beam_theory_and_converges(rod):
    exact = beam_mode_hz(0.25)
    coarse, used, fine = (first_mode_of_rod_hz(rod, 0.0, n)[0] for n in (4, 8, 16))
    assert used == pytest.approx(exact, rel=0.003)
    assert abs(used - fine) < 0.5 * abs(coarse - fine)


def test_an_elastic_rod_keeps_its_swing_and_a_payload_slows_it(rod):
    mode_hz, size_m = first_mode_of_rod_hz(rod, 0.5, 4)
    assert mode_hz == pytest.approx(beam_mode_hz(0.25, 0.5), rel=0.03)
    # The viscosity that calms the elements takes 1.5 % in this time.
    assert size_m[-300:].max() == pytest.approx(size_m[:300].max(), rel=0.03)


def test_energy_of_the_rod_never_grows_unforced(rod):
    """No current, no gravity, a kick: whatever is stored comes from it, and it all dies down."""
    dead = rod.changed(**{"servo.current_limit_a": 0.0, "world.gravity_m_s2": 0.0,
                          "stiffness.prebend_rad": 0.0})  # fmt: skip
    rig = CosseratRig(dead, 2, 1.0)
    rng = np.random.default_rng(1)
    rig.link.rod.velocity_collection[:, 2:] = 0.2 * rng.standard_normal((3, 9))
    rig.link.rod.omega_collection[:, 1:] = 0.2 * rng.standard_normal((3, 9))
    before = kinetic_j(rig)
    history = []
    for _ in range(2000):
        rig.step()
        history.append(kinetic_j(rig))
    history = np.array(history)
    assert history.max() <= 1.001 * before
    peaks = history.reshape(4, 500).max(axis=1)
    assert np.all(np.diff(peaks) < 0)
    assert peaks[-1] < 0.05 * before


def test_a_symmetric_rod_moves_symmetrically(rod):
    even = rod.changed(**{"stiffness.directional_share": 0.0, "stiffness.prebend_rad": 0.0})
    left, right = (CosseratRig(even, 1, 1.5) for _ in range(2))
    for k in range(60):
        goal = 0.4 * np.sin(0.05 * k)
        for rig, sign in ((left, -1), (right, 1)):
            rig.send(np.array([sign * goal]))
            for _ in range(17):
                rig.step()
    np.testing.assert_allclose(tip_m(left), tip_m(right) * [-1, 1, 1], atol=1e-9)
    assert abs(deflection_m(right)[0]) > 1e-3
    assert abs(tip_m(right)[1]) < 1e-9


def swing(rig):
    """First mode in Hz and mean deflection in m after a jump of the base."""
    advance(rig, 0.3)
    rig.send(np.array([np.radians(8.0)]))
    x = []
    for _ in range(2200):
        rig.step()
        x.append(deflection_m(rig)[0])
    x = np.array(x[500:])
    turns = np.flatnonzero(np.diff(np.sign(np.diff(x)))) * rig.step_s
    return 0.5 / np.mean(np.diff(turns)[:3]), x[turns.size and -800 :].mean()


@pytest.mark.parametrize("payload_kg", [0.0, 1.5])
def test_both_engines_agree_on_first_mode_and_sag(rod, parameters, payload_kg):
    """The same numbers; the laws differ, so the agreement is that of engineering."""
    mode, sag = swing(CosseratRig(rod, 1, payload_kg))
    other_mode, other_sag = swing(MujocoRig(parameters, 1, payload_kg))
    assert mode == pytest.approx(other_mode, rel=0.15)
    assert sag == pytest.approx(other_sag, rel=0.15)


def leaning(parameters):
    rig = CosseratRig(parameters, 2, 1.0)
    rig.start_leak()
    advance(rig, 0.5, [0.3, 0.2])
    return rig.markers_m.copy()


@pytest.fixture(scope="module")
def default_lean(rod):
    return leaning(rod)


def test_strength_zero_is_no_effect_on_the_rod(rod, default_lean):
    nothing = rod.hide(dict.fromkeys(rod.effects(), 0.0))
    np.testing.assert_array_equal(leaning(nothing), default_lean)


@pytest.mark.parametrize(
    "effect, strength",
    [("unmodelled_payload", 0.3), ("payload_offset", 0.05), ("prebend", 0.05),
     ("directional_stiffness", 0.3), ("stiffness_softening", 0.4), ("stiffness_hardening", 2.0),
     ("pressure_leak", 0.5), ("hysteresis", 0.4), ("creep", 0.4), ("aerodynamic_drag", 2.0),
     ("cross_axis_coupling", 0.2), ("load_offset", 4.0), ("backlash", 0.01)],
)  # fmt: skip
def test_what_is_hidden_shows_on_the_rod(rod, default_lean, effect, strength):
    moved = leaning(rod.hide({effect: strength})) - default_lean
    assert np.sqrt(np.mean(moved[12:] ** 2)) > 2e-4


def test_a_trial_of_the_rod_depends_on_its_seed_alone(short_case):
    rig = read_rig("cosserat").changed(**{"world.settle_s": 0.1, "world.pause_s": 0.1})
    case = short_case(period_s=0.3)
    trial = run_case(rig, case)
    assert trial.sha256() == run_case(rig, case).sha256()
    assert np.ptp(trial.tip_m[:, 0]) > 0.05


def test_a_choice_of_the_other_engine_is_refused(rod):
    wrong = dataclasses.replace(rod, structure=RigStructure(engine="cosserat", hysteresis="dahl"))
    with pytest.raises(InputError, match="hysteresis = 'dahl'"):
        CosseratRig(wrong, 1, 0.0)


def test_a_rod_that_folds_says_so(rod, short_case):
    case = short_case(payload_kg=10.0, amplitude_rad=1.0, period_s=2.0, dof=1)
    with pytest.raises(InputError, match="the link folds"):
        run_case(rod, case)
