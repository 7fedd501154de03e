"""Step functions of a composed plant, and the variables that its models share.

Initial state of a composed plant: at rest, bends in equilibrium, load held by the drive.

Low-pass of measured outputs: filter states after the outputs of a composed plant.

A first-order stage of time θ delays a slow signal by θ. A stage of time zero would be infinitely
fast. So its state follows with D = √(θ² + D_0²), and the output contains the fraction θ/D of it::

    ż = (y − z) / D,   y_lagged = y + θ/D (z − y)

The mean delay is θ exactly, at zero the signal is unchanged, and all is smooth in θ. For θ well
above D_0 it is the first-order low-pass 1 / (1 + θ s) [Oppenheim & Willsky 1997]. It acts on the
current within the step; the current is sampled after it (`models.plant.composition.parts`).

Current sampled at a phase of the step, interpolated between the ends of two steps.

The drive computes the saw-tooth of a goal that jumps
(`models.plant.components.goal`). A low-pass keeps its part in phase at the frequency
of the steps. The rest of the current changes little within a step, so it is interpolated between
the ends of the step. A servo limits the current at every moment, so the sample is clipped to the
sensor's reading at the limit. The motion does not depend on the sample.

Application of the effects port by port, with the load's torques in between.

Restart of a model that is driven by measurement, at samples that cannot continue its past.

Some samples follow from no motion of a servo: a start far from zero whose first angle comes with
the first step, or an encoder that jumps. Taken as a motion, a jump of 4 rad bends the link beyond
every limit, and all later steps fail. Instead, joints and load restart at rest at the sample.
Estimates from before the jump, such as the payload, are kept.

At a state that no link can have, everything restarts at the end of the step, the estimates too.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any, Final

import casadi as ca

from firmware_py.signals import PAYLOAD, PERIOD_S
from models.plant.components.drive import current_limit
from models.plant.components.goal import declare_step_length
from models.plant.components.link import solve_symmetric
from models.plant.components.load import PlantLoad
from models.plant.effects import Effect
from models.plant.scope import Expr, Scope, substitute
from models.plant.step_model import StepModel, Variable, runge_kutta
from models.shared.catalogue import Port

MAX_SUBSTEP_S: Final = 1e-3
"""Longest Runge–Kutta step: dry friction is stiff."""

SMALLEST_STATE: Final = 1e-30
"""Magnitude below which a state is set to zero at the end of a step. A state that decays at rest
would become a subnormal number, which slows the processor (docs/sources.md, "FMI"). No state has a
meaning below it in SI units, and products of ten such states are still normal numbers (2.2e-308 and
above) [assumed]."""

COORDINATE_NAME: Final = {"rad": "angle", "m": "position"}
"""Name of a joint's measured coordinate, by the suffix of its unit."""


def payload_variable(scope: Scope, start: float = 0.0) -> Variable:
    """Payload as an input or output."""
    most_kg = scope.most_payload_kg
    start = min(start, most_kg)
    return Variable(PAYLOAD.name, PAYLOAD.unit, start, PAYLOAD.description, 0.0, most_kg)


def current_variable(joint: int) -> Variable:
    """Motor current as an input or output."""
    description = f"measured motor current of joint {joint}"
    return Variable(f"current_{joint}_a", "A", 0.0, description, sampled=True)


def measured_current(scope: Scope, joint: int, current: Expr) -> Expr:
    """Motor current as the sensor measures it."""
    return (1 + scope.current_scale[joint]) * current + scope.current_bias[joint]


