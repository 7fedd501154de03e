"""Drives: torque on a joint and motor current from a goal or a command.

Every drive has a reflected inertia; friction is an effect. All joints of a plant have the same kind
of drive, each with parameters of its own.
"""

from __future__ import annotations

from typing import ClassVar, Final, Protocol

import casadi as ca

from models.plant.parameter import Parameter
from models.plant.scope import Expr, Scope
from models.plant.step_model import Variable

SI_UNIT_OF: Final = {"rad": "rad", "m": "m", "nm": "N.m", "n": "N"}


class Drive(Protocol):
    """Interface of a drive.

    Attributes
    ----------
    kind : str
        Name in a plant document.
    features : tuple of str
        Features that effects may need (`models.plant.effects.Need`).
    has_presliding : bool
        Whether dry friction has bristles and depends on the drive's torque on the gear.
    """

    kind: ClassVar[str]
    features: ClassVar[tuple[str, ...]]
    has_presliding: ClassVar[bool]

    def parameters(self, scope: Scope) -> tuple[Parameter, ...]:
        """Parameters for the joints of `scope`."""
        ...

    def declare(self, scope: Scope) -> None:
        """Add inputs and states; set `goal` and `start`."""
        ...

    def apply_control(self, scope: Scope) -> None:
        """Set `current` and `motor_torque` by the control law."""
        ...

    def reflected_inertia(self, scope: Scope, joint: int) -> Expr:
        """Inertia of the drive seen from the joint."""
        ...

    def torque_constant(self, scope: Scope, joint: int) -> Expr:
        """Torque at the joint per ampere."""
        ...

    def sampled_current(self, scope: Scope, joint: int, step_s: Expr) -> Expr:
        """Current at the end of a step whose mean current is `scope.current`.

        Parameters
        ----------
        scope : Scope
            With `current` set.
        joint : int
            Number of the joint.
        step_s : SX
            Length of the step.
        """
        ...


def declare_goal(scope: Scope, joint: int) -> None:
    """Add the goal of a joint as an input; set `goal` and `start`."""
    angle = scope.suffix["angle"]
    goal = scope.input(
        Variable(
            f"goal_{joint}_{angle}", SI_UNIT_OF[angle], 0.0, f"goal of joint {joint}", nominal=0.5
        )
    )
    scope.goal[joint] = goal
    scope.start[joint] = goal - scope.encoder_error[joint]


def start_offset_parameter(scope: Scope, joint: int) -> Parameter:
    """Return the offset of the first position, for a joint without a stiff position loop."""
    angle = scope.suffix["angle"]
    return Parameter(
        name=f"start_offset_{joint}_{angle}", unit=SI_UNIT_OF[angle],
        value=0.0, low=-10.0, high=10.0,
        description="first position, from the first goal or from zero; of a trial, as measured",
        source="at the goal",
    )  # fmt: skip


def friction_speed_parameter(scope: Scope, joint: int) -> Parameter:
    """Return the speed that regularises the dry friction of a drive."""
    angle = scope.suffix["angle"]
    return Parameter(
        name=f"friction_speed_{joint}_{angle}_s", unit=f"{SI_UNIT_OF[angle]}/s",
        value=0.02 if angle == "rad" else 0.002, low=0.005 if angle == "rad" else 1e-4, high=0.2,
        description="speed below which dry friction is linear in the rate",
        source="numerical: 3 % of the study's peak rate",
    )  # fmt: skip


