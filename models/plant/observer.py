"""Observer: the link driven by the measured angle, its payload estimated from the current.

The current is predicted from the motion (`models.plant.compose`) for the estimated
payload m, and for friction that deviates from the plant's by a fraction s_j. The innovation
corrects m and s (an extended Kalman filter of constants). The bends depend on m through their whole
past. So their sensitivity S = ∂x/∂m is integrated too, Ṡ = f_x S + f_m, and a correction Δm moves
the bends by S Δm: to first order the link is where it would be had m been known from the start.
This is the recursive prediction error method [Ljung and Söderström 1983].

A sample has the weight q̇²/(q̇² + v²), because at rest dry friction can have any value and the sample
holds no information. An innovation beyond three standard deviations counts as three.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import casadi as ca

from firmware_py.core.signals import AGE, PAYLOAD, PERIOD_S
from firmware_py.link.link_description import STUDY_LINK
from models.plant.components.drive import Drive
from models.plant.components.load import PlantLoad
from models.plant.compose import (
    Outputs,
    apply_measured_motion,
    build_step_model,
    column,
    current_variable,
    declare_measured_motion,
    measured_current,
    payload_variable,
)
from models.plant.effects import Effect
from models.plant.parameter import Parameter
from models.plant.scope import Expr, Scope, StateVariable, substitute
from models.plant.step_model import StepModel, Variable

MAX_SUBSTEP_S: Final = 2.2e-3
"""Longest Runge–Kutta step, eight per period. The angle is measured, so dry friction is not
integrated; the tips are within 10 µm of those of a step of 0.25 ms."""

OBSERVER_PARAMETERS: Final = (
    Parameter("payload_known_kg", "kg", -1.0, -1.0, STUDY_LINK.most_payload_kg,
              "payload where it is known, negative to estimate it", "unknown"),
    Parameter("payload_prior_kg", "kg", 1.0, 0.0, STUDY_LINK.most_payload_kg,
              "payload before anything is measured", "middle of the study's range"),
    Parameter("payload_spread_kg", "kg", 1.0, 0.01, 10.0,
              "standard deviation of the payload before anything is measured",
              "the study's range"),
    Parameter("payload_drift_kg", "kg", 0.0, 0.0, 1.0,
              "standard deviation that the payload may change by in a second",
              "the payload is bolted on"),
    Parameter("friction_spread", "1", 0.15, 0.0, 1.0,
              "relative standard deviation of friction between runs", "assumed"),
    Parameter("current_noise_a", "A", 0.4, 0.001, 5.0,
              "standard deviation of the current's residual, correlation included",
              "assumed: 0.12 A that hold for twelve samples"),
    Parameter("learning_rate_rad_s", "rad/s", 0.1, 0.001, 2.0,
              "joint rate above which a sample counts",
              "numerical: a seventh of the study's peak rate"),
)  # fmt: skip
"""Parameters of the payload estimate, for the study's link."""

INNOVATION_S: Final = 1.0
"""Time constant of the innovation's mean square, a quarter of the study's cycle [assumed]."""

LEAST_SQUARE: Final = 1e-24
"""Lower limit of a square under a root, whose slope is infinite at zero."""


def compose_observer(
    name: str,
    scope: Scope,
    drive: Drive,
    load: PlantLoad,
    effects: Sequence[Effect],
    with_age: bool = False,
) -> StepModel:
    """Compose the link driven by measurements, with the payload estimated.

    `with_age` adds the age of the sample as the last input, for a predictor that is composed with
    the observer; the observer itself does not depend on it.
    """
    declare_measured_motion(scope, effects)
    measured = [scope.input(current_variable(j)) for j in scope.joints]
    if with_age:
        scope.input(Variable(AGE.name, AGE.unit, description=AGE.description))
    payload = scope.state(payload_variable(scope), scope.p("payload_prior_kg"))
    mass_kg = scope.payload_kg = ca.SX.sym("payload")  # a separate symbol, for derivatives
    before = set(scope.states)
    apply_measured_motion(scope, drive, load, effects)
    moved = [s for n, s in scope.states.items() if n not in before]
    sensitivity = _Sensitivity(scope, moved, mass_kg)
    moving = set(scope.states) - {payload.name()}
    _update_estimates(scope, drive, payload, measured, sensitivity)
    outputs = load.outputs(scope)
    outputs[PAYLOAD.name] = (payload_variable(scope, 1.0), mass_kg)
    outputs |= _state_of_the_estimate(scope, outputs, sensitivity)

    known = scope.p("payload_known_kg")
    now = [(mass_kg, ca.if_else(known >= 0, known, payload))]
    start = [(payload, scope.p("payload_prior_kg"))]
    resting = []
    for state_name, state in scope.states.items():
        at_rest = substitute(state.initial, now)
        resting.append(at_rest if state_name in moving else state.symbol)
        state.initial = substitute(at_rest, start)
        state.rate = substitute(state.rate, now)
        state.finish = None if state.finish is None else substitute(state.finish, now)
    shown = {n: (v, substitute(e, now)) for n, (v, e) in outputs.items()}
    model = build_step_model(name, scope, shown, MAX_SUBSTEP_S, inputs_at_end=True)
    return _restart_where_impossible(model, scope, column(resting))


