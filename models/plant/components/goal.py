"""Shape of a goal within a step: held, interpolated or profiled; and its effect on the current.

A servo receives a goal once a step. With w(s) the fraction of the change that has taken effect at
the phase s of the step, 0 to 1::

    g(s) = g_before + Δ w(s),   w(s) = 1 − λ + λ s

λ = 0 holds the goal (a staircase). λ = 1 interpolates linearly from the previous goal, which delays
it by half a step more than holding it. Δ is the whole change, or the part that a profile of limited
speed and acceleration completes in one step (`profiled_change`); the rest follows in the next
steps. A profile that ends within the step has a λ between 0 and 1.

The jump (1 − λ) Δ makes the current jump by k_v k_p (1 − λ) Δ, which decays with the velocity loop,
τ = J / (k_t k_v). In a steady motion the jumps of the earlier steps add up. Sampled at the phase φ,
the current is above its value at the end of the step by the jump times (e^{−φh/τ} − r) / (1 − r),
and above its mean by the jump times e^{−φh/τ} / (1 − r) − τ/h, with r = e^{−h/τ}.

A dead time of the goal moves the jumps within the step, and hardly any filter delays a staircase
without smoothing it. So the goal is delayed without its staircase, and the saw-tooth is added to
the mean current (`DelayedStaircase`).
"""

from __future__ import annotations

from typing import Final

import casadi as ca

from models.plant.components.drive import declare_goal
from models.plant.parameter import Parameter
from models.plant.scope import CurrentSampling, Expr, Scope
from models.plant.step_model import Variable

NO_ACCELERATION_LIMIT: Final = 1e6
"""Acceleration in rad/s² that counts as no limit: a change of 10 rad takes 6 ms."""


def profiled_change(
    distance: Expr, rate: Expr, speed: Expr, acceleration: Expr, step_s: Expr
) -> tuple[Expr, Expr]:
    """Change of the set-point in one step, and its final rate; `distance` is what is to go.

    A profiling servo accelerates its set-point to the speed limit, holds that speed, and
    decelerates so that it comes to rest at the goal (docs/sources.md, "Control tables"). It plans
    again when the next goal arrives. With the distance e, the speed v towards the goal and the
    acceleration a, the set-point accelerates up to the speed √(v²/2 + a e), or to the limit. A goal
    that moves at the speed v is followed v / 2a late.
    """
    towards = ca.if_else(distance >= rate * ca.fabs(rate) / (2 * acceleration), 1, -1)
    way, begun = towards * distance, towards * rate
    # The addend keeps the root's derivative finite at rest.
    squared = ca.fmax(begun**2 / 2 + acceleration * way, 0) + 1e-12
    top = ca.fmin(ca.sqrt(squared), speed)
    rise_s, fall_s = (top - begun) / acceleration, top / acceleration
    level = way - (top + begun) / 2 * rise_s - top / 2 * fall_s
    level_s = ca.fmax(level, 0) / top
    rising_s = ca.fmin(rise_s, step_s)
    levelling_s = ca.fmin(ca.fmax(step_s - rise_s, 0), level_s)
    falling_s = ca.fmin(ca.fmax(step_s - rise_s - level_s, 0), fall_s)
    change = (
        (begun + acceleration / 2 * rising_s) * rising_s
        + top * levelling_s
        + (top - acceleration / 2 * falling_s) * falling_s
    )
    arrived = step_s >= rise_s + level_s + fall_s
    ended = begun + acceleration * (rising_s - falling_s)
    return towards * ca.if_else(arrived, way, change), towards * ca.if_else(arrived, 0, ended)


def goal_shape_parameters(joint: int) -> list[Parameter]:
    """Interpolation, delay and profile of the goal, and the phase of the current's sample."""
    j = joint
    return [
        Parameter(f"goal_interpolation_{j}", "1", 0.0, 0.0, 1.0,
                  "0 holds the goal of a step, 1 interpolates it", "assumed held", role="nuisance",
                  prior_deviation=1.0),
        Parameter(f"current_phase_{j}", "1", 1.0, 0.02, 1.0,
                  "phase of the step at which the current is sampled",
                  "assumed: read before the next goal is sent", role="nuisance",
                  prior_deviation=1.0),
        Parameter(f"goal_delay_{j}_s", "s", 0.0, 0.0, 0.01, "time after which a goal takes effect",
                  'assumed at once; docs/sources.md, "Control tables": line time, 1 to 26 ms',
                  role="nuisance", prior_deviation=0.004),
        Parameter(f"profile_speed_{j}_rad_s", "rad/s", 100.0, 0.01, 100.0,
                  "speed limit of the goal's profile; 100 is none",
                  'docs/sources.md, "Control tables": profile velocity, 0 is none'),
        Parameter(f"profile_acceleration_{j}_rad_s2", "rad/s2", NO_ACCELERATION_LIMIT, 0.5,
                  NO_ACCELERATION_LIMIT, "acceleration limit of the goal's profile; 1e6 is none",
                  'docs/sources.md, "Control tables": profile acceleration, 0 is none'),
    ]  # fmt: skip


