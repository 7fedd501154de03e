"""The servo alone, and its loop around the heaviest link (python-control)."""

from dataclasses import replace

import control
import msgspec
import mujoco
import numpy as np
import pytest

from models.rig.hinged import BendLaw, MujocoRig
from models.rig.servo import RigServo

STEP_S = 1e-3


def settle(servo, joint_rad=0.0, seconds=2.0, goal=None):
    """Run against a joint that is held."""
    if goal is not None:
        servo.send(goal, 0.0)
    torque = 0.0
    for k in range(round(seconds / STEP_S)):
        torque = servo.step(k * STEP_S, joint_rad, 0.0)
    return torque


def linear_loop(parameters, payload_kg):
    """Loop of the position servo around the linearised robot, upright, broken at the current."""
    rig = MujocoRig(parameters, 1, payload_kg)
    model, data, link = rig.link.model, rig.data, rig.link
    count, joint = model.nv, int(link.joints[0])
    mass = np.zeros((count, count))
    mujoco.mj_fullM(model, data, mass)

    def force(q):
        data.qpos[:], data.qvel[:] = q, 0.0
        mujoco.mj_forward(model, data)
        total = data.qfrc_passive - data.qfrc_bias
        total[link.hinges] += BendLaw(parameters, STEP_S).torque_nm(q[link.hinges])
        return total.copy()

    nudge = 1e-5 * np.eye(count)
    stiffness = -np.array([(force(d) - force(-d)) / 2e-5 for d in nudge]).T
    damping = np.diag(model.dof_damping.copy())
    # The rotor is one more coordinate, tied to the joint by the gear; the teeth touch.
    tie = np.zeros((count + 1, 1))
    tie[joint], tie[count] = 1.0, -1.0

    def widen(matrix, corner):
        wide = np.zeros((count + 1, count + 1))
        wide[:count, :count], wide[count, count] = matrix, corner
        return wide

    gear = 1.0 / parameters["servo.gear_compliance_rad_nm"]
    mass = widen(mass, parameters["servo.inertia_kg_m2"])
    stiffness = widen(stiffness, 0.0) + gear * tie @ tie.T
    damping = widen(damping, 0.0) + parameters["servo.gear_damping_nm_s_rad"] * tie @ tie.T
    inverse, size = np.linalg.inv(mass), count + 1
    a = np.block(
        [[np.zeros((size, size)), np.eye(size)], [-inverse @ stiffness, -inverse @ damping]]
    )
    b = np.concatenate([np.zeros(size), inverse[:, count]])[:, None]
    rotor_rate = np.zeros((1, 2 * size))
    rotor_rate[0, -1] = 1.0
    rotor_angle = np.zeros((1, 2 * size))
    rotor_angle[0, count] = 1.0
    out = parameters["servo.position_gain_per_s"] * rotor_angle + rotor_rate
    plant = control.ss(a, b, out, 0.0)
    gain = parameters["servo.velocity_bandwidth_rad_s"] * parameters["servo.inertia_kg_m2"]
    integral = parameters["servo.velocity_integral_rad_s"]
    return plant * control.tf2ss(control.tf([gain, gain * integral], [1.0, 0.0]))


@pytest.mark.parametrize("payload_kg", [0.0, 2.0])
def test_the_servo_loop_is_stable_with_margin(parameters, payload_kg):
    loop = linear_loop(parameters, payload_kg)
    closed = control.feedback(loop, 1)
    assert np.max(closed.poles().real) < 0
    grid_rad_s = np.geomspace(0.05, 3000.0, 4000)
    modes = loop.poles()[loop.poles().imag > 0]
    narrowest = np.min(np.abs(modes.real) / np.abs(modes))  # damping ratio: half a peak's width
    assert np.log(grid_rad_s[1] / grid_rad_s[0]) < narrowest / 2, "a peak falls between two points"
    response = control.frd(loop, grid_rad_s)
    gains, phases, moduli, *_ = control.stability_margins(response, returnall=True)
    # Softening the loop is what the mode of a heavy link objects to: both directions count.
    assert not np.any((gains > 0.5) & (gains < 2.0))
    assert np.min(np.abs(phases)) > 30.0
    assert np.min(moduli) > 0.5


