"""Lost motion in the gear, between the drive's side with the encoder and the load's side."""

from __future__ import annotations

from types import MappingProxyType
from typing import Final

import casadi as ca

from models.plant.effects import Effect
from models.plant.parameter import Parameter
from models.plant.scope import Expr, Scope
from models.plant.step_model import Variable

RIGID_GEAR_TIME_S: Final = 2e-3
"""Time constant of a gear without backlash or compliance: two integration steps."""

PLATE_INERTIA = Parameter(
    "plate_inertia_{j}_kg_m2", "kg.m2", 0.04, 0.02, 1.0,
    "inertia between the gear and the root of the load", "assumed: base plate and its frame"
)  # fmt: skip
GEAR_DAMPING = Parameter(
    "gear_damping_{j}_nm_s_rad", "N.m.s/rad", 10.0, 0.0, 30.0,
    "damping of the gear in series with its compliance", "assumed", role="effect",
    prior_deviation=5.0
)  # fmt: skip

MOUNT_FRACTION = Parameter(
    "backlash_mount_fraction", "1", 0.0, -0.5, 1.5,
    "fraction of the play that is in the link's mount and moves no mass",
    "assumed: all in the gear; beyond 0 and 1 it makes up for the gear's inertia", role="effect",
    prior_deviation=0.5
)  # fmt: skip

MOUNT_TIME = Parameter(
    "backlash_mount_time_s", "s", 0.04, 0.008, 0.2,
    "mean time of the link through the play of its mount",
    "assumed: it falls through 5 mrad in 0.03 s", role="effect", prior_deviation=0.02
)  # fmt: skip


def add_windup(scope: Scope, joint: int, label: str, lost: Expr, compliance: Expr) -> None:
    """Add a lag of the load behind the drive: `lost`, with the dynamics of a plate on the gear.

    With a gear of compliance c and damping d, and the plate's inertia J::

        (T² + c J) ẅ + (2 T + c d) ẇ + w = w_lost

    ẅ depends on states only, so the load moves on an accelerated base without approximation and its
    reaction acts on the drive. T keeps the equation regular at c = 0, where w stays zero.
    """
    mass = RIGID_GEAR_TIME_S**2 + compliance * scope.p(PLATE_INERTIA.name, joint)
    damping = 2 * RIGID_GEAR_TIME_S + compliance * scope.p(GEAR_DAMPING.name, joint)
    windup, rate = _add_oscillator(scope, joint, label, lost)
    acceleration = (lost - windup - damping * rate) / mass
    scope.states[rate.name()].rate = acceleration
    scope.windup[joint] += windup
    scope.windup_rate[joint] += rate
    scope.windup_acceleration[joint] += acceleration


def add_lean(scope: Scope, joint: int, leaning: Expr, time_s: Expr) -> None:
    """Add a lean w of the link's markers in the mount, (T²/4) ẅ + T ẇ + w = w_l; no mass moves."""
    lean, rate = _add_oscillator(scope, joint, "mount_lean", leaning)
    acceleration = 4 * (leaning - lean - time_s * rate) / time_s**2
    scope.states[rate.name()].rate = acceleration
    scope.lean[joint] += lean
    scope.lean_rate[joint] += rate
    scope.lean_acceleration[joint] += acceleration


def _add_oscillator(scope: Scope, joint: int, label: str, start: Expr) -> tuple[Expr, Expr]:
    """Add a displacement and its rate as states."""
    unit = scope.suffix["angle"]
    displacement = Variable(f"{label}_{joint}_{unit}", unit, nominal=1e-3)
    value = scope.state(displacement, scope.initial_value(start))
    rate = scope.state(Variable(f"{label}_rate_{joint}_{unit}_s", f"{unit}/s", nominal=0.1))
    scope.states[value.name()].rate = rate
    return value, rate


class JointElasticity(Effect):
    """Gear wind-up c per torque (flexible joint [Spong 1987]): w = −c τ_load.

    It acts in series with the root's stiffness K: the first mode falls as if K were K / (1 + c K).
    """

    name = "joint_elasticity"
    needs = ("gear load",)
    per_joint = (
        Parameter("joint_elasticity_{j}_{angle}_{torque}", "rad/(N.m)", 0.0, 0.0, 0.02,
                  "gear wind-up per torque", "a stiff gear has 5e-5 (20 kN·m/rad)", role="effect"),
        PLATE_INERTIA,
        GEAR_DAMPING,
    )  # fmt: skip

    def apply(self, scope: Scope) -> None:
        for j in scope.joints:
            compliance = scope.p("joint_elasticity_{j}_{angle}_{torque}", j)
            lost = -compliance * scope.transmitted_torque[j]
            add_windup(scope, j, "elastic_windup", lost, compliance)


class Backlash(Effect):
    """Backlash b: the load rests at one side of it, given by the sign of its torque [Nordin 2002].

    w = −(b/2) tanh(τ_load / τ_b). The torque τ_b that closes the backlash makes the dead zone
    smooth: fits start with a wide one and reduce it. The encoder on the drive's side does not
    measure the backlash. Play in the mount of a link hardly moves mass: the fraction
    `backlash_mount_fraction` of the play moves the markers only.
    """

    name = "backlash"
    needs = ("gear load",)
    per_joint = (
        Parameter("backlash_{j}_{angle}", "rad", 0.0, 0.0, 0.1, "full play of the gear",
                  'docs/sources.md, "The servo": below 0.0017 rad (6 arc minutes)', role="effect"),
        Parameter("backlash_torque_{j}_{torque}", "N.m", 0.5, 0.05, 5.0,
                  "torque that closes the play", "numerical: 2 % of the study's peak torque"),
        PLATE_INERTIA,
        GEAR_DAMPING,
    )  # fmt: skip
    shared = (MOUNT_FRACTION, MOUNT_TIME)
    search_start = MappingProxyType({MOUNT_FRACTION.name: 0.5})

    def parameters(self, scope: Scope) -> tuple[Parameter, ...]:
        parameters = super().parameters(scope)
        return parameters if "tip" in scope.features else parameters[: -len(self.shared)]

    def apply(self, scope: Scope) -> None:
        mount = scope.p(MOUNT_FRACTION.name) if "tip" in scope.features else 0
        for j in scope.joints:
            half = scope.p("backlash_{j}_{angle}", j) / 2
            torque = scope.p("backlash_torque_{j}_{torque}", j)
            side = half * ca.tanh(scope.transmitted_torque[j] / torque)
            add_windup(scope, j, "play", (mount - 1) * side, half / torque)
            if "tip" in scope.features:
                add_lean(scope, j, mount * side, scope.p(MOUNT_TIME.name))