MAX_SENSITIVITY_PER_KG: Final = 20.0
"""Limit of a bend's sensitivity (rad/kg) and of a bend rate's (rad/(s·kg)): a link that buckles has
no finite one."""


class _Sensitivity:
    """S = ∂x/∂m of the load's states x, integrated as additional states."""

    def __init__(self, scope: Scope, load: Sequence[StateVariable], mass_kg: Expr) -> None:
        self._scope, self._load, self._mass_kg = scope, load, mass_kg
        self._x = ca.vertcat(*(s.symbol for s in load))
        slopes = []
        for s in load:
            variable = Variable(f"{s.variable.name}_per_kg", f"{s.variable.unit}/kg")
            slopes.append(scope.state(variable, ca.jacobian(ca.SX(s.initial), mass_kg)))
        self._slopes = slopes
        for slope, s in zip(slopes, load, strict=True):
            scope.states[slope.name()].rate = self.along(ca.SX(s.rate))

    def along(self, expression: Expr) -> Expr:
        """Total derivative of an expression with respect to m."""
        direct = ca.jacobian(expression, self._mass_kg)
        return ca.jtimes(expression, self._x, ca.vertcat(*self._slopes)) + direct

    def correct(self, change_kg: Expr) -> None:
        """Move the load to where it would be if m were larger by `change_kg`."""
        for slope, s in zip(self._slopes, self._load, strict=True):
            limited = _clip(slope, -MAX_SENSITIVITY_PER_KG, MAX_SENSITIVITY_PER_KG)
            self._scope.states[slope.name()].finish = limited
            moved, v = s.symbol + limited * change_kg, s.variable
            s.finish = _clip(moved, v.minimum, v.maximum) if v.maximum < ca.inf else moved


def _clip(value: Expr, low: Expr, high: Expr) -> Expr:
    return ca.fmin(ca.fmax(value, low), high)


def _state_of_the_estimate(scope: Scope, outputs: Outputs, sensitivity: _Sensitivity) -> Outputs:
    """Outputs about the motion of joint and link, and the observer's estimate of its error.

    A predictor uses them to correct the tip and to widen its interval (`models.predictor`).
    """
    result: Outputs = {}

    def add(name: str, unit: str, description: str, value: Expr) -> None:
        result[name] = (Variable(name, unit, 0.0, description), value)

    for j in scope.joints:
        hinges = [key for key in scope.bend if key[1] == j]
        bend, rate = (sum(of[key] for key in hinges) for of in (scope.bend, scope.bend_rate))
        add(f"bend_{j}_rad", "rad", f"bend of the whole link in plane {j}", bend)
        add(f"bend_rate_{j}_rad_s", "rad/s", f"rate of the bend in plane {j}", rate)
    for j in scope.joints:
        add(f"joint_rate_{j}_rad_s", "rad/s", f"rate of joint {j}", scope.rate[j])
        square = scope.states[f"innovation_square_{j}"].symbol
        add(f"innovation_{j}_a", "A", f"root mean square innovation of current {j}, moving",
            ca.sqrt(ca.fmax(square, LEAST_SQUARE)))  # fmt: skip
    variance = ca.fmax(scope.states["covariance_1_1"].symbol, LEAST_SQUARE)
    deviation = ca.if_else(scope.p("payload_known_kg") >= 0, 0, ca.sqrt(variance))
    for axis in "xyz":
        slope = sensitivity.along(outputs[f"tip_{axis}_m"][1])
        add(f"tip_{axis}_deviation_m", "m", f"standard deviation of tip {axis} by the payload",
            deviation * ca.fabs(slope))  # fmt: skip
    return result


