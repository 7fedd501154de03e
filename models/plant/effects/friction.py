"""Friction of the drive: dry, viscous, by direction, near standstill, at breakaway and by load."""

from __future__ import annotations

from types import MappingProxyType
from typing import Final

import casadi as ca

from models.plant.effects import Effect
from models.plant.parameter import Parameter
from models.plant.scope import Expr, Scope
from models.plant.step_model import Variable

FASTEST_SLIDE_S: Final = 2e-3
"""Shortest time in which sliding bends or breaks the contacts: two integration steps."""


def friction_direction(scope: Scope, joint: int) -> Expr:
    """Smooth sign of a joint's rate, for dry friction; from the drive if it has one."""
    if joint in scope.friction_direction:
        return scope.friction_direction[joint]
    return ca.tanh(scope.rate[joint] / scope.p("friction_speed_{j}_{angle}_s", joint))


def gear_load(scope: Scope, joint: int) -> Expr:
    """Torque on the gear's teeth: |τ_load − τ_drive|, or |τ_load| for a large stiff gear.

    A drive that lifts a load adds its torque on the teeth (BAM, equation of the gearbox).
    """
    return ca.fabs(scope.transmitted_torque[joint] - scope.gear_drive_torque.get(joint, 0))


class CoulombFriction(Effect):
    """Dry friction F_c sign(q̇) [Armstrong-Hélouvry et al. 1994]."""

    name = "coulomb_friction"
    per_joint = (
        Parameter("coulomb_friction_{j}_{torque}", "N.m", 0.0, 0.0, 12.0,
                  "dry friction at the output", 'docs/sources.md, "The servo": no-load current',
                  role="effect"),
    )  # fmt: skip

    def apply(self, scope: Scope) -> None:
        for j in scope.joints:
            level = scope.p("coulomb_friction_{j}_{torque}", j)
            scope.friction[j] += level * friction_direction(scope, j)


class ViscousFriction(Effect):
    """Friction B q̇."""

    name = "viscous_friction"
    per_joint = (
        Parameter("viscous_friction_{j}_{torque}_s_{angle}", "N.m.s/rad", 0.0, 0.0, 20.0,
                  "friction per rate at the output",
                  'docs/sources.md, "The servo": no-load current', role="effect"),
    )  # fmt: skip

    def apply(self, scope: Scope) -> None:
        for j in scope.joints:
            coefficient = scope.p("viscous_friction_{j}_{torque}_s_{angle}", j)
            scope.friction[j] += coefficient * scope.rate[j]


class DirectionalFriction(Effect):
    """Viscous friction that differs by direction of travel, (B + a) q̇ for q̇ > 0, else (B − a) q̇.

    Friction coefficients by direction are those of Armstrong-Hélouvry et al. (1994), section 2; a
    nut or a guide that is loaded from one side has them. No recording of a rotary joint shows it,
    so the effect is for straight guides only.
    """

    name = "directional_friction"
    needs = ("straight guide",)
    per_joint = (
        Parameter("directional_friction_{j}_{torque}_s_{angle}", "N.m.s/rad", 0.0, -20.0, 20.0,
                  "viscous friction forwards above its mean of both directions", "assumed absent",
                  role="effect"),
    )  # fmt: skip

    def apply(self, scope: Scope) -> None:
        for j in scope.joints:
            excess = scope.p("directional_friction_{j}_{torque}_s_{angle}", j)
            scope.friction[j] += excess * scope.rate[j] * friction_direction(scope, j)


class StribeckFriction(Effect):
    """Extra dry friction near standstill, (F_s + μ_s |τ|) φ(q̇/v_s) b [Stribeck 1902].

        φ(r) = (1 + (e^κ − 1) r²)^(−1/κ),
        ḃ = |q̇| (sign(q̇) − b) / (δ + |q̇| T_0),   T_0 = 2 ms

    Friction fades like exp(−r²) (Bo and Pavelescu 1982; κ → 0) or more slowly, like 1/(1 + 1.7 r²)
    (Hess and Soom 1990; κ = 1); at v_s it has faded to 37 % with any tail κ.
    After a reversal the contacts bend before they slide (Dahl 1968): b reaches sign(q̇) within the
    distance δ, at rates at which the friction already fades. A drive with presliding uses its b
    instead of this one. μ_s, the part per transmitted torque τ (BAM, model M4), is zero unless a
    plant document frees it; in a gear that slides slowly under load it is the larger part. A smooth
    sign also rises over rates. The torque is scaled by that loss, so that F_s is the largest extra
    torque where δ is short.
    """

    name = "stribeck_friction"
    parameter_needs = MappingProxyType({"stribeck_distance_{j}_{angle}": "smooth friction"})
    fitted_last = ("stribeck_tail_{j}",)
    per_joint = (
        Parameter("stribeck_friction_{j}_{torque}", "N.m", 0.0, 0.0, 12.0,
                  "extra friction near standstill", "assumed absent", role="effect"),
        Parameter("stribeck_speed_{j}_{angle}_s", "rad/s", 0.15, 0.01, 1.0,
                  "rate at which it has faded to 37 %", "assumed: a fifth of the study's peak rate",
                  role="effect"),
        Parameter("stribeck_tail_{j}", "1", 0.02, 0.02, 1.5, "how slowly it fades at higher rates",
                  "assumed next to none; 1 by Hess and Soom", prior_deviation=1.0),
        Parameter("stribeck_distance_{j}_{angle}", "rad", 2e-5, 2e-5, 0.05,
                  "distance in which it builds up after a reversal",
                  "assumed next to none; a LuGre model of such a servo has 0.2 mrad", role="effect",
                  prior_deviation=0.001),
        Parameter("stribeck_load_{j}", "1", 0.0, 0.0, 1.0,
                  "extra friction near standstill per transmitted torque", "assumed absent"),
    )  # fmt: skip

    def apply(self, scope: Scope) -> None:
        for j in scope.joints:
            tail = scope.p("stribeck_tail_{j}", j)
            ratio = scope.rate[j] / scope.p("stribeck_speed_{j}_{angle}_s", j)
            fade = ca.exp(-ca.log1p(ca.expm1(tail) * ratio**2) / tail)
            load = scope.p("stribeck_load_{j}", j) * gear_load(scope, j)
            extra = scope.p("stribeck_friction_{j}_{torque}", j) + load
            scope.friction[j] += extra * fade * _built_up(scope, j) / _peak(scope, j)


