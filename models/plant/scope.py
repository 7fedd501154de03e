"""What the parts of a plant see while they are put together: parameters, states and wires.

Drive, load and effects know nothing of each other. Each reads and writes wires, symbolic
expressions by joint or by hinge, in the order of the ports (`models.plant.composition.twin`)::

    sensor → command → stiffness → mass → bend_torque → joint_torque → servo_torque → motion
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import casadi as ca

from models.plant.parameter import Parameter
from models.plant.step_model import Variable

Expr = Any
"""A CasADi SX expression."""

Hinge = tuple[str, int]
"""A hinge of the load: its name and its plane."""

ROTARY = {"angle": "rad", "torque": "nm"}
LINEAR = {"angle": "m", "torque": "n"}
"""Unit suffixes of a joint's coordinate and of the torque (or force) on it."""


@dataclass
class StateVariable:
    """A state while it is composed: its symbol, how it starts, flows and jumps."""

    variable: Variable
    symbol: Expr
    initial: Expr
    rate: Expr = 0
    begin: Expr | None = None
    finish: Expr | None = None


@dataclass
class Scope:
    """Symbols of one composition.

    Attributes
    ----------
    joints : tuple of int
        (1,) or (1, 2).
    suffix : dict
        `ROTARY` or `LINEAR`.
    step_s : SX
        Length of the whole step, for discrete updates.
    goal, start, angle, rate, acceleration, holding : dict by joint
        Goal after the command port; where the joint starts; its coordinate and rate, and its
        acceleration where it is driven; torque that holds the load still at the start.
    direction : dict by joint
        Smooth sign of the rate, where the drive knows a better one than that of the rate alone.
    current, motor_torque, friction, joint_torque, transmitted, pressing : dict by joint
        Drive's current and torque; friction that opposes `rate`; other torque on the joint;
        torque that the load puts on the joint apart from its inertia; torque that the drive puts
        on the teeth from the other side, where the friction of its gear depends on that.
    torque_scale, current_limit_cut : dict by joint
        Factor on the drive's torque; reduction of its limit.
    windup, windup_rate, windup_acceleration : dict by joint
        Lost motion between the drive's side of the gear and the load's: the load stands at
        angle - windup.
    bend, bend_rate, stiffness, bend_torque, rest_bend : dict by hinge
        Bend of the load's hinges, their rates, stiffness, the torque acting on the bend, and the
        bend at rest upright.
    payload_kg, payload_offset_m : SX
        Mass at the tip and where it sits, towards +x.
    angle_error, current_bias, current_scale : dict by joint
        Sensor errors: added to the angle, added to and relative of the current.
    frame_tilt_rad, frame_delay_s : SX
        Errors of the mocap frame and clock.
    """

    joints: tuple[int, ...]
    suffix: dict[str, str] = field(default_factory=lambda: dict(ROTARY))
    step_s: Expr = field(default_factory=lambda: ca.SX.sym("step_s"))
    states: dict[str, StateVariable] = field(default_factory=dict)
    inputs: dict[str, tuple[Variable, Expr]] = field(default_factory=dict)
    parameters: dict[str, tuple[Variable, Expr]] = field(default_factory=dict)
    goal: dict[int, Expr] = field(default_factory=dict)
    start: dict[int, Expr] = field(default_factory=dict)
    angle: dict[int, Expr] = field(default_factory=dict)
    rate: dict[int, Expr] = field(default_factory=dict)
    acceleration: dict[int, Expr] = field(default_factory=dict)
    holding: dict[int, Expr] = field(default_factory=dict)
    direction: dict[int, Expr] = field(default_factory=dict)
    current: dict[int, Expr] = field(default_factory=dict)
    motor_torque: dict[int, Expr] = field(default_factory=dict)
    friction: dict[int, Expr] = field(default_factory=dict)
    joint_torque: dict[int, Expr] = field(default_factory=dict)
    transmitted: dict[int, Expr] = field(default_factory=dict)
    pressing: dict[int, Expr] = field(default_factory=dict)
    torque_scale: dict[int, Expr] = field(default_factory=dict)
    current_limit_cut: dict[int, Expr] = field(default_factory=dict)
    windup: dict[int, Expr] = field(default_factory=dict)
    windup_rate: dict[int, Expr] = field(default_factory=dict)
    windup_acceleration: dict[int, Expr] = field(default_factory=dict)
    bend: dict[Hinge, Expr] = field(default_factory=dict)
    bend_rate: dict[Hinge, Expr] = field(default_factory=dict)
    stiffness: dict[Hinge, Expr] = field(default_factory=dict)
    bend_torque: dict[Hinge, Expr] = field(default_factory=dict)
    rest_bend: dict[Hinge, Expr] = field(default_factory=dict)
    payload_kg: Expr = 0
    payload_offset_m: Expr = 0
    angle_error: dict[int, Expr] = field(default_factory=dict)
    current_bias: dict[int, Expr] = field(default_factory=dict)
    current_scale: dict[int, Expr] = field(default_factory=dict)
    frame_tilt_rad: Expr = 0
    frame_delay_s: Expr = 0

    def __post_init__(self) -> None:
        for j in self.joints:
            self.start[j] = 0
            self.holding[j] = ca.SX.sym(f"holding_{j}")
            for wire in (
                self.friction, self.joint_torque, self.current_limit_cut, self.windup,
                self.windup_rate, self.windup_acceleration,
                self.angle_error, self.current_bias, self.current_scale,
            ):  # fmt: skip
                wire[j] = 0
            self.torque_scale[j] = 1

    def declare(self, parameters: Sequence[Parameter]) -> None:
        """Make a symbol of each parameter."""
        for q in parameters:
            variable = Variable(
                q.name, q.unit, q.value, q.description, q.low, q.high,
                max(abs(q.value), abs(q.high) * 1e-3, 1e-9),
            )  # fmt: skip
            self.parameters[q.name] = (variable, ca.SX.sym(q.name))

    def name(self, pattern: str, joint: int | None = None) -> str:
        """Fill `{j}`, `{angle}` and `{torque}` of a pattern."""
        return pattern.format(j=joint, **self.suffix)

    def p(self, pattern: str, joint: int | None = None) -> Expr:
        """Symbol of a parameter."""
        return self.parameters[self.name(pattern, joint)][1]

    def seen_angle(self, joint: int) -> Expr:
        """Joint coordinate as the encoder shows it."""
        return self.angle[joint] + self.angle_error[joint]

    def at_start(self, expression: Expr) -> Expr:
        """Expression before anything moves, in terms of the bends, whose start is found last."""
        bends = {b.name() for b in self.bend.values()}
        still = [(s.symbol, s.initial) for n, s in self.states.items() if n not in bends]
        return substitute(expression, still)

    def input(self, variable: Variable) -> Expr:
        """Add an input."""
        symbol = ca.SX.sym(variable.name)
        self.inputs[variable.name] = (variable, symbol)
        return symbol

    def state(self, variable: Variable, initial: Expr = 0.0) -> Expr:
        """Add a state that holds its value until a rate or an update is given."""
        symbol = ca.SX.sym(variable.name)
        self.states[variable.name] = StateVariable(variable, symbol, initial)
        return symbol


def substitute(expression: Expr, pairs: Sequence[tuple[Expr, Expr]]) -> Expr:
    """Expression with the first of each pair replaced by the second, all at once."""
    if not pairs:
        return expression
    old, new = (ca.vertcat(*side) for side in zip(*pairs, strict=True))
    return ca.substitute(ca.SX(expression), old, ca.densify(ca.SX(new)))
