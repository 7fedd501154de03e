"""Small model with every feature that an FMU must support, independent of the link.

A damped pendulum driven by a torque that saturates; a counter of steps and the previous torque are
discrete.
"""

import zipfile

import casadi as ca
import numpy as np

from firmware_py.core.signals import PERIOD_S
from models.plant.step_model import StepModel, Variable

LIMIT_NM = 4.0


def pendulum(name: str = "pendulum") -> StepModel:
    x, u, p = ca.SX.sym("x", 4), ca.SX.sym("u", 2), ca.SX.sym("p", 3)
    h = ca.SX.sym("h")
    angle, rate, count, previous = ca.vertsplit(x)
    torque, mass = u[0], u[1]
    length, damping, rest = ca.vertsplit(p)

    def rates(angle, rate):
        inertia = (0.5 + mass) * length**2
        driven = ca.fmin(ca.fmax(torque, -LIMIT_NM), LIMIT_NM)
        load = driven - damping * rate - 9.81 * (0.5 + mass) * length * ca.sin(angle)
        return rate, load / inertia

    a1, r1 = rates(angle, rate)
    a2, r2 = rates(angle + 0.5 * h * a1, rate + 0.5 * h * r1)
    flow = ca.vertcat(angle + h * a2, rate + h * r2, count, previous)
    rate_now = ca.vertcat(*rates(angle, rate), 0, 0)
    begin = ca.vertcat(angle, rate, count, 0.5 * (previous + torque))
    finish = ca.vertcat(angle, rate, count + 1, previous)
    output = ca.vertcat(
        length * ca.sin(angle), -length * ca.cos(angle), previous, ca.fabs(angle) < 0.5, count, mass
    )
    return StepModel(
        name=name,
        inputs=(
            Variable("torque_nm", "N.m", 0.0, "torque on the joint", -5.0, 5.0),
            Variable("payload_kg", "kg", 0.25, "mass at the tip", 0.0, 2.0),
        ),
        parameters=(
            Variable("length_m", "m", 0.8, "length of the rod", 0.1, 2.0),
            Variable("damping_nms_rad", "N.m.s/rad", 0.3, "friction per rate", 0.0, 10.0, 0.1),
            Variable("rest_rad", "rad", 0.2, "angle at the start", -3.2, 3.2),
        ),
        states=(
            Variable("angle_rad", "rad"),
            Variable("rate_rad_s", "rad/s"),
            Variable("count", "1"),
            Variable("previous_nm", "N.m"),
        ),
        outputs=(
            Variable("tip_x_m", "m", 0.0, "tip"),
            Variable("tip_z_m", "m", 0.0, "tip"),
            Variable("torque_filtered_nm", "N.m", 0.0, "mean of two steps"),
            Variable("in_range", "1", 0.0, "1 where the angle is small", 0.0, 1.0),
            Variable("steps", "1", 0.0, "number of steps so far"),
            Variable("mass_kg", "kg", 0.0, "the input handed through"),
        ),
        initial=ca.Function("initial", [u, p], [ca.vertcat(rest + 0.01 * mass, 0, 0, torque)]),
        begin=ca.Function("begin", [x, u, p, h], [begin]),
        flow=ca.Function("flow", [x, u, p, h], [flow]),
        finish=ca.Function("finish", [x, u, p, h], [finish]),
        output=ca.Function("output", [x, u, p], [output]),
        max_substep_s=2e-3,
        rate=ca.Function("rate", [x, u, p], [rate_now]),
    )


def moving_inputs(count):
    """Torques and payloads that move the pendulum, shape (count, 2)."""
    time_s = PERIOD_S * np.arange(count)
    return np.column_stack([2.0 * np.sin(3.0 * time_s), 0.5 + 0.5 * np.cos(time_s)])


def rewritten(source, target, change):
    """Copy of an FMU with `change` applied to its files (name to bytes)."""
    with zipfile.ZipFile(source) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    change(files)
    with zipfile.ZipFile(target, "w") as archive:
        for name, data in files.items():
            archive.writestr(name, data)
    return target
