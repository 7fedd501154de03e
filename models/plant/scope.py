"""Effect of a delayed goal on the saw-tooth of the current.

Low-pass of the measured signals of a joint: set by an effect, applied by the composition.

Symbols of a plant during composition: parameters, states, inputs and physical quantities.

Drive, load and effects do not refer to each other. Each reads and changes quantities of the scope,
which are symbolic expressions by joint or by hinge, in the order of the ports
(`models.plant.effects.PORTS`)::

    sensor → command → stiffness → mass → bend_torque → joint_torque → servo_torque → motion
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import casadi as ca
import msgspec

from firmware_py.link.link_description import STUDY_LINK
from firmware_py.link.marker_layout import MarkerLayout
from models.plant.parameter import Parameter
from models.plant.step_model import Variable


@dataclass(frozen=True)
class DelayedStaircase:
    """Effect of a goal's delay on the saw-tooth of the current."""

    # Weight of the delayed goal, 0 to 1; the remainder keeps the staircase without delay
    share: ca.SX
    rate: ca.SX  # Rate of the delayed goal, without its staircase
    phase_shift: ca.SX  # Additional delay of the current's sample, as a fraction of the step


@dataclass(frozen=True)
class SensorLowPass:
    """Low-pass of the measured signals of a joint."""

    time_s: Any  # Mean delay of the filtered signals
    # Fraction of the delay in a second stage, 0.5 for two equal stages; None for first order
    second_share: Any | None
    angle_s: Any  # Time constant of the first-order low-pass of the coordinate
    # Mean of the current above the plant's, in units of the jumps of a goal that moves as the joint
    # does; None for a drive without a saw-tooth
    jump_fraction: Any | None = None


Expr = Any
"""A CasADi SX expression."""

Hinge = tuple[str, int]
"""A hinge of the load: its name and its plane."""

ROTARY = {"angle": "rad", "torque": "nm"}
LINEAR = {"angle": "m", "torque": "n"}
"""Suffixes of a joint's coordinate and of the torque (or force) on it, by kind of motion."""

READING_ITERATIONS: Final = 3
"""Fixed-point steps from an encoder's reading to the coordinate; each reduces the error by the
slope of the ripple, below 0.1 for a ripple of 6 mrad with 16 periods a turn."""


@dataclass
class StateVariable:
    """State of a plant during composition."""

    variable: Variable  # Name, unit and bounds
    symbol: Expr
    initial: Expr  # Value at the start
    rate: Expr = 0
    begin: Expr | None = None  # Discrete update at the begin of a step; None for none
    finish: Expr | None = None  # Discrete update at the end of a step; None for none