def build_step_model(
    name: str,
    scope: Scope,
    outputs: dict[str, tuple[Variable, Expr]],
    max_substep_s: float = MAX_SUBSTEP_S,
    inputs_at_end: bool = False,
) -> StepModel:
    """Build the functions of a `StepModel` from a scope whose states have all values and rates."""
    x = ca.vertcat(*(s.symbol for s in scope.states.values()))
    u = ca.vertcat(*(symbol for _, symbol in scope.inputs.values()))
    p = ca.vertcat(*(symbol for _, symbol in scope.parameters.values()))
    h = scope.step_s

    def function(what: str, extra: Sequence[Expr], rows: Sequence[Expr]) -> Any:
        labels = ["x", "u", "p", "h"][: 3 + len(extra)]
        column = ca.cse(ca.densify(ca.vertcat(*(ca.SX(r) for r in rows))))
        return ca.Function(f"{name}_{what}", [x, u, p, *extra], [column], labels, ["result"])

    states = scope.states.values()
    initial = ca.cse(ca.densify(ca.vertcat(*(ca.SX(s.initial) for s in states))))
    begin = [s.symbol if s.begin is None else s.begin for s in states]
    finish = [s.symbol if s.finish is None else s.finish for s in states]
    flushed = [ca.if_else(ca.fabs(value) < SMALLEST_STATE, 0, value) for value in finish]
    rate = function("rate", [], [s.rate for s in states])
    return StepModel(
        name=name,
        inputs=tuple(v for v, _ in scope.inputs.values()),
        parameters=tuple(v for v, _ in scope.parameters.values()),
        states=tuple(s.variable for s in states),
        outputs=tuple(v for v, _ in outputs.values()),
        initial=ca.Function(f"{name}_initial", [u, p], [initial], ["u", "p"], ["x"]),
        begin=function("begin", [h], begin),
        flow=runge_kutta(f"{name}_flow", rate),
        finish=function("finish", [h], flushed),
        smooth_finish=function("smooth_finish", [h], finish),
        output=function("output", [], [expression for _, expression in outputs.values()]),
        max_substep_s=max_substep_s,
        rate=rate,
        inputs_at_end=inputs_at_end,
    )


NEWTON_STEPS: Final = 3
"""Newton steps from the straight link to the equilibrium; stiffness may depend on the bend."""

LARGEST_START_RAD: Final = 0.5
"""Limit of a bend in each Newton step: a weak link has no equilibrium near zero."""


def start_in_motion(scope: Scope) -> None:
    """Set the initial value of every state that has a parameter `start_STATE`; call it last."""
    for name, state in scope.states.items():
        if f"start_{name}" in scope.parameters:
            state.initial = scope.p(f"start_{name}")


def set_initial_equilibrium(scope: Scope, force: Expr) -> None:
    """Set the initial value of every state, and `rest_bend`.

    The joints rest at the first goal, the bends are in equilibrium there (`NEWTON_STEPS` from the
    straight link), and the drive holds the load. `rest_bend` is the equilibrium at encoder readings
    of zero (upright), the reference of the Deformation Index. `force` holds velocity and gravity
    forces over the joints' coordinates and the bends.
    """
    for state in scope.states.values():  # a state may start at another, e.g. the shaped goal
        state.initial = scope.initial_value(state.initial)
    bends = [scope.states[b.name()] for b in scope.bend.values()]
    symbols = ca.vertcat(*(b.symbol for b in bends))
    count = len(scope.joints)
    residual = ca.vertcat(*scope.bend_torque.values()) - force[count:, :]

    def at_rest(expression: Expr, angles: Sequence[Expr]) -> Expr:
        """Expression with every state except joints and bends at its initial value."""
        own = {s.name() for s in (*scope.angle.values(), *scope.bend.values())}
        still = [(s.symbol, s.initial) for n, s in scope.states.items() if n not in own]
        expression = substitute(expression, still)
        return substitute(expression, list(zip(scope.angle.values(), angles, strict=True)))

    def equilibrium(angles: Sequence[Expr]) -> Expr:
        balance = at_rest(residual, angles)
        slope = ca.jacobian(balance, symbols)
        bend = ca.SX.zeros(symbols.numel())
        for _ in range(NEWTON_STEPS):
            here = [(symbols, bend)]
            bend = bend + solve_symmetric(-substitute(slope, here), substitute(balance, here))
            bend = ca.fmin(ca.fmax(bend, -LARGEST_START_RAD), LARGEST_START_RAD)
        return bend

    start = [scope.states[a.name()].initial for a in scope.angle.values()]
    first = equilibrium(start) if bends else ca.SX(0, 1)
    upright_angles = [ca.SX(scope.true_angle(j, 0)) for j in scope.joints]
    upright = equilibrium(upright_angles) if bends else ca.SX(0, 1)
    for key, value in zip(scope.bend, ca.vertsplit(upright), strict=True):
        scope.rest_bend[key] = value
    holding = force[:count] - ca.vertcat(*scope.joint_torque.values())
    holding = substitute(at_rest(holding, start), [(symbols, first)])
    for state, value in zip(bends, ca.vertsplit(first), strict=True):
        state.initial = value
    held = list(zip(scope.holding_torque.values(), ca.vertsplit(holding), strict=True))
    for state in scope.states.values():
        state.initial = substitute(substitute(state.initial, [(symbols, first)]), held)


