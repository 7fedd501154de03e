"""Drive of a joint that moves as measured: the coordinate is an input, the torque an output."""

from __future__ import annotations

import casadi as ca

from models.plant.components.drive import Drive, friction_speed_parameter, start_rate_parameter
from models.plant.parameter import Parameter
from models.plant.scope import Expr, Scope


class Measured(Drive):
    """Joint that moves as its encoder measures, whatever drives it.

    Only the load has equations of motion, so a wrong servo loop cannot hide a wrong load. The
    torque that the motion needs, with friction, is an output. The drive also describes a test bench
    that imposes a displacement and measures force. The composition adds the coordinate as an input.
    """

    kind = "measured"
    features = ("imposed motion", "smooth friction")

    def parameters(self, scope: Scope) -> list[Parameter]:
        follow_rate = Parameter(
            "follow_rate_per_s", "1/s", 200.0, 20.0, 2000.0,
            "bandwidth that follows the measured coordinate",
            "numerical: a fifth of the internal rate"
        )  # fmt: skip
        return [follow_rate, *super().parameters(scope)]

    def joint_parameters(self, scope: Scope, joint: int) -> list[Parameter]:
        rotary = scope.suffix["angle"] == "rad"
        return [
            Parameter(f"rotor_inertia_{joint}_kg_m2" if rotary else f"rotor_mass_{joint}_kg",
                      "kg.m2" if rotary else "kg", 0.0, 0.0, 1e3,
                      "inertia between the force sensor and the load", "assumed none"),
            start_rate_parameter(scope, joint),
            friction_speed_parameter(scope, joint),
        ]  # fmt: skip

    def reflected_inertia(self, scope: Scope, joint: int) -> Expr:
        rotary = scope.suffix["angle"] == "rad"
        return scope.p("rotor_inertia_{j}_kg_m2" if rotary else "rotor_mass_{j}_kg", joint)

    def torque_constant(self, scope: Scope, joint: int) -> Expr:
        """Return one: the output is the torque itself."""
        return ca.SX(1)
