"""Drives whose torque is in proportion to an input: a commanded voltage, or a measured current."""

from __future__ import annotations

import casadi as ca

from models.plant.components.drive import (
    TORQUE_UNIT,
    Drive,
    friction_speed_parameter,
    start_offset_parameter,
    start_rate_parameter,
)
from models.plant.parameter import NO_DEFAULT, Parameter
from models.plant.scope import Expr, Scope
from models.plant.step_model import Variable


class _Proportional(Drive):
    """Drive with the torque k u of an input u; `torque_constant` is k."""

    def input_variable(self, joint: int) -> Variable:
        raise NotImplementedError

    def declare(self, scope: Scope) -> None:
        for j in scope.joints:
            scope.goal[j] = scope.input(self.input_variable(j))
            scope.start[j] = scope.p("start_offset_{j}_{angle}", j)

    def apply_control(self, scope: Scope) -> None:
        for j in scope.joints:
            scope.motor_torque[j] = self.torque_constant(scope, j) * scope.goal[j]


class Force(_Proportional):
    """Force (or torque) in proportion to a commanded voltage, F = k u; no current is measured.

    Source: EMPS (docs/sources.md, "Real recordings").
    """

    kind = "force"
    features = ("smooth friction",)

    def joint_parameters(self, scope: Scope, joint: int) -> list[Parameter]:
        torque = scope.suffix["torque"]
        return [
            Parameter(f"force_constant_{joint}_{torque}_v", f"{TORQUE_UNIT[torque]}/V",
                      NO_DEFAULT, 0.01, 1e3, "force per volt of command",
                      "data sheet of the drive"),
            start_offset_parameter(scope, joint),
            start_rate_parameter(scope, joint),
            friction_speed_parameter(scope, joint),
        ]  # fmt: skip

    def input_variable(self, joint: int) -> Variable:
        return Variable(f"command_{joint}_v", "V", 0.0, f"command of joint {joint}")

    def reflected_inertia(self, scope: Scope, joint: int) -> Expr:
        return ca.SX(0)  # the moving mass is the load's

    def torque_constant(self, scope: Scope, joint: int) -> Expr:
        return scope.p("force_constant_{j}_{torque}_v", joint) * scope.torque_scale[joint]


class Current(_Proportional):
    """Motor behind a gear whose measured current is the input: τ = k_t i.

    The loop that commands the current is not modelled. Nothing holds the joint, so its simulated
    coordinate drifts with every error of the torque.
    """

    kind = "current"
    has_presliding = True

    def joint_parameters(self, scope: Scope, joint: int) -> list[Parameter]:
        j = joint
        return [
            Parameter(f"torque_constant_{j}_nm_a", "N.m/A", NO_DEFAULT, 1e-3, 1e3,
                      "torque at the output per ampere", "data sheet of the drive"),
            Parameter(f"rotor_inertia_{j}_kg_m2", "kg.m2", 0.01, 0.0, 100.0,
                      "rotor inertia at the output", "assumed", role="nuisance"),
            Parameter(f"presliding_{j}_rad", "rad", 0.002, 1e-4, 0.1,
                      "distance in which dry friction reverses", "assumed"),
            start_offset_parameter(scope, j),
            start_rate_parameter(scope, j),
            friction_speed_parameter(scope, j),
        ]  # fmt: skip

    def input_variable(self, joint: int) -> Variable:
        description = f"measured motor current of joint {joint}"
        return Variable(f"current_{joint}_a", "A", 0.0, description)
