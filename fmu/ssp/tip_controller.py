"""Controller of the example system: it moves the tip along a sinusoid, with the estimated tip.

The direction φ of the tip from the base includes the angle of the joint and the bend of the link.
The goal is the reference plus the integral of the error, which removes the mean of the bend::

    φ_1 = atan2(x, z),   φ_2 = asin(y / |r|),   İ_j = k (r_j(t) − φ_j),   goal_j = r_j + I_j
"""

from __future__ import annotations

from typing import Final

import casadi as ca

from firmware_py.core.motion import STUDY_PERIOD_S
from firmware_py.core.signals import tip_names
from models.plant.step_model import StepModel, Variable

__all__ = ["tip_controller"]

AMPLITUDE_RAD: Final = 0.4
"""Amplitude of the reference: within the study's 30 degrees with the bend of 2 kg [assumed]."""
GAIN_1_S: Final = 0.5
"""Gain of the integral: a time constant of 2 s, slower than the link's vibration of 1 Hz
[assumed]."""
BOUND_RAD: Final = 0.3
"""Bound of the integral: the bend of the link with 2 kg is below 0.2 rad [assumed]."""


def tip_controller(dof: int) -> StepModel:
    """Compose the controller, with inputs tip_x_m, tip_y_m and tip_z_m and outputs goal_j_rad."""
    joints = range(1, dof + 1)
    x, u, p = ca.SX.sym("x", 1 + dof), ca.SX.sym("u", 3), ca.SX.sym("p", 3)
    h = ca.SX.sym("h")
    amplitude, period_s, gain = ca.vertsplit(p)
    size = ca.sqrt(ca.sumsqr(u) + 1e-12)
    seen = ca.vertcat(ca.atan2(u[0], u[2] + 1e-12), ca.asin(u[1] / size))[:dof]
    reference = -amplitude * ca.sin(2 * ca.pi * x[0] / period_s) * ca.SX.ones(dof)
    integral = x[1:] + h * gain * (reference - seen)
    bounded = ca.fmin(ca.fmax(integral, -BOUND_RAD), BOUND_RAD)
    stay = ca.Function("stay", [x, u, p, h], [x])
    outputs = [
        Variable(f"goal_{j}_rad", "rad", 0.0, f"goal of joint {j}", nominal=0.5) for j in joints
    ]
    return StepModel(
        name=f"controller_{dof}dof",
        inputs=tuple(Variable(name, "m", 0.0, "estimated end effector") for name in tip_names()),
        parameters=(
            Variable("amplitude_rad", "rad", AMPLITUDE_RAD, "of the reference", 0.0, 0.6, 0.5),
            Variable("period_s", "s", STUDY_PERIOD_S, "of the reference", 1.0, 600.0, 4.0),
            Variable("gain_1_s", "1/s", GAIN_1_S, "of the integral", 0.0, 5.0),
        ),
        states=(
            Variable("phase_s", "s"),
            *(Variable(f"integral_{j}_rad", "rad", nominal=0.1) for j in joints),
        ),
        outputs=tuple(outputs),
        initial=ca.Function("initial", [u, p], [ca.SX.zeros(1 + dof)]),
        begin=ca.Function("begin", [x, u, p, h], [ca.vertcat(x[0], bounded)]),
        flow=stay,
        finish=ca.Function("finish", [x, u, p, h], [ca.vertcat(x[0] + h, x[1:])]),
        output=ca.Function("output", [x, u, p], [reference + x[1:]]),
        max_substep_s=1.0,
    )