@dataclass
class Scope:
    """Symbols of one composition.

    Attributes
    ----------
    joints : tuple of int
        Numbers of the joints: (1,) or (1, 2).
    suffix : dict
        Unit suffixes of names: `ROTARY` or `LINEAR`.
    step_s : SX
        Length of the whole step, for discrete updates.
    states, inputs, parameters : dict by name
        What the parts have declared so far.
    absent : set of str
        Parameters that are fixed at zero.
    goal, start : dict by joint
        Goal after the command port; coordinate of the joint at the start.
    goal_change, current_jump_per_rate, sampled_above : dict by joint
        Change of a shaped goal per step; jump of the current per its rate; height of the current's
        sample above the step's end.
    goal_without_staircase : dict by joint
        Function that declares and returns the line through the middles of a shaped goal's steps.
    delayed_staircase : dict by joint
        Delay of a shaped goal, if any.
    angle, rate, acceleration : dict by joint
        Coordinate and rate on the drive's side of the gear; acceleration where it is imposed.
    mean_acceleration : dict by joint
        Mean of an imposed acceleration over the step that ends.
    holding_torque : dict by joint
        Drive torque that balances the load at the start.
    friction_direction : dict by joint
        Smooth sign of the rate with presliding, from drives with the feature "smooth friction".
    current, motor_torque : dict by joint
        Current and torque of the drive.
    friction, joint_torque : dict by joint
        Friction, which opposes `rate`; sum of all other torques on the joint.
    transmitted_torque, gear_drive_torque : dict by joint
        Torque on the gear from the load, without its inertia, and from the drive; set where the
        friction depends on it.
    torque_scale, position_gain_scale, current_limit_reduction : dict by joint
        Factors on the drive's torque and position gain; reduction of its current limit.
    windup, windup_rate, windup_acceleration : dict by joint
        Lost motion in the gear: the load's coordinate is angle - windup.
    lean, lean_rate, lean_acceleration : dict by joint
        Angle by which the link's markers lean in the mount; it moves no mass.
    bend, bend_rate, stiffness, bend_torque : dict by hinge
        Bend of the load's hinges, its rate, the hinge's stiffness and the torque on the bend.
    cross_bend, rest_bend : dict by hinge
        Bend across the plane of a single joint, by the hinge's name, if any; bend at rest upright,
        the reference of the Deformation Index.
    payload_kg, payload_offset_m : SX
        Mass at the tip and its offset towards +x.
    encoder_error, current_bias, current_scale : dict by joint
        Sensor errors: offset of the angle; offset of the current; relative error of the current.
    encoder_ripple, rate_error : dict by joint
        Functions of the coordinate, if any: periodic error of the encoder; relative error of the
        rate in the velocity loop.
    sensor_lag : dict by joint
        Low-pass of the joint's signals, if any.
    frame_turn_rad, frame_scale, frame_delay_s, frame_lag_s : SX
        Errors of the motion capture: turn about x, y and z (a tuple, applied in the order z, x, y),
        relative error of scale, delay of the clock, time constant of its first-order low-pass.
    columns : tuple of str
        Columns of a trial that the plant's document declares; empty for the link's.
    layout : MarkerLayout or None
        Layout of the link's markers; None for four rows of four on a link of its size.
    gravity, most_payload_kg : tuple of float, float
        Unit vector of gravity, z along the link at zero angle; largest payload in kg.
    features : frozenset of str
        Features of drive and load, which effects may need.
    """

    joints: tuple[int, ...]
    suffix: dict[str, str] = field(default_factory=lambda: dict(ROTARY))
    columns: tuple[str, ...] = ()
    layout: MarkerLayout | None = None
    gravity: tuple[float, float, float] = (0.0, 0.0, -1.0)
    most_payload_kg: float = STUDY_LINK.most_payload_kg
    features: frozenset[str] = frozenset()
    step_s: Expr = field(default_factory=lambda: ca.SX.sym("step_s"))
    states: dict[str, StateVariable] = field(default_factory=dict)
    inputs: dict[str, tuple[Variable, Expr]] = field(default_factory=dict)
    parameters: dict[str, tuple[Variable, Expr]] = field(default_factory=dict)
    absent: set[str] = field(default_factory=set)
    goal: dict[int, Expr] = field(default_factory=dict)
    start: dict[int, Expr] = field(default_factory=dict)
    goal_change: dict[int, Expr] = field(default_factory=dict)
    current_jump_per_rate: dict[int, Expr] = field(default_factory=dict)
    sampled_above: dict[int, Expr] = field(default_factory=dict)
    goal_without_staircase: dict[int, Callable[[], Expr]] = field(default_factory=dict)
    delayed_staircase: dict[int, DelayedStaircase] = field(default_factory=dict)
    angle: dict[int, Expr] = field(default_factory=dict)
    rate: dict[int, Expr] = field(default_factory=dict)
    acceleration: dict[int, Expr] = field(default_factory=dict)
    mean_acceleration: dict[int, Expr] = field(default_factory=dict)
    holding_torque: dict[int, Expr] = field(default_factory=dict)
    friction_direction: dict[int, Expr] = field(default_factory=dict)
    current: dict[int, Expr] = field(default_factory=dict)
    motor_torque: dict[int, Expr] = field(default_factory=dict)
    friction: dict[int, Expr] = field(default_factory=dict)
    joint_torque: dict[int, Expr] = field(default_factory=dict)
    transmitted_torque: dict[int, Expr] = field(default_factory=dict)
    gear_drive_torque: dict[int, Expr] = field(default_factory=dict)
    torque_scale: dict[int, Expr] = field(default_factory=dict)
    position_gain_scale: dict[int, Expr] = field(default_factory=dict)
    current_limit_reduction: dict[int, Expr] = field(default_factory=dict)
    windup: dict[int, Expr] = field(default_factory=dict)
    windup_rate: dict[int, Expr] = field(default_factory=dict)
    windup_acceleration: dict[int, Expr] = field(default_factory=dict)
    lean: dict[int, Expr] = field(default_factory=dict)
    lean_rate: dict[int, Expr] = field(default_factory=dict)
    lean_acceleration: dict[int, Expr] = field(default_factory=dict)
    bend: dict[Hinge, Expr] = field(default_factory=dict)
    bend_rate: dict[Hinge, Expr] = field(default_factory=dict)
    stiffness: dict[Hinge, Expr] = field(default_factory=dict)
    bend_torque: dict[Hinge, Expr] = field(default_factory=dict)
    cross_bend: dict[str, Expr] = field(default_factory=dict)
    rest_bend: dict[Hinge, Expr] = field(default_factory=dict)
    payload_kg: Expr = 0
    payload_offset_m: Expr = 0
    encoder_error: dict[int, Expr] = field(default_factory=dict)
    current_bias: dict[int, Expr] = field(default_factory=dict)
    current_scale: dict[int, Expr] = field(default_factory=dict)
    encoder_ripple: dict[int, Callable[[Expr], Expr]] = field(default_factory=dict)
    rate_error: dict[int, Callable[[Expr], Expr]] = field(default_factory=dict)
    sensor_lag: dict[int, SensorLowPass] = field(default_factory=dict)
    frame_turn_rad: tuple[Expr, Expr, Expr] = (0, 0, 0)
    frame_scale: Expr = 0
    frame_delay_s: Expr = 0
    frame_lag_s: Expr = 0

    def __post_init__(self) -> None:
        for j in self.joints:
            self.start[j] = 0
            self.holding_torque[j] = ca.SX.sym(f"holding_{j}")
            for quantity in (
                self.friction, self.joint_torque, self.current_limit_reduction, self.windup,
                self.windup_rate, self.windup_acceleration, self.lean, self.lean_rate,
                self.lean_acceleration, self.encoder_error, self.current_bias, self.current_scale,
            ):  # fmt: skip
                quantity[j] = 0
            self.torque_scale[j] = self.position_gain_scale[j] = 1

    def declare(self, parameters: Sequence[Parameter]) -> None:
        """Add parameters and create a symbol for each."""
        for q in parameters:
            self.parameters[q.name] = (variable_of(q), ca.SX.sym(q.name))
            if is_absent(q):
                self.absent.add(q.name)

    def name(self, pattern: str, joint: int | None = None) -> str:
        """Return a name, with the placeholders of its pattern filled in.

        Parameters
        ----------
        pattern : str
            Name with `{j}`, `{angle}` and `{torque}` as placeholders.
        joint : int, optional
            Number of the joint, for `{j}`.
        """
        return pattern.format(j=joint, **self.suffix)

    def p(self, pattern: str, joint: int | None = None) -> Expr:
        """Return the symbol of a parameter.

        Parameters
        ----------
        pattern, joint
            Name of the parameter as for the method `name`.
        """
        return self.parameters[self.name(pattern, joint)][1]

    def measured_angle(self, joint: int) -> Expr:
        """Return the joint coordinate as the encoder measures it."""
        reading = self.angle[joint] + self.encoder_error[joint]
        if joint in self.encoder_ripple:
            reading = reading + self.encoder_ripple[joint](self.angle[joint])
        return reading

    def measured_rate(self, joint: int) -> Expr:
        """Return the rate of the joint as the velocity loop measures it."""
        error = self.rate_error[joint](self.angle[joint]) if joint in self.rate_error else 0
        return self.rate[joint] * (1 + error)

    def true_angle(self, joint: int, reading: Expr) -> Expr:
        """Return the joint coordinate at which the encoder shows `reading`.

        Parameters
        ----------
        joint : int
            Number of the joint.
        reading : SX
            Coordinate as the encoder measures it.
        """
        angle = reading - self.encoder_error[joint]
        if joint in self.encoder_ripple:
            smooth = angle
            for _ in range(READING_ITERATIONS):
                angle = smooth - self.encoder_ripple[joint](angle)
        return angle

    def ripple_since_upright(self, joint: int) -> Expr:
        """Return the encoder's periodic error minus its value at a reading of zero (upright)."""
        if joint not in self.encoder_ripple:
            return 0
        ripple = self.encoder_ripple[joint]
        return ripple(self.angle[joint]) - ripple(self.true_angle(joint, 0))

    def initial_value(self, expression: Expr) -> Expr:
        """Return an expression's value at the start, as a function of the bends (solved last)."""
        bends = {b.name() for b in self.bend.values()}
        still = [(s.symbol, s.initial) for n, s in self.states.items() if n not in bends]
        return substitute(expression, still)

    def input(self, variable: Variable) -> Expr:
        """Add an input and return its symbol."""
        symbol = ca.SX.sym(variable.name)
        self.inputs[variable.name] = (variable, symbol)
        return symbol

    def state(self, variable: Variable, initial: Expr = 0.0) -> Expr:
        """Add a state and return its symbol; it is constant until a rate or an update is set.

        Parameters
        ----------
        variable : Variable
            Name and unit of the state.
        initial : SX or float
            Value at the start.
        """
        symbol = ca.SX.sym(variable.name)
        self.states[variable.name] = StateVariable(variable, symbol, initial)
        return symbol


