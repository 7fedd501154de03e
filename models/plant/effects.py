"""Effects: what a plant can hold beyond its nominal drive and load.

An effect is one small class: its name in the catalogue, its parameters (the first one is its
strength: at zero the plant is exactly the one without it), the states that it adds, and the wires
that it changes at its port. Deriving from `Effect` is all it takes to make one known.
"""

from __future__ import annotations

from typing import Any, ClassVar, Final

import casadi as ca

from models.catalogue import CATALOGUE, Port
from models.plant.parameter import Parameter
from models.plant.scope import Expr, Scope
from models.plant.step import Variable

PORTS: Final[tuple[Port, ...]] = (
    "sensor", "command", "stiffness", "mass", "bend_torque", "servo_torque", "joint_torque",
)  # fmt: skip
"""Order in which the ports are served: what the sensors show is what the drive sees."""

EFFECTS: Final[dict[str, type[Effect]]] = {}
"""Effects by name; a class enters by being defined."""


class Effect:
    """Base of all effects.

    Attributes
    ----------
    name : str
        As a plant document calls it.
    port : str
        Where it acts; taken from the catalogue unless the class says otherwise.
    per_joint : tuple of Parameter
        With patterns as names ({j}, {angle}, {torque}); one of each for every joint.
    shared : tuple of Parameter
        One for all joints.
    """

    name: ClassVar[str]
    port: ClassVar[Port]
    per_joint: ClassVar[tuple[Parameter, ...]] = ()
    shared: ClassVar[tuple[Parameter, ...]] = ()

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        if not hasattr(cls, "port"):
            cls.port = CATALOGUE[cls.name].port
        EFFECTS[cls.name] = cls

    def parameters(self, scope: Scope) -> tuple[Parameter, ...]:
        """Parameters for the joints of `scope`, the strength first."""
        named = [
            _renamed(q, scope.name(q.name, j), scope) for q in self.per_joint for j in scope.joints
        ]
        return (*named, *self.shared)

    def apply(self, scope: Scope) -> None:
        """Change the wires of the port."""
        raise NotImplementedError


def _renamed(q: Parameter, name: str, scope: Scope) -> Parameter:
    unit = q.unit if scope.suffix["angle"] == "rad" else q.unit.replace("N.m", "N")
    return Parameter(
        name=name, unit=unit, value=q.value, low=q.low, high=q.high, role=q.role,
        description=q.description, source=q.source,
    )  # fmt: skip


def direction(scope: Scope, joint: int) -> Expr:
    """Smooth sign of a joint's rate, for dry friction."""
    return ca.tanh(scope.rate[joint] / scope.p("friction_speed_{j}_{angle}_s", joint))


class CoulombFriction(Effect):
    """Dry friction F_c sign(q̇) [Armstrong-Hélouvry et al. 1994]."""

    name = "coulomb_friction"
    per_joint = (
        Parameter(name="coulomb_friction_{j}_{torque}", unit="N.m", value=0.0, low=0.0, high=12.0,
                  role="effect", description="dry friction at the output",
                  source="FACTS §6: 4.5 N·m from the no-load current"),
    )  # fmt: skip

    def apply(self, scope: Scope) -> None:
        """Oppose the rate with a constant."""
        for j in scope.joints:
            scope.friction[j] += scope.p("coulomb_friction_{j}_{torque}", j) * direction(scope, j)


class ViscousFriction(Effect):
    """Friction B q̇."""

    name = "viscous_friction"
    per_joint = (
        Parameter(name="viscous_friction_{j}_{torque}_s_{angle}", unit="N.m.s/rad", value=0.0,
                  low=0.0, high=20.0, role="effect", description="friction per rate at the output",
                  source="FACTS §6: 2.0 N·m·s/rad from the no-load current"),
    )  # fmt: skip

    def apply(self, scope: Scope) -> None:
        """Oppose the rate in proportion."""
        for j in scope.joints:
            scope.friction[j] += (
                scope.p("viscous_friction_{j}_{torque}_s_{angle}", j) * scope.rate[j]
            )


class LoadDependentFriction(Effect):
    """Gear friction μ |τ| sign(q̇) in proportion to the transmitted torque (BAM, model M4)."""

    name = "load_dependent_friction"
    per_joint = (
        Parameter(name="load_dependent_friction_{j}", unit="1", value=0.0, low=0.0, high=0.5,
                  role="effect", description="friction per transmitted torque",
                  source="FACTS §6: 0.14"),
    )  # fmt: skip

    def apply(self, scope: Scope) -> None:
        """Oppose the rate in proportion to the load."""
        for j in scope.joints:
            load = ca.fabs(scope.transmitted[j])
            scope.friction[j] += (
                scope.p("load_dependent_friction_{j}", j) * load * direction(scope, j)
            )