def declare_step_length(scope: Scope) -> Expr:
    """Length of the step as a state, for outputs and rates; added if there is none yet."""
    if "step_s" not in scope.states:
        scope.state(Variable("step_s", "s", nominal=0.017), 1.0)
        scope.states["step_s"].begin = scope.step_s
    return scope.states["step_s"].symbol


def declare_shaped_goal(scope: Scope, joint: int) -> None:
    """Add a goal as an input and its shape within the step; set `goal`, `sampling`, `start`."""
    declare_goal(scope, joint)
    sent, unit, step_s = scope.goal[joint], scope.suffix["angle"], declare_step_length(scope)
    at_end = 1 - scope.p("goal_interpolation_{j}", joint)
    shaped = scope.state(Variable(f"shaped_goal_{joint}_{unit}", unit, nominal=0.5), sent)
    change = scope.state(Variable(f"goal_change_{joint}_{unit}", unit, nominal=0.01))
    rate = scope.state(Variable(f"goal_rate_{joint}_{unit}_s", f"{unit}/s", nominal=0.5))
    wanted, scope.states[rate.name()].begin = profiled_change(
        sent - shaped,
        rate,
        scope.p("profile_speed_{j}_rad_s", joint),
        scope.p("profile_acceleration_{j}_rad_s2", joint),
        scope.step_s,
    )
    scope.states[change.name()].begin = wanted
    scope.states[shaped.name()].begin = shaped + at_end * wanted
    scope.states[shaped.name()].rate = (1 - at_end) * change / step_s
    scope.goal[joint] = shaped - scope.p("goal_delay_{j}_s", joint) / step_s * change
    scope.sampling[joint] = CurrentSampling(change, lambda: _without_staircase(scope, joint))


def _without_staircase(scope: Scope, joint: int) -> Expr:
    """Goal that follows the line through the middles of its steps instead of the staircase."""
    if "step_phase" not in scope.states:  # 0 to 1
        scope.state(Variable("step_phase", "1"))
        scope.states["step_phase"].begin = ca.SX(0.0)
        scope.states["step_phase"].rate = 1 / declare_step_length(scope)
    at_end = 1 - scope.p("goal_interpolation_{j}", joint)
    phase = scope.states["step_phase"].symbol
    return scope.goal[joint] + at_end * scope.sampling[joint].goal_change * (phase - 0.5)


def goal_rate(scope: Scope, joint: int) -> Expr:
    """Rate of the goal in this step, after the command port."""
    sampling = scope.sampling[joint]
    sent, late = sampling.goal_change / declare_step_length(scope), sampling.delay
    return sent if late is None else sent + late.share * (late.rate - sent)


def declare_goal_rate_change(scope: Scope, joint: int) -> None:
    """Add the goal's change of rate since the previous step as a state, for `goal_rate_change`."""
    unit = scope.suffix["angle"]
    name = f"goal_rate_change_{joint}_{unit}_s"
    scope.state(Variable(name, f"{unit}/s", nominal=0.1))
    change = scope.states[f"goal_change_{joint}_{unit}"]
    scope.states[name].begin = (change.begin - change.symbol) / scope.step_s


def goal_rate_change(scope: Scope, joint: int) -> Expr:
    return scope.states[f"goal_rate_change_{joint}_{scope.suffix['angle']}_s"].symbol


def staircase_in_current(scope: Scope, joint: int, decay_s: Expr) -> Expr:
    """Change of the goal in a step times the current's sample above the twin's, per jump."""
    step_s, sampling = declare_step_length(scope), scope.sampling[joint]
    at_once, late = sampling.goal_change * above_end(scope, joint, decay_s), sampling.delay
    if late is None:
        return at_once
    phase = sampling_phase(scope, joint, step_s) + late.phase_shift
    late_phase = ca.fmin(ca.fmax(phase, 0.0), 1.0)
    delayed = late.rate * step_s * above_mean(late_phase, step_s, decay_s)
    return at_once + late.share * (delayed - at_once)


def above_end(scope: Scope, joint: int, decay_s: Expr) -> Expr:
    """Sampled current minus that at the end of the step, per jump of the current."""
    step_s = declare_step_length(scope)
    phase = sampling_phase(scope, joint, step_s)
    return above_mean(phase, step_s, decay_s) - above_mean(1.0, step_s, decay_s)


def above_mean(phase: Expr, step_s: Expr, decay_s: Expr) -> Expr:
    """Current at a phase of the step above its mean, per jump, as the velocity loop decays."""
    decay = ca.exp(-step_s / decay_s)
    return ca.exp(-phase * step_s / decay_s) / (1 - decay) - decay_s / step_s


def sampling_phase(scope: Scope, joint: int, step_s: Expr) -> Expr:
    """Phase in (0, 1] of the current's sample, counted from the last jump of the goal.

    A sample taken before the delayed jump follows the jump of the previous step.
    """
    delay_s = scope.p("goal_delay_{j}_s", joint)
    phase = scope.p("current_phase_{j}", joint) - delay_s / step_s
    return phase - ca.ceil(phase) + 1.0
