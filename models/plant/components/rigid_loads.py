"""Rigid loads: a pendulum and a mass on a straight guide. The joint is their only coordinate."""

from __future__ import annotations

import casadi as ca

from models.plant.components.load import PlantLoad
from models.plant.parameter import NO_DEFAULT, Parameter
from models.plant.scope import LINEAR, Expr, Scope


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