class Hysteresis(Effect):
    """Bouc–Wen in the root patch, κ K u_y z, biaxial after Park, Wen and Ang (1986).

    u_y ż_j = φ̇_j − z_j Σ_k ½ (|φ̇_k z_k| + φ̇_k z_k)
    """

    name = "hysteresis"
    per_joint = (
        Parameter(name="hysteresis_share_{j}", unit="1", value=0.0, low=0.0, high=2.0,
                  role="effect", description="Bouc-Wen share of the root's stiffness",
                  source="FACTS §6"),
    )  # fmt: skip
    shared = (
        Parameter(name="hysteresis_yield_rad", unit="rad", value=0.01, low=0.001, high=0.1,
                  role="effect", description="bend at which the patch slips",
                  source="assumed: a fifth of the bend in the study"),
    )  # fmt: skip

    def apply(self, scope: Scope) -> None:
        """Add the hysteretic torque."""
        yield_rad = scope.p("hysteresis_yield_rad")
        z = {j: scope.state(Variable(f"hysteresis_{j}", "1")) for j in scope.joints}
        rate = {j: scope.bend_rate["root", j] for j in scope.joints}
        slip = sum((ca.fabs(rate[j] * z[j]) + rate[j] * z[j]) / 2 for j in scope.joints)
        for j in scope.joints:
            scope.states[f"hysteresis_{j}"].rate = (rate[j] - z[j] * slip) / yield_rad
            scope.bend_torque["root", j] -= (
                scope.p("hysteresis_share_{j}", j) * scope.stiffness["root", j] * yield_rad * z[j]
            )


class Creep(Effect):
    """Relaxing share of every hinge's stiffness: a Maxwell branch (standard linear solid).

    τ = g K (φ − ε),   ε̇ = (φ − ε) / T   (FACTS §6)
    """

    name = "creep"
    per_joint = (
        Parameter(name="creep_share_{j}", unit="1", value=0.0, low=0.0, high=1.0, role="effect",
                  description="relaxing share of the stiffness", source="FACTS §6: 6 to 10 %"),
    )  # fmt: skip
    shared = (
        Parameter(name="creep_time_s", unit="s", value=3.0, low=0.05, high=60.0, role="effect",
                  description="relaxation time", source="FACTS §6: branches of 0.3, 5 and 120 s"),
    )  # fmt: skip

    def apply(self, scope: Scope) -> None:
        """Add the relaxing torque."""
        for (hinge, j), bend in scope.bend.items():
            name = f"creep_{hinge}_{j}_rad"
            crept = scope.state(Variable(name, "rad", nominal=0.05), bend)
            scope.states[name].rate = (bend - crept) / scope.p("creep_time_s")
            scope.bend_torque[hinge, j] -= (
                scope.p("creep_share_{j}", j) * scope.stiffness[hinge, j] * (bend - crept)
            )


class Prebend(Effect):
    """The unloaded link is bent: the span's torque vanishes at ψ_0 in place of zero."""

    name = "prebend"
    per_joint = (
        Parameter(name="prebend_{j}_rad", unit="rad", value=0.0, low=-0.15, high=0.15,
                  role="effect", description="bend of the unloaded link",
                  source="assumed straight"),
    )  # fmt: skip

    def apply(self, scope: Scope) -> None:
        """Shift where the span is at ease."""
        for j in scope.joints:
            scope.bend_torque["span", j] += (
                scope.p("prebend_{j}_rad", j) * scope.stiffness["span", j]
            )


class StribeckFriction(Effect):
    """Extra dry friction near standstill, F_s exp(−(q̇/v_s)²) sign(q̇) [Stribeck 1902]."""

    name = "stribeck_friction"
    per_joint = (
        Parameter(name="stribeck_friction_{j}_{torque}", unit="N.m", value=0.0, low=0.0, high=12.0,
                  role="effect", description="extra friction near standstill",
                  source="assumed absent"),
        Parameter(name="stribeck_speed_{j}_{angle}_s", unit="rad/s", value=0.15, low=0.03, high=1.0,
                  role="effect", description="rate at which it has faded to 37 %",
                  source="assumed: a fifth of the study's peak rate"),
    )  # fmt: skip

    def apply(self, scope: Scope) -> None:
        """Oppose the rate, the less the faster."""
        for j in scope.joints:
            fade = ca.exp(-((scope.rate[j] / scope.p("stribeck_speed_{j}_{angle}_s", j)) ** 2))
            strength = scope.p("stribeck_friction_{j}_{torque}", j)
            scope.friction[j] += strength * fade * direction(scope, j)


class DirectionalStiffness(Effect):
    """Stiffer towards one side: K (1 + d s), s = tanh(φ/φ_s) the smooth side of the bend.

    φ_s = 10 mrad keeps the torque smooth where the bend changes side.
    """

    name = "directional_stiffness"
    per_joint = (
        Parameter(name="directional_stiffness_{j}", unit="1", value=0.0, low=-0.6, high=0.6,
                  role="effect", description="stiffness gained for positive bend, lost for negative",
                  source="FACTS §6: 0.2 where negative angles deform more"),
    )  # fmt: skip

    def apply(self, scope: Scope) -> None:
        """Scale each hinge's stiffness by the side it is bent to."""
        for (hinge, j), bend in scope.bend.items():
            side = ca.tanh(bend / 0.01)
            scope.stiffness[hinge, j] *= 1 + scope.p("directional_stiffness_{j}", j) * side
