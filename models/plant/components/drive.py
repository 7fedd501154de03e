"""Drives: their base, what they share, and every kind without a position cascade.

Every drive has a reflected inertia; friction is an effect. All joints of a plant have the same kind
of drive, and parameters by joint.
"""

from __future__ import annotations

from typing import ClassVar, Final

import casadi as ca

from models.plant.parameter import NO_DEFAULT, Parameter
from models.plant.scope import Expr, Scope
from models.plant.step_model import Variable

TORQUE_UNIT: Final = {"nm": "N.m", "n": "N"}
"""SI unit of a torque or force by its suffix; the suffix of a coordinate is its unit."""


class Drive:
    """Drive of the joints: control law, motor and reflected inertia.

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
    features: ClassVar[tuple[str, ...]] = ()
    has_presliding: ClassVar[bool] = False

    def parameters(self, scope: Scope) -> list[Parameter]:
        return [q for j in scope.joints for q in self.joint_parameters(scope, j)]

    def joint_parameters(self, scope: Scope, joint: int) -> list[Parameter]:
        """Parameters of one joint."""
        raise NotImplementedError

    def declare(self, scope: Scope) -> None:
        """Add inputs and states; set `goal` and `start`."""

    def apply_control(self, scope: Scope) -> None:
        """Set `motor_torque`, and `current` if it is measured, by the control law."""

    def reflected_inertia(self, scope: Scope, joint: int) -> Expr:
        """Rotor inertia times gear ratio squared."""
        return scope.p("rotor_inertia_{j}_kg_m2", joint)

    def torque_constant(self, scope: Scope, joint: int) -> Expr:
        """Torque at the joint per ampere."""
        return scope.torque_scale[joint] * scope.p("torque_constant_{j}_nm_a", joint)

    def sampled_current(self, scope: Scope, joint: int, step_s: Expr) -> Expr:
        """Current at the end of a step; a velocity loop adds a saw-tooth to `scope.current`."""
        return scope.current[joint]


def current_limit(scope: Scope, joint: int) -> Expr:
    """Current limit of a drive, reduced by effects."""
    return scope.p("current_limit_{j}_a", joint) - scope.current_limit_reduction[joint]


def declare_goal(scope: Scope, joint: int) -> None:
    """Add the goal of a joint as an input; set `goal` and `start`."""
    unit = scope.suffix["angle"]
    goal = Variable(f"goal_{joint}_{unit}", unit, 0.0, f"goal of joint {joint}", nominal=0.5)
    scope.goal[joint] = scope.input(goal)
    scope.start[joint] = scope.true_angle(joint, scope.goal[joint])


def start_offset_parameter(scope: Scope, joint: int) -> Parameter:
    """Offset of the first position, for a joint without a stiff position loop."""
    unit = scope.suffix["angle"]
    meaning = "first position, from the first goal or from zero; of a trial, as measured"
    return Parameter(f"start_offset_{joint}_{unit}", unit, 0.0, -10.0, 10.0, meaning, "at the goal")


def start_rate_parameter(scope: Scope, joint: int) -> Parameter:
    """Rate at the start, for a joint whose trial may begin in motion."""
    unit, meaning = scope.suffix["angle"], "rate at the start; of a trial, as measured"
    name = f"start_joint_rate_{joint}_{unit}_s"
    return Parameter(name, f"{unit}/s", 0.0, -100.0, 100.0, meaning, "at rest")


def friction_speed_parameter(scope: Scope, joint: int) -> Parameter:
    """Speed that regularises the dry friction of a drive."""
    unit = scope.suffix["angle"]
    value, low = (0.02, 0.005) if unit == "rad" else (0.002, 1e-4)
    return Parameter(
        f"friction_speed_{joint}_{unit}_s", f"{unit}/s", value, low, 0.2,
        "speed below which dry friction is linear in the rate",
        "numerical: 3 % of the study's peak rate",
    )  # fmt: skip


def declare_presliding(scope: Scope, joint: int) -> None:
    """Add the torque of the drive on a small gear and the presliding of its friction.

    The drive loads the teeth like the load does (BAM), so friction depends on the drive's torque.
    Dry friction holds a joint at rest by bristles that bend before they slide (Dahl 1968)::

        ż = (q̇ − |q̇| z) / (δ + |q̇| T),   direction = z + T_d ż

    z reaches sign(q̇) within the distance δ and is constant at rest; a smooth sign of the rate alone
    would let the joint creep. T, half an internal step, is the shortest time in which the bristles
    reverse. T_d damps them: a sticking joint oscillates for a few periods only.
    """
    scope.gear_drive_torque[joint] = ca.SX.sym(f"drive_torque_{joint}")
    z = scope.state(Variable(f"bristle_{joint}", "1"))
    speed = ca.fabs(scope.rate[joint])
    reach = scope.p("presliding_{j}_{angle}", joint) + speed * 5e-4
    scope.states[z.name()].rate = (scope.rate[joint] - speed * z) / reach
    scope.friction_direction[joint] = z + 5e-3 * scope.states[z.name()].rate


class Duty(Drive):
    """DC motor whose duty cycle is proportional to the position error, as in small Dynamixels.

        d = clip(k_d (goal − q), ±1),   i = clip((d V − k_t q̇) / R, ±i_max),   τ = k_t i

    The supply voltage V is an input, because a voltage drop resembles friction (README of the
    data). With torque disabled (`enabled` is 0) the winding is open: no current, hence no braking.
    Source: BAM (docs/sources.md, "Real recordings").
    """

    kind = "duty"
    features = ("current", "current limit", "position gain")
    has_presliding = True

    def joint_parameters(self, scope: Scope, joint: int) -> list[Parameter]:
        j = joint
        return [
            Parameter(f"duty_gain_{j}", "1/rad", NO_DEFAULT, 0.01, 50.0, "duty per radian of error",
                      "register of the servo"),
            start_offset_parameter(scope, j),
            Parameter(f"winding_resistance_{j}_ohm", "Ohm", 3.5, 0.1, 50.0,
                      "resistance of the winding", "assumed: 1.5 A stall at 5 V", role="nuisance"),
            Parameter(f"torque_constant_{j}_nm_a", "N.m/A", 0.36, 0.01, 10.0,
                      "torque and back EMF constant", "assumed: 0.52 N·m stall at 1.5 A",
                      role="nuisance"),
            Parameter(f"rotor_inertia_{j}_kg_m2", "kg.m2", 0.002, 1e-4, 0.1,
                      "rotor inertia at the output", "assumed", role="nuisance"),
            Parameter(f"current_limit_{j}_a", "A", 3.0, 0.1, 50.0, "rated current limit",
                      "assumed: twice the stall current at 5 V"),
            Parameter(f"presliding_{j}_rad", "rad", 0.002, 1e-4, 0.1,
                      "distance in which dry friction reverses",
                      "assumed: two steps of the encoder"),
        ]  # fmt: skip

    def declare(self, scope: Scope) -> None:
        for j in scope.joints:
            declare_goal(scope, j)
            scope.start[j] += scope.p("start_offset_{j}_{angle}", j)
            scope.input(Variable(f"supply_{j}_v", "V", 5.0, "measured supply", 0.0, nominal=5.0))
            scope.input(Variable(f"enabled_{j}", "1", 1.0, "1 where torque is enabled", 0.0, 1.0))

    def apply_control(self, scope: Scope) -> None:
        for j in scope.joints:
            gain = scope.position_gain_scale[j] * scope.p("duty_gain_{j}", j)
            duty = gain * (scope.goal[j] - scope.measured_angle(j))
            duty = ca.fmin(ca.fmax(duty, -1), 1)
            constant = self.torque_constant(scope, j)
            voltage = duty * scope.inputs[f"supply_{j}_v"][1] - constant * scope.rate[j]
            wanted = voltage / scope.p("winding_resistance_{j}_ohm", j)
            limit = ca.fmax(current_limit(scope, j), 0)
            closed = scope.inputs[f"enabled_{j}"][1]
            scope.current[j] = closed * ca.fmin(ca.fmax(wanted, -limit), limit)
            scope.motor_torque[j] = constant * scope.current[j]


class _Proportional(Drive):
    """Drive with the torque k u of an input u; `torque_constant` is k."""

    def input_variable(self, joint: int) -> Variable:
        raise NotImplementedError

    def declare(self, scope: Scope) -> None:
        for j in scope.joints:
            scope.goal[j] = scope.input(self.input_variable(j))
            scope.start[j] = scope.p("start_offset_{j}_{angle}", j)

    def apply_control(self, scope: Scope) -> None:
        for j in scope.joints:
            scope.motor_torque[j] = self.torque_constant(scope, j) * scope.goal[j]


class Force(_Proportional):
    """Force (or torque) in proportion to a commanded voltage, F = k u; no current is measured.

    Source: EMPS (docs/sources.md, "Real recordings").
    """

    kind = "force"
    features = ("smooth friction",)

    def joint_parameters(self, scope: Scope, joint: int) -> list[Parameter]:
        torque = scope.suffix["torque"]
        return [
            Parameter(f"force_constant_{joint}_{torque}_v", f"{TORQUE_UNIT[torque]}/V",
                      NO_DEFAULT, 0.01, 1e3, "force per volt of command",
                      "data sheet of the drive"),
            start_offset_parameter(scope, joint),
            start_rate_parameter(scope, joint),
            friction_speed_parameter(scope, joint),
        ]  # fmt: skip

    def input_variable(self, joint: int) -> Variable:
        return Variable(f"command_{joint}_v", "V", 0.0, f"command of joint {joint}")

    def reflected_inertia(self, scope: Scope, joint: int) -> Expr:
        return ca.SX(0)  # the moving mass is the load's

    def torque_constant(self, scope: Scope, joint: int) -> Expr:
        return scope.p("force_constant_{j}_{torque}_v", joint) * scope.torque_scale[joint]


class Current(_Proportional):
    """Motor behind a gear whose measured current is the input: τ = k_t i.

    The loop that commands the current is not modelled. Nothing holds the joint, so its simulated
    coordinate drifts with every error of the torque.
    """

    kind = "current"
    has_presliding = True

    def joint_parameters(self, scope: Scope, joint: int) -> list[Parameter]:
        j = joint
        return [
            Parameter(f"torque_constant_{j}_nm_a", "N.m/A", NO_DEFAULT, 1e-3, 1e3,
                      "torque at the output per ampere", "data sheet of the drive"),
            Parameter(f"rotor_inertia_{j}_kg_m2", "kg.m2", 0.01, 0.0, 100.0,
                      "rotor inertia at the output", "assumed", role="nuisance"),
            Parameter(f"presliding_{j}_rad", "rad", 0.002, 1e-4, 0.1,
                      "distance in which dry friction reverses", "assumed"),
            start_offset_parameter(scope, j),
            start_rate_parameter(scope, j),
            friction_speed_parameter(scope, j),
        ]  # fmt: skip

    def input_variable(self, joint: int) -> Variable:
        description = f"measured motor current of joint {joint}"
        return Variable(f"current_{joint}_a", "A", 0.0, description)


class Measured(Drive):
    """Joint that moves as its encoder measures, whatever drives it.

    Only the load has equations of motion, so a wrong servo loop cannot hide a wrong load. The
    torque that the motion needs, with friction, is an output. The drive also describes a test bench
    that imposes a displacement and measures force. The composition adds the coordinate as an input.
    """

    kind = "measured"
    features = ("imposed motion", "smooth friction")

    def parameters(self, scope: Scope) -> list[Parameter]:
        follow_rate = Parameter(
            "follow_rate_per_s", "1/s", 200.0, 20.0, 2000.0,
            "bandwidth that follows the measured coordinate",
            "numerical: a fifth of the internal rate"
        )  # fmt: skip
        return [follow_rate, *super().parameters(scope)]

    def joint_parameters(self, scope: Scope, joint: int) -> list[Parameter]:
        rotary = scope.suffix["angle"] == "rad"
        return [
            Parameter(f"rotor_inertia_{joint}_kg_m2" if rotary else f"rotor_mass_{joint}_kg",
                      "kg.m2" if rotary else "kg", 0.0, 0.0, 1e3,
                      "inertia between the force sensor and the load", "assumed none"),
            start_rate_parameter(scope, joint),
            friction_speed_parameter(scope, joint),
        ]  # fmt: skip

    def reflected_inertia(self, scope: Scope, joint: int) -> Expr:
        rotary = scope.suffix["angle"] == "rad"
        return scope.p("rotor_inertia_{j}_kg_m2" if rotary else "rotor_mass_{j}_kg", joint)

    def torque_constant(self, scope: Scope, joint: int) -> Expr:
        """Return one: the output is the torque itself."""
        return ca.SX(1)
