"""Base of a drive, and what several drives share: inputs, parameters, presliding of dry friction.

Every drive has a reflected inertia; friction is an effect. All joints of a plant have the same kind
of drive, and parameters by joint.
"""

from __future__ import annotations

from typing import ClassVar, Final

import casadi as ca

from models.plant.parameter import Parameter
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
