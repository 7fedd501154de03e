"""Drive with a position loop and a velocity loop: the cascade of a Dynamixel PRO."""

from __future__ import annotations

from typing import Final

import casadi as ca

from firmware_py.link.link_description import STUDY_LINK
from models.plant.components.drive import Drive, current_limit, friction_speed_parameter
from models.plant.components.goal import (
    above_end,
    above_mean,
    declare_goal_rate_change,
    declare_shaped_goal,
    declare_step_length,
    goal_rate,
    goal_rate_change,
    goal_shape_parameters,
    sampling_phase,
    staircase_in_current,
)
from models.plant.parameter import Parameter
from models.plant.scope import Expr, Scope
from models.plant.step_model import Variable

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
            if FEEDFORWARD.format(j=j) not in scope.absent:
                declare_goal_rate_change(scope, j)
            if POSITION_INTEGRAL.format(j=j) not in scope.absent:
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
            sampling.jump_per_rate = per_goal * declare_step_length(scope)
            staircase = staircase_in_current(scope, j, self._decay_s(scope, j))
            sampling.above_end = per_goal * at_once * staircase
            if FEEDFORWARD.format(j=j) not in scope.absent:
                jump = gain * weight * scope.p(FEEDFORWARD, j) * goal_rate_change(scope, j)
                sampling.above_end += jump * above_end(scope, j, self._decay_s(scope, j))

    def _rate_reference(self, scope: Scope, joint: int) -> Expr:
        """Set-point of the rate, from the position loop."""
        lag = scope.goal[joint] - scope.measured_angle(joint)
        reference = self._position_gain(scope, joint) * lag
        if FEEDFORWARD.format(j=joint) not in scope.absent:
            reference += scope.p(FEEDFORWARD, joint) * goal_rate(scope, joint)
        if POSITION_INTEGRAL.format(j=joint) not in scope.absent:
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
