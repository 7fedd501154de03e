"""Rigid loads: a pendulum and a mass on a straight guide."""

from __future__ import annotations

from typing import ClassVar

import casadi as ca

from models.plant.parameter import NO_DEFAULT, Parameter
from models.plant.scope import LINEAR, ROTARY, Expr, Scope
from models.plant.step_model import Variable


class RigidLoad:
    """Load without bends: the joints are its only coordinates."""

    max_dof: ClassVar[int] = 1

    def declare(self, scope: Scope) -> None:
        """Add no state."""

    def apply_elastic_torques(self, scope: Scope) -> None:
        """Set nothing: there are no bends."""

    def outputs(self, scope: Scope) -> dict[str, tuple[Variable, Expr]]:
        """Return no output: the joint's are the only ones."""
        return {}


class Pendulum(RigidLoad):
    """Rigid pendulum that hangs down at zero: J q̈ = τ − (m + m_p) g l sin q − ½ m_a g l sin q.

    A point mass m with the payload m_p is at the end of a uniform arm m_a of length l, so
    J = (m + m_p + m_a/3) l².
    """

    kind: ClassVar[str] = "pendulum"
    features: ClassVar[tuple[str, ...]] = ("gear load",)
    suffix: ClassVar[dict[str, str]] = ROTARY

    def parameters(self, scope: Scope) -> tuple[Parameter, ...]:
        """Return masses, length and gravity."""
        return (
            Parameter(name="mass_kg", unit="kg", value=NO_DEFAULT, low=0.001, high=100.0,
                      description="mass at the end", source="weighed"),
            Parameter(name="arm_mass_kg", unit="kg", value=0.0, low=0.0, high=10.0,
                      role="nuisance", description="mass of the arm", source="not recorded"),
            Parameter(name="arm_length_m", unit="m", value=NO_DEFAULT, low=0.001, high=10.0,
                      description="length of the arm", source="measured"),
            Parameter(name="gravity_m_s2", unit="m/s2", value=9.81, low=0.0, high=30.0,
                      description="gravity", source="standard gravity"),
        )  # fmt: skip

    def apply_transmitted_torque(self, scope: Scope) -> None:
        """Set the torque on the gear: other torque on the joint minus gravity."""
        scope.transmitted_torque[1] = scope.joint_torque[1] - self._gravity(scope)

    def motion_equations(self, scope: Scope) -> tuple[Expr, Expr]:
        """Return inertia and gravity torque."""
        mass_kg = scope.p("mass_kg") + scope.payload_kg + scope.p("arm_mass_kg") / 3
        return ca.SX(mass_kg * scope.p("arm_length_m") ** 2), ca.SX(self._gravity(scope))

    def _gravity(self, scope: Scope) -> Expr:
        mass_kg = scope.p("mass_kg") + scope.payload_kg + scope.p("arm_mass_kg") / 2
        lever = scope.p("arm_length_m") * ca.sin(scope.angle[1] - scope.windup[1])
        return mass_kg * scope.p("gravity_m_s2") * lever


class Mass(RigidLoad):
    """Mass on a straight guide: m q̈ = F."""

    kind: ClassVar[str] = "mass"
    features: ClassVar[tuple[str, ...]] = ("straight guide",)
    suffix: ClassVar[dict[str, str]] = LINEAR

    def parameters(self, scope: Scope) -> tuple[Parameter, ...]:
        """Return the moving mass."""
        return (
            Parameter(name="mass_kg", unit="kg", value=NO_DEFAULT, low=0.01, high=1e4,
                      role="nuisance", description="moving mass", source="weighed"),
        )  # fmt: skip

    def apply_transmitted_torque(self, scope: Scope) -> None:
        """Set the force on the gear: other force on the joint."""
        scope.transmitted_torque[1] = ca.SX(scope.joint_torque[1])

    def motion_equations(self, scope: Scope) -> tuple[Expr, Expr]:
        """Return the mass, and a force of zero."""
        return ca.SX(scope.p("mass_kg") + scope.payload_kg), ca.SX(0)
