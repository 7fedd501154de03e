"""Drive with a torque in proportion to the measured motor current."""

from __future__ import annotations

from typing import ClassVar

import casadi as ca

from models.plant.components.drive import (
    Drive,
    friction_speed_parameter,
    start_offset_parameter,
    start_rate_parameter,
)
from models.plant.parameter import NO_DEFAULT, Parameter
from models.plant.scope import Expr, Scope
from models.plant.step_model import Variable


class Current(Drive):
    """Motor behind a gear whose measured current is the input: τ = k_t i.

    The loop that commands the current is not modelled. Nothing holds the joint, so its simulated
    coordinate drifts with every error of the torque.
    """

    kind: ClassVar[str] = "current"
    has_presliding: ClassVar[bool] = True

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

    def declare(self, scope: Scope) -> None:
        for j in scope.joints:
            measured = Variable(f"current_{j}_a", "A", 0.0, f"measured motor current of joint {j}")
            scope.goal[j] = scope.input(measured)
            scope.start[j] = scope.p("start_offset_{j}_{angle}", j)

    def apply_control(self, scope: Scope) -> None:
        for j in scope.joints:
            scope.motor_torque[j] = self.torque_constant(scope, j) * scope.goal[j]

    def sampled_current(self, scope: Scope, joint: int, step_s: Expr) -> Expr:
        return ca.SX(scope.goal[joint])
