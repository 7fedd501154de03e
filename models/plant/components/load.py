"""Loads: the mechanisms that the joints move. The inflatable link has a module of its own."""

from __future__ import annotations

from typing import ClassVar

import casadi as ca

from models.plant.parameter import NO_DEFAULT, Parameter
from models.plant.scope import LINEAR, ROTARY, Expr, Scope
from models.plant.step_model import Variable


class PlantLoad:
    """Load of one or two joints; the methods here are those of a rigid load on one joint.

    Attributes
    ----------
    kind : str
        Name in a plant document.
    max_dof : int
        Largest number of joints.
    features : tuple of str
        Features that effects may need (`models.plant.effects.Need`).
    suffix : dict
        Unit suffixes of names, `ROTARY` or `LINEAR`.
    """

    kind: ClassVar[str]
    max_dof: ClassVar[int] = 1
    features: ClassVar[tuple[str, ...]] = ()
    suffix: ClassVar[dict[str, str]] = ROTARY

    def parameters(self, scope: Scope) -> list[Parameter]:
        raise NotImplementedError

    def declare(self, scope: Scope) -> None:
        """Add the states of the load, and its bends if any."""

    def apply_elastic_torques(self, scope: Scope) -> None:
        """Set `bend_torque` to the elastic torque on each bend."""

    def apply_limit(self, scope: Scope) -> None:
        """Bound `bend_torque`, with what effects have added; add the viscous torque."""

    def apply_transmitted_torque(self, scope: Scope) -> None:
        """Set `transmitted_torque`: other torque on each joint, less that of the load.

        A torque on the joint that also bends the root is in both terms and cancels out.
        """
        for j in scope.joints:
            scope.transmitted_torque[j] = scope.joint_torque[j] - scope.bend_torque["root", j]

    def motion_equations(self, scope: Scope) -> tuple[Expr, Expr]:
        """Mass matrix (n, n) and force (n,) over the joints' coordinates and the bends."""
        raise NotImplementedError

    def outputs(self, scope: Scope) -> dict[str, tuple[Variable, Expr]]:
        """Measured quantities of the load by name, without those of the joints."""
        return {}


class Pendulum(PlantLoad):
    """Rigid pendulum that hangs down at zero: J q̈ = τ − (m + m_p) g l sin q − ½ m_a g l sin q.

    A point mass m with the payload m_p is at the end of a uniform arm m_a of length l, so
    J = (m + m_p + m_a/3) l².
    """

    kind = "pendulum"
    features = ("gear load",)

    def parameters(self, scope: Scope) -> list[Parameter]:
        return [
            Parameter("mass_kg", "kg", NO_DEFAULT, 0.001, 100.0, "mass at the end", "weighed"),
            Parameter("arm_mass_kg", "kg", 0.0, 0.0, 10.0, "mass of the arm", "not recorded",
                      role="nuisance"),
            Parameter("arm_length_m", "m", NO_DEFAULT, 0.001, 10.0, "length of the arm",
                      "measured"),
            Parameter("gravity_m_s2", "m/s2", 9.81, 0.0, 30.0, "gravity", "standard gravity"),
        ]  # fmt: skip

    def apply_transmitted_torque(self, scope: Scope) -> None:
        scope.transmitted_torque[1] = scope.joint_torque[1] - self._gravity(scope)

    def motion_equations(self, scope: Scope) -> tuple[Expr, Expr]:
        mass_kg = scope.p("mass_kg") + scope.payload_kg + scope.p("arm_mass_kg") / 3
        return ca.SX(mass_kg * scope.p("arm_length_m") ** 2), ca.SX(self._gravity(scope))

    def _gravity(self, scope: Scope) -> Expr:
        mass_kg = scope.p("mass_kg") + scope.payload_kg + scope.p("arm_mass_kg") / 2
        lever = scope.p("arm_length_m") * ca.sin(scope.angle[1] - scope.windup[1])
        return mass_kg * scope.p("gravity_m_s2") * lever


class Mass(PlantLoad):
    """Mass on a straight guide: m q̈ = F."""

    kind = "mass"
    features = ("straight guide",)
    suffix = LINEAR

    def parameters(self, scope: Scope) -> list[Parameter]:
        return [
            Parameter("mass_kg", "kg", NO_DEFAULT, 0.01, 1e4, "moving mass", "weighed",
                      role="nuisance"),
        ]  # fmt: skip

    def apply_transmitted_torque(self, scope: Scope) -> None:
        scope.transmitted_torque[1] = ca.SX(scope.joint_torque[1])

    def motion_equations(self, scope: Scope) -> tuple[Expr, Expr]:
        return ca.SX(scope.p("mass_kg") + scope.payload_kg), ca.SX(0)


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