SHORTEST_LAG_S: Final = 2e-3
"""D_0: a pole at 500 per second, which an internal step of 2.9 ms integrates stably."""

LAGGED: Final = ("current_{j}_", "deflection_{j}_", "angle_{j}_", "position_{j}_",
    "torque_{j}_", "force_{j}_",
)  # fmt: skip
"""Start of the names of outputs that a joint's lag may act on; it acts on the first of them that
the plant's document declares."""


def lag_outputs(
    scope: Scope, outputs: dict[str, tuple[Variable, Expr]]
) -> dict[str, tuple[Variable, Expr]]:
    """Outputs with the low-pass of every joint applied to its signal."""
    result = dict(outputs)
    for j, lag in scope.sensor_lag.items():
        name = lagged_output(outputs, j, scope.columns)
        variable, value = outputs[name]
        if lag.jump_fraction is not None and name == current_variable(j).name:
            jump = lag.jump_fraction * scope.current_jump_per_rate[j] * scope.rate[j]
            value += _passed_fraction(lag.time_s) * jump
        second = lag.second_share
        shares = [1] if second is None else [1 - second, second]
        for number, share in enumerate(shares, 1):
            filtered = Variable(f"lagged_{name}_{number}", variable.unit)
            value = _stage(scope, filtered, value, share * lag.time_s)
        result[name] = (variable, value)
    return result


def lagged_output(
    outputs: dict[str, tuple[Variable, Expr]], joint: int, columns: tuple[str, ...] = ()
) -> str:
    """Name of the output that a joint's lag acts on (`LAGGED`).

    `columns` are those that the plant declares. An output that is not declared is not measured,
    like the current in a log without it; the lag then acts on the first declared output.
    """
    measured = [name for name in outputs if name in columns] or list(outputs)
    beginnings = [pattern.format(j=joint) for pattern in LAGGED]
    return next(name for start in beginnings for name in measured if name.startswith(start))


def _stage(scope: Scope, variable: Variable, value: Expr, time_s: Expr) -> Expr:
    still = [(s.symbol, s.initial) for s in scope.states.values()]
    state = scope.state(variable, substitute(value, still))
    scope.states[variable.name].rate = (value - state) / _delay_s(time_s)
    return value + _passed_fraction(time_s) * (state - value)


def _delay_s(time_s: Expr) -> Expr:
    return ca.sqrt(time_s**2 + SHORTEST_LAG_S**2)


def _passed_fraction(time_s: Expr) -> Expr:
    """Fraction θ/D of an output that passes through a filter of time θ."""
    return time_s / _delay_s(time_s)


Outputs = dict[str, tuple[Variable, Expr]]


def sampled_currents(scope: Scope, outputs: Outputs) -> Outputs:
    """Outputs with every measured current as it is sampled.

    The currents in `outputs` are those at the end of the step, after the low-pass if any.
    """
    result = dict(outputs)
    for j in scope.current:
        name = current_variable(j).name
        variable, value = outputs[name]
        if j in scope.sampled_above:
            above = (1 + scope.current_scale[j]) * scope.sampled_above[j]
            if j in scope.sensor_lag and lagged_output(outputs, j, scope.columns) == name:
                above *= _kept_fraction(scope, scope.sensor_lag[j].time_s)
            value = _within_limit(scope, j, value + above)
            # Clipped again: the line between two samples at the limit may round beyond it.
            value = _within_limit(scope, j, current_at_phase(scope, j, value))
        else:
            value = current_at_phase(scope, j, value)
        result[name] = (variable, value)
    return result


def current_at_phase(scope: Scope, joint: int, current: Expr) -> Expr:
    """Current at `current_phase` of the step; unchanged if the drive has no such parameter."""
    name = f"current_phase_{joint}"
    if name not in scope.parameters:
        return current
    phase = scope.p("current_phase_{j}", joint)
    still = [(s.symbol, s.initial) for s in scope.states.values()]
    before = scope.state(Variable(f"current_before_{joint}_a", "A"), substitute(current, still))
    scope.states[before.name()].begin = current
    return phase * current + (1 - phase) * before


