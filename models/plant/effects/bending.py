"""Effects of the link's bending: rest shape, varying stiffness, memory, coupling of the planes."""

from __future__ import annotations

import casadi as ca

from models.plant.effects import Effect
from models.plant.parameter import Parameter
from models.plant.scope import Expr, Scope, substitute
from models.plant.step_model import Variable
from models.shared.catalogue import LEAK_TIME_S, REFERENCE_BEND_RAD


class Prebend(Effect):
    """The unloaded link is bent: the span's torque vanishes at ψ_0, τ(ψ − ψ_0).

    The link bends evenly by β from root to tip, so its tip is off by β L/2. The span hinge at x L
    puts the tip there with ψ_0 = β / (2 (1 − x)).
    """

    name = "prebend"
    needs = ("bend", "tip")
    per_joint = (
        Parameter("prebend_{j}_rad", "rad", 0.0, -0.15, 0.15,
                  "bend of the unloaded link from root to tip", "assumed straight", role="effect"),
    )  # fmt: skip

    def apply(self, scope: Scope) -> None:
        gain = 0.5 / (1 - scope.p("span_position"))
        shift = [
            (scope.bend["span", j], scope.bend["span", j] - gain * scope.p("prebend_{j}_rad", j))
            for j in scope.joints
        ]
        for key in [("span", j) for j in scope.joints]:
            scope.bend_torque[key] = substitute(scope.bend_torque[key], shift)
            scope.stiffness[key] = substitute(scope.stiffness[key], shift)


class DirectionalStiffness(Effect):
    """Stiffer towards one side: K (1 + d s), s = tanh(φ/φ_s), the smooth sign of the bend.

    φ_s = 10 mrad keeps the torque smooth where the bend changes sign.
    """

    name = "directional_stiffness"
    needs = ("bend",)
    per_joint = (
        Parameter("directional_stiffness_{j}", "1", 0.0, -0.5, 0.5,
                  "relative gain for positive bend, loss for negative",
                  'docs/sources.md, "The link": 0.2 in the rig; assumed none here', role="effect"),
    )  # fmt: skip

    def apply(self, scope: Scope) -> None:
        for (hinge, j), bend in scope.bend.items():
            side = ca.tanh(bend / 0.01)
            scope.stiffness[hinge, j] *= 1 + scope.p("directional_stiffness_{j}", j) * side


class StiffnessSoftening(Effect):
    """The secant stiffness falls with the bend, K / (1 + a ‖φ‖); a fraction s is lost at 0.1 rad.

    a = s / ((1 − s) 0.1 rad). The torque still grows with the bend, so the link cannot snap.
    """

    name = "stiffness_softening"
    needs = ("bend",)
    shared = (
        Parameter("softening_share", "1", 0.0, 0.0, 0.6, "stiffness lost at 0.1 rad of bend",
                  "assumed absent", role="effect"),
    )  # fmt: skip

    def apply(self, scope: Scope) -> None:
        loss = scope.p("softening_share")
        for hinge, j in scope.stiffness:
            # Softening sets in over 2 mrad, so that it is smooth at zero.
            size = ca.sqrt(_square(scope, hinge) + 2e-3**2) - 2e-3
            scope.stiffness[hinge, j] /= 1 + loss / (1 - loss) * size / REFERENCE_BEND_RAD


class StiffnessHardening(Effect):
    """The secant stiffness grows with the bend's square, K (1 + s (‖φ‖ / 0.1 rad)²) [Duffing]."""

    name = "stiffness_hardening"
    needs = ("bend",)
    shared = (
        Parameter("hardening_share", "1", 0.0, 0.0, 3.0, "stiffness gained at 0.1 rad of bend",
                  "assumed absent", role="effect"),
    )  # fmt: skip

    def apply(self, scope: Scope) -> None:
        gain = scope.p("hardening_share")
        for hinge, j in scope.stiffness:
            scope.stiffness[hinge, j] *= 1 + gain * _square(scope, hinge) / REFERENCE_BEND_RAD**2


