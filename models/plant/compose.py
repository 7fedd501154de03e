"""Composition of drive, load and effects into a step model: the twin and the driven link.

The twin is the plant in closed loop, from goals to all measured signals; its joints are states.

The driven link has measured angles as inputs, without a servo loop between the data and the load.
The angle is measured at the end of each step. A ramp connects two samples, and a critically damped
second-order filter follows it, so that the acceleration of the link's base is smooth for any
quantisation and step (ω = `follow_rate_per_s`; the filter lags an acceleration a by a/ω², 0.1 mrad
in the study). The current is the one that the motion needs::

    k_t i = M_q (q̈, b̈) + h_q + J q̈ + F − τ_joint

with friction F of the plant's effects; the bends' acceleration b̈ follows from their equations.

The ramp changes slope at the samples only, so the filter's q̈ is a saw-tooth. With ω h = 2, as in
the study, it has decayed to zero where the current is sampled. The bends take up the saw-tooth, but
the rotor would seem to have no inertia. Its J q̈ therefore uses the mean of q̈ over the step, which
is the change of q̇ per step.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any, Final

import casadi as ca

from firmware_py.core.signals import PAYLOAD
from models.plant.components.drive import TORQUE_UNIT, Drive, current_limit, declare_presliding
from models.plant.components.load import PlantLoad
from models.plant.effects import Effect
from models.plant.parameter import Parameter
from models.plant.scope import Expr, Scope, substitute
from models.plant.step_model import StepModel, Variable, runge_kutta
from models.shared.catalogue import Port

Outputs = dict[str, tuple[Variable, Expr]]
"""Outputs of a model by name, in their order."""

FOLLOW_RATE: Final = Parameter(
    "follow_rate_per_s", "1/s", 120.0, 20.0, 400.0, "bandwidth that follows the measured angle",
    "ten times the first mode, a tenth of the internal rate",
)  # fmt: skip


def compose_twin(
    name: str, scope: Scope, drive: Drive, load: PlantLoad, effects: Sequence[Effect]
) -> StepModel:
    """Compose the plant in closed loop."""
    apply_effects(scope, ("sensor",), effects)
    drive.declare(scope)
    scope.payload_kg = scope.input(payload_variable(scope))
    for j in scope.joints:
        scope.angle[j], scope.rate[j] = _declare_joint(scope, j, scope.start[j])
        if drive.has_presliding:
            declare_presliding(scope, j)
    load.declare(scope)
    apply_effects(scope, ("command",), effects)
    apply_load_torques(scope, load, effects)
    drive.apply_control(scope)
    force = _apply_motion(scope, drive, load)
    _set_initial_equilibrium(scope, force)
    _start_in_motion(scope)
    outputs: Outputs = {}
    for j in scope.joints:
        variable = angle_variable(scope, j)
        outputs[variable.name] = variable, _reported_angle(scope, j)
    for j, current in scope.current.items():
        variable = current_variable(j)
        outputs[variable.name] = variable, measured_current(scope, j, current)
    lagged = lag_outputs(scope, outputs | load.outputs(scope))
    return build_step_model(name, scope, _sampled_currents(scope, lagged))


def compose_driven(
    name: str, scope: Scope, drive: Drive, load: PlantLoad, effects: Sequence[Effect]
) -> StepModel:
    """Compose the load driven by measured coordinates, with a known payload.

    `identify` fits the link with it: without a loop, a wrong gain cannot hide a wrong stiffness.
    The output of a joint is its current, or its torque if the drive has none (`measured`). Effects
    of the command do not act: there is no goal.
    """
    declare_measured_motion(scope, effects)
    scope.payload_kg = scope.input(payload_variable(scope))
    apply_measured_motion(scope, drive, load, effects)
    outputs: Outputs = {}
    if "imposed motion" in drive.features:
        _start_in_motion(scope)
        unit = scope.suffix["torque"]
        for j in scope.joints:
            effort = f"{'torque' if unit == 'nm' else 'force'}_{j}_{unit}"
            variable = Variable(effort, TORQUE_UNIT[unit], 0.0, f"measured, joint {j}")
            outputs[effort] = variable, scope.current[j]
        outputs = lag_outputs(scope, outputs | load.outputs(scope))
    else:
        step_s = scope.step_length()
        for j in scope.joints:
            variable, sampled = current_variable(j), drive.sampled_current(scope, j, step_s)
            sampled = _current_at_phase(scope, j, sampled)
            outputs[variable.name] = variable, measured_current(scope, j, sampled)
        outputs |= load.outputs(scope)
    return build_step_model(name, scope, outputs, inputs_at_end=True)


def payload_variable(scope: Scope, start: float = 0.0) -> Variable:
    """Payload as an input or output."""
    most_kg = scope.most_payload_kg
    start = min(start, most_kg)
    return Variable(PAYLOAD.name, PAYLOAD.unit, start, PAYLOAD.description, 0.0, most_kg)


def angle_variable(scope: Scope, joint: int) -> Variable:
    """Measured coordinate of a joint as an input or output."""
    unit = scope.suffix["angle"]
    name = f"{'angle' if unit == 'rad' else 'position'}_{joint}_{unit}"
    return Variable(name, unit, 0.0, f"measured, joint {joint}")


def current_variable(joint: int) -> Variable:
    """Motor current as an input or output."""
    description = f"measured motor current of joint {joint}"
    return Variable(f"current_{joint}_a", "A", 0.0, description, sampled=True)


def _declare_joint(scope: Scope, joint: int, start: Expr) -> tuple[Expr, Expr]:
    """Add the coordinate of a joint and its rate as states."""
    unit = scope.suffix["angle"]
    angle = scope.state(Variable(f"joint_{joint}_{unit}", unit, nominal=0.5), start)
    rate = scope.state(Variable(f"joint_rate_{joint}_{unit}_s", f"{unit}/s"))
    scope.states[angle.name()].rate = rate
    return angle, rate


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
    apply_effects(scope, ("bend_torque",), [e for e in effects if not e.beyond_limit])
    load.apply_limit(scope)
    apply_effects(scope, ("bend_torque",), [e for e in effects if e.beyond_limit])
    apply_effects(scope, ("joint_torque",), effects)
    load.apply_transmitted_torque(scope)
    apply_effects(scope, ("servo_torque",), effects)


def _apply_motion(scope: Scope, drive: Drive, load: PlantLoad) -> Expr:
    """Set the accelerations of joints and bends; return the velocity and gravity force."""
    for j, drive_torque in scope.gear_drive_torque.items():
        scope.friction[j] = substitute(scope.friction[j], [(drive_torque, scope.motor_torque[j])])
    mass, force = load.motion_equations(scope)
    windup = ca.vertcat(*(scope.windup_acceleration[j] for j in scope.joints))
    base_reaction = mass[:, : len(scope.joints)] @ windup
    torque = []
    for index, j in enumerate(scope.joints):
        mass[index, index] += drive.reflected_inertia(scope, j)
        torque.append(scope.motor_torque[j] - scope.friction[j] + scope.joint_torque[j])
    torque = ca.vertcat(*torque, *scope.bend_torque.values())
    acceleration = solve_symmetric(mass, torque - force + base_reaction)
    _set_accelerations(scope, (*scope.rate.values(), *scope.bend_rate.values()), acceleration)
    return force


def _set_accelerations(scope: Scope, rates: Iterable[Expr], accelerations: Expr) -> None:
    for rate, value in zip(rates, ca.vertsplit(accelerations), strict=True):
        scope.states[rate.name()].rate = value


def declare_measured_motion(scope: Scope, effects: Sequence[Effect]) -> None:
    """Add the measured angles as inputs; set angle, rate and acceleration by the filter."""
    apply_effects(scope, ("sensor",), effects)
    unit, omega = scope.suffix["angle"], scope.p(FOLLOW_RATE.name)
    step_s, states = scope.step_length(), scope.states
    for j in scope.joints:
        true = scope.true_angle(j, scope.input(angle_variable(scope, j)))
        ramp = scope.state(Variable(f"ramp_{j}_{unit}", unit, nominal=0.5), true)
        slope = scope.state(Variable(f"ramp_rate_{j}_{unit}_s", f"{unit}/s"))
        angle, rate = _declare_joint(scope, j, true)
        before = scope.state(Variable(f"joint_rate_before_{j}_{unit}_s", f"{unit}/s"))
        scope.start[j], scope.angle[j], scope.rate[j] = true, angle, rate
        scope.acceleration[j] = omega**2 * (ramp - angle) + 2 * omega * (slope - rate)
        scope.mean_acceleration[j] = (rate - before) / step_s
        states[before.name()].begin = rate
        states[slope.name()].begin = (true - ramp) / scope.step_s
        states[ramp.name()].rate = slope
        states[ramp.name()].finish = true
        states[rate.name()].rate = scope.acceleration[j]


def apply_measured_motion(
    scope: Scope, drive: Drive, load: PlantLoad, effects: Sequence[Effect]
) -> None:
    """Set the rates of the bends on joints that move as measured, and the current needed for it."""
    load.declare(scope)
    apply_load_torques(scope, load, effects)
    mass, force = load.motion_equations(scope)
    count = len(scope.joints)
    base = ca.vertcat(*(scope.acceleration[j] - scope.windup_acceleration[j] for j in scope.joints))
    bend_torque = ca.vertcat(*scope.bend_torque.values())
    bend_force = bend_torque - force[count:] - mass[count:, :count] @ base
    bending = solve_symmetric(mass[count:, count:], bend_force)
    _set_accelerations(scope, scope.bend_rate.values(), bending)
    _set_initial_equilibrium(scope, force)
    needed = mass[:count, :] @ ca.vertcat(base, bending) + force[:count]
    for index, j in enumerate(scope.joints):
        torque = needed[index] + drive.reflected_inertia(scope, j) * scope.mean_acceleration[j]
        torque += scope.friction[j] - scope.joint_torque[j]
        scope.current[j] = torque / drive.torque_constant(scope, j)


def solve_symmetric(matrix: Expr, right: Expr) -> Expr:
    """Solve a symmetric positive definite system, (n, n) and (n,), by LDL decomposition."""
    diagonal, upper, order = ca.ldl(matrix)
    return ca.ldl_solve(right, diagonal, upper, order)


NEWTON_STEPS: Final = 3
"""Newton steps from the straight link to the equilibrium; stiffness may depend on the bend."""

LARGEST_START_RAD: Final = 0.5
"""Limit of a bend in each Newton step: a weak link has no equilibrium near zero."""


def _set_initial_equilibrium(scope: Scope, force: Expr) -> None:
    """Set the initial value of every state, and `rest_bend`.

    The joints rest at the first goal, the bends are in equilibrium there, and the drive holds the
    load. `rest_bend` is the equilibrium at encoder readings of zero (upright), the reference of the
    Deformation Index. `force` holds velocity and gravity forces over the joints' coordinates and
    the bends.
    """
    for state in scope.states.values():  # a state may start at another, e.g. the shaped goal
        state.initial = scope.initial_value(state.initial)
    angles, bends = list(scope.angle.values()), list(scope.bend.values())
    moving = {s.name() for s in (*angles, *bends)}
    still = [(s.symbol, s.initial) for n, s in scope.states.items() if n not in moving]
    symbols, count = ca.vertcat(*bends), len(angles)
    residual = ca.vertcat(*scope.bend_torque.values()) - force[count:, :]

    def at_rest(expression: Expr, values: Sequence[Expr]) -> Expr:
        """Expression at these joint coordinates, all states but the bends at their start."""
        expression = substitute(expression, still)
        return substitute(expression, list(zip(angles, values, strict=True)))

    def equilibrium(values: Sequence[Expr]) -> Expr:
        if not bends:
            return ca.SX(0, 1)
        balance = at_rest(residual, values)
        slope = ca.jacobian(balance, symbols)
        bend = ca.SX.zeros(symbols.numel())
        for _ in range(NEWTON_STEPS):
            here = [(symbols, bend)]
            bend = bend + solve_symmetric(-substitute(slope, here), substitute(balance, here))
            bend = ca.fmin(ca.fmax(bend, -LARGEST_START_RAD), LARGEST_START_RAD)
        return bend

    start = [scope.states[a.name()].initial for a in angles]
    first = equilibrium(start)
    upright = equilibrium([ca.SX(scope.true_angle(j, 0)) for j in scope.joints])
    scope.rest_bend.update(zip(scope.bend, ca.vertsplit(upright), strict=True))
    holding = force[:count] - ca.vertcat(*scope.joint_torque.values())
    holding = substitute(at_rest(holding, start), [(symbols, first)])
    for bend, value in zip(bends, ca.vertsplit(first), strict=True):
        scope.states[bend.name()].initial = value
    torques = list(zip(scope.holding_torque.values(), ca.vertsplit(holding), strict=True))
    for state in scope.states.values():
        state.initial = substitute(substitute(state.initial, [(symbols, first)]), torques)


def _start_in_motion(scope: Scope) -> None:
    """Set the initial value of every state that has a parameter `start_STATE`; call it last."""
    for name, state in scope.states.items():
        if f"start_{name}" in scope.parameters:
            state.initial = scope.p(f"start_{name}")


def measured_current(scope: Scope, joint: int, current: Expr) -> Expr:
    """Motor current as the sensor measures it."""
    return (1 + scope.current_scale[joint]) * current + scope.current_bias[joint]


def _reported_angle(scope: Scope, joint: int) -> Expr:
    """Measured coordinate of a joint after its low-pass, to second order in its time."""
    measured = scope.measured_angle(joint)
    if joint not in scope.sensor_lag:
        return measured
    lag_s, rate = scope.sensor_lag[joint].angle_s, scope.rate[joint]
    return measured - lag_s * rate + lag_s**2 * scope.states[rate.name()].rate


def lag_outputs(scope: Scope, outputs: Outputs) -> Outputs:
    """Outputs with the low-pass of every joint applied to its signal.

    A first-order stage of time θ delays a slow signal by θ. A stage of time zero would be
    infinitely fast. So its state follows with D = √(θ² + D_0²), and the output contains the
    fraction θ/D of it::

        ż = (y − z) / D,   y_lagged = y + θ/D (z − y)

    The mean delay is θ exactly, at zero the signal is unchanged, and all is smooth in θ. For θ well
    above D_0 it is the first-order low-pass 1 / (1 + θ s) [Oppenheim & Willsky 1997]. It acts on
    the current within the step; the current is sampled after it (`_sampled_currents`).
    """
    result = dict(outputs)
    for j, lag in scope.sensor_lag.items():
        name = _lagged_output(scope, outputs, j)
        variable, value = outputs[name]
        if lag.jump_fraction is not None and name == current_variable(j).name:
            jump = lag.jump_fraction * scope.sampling[j].jump_per_rate * scope.rate[j]
            value += lag.time_s / _delay_s(lag.time_s) * jump
        second = lag.second_share
        for stage, share in enumerate([1] if second is None else [1 - second, second], 1):
            time_s, filtered = share * lag.time_s, f"lagged_{name}_{stage}"
            state = scope.state(Variable(filtered, variable.unit), _at_start(scope, value))
            scope.states[filtered].rate = (value - state) / _delay_s(time_s)
            value = value + time_s / _delay_s(time_s) * (state - value)
        result[name] = (variable, value)
    return result


def _delay_s(time_s: Expr) -> Expr:
    """Delay D of a stage; D_0 is a pole at 500 per second, stable in an internal step of 2.9 ms."""
    return ca.sqrt(time_s**2 + 2e-3**2)


def _at_start(scope: Scope, expression: Expr) -> Expr:
    return substitute(expression, [(s.symbol, s.initial) for s in scope.states.values()])


def _lagged_output(scope: Scope, outputs: Outputs, joint: int) -> str:
    """Name of the output that a joint's lag acts on: its first measured one in this order.

    An output that the plant does not declare as a column is not measured, like the current in a log
    without it.
    """
    measured = [name for name in outputs if name in scope.columns] or list(outputs)
    signals = ("current", "deflection", "angle", "position", "torque", "force")
    return next(n for s in signals for n in measured if n.startswith(f"{s}_{joint}_"))


def _sampled_currents(scope: Scope, outputs: Outputs) -> Outputs:
    """Outputs with every measured current as it is sampled at a phase of the step.

    The currents in `outputs` are those at the end of the step, after the low-pass if any. The drive
    computes the saw-tooth of a goal that jumps (`models.plant.components.cascade`); a low-pass
    keeps its part in phase at the frequency of the steps. The rest of the current changes little
    within a step, so it is interpolated between the ends of the step. A servo limits the current at
    every moment, so the sample is clipped to the sensor's reading at the limit. The motion does not
    depend on the sample.
    """
    result = dict(outputs)
    for j in scope.current:
        name = current_variable(j).name
        variable, value = outputs[name]
        if j in scope.sampling:
            above = (1 + scope.current_scale[j]) * scope.sampling[j].above_end
            if j in scope.sensor_lag and _lagged_output(scope, outputs, j) == name:
                turn = 2 * math.pi * scope.sensor_lag[j].time_s / scope.step_length()
                above *= 1 / (1 + turn**2)
            value = _within_limit(scope, j, value + above)
            # Clipped again: the line between two samples at the limit may round beyond it.
            value = _within_limit(scope, j, _current_at_phase(scope, j, value))
        else:
            value = _current_at_phase(scope, j, value)
        result[name] = (variable, value)
    return result


def _current_at_phase(scope: Scope, joint: int, current: Expr) -> Expr:
    """Current at `current_phase` of the step; unchanged if the drive has no such parameter."""
    if f"current_phase_{joint}" not in scope.parameters:
        return current
    phase = scope.p("current_phase_{j}", joint)
    name = f"current_before_{joint}_a"
    before = scope.state(Variable(name, "A"), _at_start(scope, current))
    scope.states[name].begin = current
    return phase * current + (1 - phase) * before


def _within_limit(scope: Scope, joint: int, measured: Expr) -> Expr:
    """Measured current, limited to the sensor's reading at the current limit."""
    limit = current_limit(scope, joint)
    low, high = (measured_current(scope, joint, bound) for bound in (-limit, limit))
    return ca.fmin(ca.fmax(measured, low), high)


