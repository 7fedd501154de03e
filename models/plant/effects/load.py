"""Effects of the load: undeclared mass, offset, constant torque and air drag."""

from __future__ import annotations

import casadi as ca

from models.plant.effects import Effect
from models.plant.parameter import Parameter
from models.plant.scope import Expr, Scope


class UnmodelledPayload(Effect):
    """Mass at the tip beyond the declared payload: m_tip = m_declared + Δm."""

    name = "unmodelled_payload"
    shared = (
        Parameter("unmodelled_payload_kg", "kg", 0.0, -0.2, 3.0,
                  "mass at the tip beyond the declared payload", "assumed absent", role="effect"),
    )  # fmt: skip

    def apply(self, scope: Scope) -> None:
        scope.payload_kg += scope.p("unmodelled_payload_kg")


class PayloadOffset(Effect):
    """Offset o L of the payload's centre from the axis, towards +x in the tip's frame.

    Mass at the tip without a payload is on the axis.
    """

    name = "payload_offset"
    needs = ("tip",)
    shared = (
        Parameter("payload_offset_share", "1", 0.0, -0.2, 0.2,
                  "offset towards +x, fraction of the link's length",
                  "assumed absent; hung by hand within 3 mm", role="effect"),
    )  # fmt: skip

    def apply(self, scope: Scope) -> None:
        scope.payload_offset_m += scope.p("payload_offset_share") * scope.p("link_length_m")


class LoadOffset(Effect):
    """Constant torque (or force) on the joint, as from a cable or a spring."""

    name = "load_offset"
    of_each_joint = True
    per_joint = (
        Parameter("load_offset_{j}_{torque}", "N.m", 0.0, -30.0, 30.0,
                  "constant torque on the joint", "assumed absent", role="effect"),
    )  # fmt: skip

    def apply(self, scope: Scope) -> None:
        for j in scope.joints:
            scope.joint_torque[j] += scope.p("load_offset_{j}_{torque}", j)


class AerodynamicDrag(Effect):
    """Quadratic air drag, c |ω| ω on the joint, with ω = q̇ + Σ s_h φ̇_h.

    The drag on a link grows with the square of the distance from the joint. A hinge at the fraction
    ρ of the reach is therefore bent by s = 1 − 4ρ/3 + ρ⁴/3 of the torque on the joint. The same
    weights in ω make the power −c |ω|³, which is never positive (½ρC_d b ω² L⁴/4; docs/sources.md,
    "The link").
    """

    name = "aerodynamic_drag"
    shared = (
        Parameter("aerodynamic_drag_{torque}", "N.m", 0.0, 0.0, 10.0, "drag torque at 1 rad/s",
                  'docs/sources.md, "The link": 0.02 N·m', role="effect"),
    )  # fmt: skip

    def apply(self, scope: Scope) -> None:
        fractions = _drag_fractions(scope) if ("span", 1) in scope.bend else {}
        rate = {
            j: scope.rate[j] + sum(s * scope.bend_rate[hinge, j] for hinge, s in fractions.items())
            for j in scope.joints
        }
        # Linear below 1 µrad/s, so that it has a derivative at rest.
        speed = ca.sqrt(sum(r**2 for r in rate.values()) + 1e-6**2)
        for j in scope.joints:
            torque = scope.p("aerodynamic_drag_{torque}") * speed * rate[j]
            scope.joint_torque[j] -= torque
            for hinge, fraction in fractions.items():
                scope.bend_torque[hinge, j] -= fraction * torque


def _drag_fractions(scope: Scope) -> dict[str, Expr]:
    """Fraction of the drag's torque about the joint that bends each hinge of the link."""
    offset_m, length_m = scope.p("base_offset_m"), scope.p("link_length_m")
    place_m = {"root": offset_m, "span": offset_m + scope.p("span_position") * length_m}
    reaches = {hinge: place / (offset_m + length_m) for hinge, place in place_m.items()}
    return {hinge: 1 - 4 * r / 3 + r**4 / 3 for hinge, r in reaches.items()}