class PressureLeak(Effect):
    """Stiffness falls with a leak, K (1 − s)^(t / 10 s), from the start of the run.

    The outflow through a small hole is proportional to the remaining pressure [orifice, laminar],
    so what depends on pressure falls exponentially. The strength is the loss of stiffness, not of
    pressure: pressure enters the stiffness of a link by shear and prestress alone (docs/sources.md,
    "The link"), but woven skins also lose modulus with it. The limit moment, which pressure
    carries, falls at the same rate.
    """

    name = "pressure_leak"
    needs = ("bend",)
    shared = (
        Parameter("leak_share", "1", 0.0, 0.0, 0.6, "fraction of stiffness lost per 10 s",
                  "assumed tight", role="effect"),
    )  # fmt: skip

    def apply(self, scope: Scope) -> None:
        remaining = scope.state(Variable("pressure_left", "1"), 1.0)
        per_s = ca.log(1 - scope.p("leak_share"))
        scope.states[remaining.name()].rate = remaining * per_s / LEAK_TIME_S
        for key in scope.stiffness:
            scope.stiffness[key] *= remaining
        scope.limit_moment *= remaining


class Hysteresis(Effect):
    """Bouc–Wen hysteresis in the root patch, κ K u_y z, biaxial after Park, Wen and Ang (1986).

    ż_j = r_j − z_j Σ_k ½ (|r_k z_k| + r_k z_k),   r_j = φ̇_j / u_y

    It is added to the elastic torque K φ, below the limit moment. Threads need a few milliseconds
    to slip, so r is limited below 300 yield bends per second. Then no bend rate makes the equation
    stiff; the study's motions stay far below the limit.
    """

    name = "hysteresis"
    needs = ("bend",)
    per_joint = (
        Parameter("hysteresis_share_{j}", "1", 0.0, 0.0, 3.0,
                  "Bouc-Wen fraction of the root's stiffness",
                  'docs/sources.md, "The link"; the root stands for the whole link', role="effect",
                  prior_deviation=0.25),
    )  # fmt: skip
    shared = (
        Parameter("hysteresis_yield_rad", "rad", 0.01, 0.005, 0.1, "bend at which the patch slips",
                  "assumed: a fifth of the bend in the study", role="effect"),
    )  # fmt: skip

    def apply(self, scope: Scope) -> None:
        yield_rad = scope.p("hysteresis_yield_rad")
        z = {
            j: scope.state(Variable(f"hysteresis_{j}", "1", minimum=-1.0, maximum=1.0))
            for j in scope.joints
        }
        rate = {j: scope.bend_rate["root", j] / yield_rad for j in scope.joints}
        speed = sum(r**2 for r in rate.values()) / 300.0**2
        rate = {j: r / ca.sqrt(1 + speed) for j, r in rate.items()}
        slip = sum((ca.fabs(rate[j] * z[j]) + rate[j] * z[j]) / 2 for j in scope.joints)
        for j in scope.joints:
            scope.states[f"hysteresis_{j}"].rate = rate[j] - z[j] * slip
            scope.bend_torque["root", j] -= (
                scope.p("hysteresis_share_{j}", j) * scope.stiffness["root", j] * yield_rad * z[j]
            )


class Creep(Effect):
    """Relaxing part of every hinge's stiffness: Maxwell branches (standard linear solids).

    τ = Σ_b g/3 K (φ − ε_b),   ε̇_b = (φ − ε_b) / T_b,   T_b = T/16, T, 24 T

    The torque is added to the elastic torque K φ, below the limit moment (docs/sources.md, "The
    link"). Polymers relax over decades of time; a single branch fits one period of motion only. A
    branch much slower than the trials acts as stiffness, so K and g are determined better together
    than separately.
    """

    name = "creep"
    needs = ("bend",)
    per_joint = (
        Parameter("creep_share_{j}", "1", 0.0, 0.0, 2.0, "relaxing fraction of the stiffness",
                  'docs/sources.md, "The link": three branches of 6 to 10 %', role="effect",
                  prior_deviation=0.25),
    )  # fmt: skip
    shared = (
        Parameter("creep_time_s", "s", 5.0, 0.8, 60.0, "relaxation time of the middle branch",
                  'docs/sources.md, "The link": branches of 0.3, 5 and 120 s', role="effect"),
    )  # fmt: skip

    def apply(self, scope: Scope) -> None:
        branches = (1 / 16, 1.0, 24.0)
        for (hinge, j), bend in scope.bend.items():
            fraction = scope.p("creep_share_{j}", j) / len(branches)
            for b, ratio in enumerate(branches, 1):
                name = f"creep_{hinge}_{j}_{b}_rad"
                crept = scope.state(Variable(name, "rad", nominal=0.05), bend)
                scope.states[name].rate = (bend - crept) / (ratio * scope.p("creep_time_s"))
                scope.bend_torque[hinge, j] -= fraction * scope.stiffness[hinge, j] * (bend - crept)