def _within_limit(scope: Scope, joint: int, measured: Expr) -> Expr:
    """Measured current, limited to the sensor's reading at the current limit."""
    limit = current_limit(scope, joint)
    low, high = (measured_current(scope, joint, bound) for bound in (-limit, limit))
    return ca.fmin(ca.fmax(measured, low), high)


def _kept_fraction(scope: Scope, time_s: Expr) -> Expr:
    """In-phase gain of a first-order low-pass at the frequency of the steps."""
    return 1 / (1 + (2 * math.pi * time_s / declare_step_length(scope)) ** 2)


def apply_effects(scope: Scope, ports: Iterable[Port], effects: Sequence[Effect]) -> None:
    """Apply the effects port by port; they are in the order of `models.plant.effects`."""
    for port in ports:
        for effect in effects:
            if effect.port == port:
                effect.apply(scope)


def apply_load_torques(scope: Scope, load: PlantLoad, effects: Sequence[Effect]) -> None:
    """Set every torque except the drive's: on the bends, on the joints and through the gears.

    The motion of joints and bends must be set.
    """
    apply_effects(scope, ("stiffness", "mass"), effects)
    load.apply_elastic_torques(scope)
    apply_effects(scope, ("bend_torque", "joint_torque"), effects)
    load.apply_transmitted_torque(scope)
    apply_effects(scope, ("servo_torque",), effects)


JUMP_RAD_S: Final = 10.0
"""Rate above which a measured angle jumps: 13 times the peak rate of the study's
motion, 30° at 4.352 s. [assumed]"""

LARGEST_BEND_RAD: Final = math.pi
"""Bend of a hinge at which the link lies on itself."""

LARGEST_STATE: Final = 1e100
"""Sum of the magnitudes of all states above which the next step may overflow."""


def restart_where_impossible(
    model: StepModel, scope: Scope, resting: Sequence[Expr], jump: Expr
) -> StepModel:
    """Add the restarts to a model.

    `resting` is the state at rest at the sample, in the order of the model's states. `jump` says
    whether the sample cannot continue the past (`is_jump`).
    """
    x, u, p = (
        ca.vertcat(*(s.symbol for s in scope.states.values())),
        ca.vertcat(*(symbol for _, symbol in scope.inputs.values())),
        ca.vertcat(*(symbol for _, symbol in scope.parameters.values())),
    )
    bends = [ca.fabs(bend) <= LARGEST_BEND_RAD for bend in scope.bend.values()]
    size = sum(ca.fabs(s.symbol) for s in scope.states.values())
    possible = ca.Function("possible", [x], [_all([*bends, size <= LARGEST_STATE])])
    jumps = ca.Function("jumps", [x, u, p, scope.step_s], [jump])
    column = ca.cse(ca.densify(ca.vertcat(*(ca.SX(value) for value in resting))))
    rest = ca.Function("rest", [x, u, p], [column])

    x, u, p = (ca.MX.sym(label, model.begin.size_in(k)) for k, label in enumerate("xup"))
    arguments = (x, u, p, ca.MX.sym("h"))
    labels = ["x", "u", "p", "h"]
    # Only the chosen branch is computed, so a step without a restart costs nothing.
    before = ca.if_else(jumps(*arguments), rest(x, u, p), x, True)
    after = model.finish(*arguments)
    kept = ca.if_else(possible(after), after, model.initial(u, p), True)
    begun = model.begin(before, *arguments[1:])
    return replace(
        model,
        begin=ca.Function(model.begin.name(), arguments, [begun], labels, ["result"]),
        finish=ca.Function(model.finish.name(), arguments, [kept], labels, ["result"]),
    )


def is_jump(scope: Scope) -> Expr:
    """Whether any measured angle has changed faster than `JUMP_RAD_S` since the last sample.

    In steps shorter than the control period, an angle may change as much as in a control period: a
    host with small steps holds the robot's samples, which arrive once per period.
    """
    angle = scope.suffix["angle"]
    ramps = [scope.states[f"ramp_{j}_{angle}"] for j in scope.joints]
    limit = JUMP_RAD_S * ca.fmax(scope.step_s, PERIOD_S)
    return 1 - _all([ca.fabs(ramp.finish - ramp.symbol) <= limit for ramp in ramps])


def _all(conditions: Sequence[Expr]) -> Expr:
    """1 if all conditions hold, else 0; a comparison with NaN does not hold."""
    result: Expr = 1
    for condition in conditions:
        result = ca.logic_and(result, condition)
    return result
