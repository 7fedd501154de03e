"""Symbols of a plant during composition: parameters, states, inputs and physical quantities.

Drive, load and effects do not refer to each other. Each reads and changes quantities of the scope,
which are symbolic expressions by joint or by hinge, in the order of the ports
(`models.plant.effects.PORTS`)::

    sensor → command → stiffness → mass → bend_torque → joint_torque → servo_torque → motion
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import msgspec

from firmware_py.link.link_description import STUDY_LINK
from firmware_py.link.marker_layout import MarkerLayout
from models.plant.parameter import Parameter
from models.plant.step_model import Variable

Expr = Any
"""A CasADi SX expression."""

Hinge = tuple[str, int]
"""A hinge of the load: its name and its plane."""

ROTARY = {"angle": "rad", "torque": "nm"}
LINEAR = {"angle": "m", "torque": "n"}
"""Suffixes of a joint's coordinate and of the torque (or force) on it, by kind of motion."""


@dataclass
class StateVariable:
    """State of a plant during composition."""

    variable: Variable
    symbol: Expr
    initial: Expr
    rate: Expr = 0
    begin: Expr | None = None  # Discrete update at the begin of a step
    finish: Expr | None = None  # Discrete update at the end of a step


@dataclass(frozen=True)
class SensorLowPass:
    """Low-pass of the measured signals of a joint."""

    time_s: Expr  # Mean delay of the filtered signals
    second_share: Expr | None  # Fraction of the delay in a second stage; None for first order
    angle_s: Expr  # Time constant of the low-pass of the coordinate
    # Mean of the current above the plant's, in units of the jumps of a goal that moves as the joint
    # does; None for a drive without a saw-tooth
    jump_fraction: Expr | None


@dataclass(frozen=True)
class DelayedStaircase:
    """Effect of a goal's delay on the saw-tooth of the current."""

    share: Expr  # Weight of the delayed goal, 0 to 1; the rest keeps the staircase without delay
    rate: Expr  # Rate of the delayed goal, without its staircase
    phase_shift: Expr  # Additional delay of the current's sample, as a fraction of the step


@dataclass
class CurrentSampling:
    """Saw-tooth of a joint's current, which a goal with a shape within the step causes."""

    goal_change: Expr  # Change of the goal in this step
    smooth_goal: Callable[[], Expr]  # Declares the goal on the line through its steps' middles
    delay: DelayedStaircase | None = None  # Delay of the goal, if an effect has one
    rate_change: Expr = 0  # Change of the goal's rate since the previous step
    jump_per_rate: Expr = 0  # Jump of the current per rate of a goal
    above_end: Expr = 0  # Sampled current minus the current at the end of the step


def _zeros() -> defaultdict[int, Expr]:
    return defaultdict(int)


def _ones() -> defaultdict[int, Expr]:
    return defaultdict(lambda: 1)


