"""Lost motion in the gear: between the drive's side, where the encoder sits, and the load's."""

from __future__ import annotations

from typing import Final

import casadi as ca

from models.plant.effects import Effect
from models.plant.parameter import Parameter
from models.plant.scope import Expr, Scope
from models.plant.step_model import Variable

RIGID_GEAR_TIME_S: Final = 2e-3
"""Time in which a gear without play or give follows; two integration steps."""

PLATE_INERTIA = Parameter(
    name="plate_inertia_{j}_kg_m2", unit="kg.m2", value=0.04, low=0.02, high=1.0,
    description="inertia between the gear and the root of the load",
    source="assumed: base plate and its frame",
)  # fmt: skip
GEAR_DAMPING = Parameter(
    name="gear_damping_{j}_nm_s_rad", unit="N.m.s/rad", value=10.0, low=0.0, high=30.0,
    description="damping of the gear while it gives", source="assumed",
)  # fmt: skip


def add_windup(scope: Scope, joint: int, label: str, lost: Expr, compliance: Expr) -> None:
    """Let the load lag behind the drive by `lost`, as fast as a plate on the gear can move.

    With a gear of compliance c and damping d, and the plate's inertia J::

        (T² + c J) ẅ + (2 T + c d) ẇ + w = w_lost

    ẅ is known from states alone, so the load is carried on an accelerated base exactly and the
    drive feels its reaction. T keeps the equation regular at c = 0, where w stays zero.
    """
    angle = scope.suffix["angle"]
    windup = scope.state(
        Variable(f"{label}_{joint}_{angle}", angle, nominal=1e-3), scope.initial_value(lost)
    )
    rate = scope.state(Variable(f"{label}_rate_{joint}_{angle}_s", f"{angle}/s", nominal=0.1))
    mass = RIGID_GEAR_TIME_S**2 + compliance * scope.p(PLATE_INERTIA.name, joint)
    damping = 2 * RIGID_GEAR_TIME_S + compliance * scope.p(GEAR_DAMPING.name, joint)
    acceleration = (lost - windup - damping * rate) / mass
    scope.states[windup.name()].rate = rate
    scope.states[rate.name()].rate = acceleration
    scope.windup[joint] += windup
    scope.windup_rate[joint] += rate
    scope.windup_acceleration[joint] += acceleration


class JointElasticity(Effect):
    """The gear winds up by c per torque (flexible joint [Spong 1987]): w = −c τ_load.

    In series with the root's stiffness K: the first mode falls as if K were K / (1 + c K).
    """

    name = "joint_elasticity"
    needs = ("gear load",)
    per_joint = (
        Parameter(name="joint_elasticity_{j}_{angle}_{torque}", unit="rad/(N.m)", value=0.0,
                  low=0.0, high=0.02, role="effect", description="gear wind-up per torque",
                  source="a stiff gear has 5e-5 (20 kN·m/rad)"),
        PLATE_INERTIA,
        GEAR_DAMPING,
    )  # fmt: skip

    def apply(self, scope: Scope) -> None:
        """Wind up by the torque that the load puts on the joint."""
        for j in scope.joints:
            compliance = scope.p("joint_elasticity_{j}_{angle}_{torque}", j)
            add_windup(
                scope, j, "elastic_windup", -compliance * scope.transmitted_torque[j], compliance
            )


class Backlash(Effect):
    """Play b: the load hangs at one side of it, by the sign of its torque [Nordin 2002].

    w = −(b/2) tanh(τ_load / τ_b). The torque τ_b that closes the play makes the dead zone smooth:
    fits start at a wide one and shrink it. The encoder on the drive's side does not see the play.
    """

    name = "backlash"
    needs = ("gear load",)
    per_joint = (
        Parameter(name="backlash_{j}_{angle}", unit="rad", value=0.0, low=0.0, high=0.1,
                  role="effect", description="full play of the gear",
                  source='docs/sources.md, "The servo": below 0.0017 rad (6 arc minutes)'),
        Parameter(name="backlash_torque_{j}_{torque}", unit="N.m", value=0.5, low=0.05, high=5.0,
                  description="torque that closes the play",
                  source="numerical: 2 % of the study's peak torque"),
        PLATE_INERTIA,
        GEAR_DAMPING,
    )  # fmt: skip

    def apply(self, scope: Scope) -> None:
        """Lay the load on the side that its torque presses it to."""
        for j in scope.joints:
            half = scope.p("backlash_{j}_{angle}", j) / 2
            torque = scope.p("backlash_torque_{j}_{torque}", j)
            lost = -half * ca.tanh(scope.transmitted_torque[j] / torque)
            add_windup(scope, j, "play", lost, half / torque)
