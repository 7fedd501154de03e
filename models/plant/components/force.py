"""Drive with a force in proportion to a commanded voltage."""

from __future__ import annotations

from typing import ClassVar

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


class Force(Drive):
    """Force (or torque) in proportion to a commanded voltage, F = k u; no current is measured.

    Source: EMPS (docs/sources.md, "Real recordings").
    """

    kind: ClassVar[str] = "force"
    features: ClassVar[tuple[str, ...]] = ("smooth friction",)

    def joint_parameters(self, scope: Scope, joint: int) -> list[Parameter]:
        torque = scope.suffix["torque"]
        return [
            Parameter(f"force_constant_{joint}_{torque}_v", f"{TORQUE_UNIT[torque]}/V", NO_DEFAULT,
                      0.01, 1e3, "force per volt of command", "data sheet of the drive"),
            start_offset_parameter(scope, joint),
            start_rate_parameter(scope, joint),
            friction_speed_parameter(scope, joint),
        ]  # fmt: skip

    def declare(self, scope: Scope) -> None:
        for j in scope.joints:
            command = Variable(f"command_{j}_v", "V", 0.0, f"command of joint {j}")
            scope.goal[j] = scope.input(command)
            scope.start[j] = scope.p("start_offset_{j}_{angle}", j)

    def apply_control(self, scope: Scope) -> None:
        for j in scope.joints:
            scope.motor_torque[j] = self.torque_constant(scope, j) * scope.goal[j]

    def reflected_inertia(self, scope: Scope, joint: int) -> Expr:
        """Return zero: the moving mass is the load's."""
        return ca.SX(0)

    def torque_constant(self, scope: Scope, joint: int) -> Expr:
        """Return the force per volt: the command replaces the current."""
        return scope.p("force_constant_{j}_{torque}_v", joint) * scope.torque_scale[joint]