@dataclass
class Scope:
    """Symbols of one composition. An effect reads the motion and changes what its port offers."""

    # The machine
    joints: tuple[int, ...]  # Numbers of the joints: (1,) or (1, 2)
    suffix: dict[str, str] = field(default_factory=lambda: dict(ROTARY))  # Units in names
    columns: tuple[str, ...] = ()  # Columns of a trial that the plant declares; none for the link's
    layout: MarkerLayout | None = None  # Markers of the link; None for four rows of four
    gravity: tuple[float, float, float] = (0.0, 0.0, -1.0)  # Unit vector, z along the link at zero
    most_payload_kg: float = STUDY_LINK.most_payload_kg
    features: frozenset[str] = frozenset()  # Features of drive and load, which effects may need

    # What the parts have declared so far, by name
    step_s: Expr = field(default_factory=lambda: ca.SX.sym("step_s"))  # Length of the whole step
    states: dict[str, StateVariable] = field(default_factory=dict)
    inputs: dict[str, tuple[Variable, Expr]] = field(default_factory=dict)
    parameters: dict[str, tuple[Variable, Expr]] = field(default_factory=dict)
    absent: set[str] = field(default_factory=set)  # Parameters that are fixed at zero

    # Motion by joint, on the drive's side of the gear
    start: dict[int, Expr] = field(default_factory=_zeros)  # Coordinate at the start
    angle: dict[int, Expr] = field(default_factory=dict)
    rate: dict[int, Expr] = field(default_factory=dict)
    acceleration: dict[int, Expr] = field(default_factory=dict)  # Set where the motion is imposed
    mean_acceleration: dict[int, Expr] = field(default_factory=dict)  # Over the step that ends
    holding_torque: dict[int, Expr] = field(default_factory=dict)  # Balances the load at the start

    # Port sensor
    encoder_error: dict[int, Expr] = field(default_factory=_zeros)  # Offset of the coordinate
    encoder_ripple: dict[int, Callable[[Expr], Expr]] = field(default_factory=dict)  # Periodic
    rate_error: dict[int, Callable[[Expr], Expr]] = field(default_factory=dict)  # Of the loop
    current_bias: dict[int, Expr] = field(default_factory=_zeros)
    current_scale: dict[int, Expr] = field(default_factory=_zeros)  # Relative error
    sensor_lag: dict[int, SensorLowPass] = field(default_factory=dict)
    frame_turn_rad: tuple[Expr, Expr, Expr] = (0, 0, 0)  # Mocap about x, y, z; applied as z, x, y
    frame_scale: Expr = 0  # Relative error of the mocap's scale
    frame_delay_s: Expr = 0  # Delay of the mocap's clock
    frame_lag_s: Expr = 0  # Time constant of the mocap's first-order low-pass

    # Port command
    goal: dict[int, Expr] = field(default_factory=dict)
    sampling: dict[int, CurrentSampling] = field(default_factory=dict)
    position_gain_scale: dict[int, Expr] = field(default_factory=_ones)
    current_limit_reduction: dict[int, Expr] = field(default_factory=_zeros)

    # Ports stiffness and bend_torque, by hinge and plane
    bend: dict[Hinge, Expr] = field(default_factory=dict)
    bend_rate: dict[Hinge, Expr] = field(default_factory=dict)
    stiffness: dict[Hinge, Expr] = field(default_factory=dict)
    limit_moment: Expr = 0  # Of the root of a link
    bend_torque: dict[Hinge, Expr] = field(default_factory=dict)
    rest_bend: dict[Hinge, Expr] = field(default_factory=dict)  # At rest upright, for the DI
    cross_bend: dict[str, Expr] = field(default_factory=dict)  # Across the plane of a single joint

    # Port mass
    payload_kg: Expr = 0
    payload_offset_m: Expr = 0  # Towards +x

    # Ports joint_torque and servo_torque
    joint_torque: dict[int, Expr] = field(default_factory=_zeros)  # Without motor and friction
    transmitted_torque: dict[int, Expr] = field(default_factory=dict)  # Load on the gear at rest
    gear_drive_torque: dict[int, Expr] = field(default_factory=dict)  # Of the drive on a small gear
    friction: dict[int, Expr] = field(default_factory=_zeros)  # Opposes `rate`
    friction_direction: dict[int, Expr] = field(default_factory=dict)  # Sign with presliding
    torque_scale: dict[int, Expr] = field(default_factory=_ones)  # Of the torque constant
    current: dict[int, Expr] = field(default_factory=dict)
    motor_torque: dict[int, Expr] = field(default_factory=dict)
    # Lost motion: the load's coordinate is angle - windup
    windup: dict[int, Expr] = field(default_factory=_zeros)
    windup_rate: dict[int, Expr] = field(default_factory=_zeros)
    windup_acceleration: dict[int, Expr] = field(default_factory=_zeros)
    # Angle by which the markers lean in the mount, without mass
    lean: dict[int, Expr] = field(default_factory=_zeros)
    lean_rate: dict[int, Expr] = field(default_factory=_zeros)
    lean_acceleration: dict[int, Expr] = field(default_factory=_zeros)

    def __post_init__(self) -> None:
        self.holding_torque = {j: ca.SX.sym(f"holding_{j}") for j in self.joints}

    def declare(self, parameters: Sequence[Parameter]) -> None:
        """Add parameters and create a symbol for each."""
        for q in parameters:
            self.parameters[q.name] = (variable_of(q), ca.SX.sym(q.name))
            if is_absent(q):
                self.absent.add(q.name)

    def name(self, pattern: str, joint: int | None = None) -> str:
        """Name with the placeholders `{j}`, `{angle}` and `{torque}` of its pattern filled in."""
        return pattern.format(j=joint, **self.suffix)

    def p(self, pattern: str, joint: int | None = None) -> Expr:
        """Symbol of the parameter with this `name`."""
        return self.parameters[self.name(pattern, joint)][1]

    def has(self, pattern: str, joint: int | None = None) -> bool:
        """Whether the parameter with this `name` is not fixed at zero."""
        return self.name(pattern, joint) not in self.absent

    def input(self, variable: Variable) -> Expr:
        """Add an input and return its symbol."""
        symbol = ca.SX.sym(variable.name)
        self.inputs[variable.name] = (variable, symbol)
        return symbol

    def state(self, variable: Variable, initial: Expr = 0.0) -> Expr:
        """Add a state and return its symbol; it is constant until a rate or an update is set."""
        symbol = ca.SX.sym(variable.name)
        self.states[variable.name] = StateVariable(variable, symbol, initial)
        return symbol

    def step_length(self) -> Expr:
        """Length of the step as a state, for outputs and rates; added if there is none yet."""
        if "step_s" not in self.states:
            self.state(Variable("step_s", "s", nominal=0.017), 1.0)
            self.states["step_s"].begin = self.step_s
        return self.states["step_s"].symbol

    def measured_angle(self, joint: int) -> Expr:
        """Joint coordinate as the encoder measures it."""
        reading = self.angle[joint] + self.encoder_error[joint]
        if joint in self.encoder_ripple:
            reading = reading + self.encoder_ripple[joint](self.angle[joint])
        return reading

    def measured_rate(self, joint: int) -> Expr:
        """Rate of the joint as the velocity loop measures it."""
        error = self.rate_error[joint](self.angle[joint]) if joint in self.rate_error else 0
        return self.rate[joint] * (1 + error)

    def true_angle(self, joint: int, reading: Expr) -> Expr:
        """Joint coordinate at which the encoder shows `reading`."""
        angle = reading - self.encoder_error[joint]
        if joint in self.encoder_ripple:
            smooth = angle
            # Each fixed-point step reduces the error by the slope of the ripple, below 0.1 for a
            # ripple of 6 mrad with 16 periods a turn.
            for _ in range(3):
                angle = smooth - self.encoder_ripple[joint](angle)
        return angle

    def ripple_since_upright(self, joint: int) -> Expr:
        """Periodic error of the encoder minus its value at a reading of zero (upright)."""
        if joint not in self.encoder_ripple:
            return 0
        ripple = self.encoder_ripple[joint]
        return ripple(self.angle[joint]) - ripple(self.true_angle(joint, 0))

    def initial_value(self, expression: Expr) -> Expr:
        """Value of an expression at the start, as a function of the bends (solved last)."""
        bends = {b.name() for b in self.bend.values()}
        still = [(s.symbol, s.initial) for n, s in self.states.items() if n not in bends]
        return substitute(expression, still)


def variable_of(q: Parameter) -> Variable:
    """Convert a parameter to a variable of a step model."""
    nominal = max(abs(q.value), abs(q.high) * 1e-3, 1e-9)
    return Variable(q.name, q.unit, q.value, q.description, q.low, q.high, nominal)


def without_values(parameters: Mapping[str, Parameter]) -> tuple[tuple[str, Parameter], ...]:
    """Parameters reduced to what a composition depends on: no values except fixed zeros."""
    return tuple(
        (name, msgspec.structs.replace(q, value=float(not is_absent(q)), error=None, source=""))
        for name, q in parameters.items()
    )


def is_absent(q: Parameter) -> bool:
    """Whether a parameter is fixed at zero."""
    return q.role == "fixed" and q.value == 0


def substitute(expression: Expr, pairs: Sequence[tuple[Expr, Expr]]) -> Expr:
    """Replace the first of each pair by the second, all at once."""
    if not pairs:
        return expression
    old, new = (ca.vertcat(*side) for side in zip(*pairs, strict=True))
    return ca.substitute(ca.SX(expression), old, ca.densify(ca.SX(new)))