def _update_estimates(
    scope: Scope, drive: Drive, payload: Expr, measured: Sequence[Expr], sensitivity: _Sensitivity
) -> None:
    """Update payload and friction deviations at the end of a step, joint by joint."""
    deviations = [scope.state(Variable(f"friction_deviation_{j}", "1")) for j in scope.joints]
    prior = [scope.p("payload_spread_kg")] + [scope.p("friction_spread")] * len(deviations)
    count = len(prior)
    covariance = ca.SX.zeros(count, count)
    entries: dict[tuple[int, int], Expr] = {}
    for row in range(count):
        for other in range(row + 1):
            unit = "1" if other else "kg" if row else "kg2"
            variable = Variable(f"covariance_{row + 1}_{other + 1}", unit)
            entry = scope.state(variable, prior[row] ** 2 if row == other else 0.0)
            entries[row, other] = covariance[row, other] = covariance[other, row] = entry
    covariance[0, 0] += scope.p("payload_drift_kg") ** 2 * scope.step_s
    change = ca.SX.zeros(count)
    noise = scope.p("current_noise_a") ** 2
    for index, j in enumerate(scope.joints):
        of_friction = scope.friction[j] / drive.torque_constant(scope, j)
        sampled = drive.sampled_current(scope, j, scope.step_s)
        predicted = measured_current(scope, j, sampled + deviations[index] * of_friction)
        regressor = ca.SX.zeros(count)
        regressor[0], regressor[1 + index] = sensitivity.along(predicted), of_friction
        weight = scope.rate[j] ** 2 / (scope.rate[j] ** 2 + scope.p("learning_rate_rad_s") ** 2)
        gain = covariance @ regressor
        variance = noise + weight * ca.dot(regressor, gain)
        square = scope.state(Variable(f"innovation_square_{j}", "1"))
        part = weight * (1 - ca.exp(-scope.step_s / INNOVATION_S))
        error = measured[index] - predicted
        scope.states[square.name()].finish = square + part * (error**2 - square)
        innovation, limit = error - ca.dot(regressor, change), 3 * ca.sqrt(variance)
        change += gain * (weight / variance * _clip(innovation, -limit, limit))
        covariance -= weight / variance * (gain @ gain.T)
    largest = scope.parameters["payload_known_kg"][0].maximum
    estimate = _clip(payload + change[0], 0, largest)
    scope.states[payload.name()].finish = estimate
    sensitivity.correct(ca.if_else(scope.p("payload_known_kg") >= 0, 0, estimate - payload))
    for index, deviation in enumerate(deviations):
        scope.states[deviation.name()].finish = deviation + change[1 + index]
    for place, entry in entries.items():
        scope.states[entry.name()].finish = covariance[place]


JUMP_RAD_S: Final = 10.0
"""Rate above which a measured angle jumps: 13 times the peak rate of the study's motion, 30° at
4.352 s [assumed]."""

LARGEST_STATE: Final = 1e100
"""Sum of the magnitudes of all states above which the next step may overflow."""


def _restart_where_impossible(model: StepModel, scope: Scope, resting: Expr) -> StepModel:
    """Add restarts at samples that cannot continue the past.

    Some samples follow from no motion of a servo: a start far from zero whose first angle comes
    with the first step, or an encoder that jumps. Taken as a motion, a jump of 4 rad bends the link
    beyond every limit, and all later steps fail. Instead, joints and load restart at rest at the
    sample. Estimates from before the jump, such as the payload, remain. At a state that no link
    can have (a bend of π, where the link lies on itself), everything restarts at the end of the
    step, the estimates too. `resting` is the state at rest at the sample.
    """
    x, u, p = (
        ca.vertcat(*(s.symbol for s in scope.states.values())),
        ca.vertcat(*(symbol for _, symbol in scope.inputs.values())),
        ca.vertcat(*(symbol for _, symbol in scope.parameters.values())),
    )
    bends = [ca.fabs(bend) <= math.pi for bend in scope.bend.values()]
    size = sum(ca.fabs(s.symbol) for s in scope.states.values())
    possible = ca.Function("possible", [x], [_all([*bends, size <= LARGEST_STATE])])
    jumps = ca.Function("jumps", [x, u, p, scope.step_s], [_is_jump(scope)])
    rest = ca.Function("rest", [x, u, p], [resting])

    x, u, p = (ca.MX.sym(label, model.begin.size_in(k)) for k, label in enumerate("xup"))
    arguments, labels = (x, u, p, ca.MX.sym("h")), ["x", "u", "p", "h"]
    # Only the chosen branch is computed, so a step without a restart costs nothing.
    before = ca.if_else(jumps(*arguments), rest(x, u, p), x, True)
    after = model.finish(*arguments)
    ended = ca.if_else(possible(after), after, model.initial(u, p), True)
    begun = model.begin(before, *arguments[1:])
    return replace(
        model,
        begin=ca.Function(model.begin.name(), arguments, [begun], labels, ["result"]),
        finish=ca.Function(model.finish.name(), arguments, [ended], labels, ["result"]),
    )


def _is_jump(scope: Scope) -> Expr:
    """Whether any measured angle has changed faster than `JUMP_RAD_S` since the last sample.

    In steps shorter than the control period, an angle may change as much as in a control period: a
    host with small steps holds the robot's samples, which arrive once per period.
    """
    ramps = [scope.states[f"ramp_{j}_{scope.suffix['angle']}"] for j in scope.joints]
    limit = JUMP_RAD_S * ca.fmax(scope.step_s, PERIOD_S)
    return 1 - _all([ca.fabs(ramp.finish - ramp.symbol) <= limit for ramp in ramps])


def _all(conditions: Sequence[Expr]) -> Expr:
    """1 if all conditions hold, else 0; a comparison with NaN does not hold."""
    result: Expr = 1
    for condition in conditions:
        result = ca.logic_and(result, condition)
    return result