class Cascade:
    """P position → PI velocity → current, as the Dynamixel PRO runs it.

    docs/sources.md, "The servo".

    With e = k_p (goal − q) − q̇::

        i = k_v (e + I / T_i),   İ = e,   τ = k_t i

    the current clipped to its limit, and I held back while it is (back-calculation).
    """

    kind: ClassVar[str] = "cascade"
    features: ClassVar[tuple[str, ...]] = ("current", "current limit")
    has_presliding: ClassVar[bool] = False

    def parameters(self, scope: Scope) -> tuple[Parameter, ...]:
        """Gains, torque constant, inertia and limit of each joint."""
        result: list[Parameter] = []
        for j in scope.joints:
            result += [
                Parameter(name=f"position_gain_{j}_per_s", unit="1/s", value=12.0, low=2.0,
                          high=60.0, role="nuisance", description="position loop: rate per error",
                          source='docs/sources.md, "The servo"'),
                Parameter(name=f"velocity_gain_{j}_a_s_rad", unit="A.s/rad", value=18.4, low=2.0,
                          high=60.0, role="nuisance", description="current per rate error",
                          source='docs/sources.md, "The servo": 150 rad/s on the inertia'),
                Parameter(name=f"velocity_integral_time_{j}_s", unit="s", value=0.5, low=0.02,
                          high=5.0, role="nuisance", description="integral time of the rate error",
                          source="assumed: slower than the position loop"),
                Parameter(name=f"torque_constant_{j}_nm_a", unit="N.m/A", value=6.83, low=2.0,
                          high=15.0, description="torque at the output per ampere",
                          source='docs/sources.md, "The servo"'),
                Parameter(name=f"rotor_inertia_{j}_kg_m2", unit="kg.m2", value=0.84, low=0.4,
                          high=2.0, role="nuisance", description="rotor inertia at the output",
                          source='docs/sources.md, "The servo": recalled'),
                Parameter(name=f"current_limit_{j}_a", unit="A", value=10.0, low=0.5, high=50.0,
                          description="rated current limit", source='docs/sources.md, "The servo"'),
                friction_speed_parameter(scope, j),
            ]  # fmt: skip
        return tuple(result)

    def declare(self, scope: Scope) -> None:
        """Add goals as inputs and the integral of the velocity error as a state."""
        for j in scope.joints:
            declare_goal(scope, j)
            scope.state(Variable(f"velocity_integral_{j}_rad", "rad", nominal=0.01))

    def apply_control(self, scope: Scope) -> None:
        """Set current and torque by both loops."""
        for j in scope.joints:
            integral = scope.states[f"velocity_integral_{j}_rad"]
            gain = scope.p("velocity_gain_{j}_a_s_rad", j)
            held = scope.holding_torque[j] / self.torque_constant(scope, j)
            integral.initial = held * scope.p("velocity_integral_time_{j}_s", j) / gain
            limit = scope.p("current_limit_{j}_a", j) - scope.current_limit_reduction[j]
            error = (
                scope.p("position_gain_{j}_per_s", j) * (scope.goal[j] - scope.measured_angle(j))
                - scope.rate[j]
            )
            wanted = gain * (error + integral.symbol / scope.p("velocity_integral_time_{j}_s", j))
            current = ca.fmin(ca.fmax(wanted, -limit), limit)
            integral.rate = error - (wanted - current) / gain
            scope.current[j] = current
            scope.motor_torque[j] = self.torque_constant(scope, j) * current

    def reflected_inertia(self, scope: Scope, joint: int) -> Expr:
        """Rotor inertia times gear ratio squared."""
        return scope.p("rotor_inertia_{j}_kg_m2", joint)

    def torque_constant(self, scope: Scope, joint: int) -> Expr:
        """Torque constant at the output."""
        return scope.torque_scale[joint] * scope.p("torque_constant_{j}_nm_a", joint)

    def sampled_current(self, scope: Scope, joint: int, step_s: Expr) -> Expr:
        """Current at the end of a step; the staircase of the goal makes the current a saw-tooth.

        Each step the goal jumps by q̇h and the current by k_v k_p q̇h, which then decays with the
        velocity loop, τ = J / (k_t k_v). The current at the end of the step differs from its mean
        by k_v k_p q̇h (r / (1 − r) − τ/h), r = exp(−h/τ). The difference is negative and
        proportional to the rate, like negative viscous friction.
        """
        gain = scope.p("velocity_gain_{j}_a_s_rad", joint)
        decay_s = self.reflected_inertia(scope, joint) / (self.torque_constant(scope, joint) * gain)
        left = ca.exp(-step_s / decay_s)
        jump = gain * scope.p("position_gain_{j}_per_s", joint) * step_s * scope.rate[joint]
        return scope.current[joint] + jump * (left / (1 - left) - decay_s / step_s)


