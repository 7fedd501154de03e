"""The MuJoCo link against mechanics that do not need MuJoCo."""

import numpy as np
import pytest

from models.rig.hinged import MujocoRig
from models.shared.kinematics import rigid_tip_m

MEMORYLESS = {"memory.hysteresis_share": 0.0, "memory.relaxing_share": 0.0}
EVEN = {"stiffness.directional_share": 0.0, "stiffness.prebend_rad": 0.0}


def tip_m(rig):
    return rig.markers_m[12:].mean(axis=0)


def joint_rad(rig):
    return rig.data.qpos[rig.link.joints]


def deflection_m(rig):
    """Tip against a rigid link on the same joints."""
    rigid = rigid_tip_m(joint_rad(rig)[None], 0.06, 0.95)[0]
    return tip_m(rig) - rigid


def run(rig, seconds, goal=None):
    if goal is not None:
        rig.send(np.asarray(goal))
    for _ in range(round(seconds / rig.step_s)):
        rig.step()


def test_markers_at_rest_stand_where_the_contract_puts_them(parameters, rigid_markers):
    rig = MujocoRig(parameters, 2, 0.0)
    np.testing.assert_allclose(rig.markers_m, rigid_markers(np.zeros((1, 2)))[0], atol=1e-12)


@pytest.mark.parametrize("joint, axis", [(0, 0), (1, 1)])
def test_positive_angle_leans_towards_plus_x_and_plus_y(parameters, joint, axis):
    rig = MujocoRig(parameters, 2, 0.5)
    goal = np.zeros(2)
    goal[joint] = 0.2
    run(rig, 2.0, goal)
    assert tip_m(rig)[axis] > 0.15
    assert abs(tip_m(rig)[1 - axis]) < 0.02
    # Gravity pulls the leaning link further; the servo holds back, so its current is negative.
    assert deflection_m(rig)[axis] > 0
    assert rig.servos[joint].current_a < 0


def test_a_symmetric_link_moves_symmetrically(parameters):
    left, right = (MujocoRig(parameters.changed(**EVEN), 1, 1.5) for _ in range(2))
    for k in range(120):
        goal = 0.4 * np.sin(0.05 * k)
        left.send(np.array([-goal]))
        right.send(np.array([goal]))
        for _ in range(17):
            left.step()
            right.step()
    mirrored = tip_m(right) * [-1, 1, 1]
    np.testing.assert_allclose(tip_m(left), mirrored, atol=1e-9)
    assert abs(deflection_m(right)[0]) > 1e-3  # it did bend
    assert abs(tip_m(right)[1]) < 1e-9  # and stayed in its plane


@pytest.mark.parametrize("root_nm_rad", [350.0, 1e6])
def test_sag_of_a_cantilever_follows_beam_theory(parameters, root_nm_rad):
    """Gravity along x, weak enough to stay linear: Timoshenko's beam on a root spring."""
    gravity, payload = 0.2, 0.5
    rig = MujocoRig(
        parameters.changed(
            **MEMORYLESS, **EVEN,
            **{"world.gravity_m_s2": gravity, "stiffness.root_nm_rad": root_nm_rad,
               "stiffness.root_limit_nm": 1e6, "stiffness.span_limit_nm": 1e6,
               "stiffness.damping_s": 0.08},
        ), 1, payload, gravity=(1.0, 0.0, 0.0),
    )  # fmt: skip
    run(rig, 4.0)
    length, bending, shear = 0.95, 135.0, 1070.0 + 41300.0 * 0.15**2
    tip_n, line_n_m = (0.25 + payload) * gravity, 0.9 / length * gravity
    sag = (
        tip_n * length**3 / (3 * bending)
        + line_n_m * length**4 / (8 * bending)
        + (tip_n * length + line_n_m * length**2 / 2) / shear
        + (tip_n * length + line_n_m * length**2 / 2) / root_nm_rad * length
    )
    assert deflection_m(rig)[0] == pytest.approx(sag, rel=0.01)


def first_mode_hz(parameters, payload_kg):
    """From the turning points of the tip after a small jump of the base."""
    rig = MujocoRig(parameters, 1, payload_kg)
    run(rig, 1.0)
    rig.send(np.array([np.radians(4.0)]))
    x = []
    for _ in range(2000):
        rig.step()
        x.append(deflection_m(rig)[0])
    x = np.array(x[200:])
    turns = np.flatnonzero(np.diff(np.sign(np.diff(x)))) * rig.step_s
    return 0.5 / np.mean(np.diff(turns)[:3])


def test_first_mode_lies_between_1_and_5_hz_and_falls_with_payload(parameters):
    modes = [first_mode_hz(parameters, payload) for payload in (0.0, 0.5, 1.0, 2.0)]
    assert min(modes) > 1.0 and max(modes) < 5.0
    assert np.all(np.diff(modes) < 0)


def test_gravity_is_a_direction(parameters):
    even = parameters.changed(**EVEN, **{"stiffness.damping_s": 0.05})  # so that it is at rest soon
    hanging = MujocoRig(even, 1, 1.0, gravity=(0.0, 0.0, 1.0))
    upright = MujocoRig(even, 1, 1.0)
    for rig in (hanging, upright):
        run(rig, 2.0, [0.3])
    # Upright the load bends the link outwards, hanging it straightens it.
    assert deflection_m(upright)[0] > 0.005
    assert deflection_m(hanging)[0] < -0.005
    assert upright.servos[0].current_a < 0 < hanging.servos[0].current_a


def test_drag_slows_by_its_torque(parameters):
    """One radian per second about joint 1: the torque about the axis is the one asked for."""
    rig = MujocoRig(parameters.hide({"aerodynamic_drag": 5.0 - 0.02}), 1, 0.0)
    # Move the pieces as a rigid rotation would, then let the drag look at them.
    centres = rig.data.xipos[rig.link.bodies].copy()
    rig.data.xipos[rig.link.bodies, 0] += centres[:, 2] * rig.step_s
    rig._set_drag()
    torque = np.sum(rig.data.xfrc_applied[rig.link.bodies, 0] * centres[:, 2])
    assert torque == pytest.approx(-5.0, rel=1e-9)