def _built_up(scope: Scope, joint: int) -> Expr:
    """State b of the contacts, between −1 and 1; see `StribeckFriction`."""
    direction = friction_direction(scope, joint)
    distance = scope.name("stribeck_distance_{j}_{angle}", joint)
    if distance not in scope.parameters:
        return direction
    speed = ca.fabs(scope.rate[joint])
    built = scope.state(Variable(f"stribeck_built_{joint}", "1", minimum=-1.0, maximum=1.0))
    reach = scope.p(distance) + speed * FASTEST_SLIDE_S
    scope.states[built.name()].rate = speed / reach * (direction - built)
    return built


def _peak(scope: Scope, joint: int) -> Expr:
    """Largest value of tanh(q̇/v_0) φ(q̇/v_s) over rates; 1 if the drive sets the sign.

    Interpolated by powers between its limits: 1 for v_s ≫ v_0, and for v_s ≪ v_0 the largest value
    of q̇/v_0 φ(q̇/v_s), (v_s/v_0) (κ/((2 − κ)(e^κ − 1)))^(1/2) (2/(2 − κ))^(−1/κ). The exponent
    falls with the tail κ: the peak is within 2.1 % up to κ = 1, by a scan.
    """
    if joint in scope.friction_direction:
        return 1
    fading = scope.p("stribeck_speed_{j}_{angle}_s", joint)
    rising = scope.p("friction_speed_{j}_{angle}_s", joint)
    tail = scope.p("stribeck_tail_{j}", joint)
    width = fading / rising * ca.sqrt(tail / (2 - tail) / ca.expm1(tail))
    limit = width * (2 / (2 - tail)) ** (-1 / tail)
    exponent = 1.55 - 0.1 * tail
    return (1 + limit**-exponent) ** (-1 / exponent)


class Stiction(Effect):
    """Breakaway torque F_b above sliding friction, lost over a distance and regained at rest.

        F = F_b (1 − x²) sign(q̇),   ẋ = (q̇ − |q̇| x) / (δ + |q̇| T_0) − x / T

    x is the bristle of Dahl (1968). From rest (x = 0) or after a reversal it passes zero, where the
    contacts hold most; sliding by a few δ breaks them. Bliman and Sorine (1995) describe friction
    that exceeds its sliding level over a distance and not at a speed. The rising static friction of
    Armstrong-Hélouvry et al. (1994) returns with the dwell time T. Stribeck friction acts before a
    standstill as well as after it; stiction acts after it only.
    """

    name = "stiction"
    per_joint = (
        Parameter("stiction_{j}_{torque}", "N.m", 0.0, 0.0, 12.0,
                  "breakaway torque above sliding friction", "assumed absent", role="effect"),
        Parameter("stiction_distance_{j}_{angle}", "rad", 0.01, 0.002, 0.1,
                  "distance in which sliding breaks the contacts",
                  "assumed: a hundredth of the study's stroke", role="effect"),
        Parameter("stiction_dwell_{j}_s", "s", 2.0, 0.1, 100.0,
                  "time at rest in which they form again",
                  "assumed: below the rest before a trial"),
    )  # fmt: skip

    def apply(self, scope: Scope) -> None:
        for j in scope.joints:
            rate = scope.rate[j]
            slid = scope.state(Variable(f"slid_{j}", "1", minimum=-1.0, maximum=1.0))
            speed = ca.fabs(rate)
            reach = scope.p("stiction_distance_{j}_{angle}", j) + speed * FASTEST_SLIDE_S
            forming = slid / scope.p("stiction_dwell_{j}_s", j)
            scope.states[slid.name()].rate = (rate - speed * slid) / reach - forming
            level = scope.p("stiction_{j}_{torque}", j) * (1 - slid**2)
            scope.friction[j] += level * friction_direction(scope, j)


class LoadDependentFriction(Effect):
    """Gear friction μ |τ| sign(q̇) in proportion to the transmitted torque (BAM, model M4)."""

    name = "load_dependent_friction"
    needs = ("gear load",)
    per_joint = (
        Parameter("load_dependent_friction_{j}", "1", 0.0, 0.0, 0.5,
                  "friction per transmitted torque", 'docs/sources.md, "The servo"', role="effect"),
    )  # fmt: skip

    def apply(self, scope: Scope) -> None:
        for j in scope.joints:
            coefficient = scope.p("load_dependent_friction_{j}", j)
            scope.friction[j] += coefficient * gear_load(scope, j) * friction_direction(scope, j)