def variable_of(parameter: Parameter) -> Variable:
    """Convert a parameter to a variable of a step model."""
    q = parameter
    return Variable(
        q.name, q.unit, q.value, q.description, q.low, q.high,
        max(abs(q.value), abs(q.high) * 1e-3, 1e-9),
    )  # fmt: skip


def variables_of(
    parameters: Mapping[str, Parameter], variables: Sequence[Variable]
) -> tuple[Variable, ...]:
    """Parameters as variables of a step model, in the order of `variables`."""
    return tuple(variable_of(parameters[v.name]) for v in variables)


def without_values(parameters: Mapping[str, Parameter]) -> tuple[tuple[str, Parameter], ...]:
    """Parameters reduced to what a composition depends on: no values except fixed zeros."""
    return tuple(
        (name, msgspec.structs.replace(q, value=float(not is_absent(q)), error=None, source=""))
        for name, q in parameters.items()
    )


def is_absent(parameter: Parameter) -> bool:
    """Whether a parameter is fixed at zero."""
    return parameter.role == "fixed" and parameter.value == 0


def substitute(expression: Expr, pairs: Sequence[tuple[Expr, Expr]]) -> Expr:
    """Replace the first of each pair by the second, all at once."""
    if not pairs:
        return expression
    old, new = (ca.vertcat(*side) for side in zip(*pairs, strict=True))
    return ca.substitute(ca.SX(expression), old, ca.densify(ca.SX(new)))
