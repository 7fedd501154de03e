"""What the load is or meets beyond what is declared: mass, constant torque, air."""

from __future__ import annotations

import casadi as ca

from models.plant.effects import Effect
from models.plant.parameter import Parameter
from models.plant.scope import Expr, Scope


class UnmodelledPayload(Effect):
    """Mass at the tip beyond the declared payload: m_tip = m_declared + Δm."""

    name = "unmodelled_payload"
    shared = (
        Parameter(name="unmodelled_payload_kg", unit="kg", value=0.0, low=-0.2, high=3.0,
                  role="effect", description="mass at the tip beyond the declared payload",
                  source="assumed absent"),
    )  # fmt: skip

    def apply(self, scope: Scope) -> None:
        """Add it to the payload."""
        scope.payload_kg += scope.p("unmodelled_payload_kg")


class PayloadOffset(Effect):
    """The payload's centre lies off the axis, towards +x in the tip's frame: a lever o L."""

    name = "payload_offset"
    needs = ("tip",)
    shared = (
        Parameter(name="payload_offset_share", unit="1", value=0.0, low=-0.2, high=0.2,
                  role="effect", description="offset towards +x, share of the link's length",
                  source="assumed absent; hung by hand within 3 mm"),
    )  # fmt: skip

    def apply(self, scope: Scope) -> None:
        """Shift the payload."""
        scope.payload_offset_m += scope.p("payload_offset_share") * scope.p("link_length_m")


class LoadOffset(Effect):
    """A constant torque (or force) on the joint: a cable or a spring that pulls."""

    name = "load_offset"
    per_joint = (
        Parameter(name="load_offset_{j}_{torque}", unit="N.m", value=0.0, low=-30.0, high=30.0,
                  role="effect", description="constant torque on the joint",
                  source="assumed absent"),
    )  # fmt: skip

    def apply(self, scope: Scope) -> None:
        """Add the torque."""
        for j in scope.joints:
            scope.joint_torque[j] += scope.p("load_offset_{j}_{torque}", j)


class AerodynamicDrag(Effect):
    """Quadratic drag of the air, c |ω| ω on the joint, ω the rate of the load with its bends.

    On a link it is spread as the square of the distance r from the joint, dF = k r² |ω| ω dr with
    k (l_0 + L)⁴/4 = c, so that a hinge at r_h is bent by the share
    1 − 4/3 ρ + ρ⁴/3 of it, ρ = r_h / (l_0 + L)  (FACTS §6: ½ρC_d b ω² L⁴/4).
    """

    name = "aerodynamic_drag"
    shared = (
        Parameter(name="aerodynamic_drag_nm", unit="N.m", value=0.0, low=0.0, high=20.0,
                  role="effect", description="drag torque at 1 rad/s",
                  source="FACTS §6: 0.02 N·m"),
    )  # fmt: skip

    def apply(self, scope: Scope) -> None:
        """Oppose the motion of joint and bends."""
        rate = dict(scope.rate)
        for (_, j), bend_rate in scope.bend_rate.items():
            rate[j] = rate[j] + bend_rate
        speed = ca.sqrt(sum(r**2 for r in rate.values()) + 1e-12)
        shares = _shares(scope) if scope.bend else {}
        for j in scope.joints:
            torque = scope.p("aerodynamic_drag_nm") * speed * rate[j]
            scope.joint_torque[j] -= torque
            for hinge, share in shares.items():
                scope.bend_torque[hinge, j] -= share * torque


def _shares(scope: Scope) -> dict[str, Expr]:
    """Share of the drag's torque about the joint that bends each hinge of the link."""
    offset_m, length_m = scope.p("base_offset_m"), scope.p("link_length_m")
    place_m = {"root": offset_m, "span": offset_m + scope.p("span_position") * length_m}
    ratios = {hinge: place / (offset_m + length_m) for hinge, place in place_m.items()}
    return {hinge: 1 - 4 * r / 3 + r**4 / 3 for hinge, r in ratios.items()}