def test_play_is_felt_by_the_joint_and_unseen_by_the_encoder(parameters):
    play = 0.01
    servo = RigServo(parameters.changed(**{"servo.backlash_rad": play}), STEP_S)
    assert settle(servo, joint_rad=0.4 * play) == 0.0
    assert servo.encoder_rad == pytest.approx(0.0, abs=1e-6)
    assert settle(servo, joint_rad=0.7 * play) < 0.0  # the teeth push the joint back


def test_current_stays_within_its_limit_and_does_not_wind_up(parameters):
    servo = RigServo(parameters.hide({"current_saturation": 7.0}), STEP_S)
    servo.send(0.5, 0.0)
    peak = 0.0
    for k in range(1500):  # the joint is blocked
        servo.step(k * STEP_S, 0.0, 0.0)
        peak = max(peak, abs(servo.current_a))
    assert peak == pytest.approx(3.0)
    servo.send(0.0, 1.5)
    for k in range(1500, 1800):
        servo.step(k * STEP_S, 0.0, 0.0)
    assert abs(servo.current_a) < 2.9


@pytest.mark.parametrize("rate, share", [(0.1, 0.0), (0.5, 0.0), (0.1, 0.3), (-0.5, 0.3)])
def test_friction_at_constant_speed_is_coulomb_plus_viscous_plus_load(parameters, rate, share):
    """Turn goal and joint together: the current at speed pays friction and load, nothing else."""
    values = {"servo.load_friction_share": share, "servo.dead_time_s": 0.0}
    p = parameters.changed(**values)
    servo = RigServo(p, STEP_S)
    load = 6.0
    stretch = load * p["servo.gear_compliance_rad_nm"] + 0.5 * p["servo.backlash_rad"]
    for k in range(6000):
        servo.send(rate * k * STEP_S, k * STEP_S)
        # The joint follows where the gear would pass on exactly the load.
        servo.step(k * STEP_S, servo.rotor_rad - stretch, servo.rotor_rad_s)
    friction = (4.5 + share * load) * np.sign(rate) + 2.0 * rate
    assert servo.gear_nm == pytest.approx(load, rel=1e-3)
    assert servo.current_a * 6.83 == pytest.approx(load + friction, rel=0.02)


@pytest.mark.parametrize("dead_s", [0.0496, 0.05, 0.0504])
def test_dead_time_delays_the_goal_to_the_nearest_step(parameters, dead_s):
    servo = RigServo(parameters.changed(**{"servo.dead_time_s": dead_s}), STEP_S)
    servo.send(0.1, 0.0)
    for k in range(50):
        servo.step(k * STEP_S, 0.0, 0.0)
        assert servo.current_a == 0.0
    servo.step(0.05, 0.0, 0.0)
    assert servo.current_a > 0.0


def test_the_encoder_offset_is_inside_the_loop(parameters):
    servo = RigServo(parameters.hide({"encoder_offset": 0.02}), STEP_S)
    for k in range(6000):
        if k == 0:
            servo.send(0.1, 0.0)
        servo.step(k * STEP_S, servo.rotor_rad, servo.rotor_rad_s)
    assert servo.encoder_rad == pytest.approx(0.1, abs=1e-3)
    assert servo.rotor_rad == pytest.approx(0.08, abs=1e-3)


def test_a_rate_from_the_encoder_follows_its_error(parameters):
    """Reading an even ramp, a servo whose rate has the error turns its rotor less evenly."""
    uneven = {}
    for sensor in ("motor", "encoder"):
        p = replace(parameters, structure=msgspec.structs.replace(
            parameters.structure, rate_sensor=sensor))  # fmt: skip
        servo = RigServo(p.hide({"encoder_ripple": 0.004}), STEP_S)
        rates = []
        for k in range(2500):
            servo.send(0.5 * k * STEP_S, k * STEP_S)
            servo.step(k * STEP_S, servo.rotor_rad, servo.rotor_rad_s)
            rates.append(servo.rotor_rad_s)
        uneven[sensor] = np.std(rates[1000:])
    assert uneven["encoder"] > 1.1 * uneven["motor"]
