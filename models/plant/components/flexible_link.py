"""Flexible link on a joint, in a horizontal plane: one mode of inertia, spring and damper."""

from __future__ import annotations

import casadi as ca

from models.plant.components.load import PlantLoad
from models.plant.parameter import NO_DEFAULT, Parameter
from models.plant.scope import Expr, Scope
from models.plant.step_model import Variable


class FlexibleLink(PlantLoad):
    """Link whose tip is deflected by θ from the joint: J (q̈ + θ̈) + c θ̇ + k θ = 0.

    Source: the model of a link with a torsion spring at its root, from makers of such links
    [Quanser; docs/sources.md, "Real recordings"]. A trial may begin in motion: it starts with the
    measured deflection and its rate. The output is the deflection as a strain gauge at the root
    measures it.
    """

    kind = "flexible_link"
    features = ("bend", "gear load")

    def parameters(self, scope: Scope) -> list[Parameter]:
        return [
            Parameter("link_inertia_kg_m2", "kg.m2", NO_DEFAULT, 1e-6, 100.0,
                      "inertia of link and load about the joint", "data sheet of the link"),
            Parameter("root_stiffness_1_nm_rad", "N.m/rad", 10.0, 1e-3, 1e5,
                      "stiffness against deflection", "assumed", role="nuisance"),
            Parameter("root_damping_1_nm_s_rad", "N.m.s/rad", 0.1, 0.0, 1e3,
                      "damping of the deflection", "assumed", role="nuisance"),
            Parameter("start_deflection_1_rad", "rad", 0.0, -3.0, 3.0,
                      "deflection at the start; of a trial, as measured", "at rest"),
            Parameter("start_deflection_rate_1_rad_s", "rad/s", 0.0, -100.0, 100.0,
                      "its rate at the start; of a trial, as measured", "at rest"),
        ]  # fmt: skip

    def declare(self, scope: Scope) -> None:
        scope.bend["root", 1] = scope.state(Variable("deflection_1_rad", "rad", nominal=0.02))
        rate = scope.state(Variable("deflection_rate_1_rad_s", "rad/s", nominal=0.2))
        scope.bend_rate["root", 1] = rate
        scope.states["deflection_1_rad"].rate = rate
        scope.stiffness["root", 1] = scope.p("root_stiffness_1_nm_rad")

    def apply_elastic_torques(self, scope: Scope) -> None:
        scope.bend_torque["root", 1] = -scope.stiffness["root", 1] * scope.bend["root", 1]

    def apply_limit(self, scope: Scope) -> None:
        damping = scope.p("root_damping_1_nm_s_rad") * scope.bend_rate["root", 1]
        scope.bend_torque["root", 1] -= damping

    def motion_equations(self, scope: Scope) -> tuple[Expr, Expr]:
        inertia = scope.p("link_inertia_kg_m2")
        return inertia * ca.SX.ones(2, 2), ca.SX.zeros(2, 1)

    def outputs(self, scope: Scope) -> dict[str, tuple[Variable, Expr]]:
        variable = Variable("deflection_1_rad", "rad", 0.0, "measured deflection of the link")
        return {variable.name: (variable, scope.bend["root", 1])}
