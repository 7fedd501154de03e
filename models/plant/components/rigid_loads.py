"""Rigid loads: a pendulum and a mass on a straight guide.

Loads behind a gear of finite stiffness: a shaft and a slide, each with its own friction.
"""

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


UNITS = {"rad": ("rad", "N.m", "kg.m2"), "m": ("m", "N", "kg")}
"""Units of coordinate, torque and inertia by the suffix of the coordinate."""


class GearedShaft(RigidLoad):
    """Shaft x behind a gear: J ẍ + c ẋ + k x + F tanh(ẋ/v) = τ, τ = −k_g φ − d_g φ̇, φ = x − q.

    Friction F is on the load's side of the gear; friction of the effects is on the drive's. The
    play of `backlash` lies between them, in φ: the gear's spring touches only beyond it.
    """

    kind: ClassVar[str] = "geared_shaft"
    features: ClassVar[tuple[str, ...]] = ("gear load",)
    suffix: ClassVar[dict[str, str]] = ROTARY

    def parameters(self, scope: Scope) -> tuple[Parameter, ...]:
        """Inertia, spring, damping and friction of the load, stiffness and damping of the gear."""
        x = scope.suffix["angle"]
        coordinate, torque, inertia = UNITS[x]
        per, rate = scope.name("{torque}_{angle}"), scope.name("{torque}_s_{angle}")
        weight = "inertia_1_kg_m2" if x == "rad" else "mass_1_kg"
        return (
            Parameter(name=f"load_{weight}", unit=inertia, value=NO_DEFAULT, low=1e-9,
                      high=1e4, description="inertia behind the gear", source="weighed"),
            Parameter(name=f"gear_stiffness_1_{per}", unit=f"{torque}/{coordinate}", value=1000.0,
                      low=1e-3, high=1e9, description="stiffness of the gear where it touches",
                      source="assumed"),
            Parameter(name=f"gear_contact_damping_1_{rate}", unit=f"{torque}.s/{coordinate}",
                      value=1.0, low=0.0, high=1e6, description="damping of the gear's contact",
                      source="assumed"),
            Parameter(name=f"load_stiffness_1_{per}", unit=f"{torque}/{coordinate}", value=0.0,
                      low=0.0, high=1e9, description="spring from the load to the ground",
                      source="assumed none"),
            Parameter(name=f"load_damping_1_{rate}", unit=f"{torque}.s/{coordinate}", value=0.0,
                      low=0.0, high=1e6, role="nuisance",
                      description="viscous friction on the load's side of the gear",
                      source="assumed none"),
            Parameter(name=f"load_friction_1_{scope.suffix['torque']}", unit=torque, value=0.0,
                      low=0.0, high=1e6, role="nuisance",
                      description="dry friction on the load's side of the gear",
                      source="assumed none"),
        )  # fmt: skip

    def declare(self, scope: Scope) -> None:
        """Add the twist of the gear and its rate as states."""
        x = scope.suffix["angle"]
        unit = UNITS[x][0]
        twist = scope.state(Variable(f"gear_twist_1_{x}", unit, nominal=1e-3))
        rate = scope.state(Variable(f"gear_twist_rate_1_{x}_s", f"{unit}/s", nominal=0.1))
        scope.bend["gear", 1], scope.bend_rate["gear", 1] = twist, rate
        scope.states[twist.name()].rate = rate
        scope.stiffness["gear", 1] = scope.p("gear_stiffness_{j}_{torque}_{angle}", 1)

    def apply_elastic_torques(self, scope: Scope) -> None:
        """Set the torque of the gear on the load."""
        damping = scope.p("gear_contact_damping_{j}_{torque}_s_{angle}", 1)
        scope.bend_torque["gear", 1] = (
            -scope.stiffness["gear", 1] * scope.bend["gear", 1]
            - damping * scope.bend_rate["gear", 1]
        )

    def apply_transmitted_torque(self, scope: Scope) -> None:
        """Set the torque on the gear: other torque on the joint minus that of the load."""
        scope.transmitted_torque[1] = scope.joint_torque[1] - self._resistance(scope)

    def motion_equations(self, scope: Scope) -> tuple[Expr, Expr]:
        """Return the inertia in both coordinates, and the load's spring and friction."""
        weight = "load_inertia_1_kg_m2" if scope.suffix["angle"] == "rad" else "load_mass_1_kg"
        inertia = scope.p(weight) + (0 if scope.suffix["angle"] == "rad" else scope.payload_kg)
        return inertia * ca.SX.ones(2, 2), self._resistance(scope) * ca.SX.ones(2, 1)

    def _resistance(self, scope: Scope) -> Expr:
        """Torque of spring and friction that opposes the load's motion."""
        place = scope.angle[1] - scope.windup[1] + scope.bend["gear", 1]
        rate = scope.rate[1] - scope.windup_rate[1] + scope.bend_rate["gear", 1]
        dry = scope.p("load_friction_{j}_{torque}", 1)
        smooth = ca.tanh(rate / scope.p("friction_speed_{j}_{angle}_s", 1))
        viscous = scope.p("load_damping_{j}_{torque}_s_{angle}", 1)
        spring = scope.p("load_stiffness_{j}_{torque}_{angle}", 1)
        return spring * place + viscous * rate + dry * smooth


class GearedSlide(GearedShaft):
    """Slide behind a gear: `GearedShaft` with displacement and force."""

    kind: ClassVar[str] = "geared_slide"
    suffix: ClassVar[dict[str, str]] = LINEAR
