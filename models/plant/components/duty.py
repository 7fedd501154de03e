"""Drive with a proportional duty cycle: the position control of small Dynamixels."""

from __future__ import annotations

import casadi as ca

from models.plant.components.drive import (
    Drive,
    current_limit,
    declare_goal,
    start_offset_parameter,
)
from models.plant.parameter import NO_DEFAULT, Parameter
from models.plant.scope import Scope
from models.plant.step_model import Variable


class Duty(Drive):
    """DC motor whose duty cycle is proportional to the position error, as in small Dynamixels.

        d = clip(k_d (goal − q), ±1),   i = clip((d V − k_t q̇) / R, ±i_max),   τ = k_t i

    The supply voltage V is an input, because a voltage drop resembles friction (README of the
    data). With torque disabled (`enabled` is 0) the winding is open: no current, hence no braking.
    Source: BAM (docs/sources.md, "Real recordings").
    """

    kind = "duty"
    features = ("current", "current limit", "position gain")
    has_presliding = True

    def joint_parameters(self, scope: Scope, joint: int) -> list[Parameter]:
        j = joint
        return [
            Parameter(f"duty_gain_{j}", "1/rad", NO_DEFAULT, 0.01, 50.0, "duty per radian of error",
                      "register of the servo"),
            start_offset_parameter(scope, j),
            Parameter(f"winding_resistance_{j}_ohm", "Ohm", 3.5, 0.1, 50.0,
                      "resistance of the winding", "assumed: 1.5 A stall at 5 V", role="nuisance"),
            Parameter(f"torque_constant_{j}_nm_a", "N.m/A", 0.36, 0.01, 10.0,
                      "torque and back EMF constant", "assumed: 0.52 N·m stall at 1.5 A",
                      role="nuisance"),
            Parameter(f"rotor_inertia_{j}_kg_m2", "kg.m2", 0.002, 1e-4, 0.1,
                      "rotor inertia at the output", "assumed", role="nuisance"),
            Parameter(f"current_limit_{j}_a", "A", 3.0, 0.1, 50.0, "rated current limit",
                      "assumed: twice the stall current at 5 V"),
            Parameter(f"presliding_{j}_rad", "rad", 0.002, 1e-4, 0.1,
                      "distance in which dry friction reverses",
                      "assumed: two steps of the encoder"),
        ]  # fmt: skip

    def declare(self, scope: Scope) -> None:
        for j in scope.joints:
            declare_goal(scope, j)
            scope.start[j] += scope.p("start_offset_{j}_{angle}", j)
            scope.input(Variable(f"supply_{j}_v", "V", 5.0, "measured supply", 0.0, nominal=5.0))
            scope.input(Variable(f"enabled_{j}", "1", 1.0, "1 where torque is enabled", 0.0, 1.0))

    def apply_control(self, scope: Scope) -> None:
        for j in scope.joints:
            gain = scope.position_gain_scale[j] * scope.p("duty_gain_{j}", j)
            duty = gain * (scope.goal[j] - scope.measured_angle(j))
            duty = ca.fmin(ca.fmax(duty, -1), 1)
            constant = self.torque_constant(scope, j)
            voltage = duty * scope.inputs[f"supply_{j}_v"][1] - constant * scope.rate[j]
            wanted = voltage / scope.p("winding_resistance_{j}_ohm", j)
            limit = ca.fmax(current_limit(scope, j), 0)
            closed = scope.inputs[f"enabled_{j}"][1]
            scope.current[j] = closed * ca.fmin(ca.fmax(wanted, -limit), limit)
            scope.motor_torque[j] = constant * scope.current[j]