BRISTLE_DAMPING_S: Final = 5e-3
"""Damping time of the bristles: a joint that sticks oscillates for a few periods only."""

BRISTLE_REVERSAL_S: Final = 5e-4
"""Shortest time in which the bristles reverse; half an internal step."""


def declare_presliding(scope: Scope, joint: int) -> None:
    """Add the torque of the drive on a small gear and the presliding of its friction.

    The drive loads the teeth as the load does (BAM), so friction depends on its torque. Dry
    friction holds a joint at rest by bristles that bend before they slide (Dahl 1968)::

        ż = (q̇ − |q̇| z) / (δ + |q̇| T),   direction = z + T_d ż

    z reaches sign(q̇) within the distance δ and is constant at rest, where a smooth sign of the
    rate alone would let the joint creep. T bounds the rate of change for the integrator.
    """
    scope.gear_drive_torque[joint] = ca.SX.sym(f"drive_torque_{joint}")
    z = scope.state(Variable(f"bristle_{joint}", "1"))
    speed = ca.fabs(scope.rate[joint])
    reach = scope.p("presliding_{j}_{angle}", joint) + speed * BRISTLE_REVERSAL_S
    scope.states[z.name()].rate = (scope.rate[joint] - speed * z) / reach
    scope.friction_direction[joint] = z + BRISTLE_DAMPING_S * scope.states[z.name()].rate


class Duty:
    """DC motor with a proportional duty cycle, the position control of small Dynamixels.

        d = clip(k_d (goal − q), ±1),   i = clip((d V − k_t q̇) / R, ±i_max),   τ = k_t i

    The supply voltage V is an input: a drop of it resembles friction (README of the data). With
    torque disabled (`enabled` is 0) the winding is open: no current, hence no braking. Source: BAM
    (docs/sources.md, "Real recordings").
    """

    kind: ClassVar[str] = "duty"
    features: ClassVar[tuple[str, ...]] = ("current", "current limit")
    has_presliding: ClassVar[bool] = True

    def parameters(self, scope: Scope) -> tuple[Parameter, ...]:
        """Duty per error, winding and inertia of each joint."""
        result: list[Parameter] = []
        for j in scope.joints:
            result += [
                Parameter(name=f"duty_gain_{j}", unit="1/rad", value=1.15, low=0.01, high=50.0,
                          description="duty per radian of error",
                          source="kp · 651.9 / (256 · 885) for kp = 400 (README of the data)"),
                start_offset_parameter(scope, j),
                Parameter(name=f"winding_resistance_{j}_ohm", unit="Ohm", value=3.5, low=0.1,
                          high=50.0, role="nuisance", description="resistance of the winding",
                          source="assumed: 1.5 A stall at 5 V"),
                Parameter(name=f"torque_constant_{j}_nm_a", unit="N.m/A", value=0.36, low=0.01,
                          high=10.0, role="nuisance", description="torque and back EMF constant",
                          source="assumed: 0.52 N·m stall at 1.5 A"),
                Parameter(name=f"rotor_inertia_{j}_kg_m2", unit="kg.m2", value=0.002, low=1e-4,
                          high=0.1, role="nuisance", description="rotor inertia at the output",
                          source="assumed"),
                Parameter(name=f"current_limit_{j}_a", unit="A", value=3.0, low=0.1, high=50.0,
                          description="rated current limit",
                          source="assumed: twice the stall current at 5 V"),
                Parameter(name=f"presliding_{j}_rad", unit="rad", value=0.002, low=1e-4, high=0.1,
                          description="distance in which dry friction reverses",
                          source="assumed: two steps of the encoder"),
            ]  # fmt: skip
        return tuple(result)

    def declare(self, scope: Scope) -> None:
        """Add goal, supply voltage and torque enable as inputs."""
        for j in scope.joints:
            declare_goal(scope, j)
            scope.start[j] += scope.p("start_offset_{j}_{angle}", j)
            scope.input(Variable(f"supply_{j}_v", "V", 5.0, "measured supply", 0.0, nominal=5.0))
            scope.input(Variable(f"enabled_{j}", "1", 1.0, "1 where torque is enabled", 0.0, 1.0))

    def apply_control(self, scope: Scope) -> None:
        """Set the current through the winding, and its torque."""
        for j in scope.joints:
            duty = scope.p("duty_gain_{j}", j) * (scope.goal[j] - scope.measured_angle(j))
            duty = ca.fmin(ca.fmax(duty, -1), 1)
            constant = self.torque_constant(scope, j)
            voltage = duty * scope.inputs[f"supply_{j}_v"][1] - constant * scope.rate[j]
            wanted = voltage / scope.p("winding_resistance_{j}_ohm", j)
            limit = scope.p("current_limit_{j}_a", j) - scope.current_limit_reduction[j]
            limit = ca.fmax(limit, 0)
            closed = scope.inputs[f"enabled_{j}"][1]
            scope.current[j] = closed * ca.fmin(ca.fmax(wanted, -limit), limit)
            scope.motor_torque[j] = constant * scope.current[j]

    def reflected_inertia(self, scope: Scope, joint: int) -> Expr:
        """Rotor inertia times gear ratio squared."""
        return scope.p("rotor_inertia_{j}_kg_m2", joint)

    def torque_constant(self, scope: Scope, joint: int) -> Expr:
        """Torque constant at the output."""
        return scope.torque_scale[joint] * scope.p("torque_constant_{j}_nm_a", joint)

    def sampled_current(self, scope: Scope, joint: int, step_s: Expr) -> Expr:
        """Mean current of the step: without a velocity loop there is no saw-tooth."""
        return scope.current[joint]