MAX_SUBSTEP_S: Final = 1e-3
"""Longest Runge–Kutta step: dry friction is stiff."""

SMALLEST_STATE: Final = 1e-30
"""Magnitude below which a state is set to zero at the end of a step. A state that decays at rest
would become a subnormal number, which slows the processor (docs/sources.md, "FMI"). No state has a
meaning below it in SI units, and products of ten such states are still normal numbers (2.2e-308 and
above) [assumed]."""


def build_step_model(
    name: str,
    scope: Scope,
    outputs: Outputs,
    max_substep_s: float = MAX_SUBSTEP_S,
    inputs_at_end: bool = False,
) -> StepModel:
    """Build the functions of a `StepModel` from a scope whose states have all values and rates."""
    states = scope.states.values()
    x = ca.vertcat(*(s.symbol for s in states))
    u = ca.vertcat(*(symbol for _, symbol in scope.inputs.values()))
    p = ca.vertcat(*(symbol for _, symbol in scope.parameters.values()))

    def function(what: str, rows: Iterable[Expr], *step_s: Expr) -> Any:
        labels = ["x", "u", "p", "h"][: 3 + len(step_s)]
        return ca.Function(f"{name}_{what}", [x, u, p, *step_s], [column(rows)], labels, ["result"])

    begin = [s.symbol if s.begin is None else s.begin for s in states]
    finish = [s.symbol if s.finish is None else s.finish for s in states]
    flushed = [ca.if_else(ca.fabs(value) < SMALLEST_STATE, 0, value) for value in finish]
    rate = function("rate", [s.rate for s in states])
    initial = column(s.initial for s in states)
    return StepModel(
        name=name,
        inputs=tuple(v for v, _ in scope.inputs.values()),
        parameters=tuple(v for v, _ in scope.parameters.values()),
        states=tuple(s.variable for s in states),
        outputs=tuple(v for v, _ in outputs.values()),
        initial=ca.Function(f"{name}_initial", [u, p], [initial], ["u", "p"], ["x"]),
        begin=function("begin", begin, scope.step_s),
        flow=runge_kutta(f"{name}_flow", rate),
        finish=function("finish", flushed, scope.step_s),
        smooth_finish=function("smooth_finish", finish, scope.step_s),
        output=function("output", [expression for _, expression in outputs.values()]),
        max_substep_s=max_substep_s,
        rate=rate,
        inputs_at_end=inputs_at_end,
    )


def column(rows: Iterable[Expr]) -> Expr:
    """Dense column of expressions, each common part once."""
    return ca.cse(ca.densify(ca.vertcat(*(ca.SX(row) for row in rows))))
