"""Drive with a position loop and a velocity loop: the cascade of a Dynamixel PRO.

A servo receives a goal once a step and holds, interpolates or profiles it, as its current shows.
With w(s) the fraction of the goal's change that has taken effect at the phase s, 0 to 1::

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

from firmware_py.link.link_description import STUDY_LINK
from models.plant.components.drive import (
    Drive,
    current_limit,
    declare_goal,
    friction_speed_parameter,
)
from models.plant.parameter import Parameter
from models.plant.scope import CurrentSampling, Expr, Scope
from models.plant.step_model import Variable

NO_ACCELERATION_LIMIT: Final = 1e6
"""Acceleration in rad/s² that counts as no limit: a change of 10 rad takes 6 ms."""

FEEDFORWARD: Final = "velocity_feedforward_{j}"
POSITION_INTEGRAL: Final = "position_integral_{j}_per_s2"
SETPOINT_WEIGHT: Final = "setpoint_weight_{j}"
"""Parameters of extensions of the cascade that some servos have; absent by default."""


class Cascade(Drive):
    """P position → PI velocity → current, as the Dynamixel PRO runs it.

    docs/sources.md, "The servo". The set-point of the rate is w = k_p (goal − q) + k_i S + k_f ġ,
    with Ṡ = goal − q and ġ the rate of the goal::

        i = k_v (b w − q̇ + I / T_i),   İ = w − q̇,   τ = k_t i

    The current is clipped to its limit, and back-calculation limits I meanwhile. The sample of the
    current within a step is clipped to the same limit. A servo without feed-forward, position
    integral and set-point weight has k_f = k_i = 0 and b = 1. A servo with a derivative of the
    position error, or with a PID from position to current, has the same law with other gains
    (Åström and Hägglund, *Advanced PID Control*, 2006, ch. 3: set-point weights).
    """

    kind = "cascade"
    features = (
        "current", "current limit", "goal shape", "position gain", "smooth friction",
    )  # fmt: skip

    def joint_parameters(self, scope: Scope, joint: int) -> list[Parameter]:
        j, servo = joint, STUDY_LINK.preset
        optional = 'docs/sources.md, "Control tables": {}; 0 is none'
        return [
            Parameter(f"position_gain_{j}_per_s", "1/s", 12.0, 2.0, 60.0,
                      "position loop: rate per error", 'docs/sources.md, "The servo"',
                      role="nuisance"),
            Parameter(f"velocity_gain_{j}_a_s_rad", "A.s/rad", 18.4, 2.0, 60.0,
                      "current per rate error",
                      'docs/sources.md, "The servo": 150 rad/s on the inertia', role="nuisance"),
            Parameter(f"velocity_integral_time_{j}_s", "s", 0.5, 0.02, 5.0,
                      "integral time of the rate error", "assumed: slower than the position loop",
                      role="nuisance"),
            Parameter(FEEDFORWARD.format(j=j), "1", 0.0, 0.0, 1.5,
                      "share of the goal's rate in the rate that is asked",
                      optional.format("feed-forward 1st gain"), prior_deviation=0.5),
            Parameter(POSITION_INTEGRAL.format(j=j), "1/s2", 0.0, 0.0, 200.0,
                      "rate asked per integral of the position error",
                      optional.format("position I gain"), prior_deviation=10.0),
            Parameter(SETPOINT_WEIGHT.format(j=j), "1", 1.0, 0.0, 1.5,
                      "weight of the asked rate in the proportional part",
                      "assumed: a loop on the error of the rate", prior_deviation=0.3),
            Parameter(f"torque_constant_{j}_nm_a", "N.m/A", servo.torque_constant_nm_a, 2.0, 15.0,
                      "torque at the output per ampere", 'docs/sources.md, "The servo"'),
            Parameter(f"rotor_inertia_{j}_kg_m2", "kg.m2", servo.rotor_inertia_kg_m2, 0.4, 2.0,
                      "rotor inertia at the output", 'docs/sources.md, "The servo": recalled',
                      role="nuisance", prior_deviation=0.15),
            Parameter(f"current_limit_{j}_a", "A", servo.current_limit_a, 0.5, 50.0,
                      "rated current limit", 'docs/sources.md, "The servo"'),
            friction_speed_parameter(scope, j),
            *goal_shape_parameters(j),
        ]  # fmt: skip

    def declare(self, scope: Scope) -> None:
        for j in scope.joints:
            declare_shaped_goal(scope, j)
            scope.state(Variable(f"velocity_integral_{j}_rad", "rad", nominal=0.01))
            if scope.has(FEEDFORWARD, j):
                _declare_goal_rate_change(scope, j)
            if scope.has(POSITION_INTEGRAL, j):
                scope.state(Variable(f"position_integral_{j}_rad_s", "rad.s", nominal=0.01))

    def apply_control(self, scope: Scope) -> None:
        """Set the torque by both loops, and the current as it is sampled."""
        for j in scope.joints:
            integral, sampling = scope.states[f"velocity_integral_{j}_rad"], scope.sampling[j]
            gain = scope.p("velocity_gain_{j}_a_s_rad", j)
            holding_a = scope.holding_torque[j] / self.torque_constant(scope, j)
            integral.initial = holding_a * scope.p("velocity_integral_time_{j}_s", j) / gain
            limit = current_limit(scope, j)
            reference, measured = self._rate_reference(scope, j), scope.measured_rate(j)
            gathered = integral.symbol / scope.p("velocity_integral_time_{j}_s", j)
            weight = scope.p(SETPOINT_WEIGHT, j)
            wanted = gain * (weight * reference - measured + gathered)
            current = ca.fmin(ca.fmax(wanted, -limit), limit)
            integral.rate = reference - measured - (wanted - current) / gain
            scope.current[j] = current
            scope.motor_torque[j] = self.torque_constant(scope, j) * current
            per_goal = gain * weight * self._position_gain(scope, j)
            at_once = 1 - scope.p("goal_interpolation_{j}", j)
            sampling.jump_per_rate = per_goal * scope.step_length()
            staircase = staircase_in_current(scope, j, self._decay_s(scope, j))
            sampling.above_end = per_goal * at_once * staircase
            if scope.has(FEEDFORWARD, j):
                jump = gain * weight * scope.p(FEEDFORWARD, j) * sampling.rate_change
                sampling.above_end += jump * above_end(scope, j, self._decay_s(scope, j))

    def _rate_reference(self, scope: Scope, joint: int) -> Expr:
        """Set-point of the rate, from the position loop."""
        lag = scope.goal[joint] - scope.measured_angle(joint)
        reference = self._position_gain(scope, joint) * lag
        if scope.has(FEEDFORWARD, joint):
            reference += scope.p(FEEDFORWARD, joint) * goal_rate(scope, joint)
        if scope.has(POSITION_INTEGRAL, joint):
            integral = scope.states[f"position_integral_{joint}_rad_s"]
            integral.rate = lag
            reference += scope.p(POSITION_INTEGRAL, joint) * integral.symbol
        return reference

    def sampled_current(self, scope: Scope, joint: int, step_s: Expr) -> Expr:
        """Return the current as it is sampled; a goal in steps gives it a saw-tooth.

        The goal jumps by (1 − λ) ġh in each step. The joint lags the goal by
        k_p (goal − q) = q̇ − k_f ġ, so ġ = q̇ + (1 − k_f) q̈ / k_p. A held goal is late by half a
        step, and its last jump by one and a half. At the end of the step the current is below its
        mean in proportion to ġ, like negative viscous friction and inertia. Feed-forward jumps by
        k_f g̈h, whatever the goal does within the step. The position integral is too slow to matter.
        """
        gain = scope.p("velocity_gain_{j}_a_s_rad", joint) * scope.p(SETPOINT_WEIGHT, joint)
        follow_per_s = self._position_gain(scope, joint)
        forward, acceleration = scope.p(FEEDFORWARD, joint), scope.mean_acceleration[joint]
        lead_s = (1 - forward) / follow_per_s - scope.p("current_phase_{j}", joint) * step_s
        jump = gain * follow_per_s * step_s * (scope.rate[joint] + lead_s * acceleration)
        at_once = 1 - scope.p("goal_interpolation_{j}", joint)
        above = at_once * jump + gain * forward * step_s * acceleration
        phase = sampling_phase(scope, joint, step_s)
        return scope.current[joint] + above * above_mean(phase, step_s, self._decay_s(scope, joint))

    def _position_gain(self, scope: Scope, joint: int) -> Expr:
        """Set-point of the rate per position error."""
        return scope.position_gain_scale[joint] * scope.p("position_gain_{j}_per_s", joint)

    def _decay_s(self, scope: Scope, joint: int) -> Expr:
        """Time constant of the velocity loop."""
        gain = scope.p("velocity_gain_{j}_a_s_rad", joint)
        return self.reflected_inertia(scope, joint) / (self.torque_constant(scope, joint) * gain)


# The goal within a step


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


def declare_shaped_goal(scope: Scope, joint: int) -> None:
    """Add a goal as an input and its shape within the step; set `goal`, `sampling`, `start`."""
    declare_goal(scope, joint)
    sent, unit, step_s = scope.goal[joint], scope.suffix["angle"], scope.step_length()
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
        scope.states["step_phase"].rate = 1 / scope.step_length()
    at_end = 1 - scope.p("goal_interpolation_{j}", joint)
    phase = scope.states["step_phase"].symbol
    return scope.goal[joint] + at_end * scope.sampling[joint].goal_change * (phase - 0.5)


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


def goal_rate(scope: Scope, joint: int) -> Expr:
    """Rate of the goal in this step, after the command port."""
    sampling = scope.sampling[joint]
    sent, late = sampling.goal_change / scope.step_length(), sampling.delay
    return sent if late is None else sent + late.share * (late.rate - sent)


def _declare_goal_rate_change(scope: Scope, joint: int) -> None:
    """Add the goal's change of rate since the previous step as a state."""
    unit = scope.suffix["angle"]
    name = f"goal_rate_change_{joint}_{unit}_s"
    scope.sampling[joint].rate_change = scope.state(Variable(name, f"{unit}/s", nominal=0.1))
    change = scope.states[f"goal_change_{joint}_{unit}"]
    scope.states[name].begin = (change.begin - change.symbol) / scope.step_s


# The saw-tooth of the current


def staircase_in_current(scope: Scope, joint: int, decay_s: Expr) -> Expr:
    """Change of the goal in a step times the current's sample above the twin's, per jump."""
    step_s, sampling = scope.step_length(), scope.sampling[joint]
    at_once, late = sampling.goal_change * above_end(scope, joint, decay_s), sampling.delay
    if late is None:
        return at_once
    phase = sampling_phase(scope, joint, step_s) + late.phase_shift
    late_phase = ca.fmin(ca.fmax(phase, 0.0), 1.0)
    delayed = late.rate * step_s * above_mean(late_phase, step_s, decay_s)
    return at_once + late.share * (delayed - at_once)


def above_end(scope: Scope, joint: int, decay_s: Expr) -> Expr:
    """Sampled current minus that at the end of the step, per jump of the current."""
    step_s = scope.step_length()
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