class Force:
    """Force in proportion to a commanded voltage: F = k u.

    Source: EMPS (docs/sources.md, "Real recordings").
    """

    kind: ClassVar[str] = "force"
    features: ClassVar[tuple[str, ...]] = ()
    has_presliding: ClassVar[bool] = False

    def parameters(self, scope: Scope) -> tuple[Parameter, ...]:
        """Force (or torque) per volt of each joint."""
        torque = scope.suffix["torque"]
        result: list[Parameter] = []
        for j in scope.joints:
            result += [
                Parameter(name=f"force_constant_{j}_{torque}_v", unit=f"{SI_UNIT_OF[torque]}/V",
                          value=35.1507, low=0.01, high=1e3,
                          description="force per volt of command",
                          source="EMPS, README of the data"),
                start_offset_parameter(scope, j),
                friction_speed_parameter(scope, j),
            ]  # fmt: skip
        return tuple(result)

    def declare(self, scope: Scope) -> None:
        """Add the command voltage as an input."""
        for j in scope.joints:
            scope.goal[j] = scope.input(
                Variable(f"command_{j}_v", "V", 0.0, f"command of joint {j}")
            )
            scope.start[j] = scope.p("start_offset_{j}_{angle}", j)

    def apply_control(self, scope: Scope) -> None:
        """Set the force in proportion to the command; no current is measured."""
        for j in scope.joints:
            scope.motor_torque[j] = self.torque_constant(scope, j) * scope.goal[j]

    def reflected_inertia(self, scope: Scope, joint: int) -> Expr:
        """None: the moving mass is the load's."""
        return ca.SX(0)

    def torque_constant(self, scope: Scope, joint: int) -> Expr:
        """Force per volt; the command takes the place of the current."""
        return scope.p("force_constant_{j}_{torque}_v", joint) * scope.torque_scale[joint]

    def sampled_current(self, scope: Scope, joint: int, step_s: Expr) -> Expr:
        """Mean current of the step: without a velocity loop there is no saw-tooth."""
        return scope.current[joint]


DRIVES: Final[dict[str, type[Drive]]] = {d.kind: d for d in (Cascade, Duty, Force)}
"""Drives by their name in a plant document."""