class CrossAxisCoupling(Effect):
    """Coupling of the planes: τ_1 ← τ_1 + κ τ_2, τ_2 ← τ_2 + κ τ_1.

    Asymmetric bending of a section with turned principal axes [Timoshenko]. A link that one joint
    moves also vibrates across its plane, in its first mode. With the levers ℓ_h of the hinges about
    the tip, the compliance C = Σ ℓ_h² / K_h and the mass m at the tip, including a quarter of the
    link's [Rayleigh], the tip's deflection y follows

        m ÿ = (κ Σ ℓ_h τ_h / K_h − y) / C − 2 ζ √(m / C) ẏ + m g y / L
    """

    name = "cross_axis_coupling"
    needs = ("bend", "tip")
    beyond_limit = True
    shared = (
        Parameter("coupling_share", "1", 0.0, -0.5, 0.5, "torque of one plane per other plane's",
                  "assumed absent", role="effect"),
        Parameter("coupling_damping_ratio", "1", 0.08, 0.01, 0.3,
                  "damping ratio across the plane of a single joint",
                  'docs/sources.md, "The link": damping ratio 7 to 9 %', role="effect",
                  prior_deviation=0.04),
    )  # fmt: skip

    def apply(self, scope: Scope) -> None:
        if len(scope.joints) == 1:
            _bend_across(scope)
            return
        uncoupled = dict(scope.bend_torque)
        for hinge, j in uncoupled:
            other = 3 - j
            scope.bend_torque[hinge, j] += scope.p("coupling_share") * uncoupled[hinge, other]


def _bend_across(scope: Scope) -> None:
    """Deflection of a link across the plane of its only joint, and the bends of its hinges."""
    (j,) = scope.joints
    length_m, gravity = scope.p("link_length_m"), scope.p("gravity_m_s2")
    lever_m = {"root": length_m, "span": (1 - scope.p("span_position")) * length_m}
    stiffness = {h: scope.p(h + "_stiffness_{j}_nm_rad", j) for h in lever_m}
    compliance = sum(lever_m[h] ** 2 / stiffness[h] for h in lever_m)
    per_m = {h: lever_m[h] / stiffness[h] / compliance for h in lever_m}
    mass_kg = scope.p("tip_mass_kg") + scope.payload_kg + scope.p("link_mass_kg") / 4
    standing_m = scope.p("coupling_share") * sum(
        lever_m[h] * scope.bend_torque[h, j] / stiffness[h] for h in lever_m
    )
    weight = -scope.gravity[2] * gravity * mass_kg / length_m
    start_m = standing_m / (1 - weight * compliance)
    damping = 2 * scope.p("coupling_damping_ratio") * ca.sqrt(mass_kg / compliance)
    across_m = scope.state(Variable("across_m", "m", nominal=0.01), start_m)
    rate_m_s = scope.state(Variable("across_rate_m_s", "m/s", nominal=0.1))
    force_n = (standing_m - across_m) / compliance - damping * rate_m_s + weight * across_m
    scope.states["across_m"].rate = rate_m_s
    scope.states["across_rate_m_s"].rate = force_n / mass_kg
    scope.cross_bend |= {h: across_m * bend for h, bend in per_m.items()}
    for h, bend in scope.cross_bend.items():
        scope.bend_torque[h, j] -= scope.p("coupling_share") * stiffness[h] * bend


def _square(scope: Scope, hinge: str) -> Expr:
    """Square of a hinge's total bend over the planes."""
    return sum(scope.bend[hinge, j] ** 2 for j in scope.joints)
