"""The observer: the link driven by the measured angle, the payload estimated from the current.

The angle is measured at the end of each step. Between two samples it is taken as a ramp, and a
critically damped second-order filter follows it, so that the link's base has a smooth
acceleration whatever the quantisation and the step (ω = `follow_rate_per_s`; it lags behind an
acceleration a by a/ω², 0.1 mrad in the study).

At the end of a step the torque that the drive gives by its current is compared with the one that
the motion of the link needs, which is affine in the payload m::

    k_t i − J q̈ − F = (A + m B) + s F + noise

with friction F of the plant's effects. Recursive least squares (a Kalman filter of constants)
estimates m and, per joint, the share s by which friction differs from the plant's. A sample counts
by q̇²/(q̇² + v²): at rest dry friction can take any value and nothing is learnt.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi as ca

from firmware_py.signals import PAYLOAD
from models.plant.compose import (
    build,
    current_variable,
    measured_current,
    payload_variable,
    serve,
    settle,
    substitute,
)
from models.plant.effects import PORTS, Effect
from models.plant.mechanics import solve
from models.plant.parameter import Parameter
from models.plant.scope import Expr, Scope
from models.plant.servo import UNIT_OF, Drive
from models.plant.step import StepModel, Variable


def observer_parameters() -> tuple[Parameter, ...]:
    """Parameters of the follower and of the payload estimate."""
    return (
        Parameter(name="follow_rate_per_s", unit="1/s", value=120.0, low=20.0, high=400.0,
                  description="bandwidth that follows the measured angle",
                  source="ten times the first mode, a tenth of the internal rate"),
        Parameter(name="payload_known_kg", unit="kg", value=-1.0, low=-1.0, high=3.0,
                  description="payload where it is known, negative to estimate it",
                  source="unknown"),
        Parameter(name="payload_prior_kg", unit="kg", value=1.0, low=0.0, high=3.0,
                  description="payload before anything is measured",
                  source="middle of the study's range"),
        Parameter(name="payload_spread_kg", unit="kg", value=1.0, low=0.01, high=10.0,
                  description="standard deviation of the payload before anything is measured",
                  source="the study's range"),
        Parameter(name="payload_drift_kg_s", unit="kg/s", value=0.0, low=0.0, high=1.0,
                  description="standard deviation that the payload may change by in a second",
                  source="the payload is bolted on"),
        Parameter(name="friction_spread", unit="1", value=0.15, low=0.0, high=1.0,
                  description="relative standard deviation of friction between runs",
                  source="assumed"),
        Parameter(name="torque_noise_nm", unit="N.m", value=1.5, low=0.01, high=20.0,
                  description="standard deviation of the torque balance, correlation included",
                  source="assumed"),
        Parameter(name="learning_rate_rad_s", unit="rad/s", value=0.1, low=0.001, high=2.0,
                  description="joint rate above which a sample counts",
                  source="numerical: a seventh of the study's peak rate"),
    )  # fmt: skip


def compose_driven(
    name: str, scope: Scope, drive: Drive, load: Any, effects: Sequence[Effect]
) -> StepModel:
    """Link driven by the measured angles, payload given, current as an output.

    What `identify` fits the link with: no loop hides an error of the load from the load's own
    parameters.
    """
    acceleration = [_follow(scope, j) for j in scope.joints]
    scope.payload_kg = scope.input(payload_variable())
    needed, bending = _move(scope, load, effects, acceleration)
    needed = substitute(needed, [bending])
    serve(scope, ("sensor",), effects, load)
    outputs: dict[str, tuple[Variable, Expr]] = {}
    for index, j in enumerate(scope.joints):
        torque = needed[index] + drive.inertia(scope, j) * acceleration[index]
        torque += scope.friction[j] - scope.joint_torque[j]
        current = torque / (scope.torque_scale[j] * scope.p("torque_constant_{j}_nm_a", j))
        variable = current_variable(j)
        outputs[variable.name] = (variable, measured_current(scope, j, current))
    return build(name, scope, outputs | load.outputs(scope))


def compose_observer(
    name: str, scope: Scope, drive: Drive, load: Any, effects: Sequence[Effect]
) -> StepModel:
    """Link driven by the measured angles, payload estimated; see the module's text."""
    acceleration = [_follow(scope, j) for j in scope.joints]
    currents = [scope.input(current_variable(j)) for j in scope.joints]
    payload = scope.state(payload_variable(), scope.p("payload_prior_kg"))
    mass_kg = scope.payload_kg = ca.SX.sym("payload")  # a symbol of its own: to derive by it
    needed, bending = _move(scope, load, effects, acceleration)
    slope = ca.jacobian(needed, mass_kg)
    affine = [substitute(part, [bending]) for part in (needed - mass_kg * slope, slope)]
    _estimate(scope, drive, payload, affine, acceleration, currents)
    serve(scope, ("sensor",), effects, load)
    outputs = load.outputs(scope)
    outputs[PAYLOAD.name] = (payload_variable(1.0), mass_kg)

    known = scope.p("payload_known_kg")
    now = [(mass_kg, ca.if_else(known >= 0, known, payload))]
    start = [(payload, scope.p("payload_prior_kg"))]
    for state in scope.states.values():
        state.initial = substitute(substitute(state.initial, now), start)
        state.rate = substitute(state.rate, now)
        state.finish = None if state.finish is None else substitute(state.finish, now)
    return build(name, scope, {n: (v, substitute(e, now)) for n, (v, e) in outputs.items()})


def _move(
    scope: Scope, load: Any, effects: Sequence[Effect], acceleration: Sequence[Expr]
) -> tuple[Expr, tuple[Expr, Expr]]:
    """Let the load bend on joints that move as measured.

    Returns the torque that each joint needs, and what stands in it for the acceleration of the
    bends together with what that acceleration is.
    """
    load.declare(scope)
    serve(scope, PORTS[1 : PORTS.index("servo_torque")], effects, load)
    load.transmit(scope)
    serve(scope, ("servo_torque", "joint_torque"), effects, load)
    mass, force = load.equations(scope)
    count = len(scope.joints)
    base, bending = ca.vertcat(*acceleration), ca.SX.sym("bending", len(scope.bend))
    needed = mass[:count, :] @ ca.vertcat(base, bending) + force[:count]
    own = ca.vertcat(*scope.bend_torque.values()) - force[count:] - mass[count:, :count] @ base
    solution = solve(mass[count:, count:], own)
    for rate, value in zip(scope.bend_rate.values(), ca.vertsplit(solution), strict=True):
        scope.states[rate.name()].rate = value
    settle(scope, load, force)
    return needed, (bending, solution)


def _follow(scope: Scope, joint: int) -> Expr:
    """Wire angle and rate of a joint to the filtered measurement; returns the acceleration."""
    angle = scope.suffix["angle"]
    unit = UNIT_OF[angle]
    sample = scope.input(Variable(f"angle_{joint}_{angle}", unit, 0.0, f"measured, joint {joint}"))
    true = sample - scope.angle_error[joint]
    ramp = scope.state(Variable(f"ramp_{joint}_{angle}", unit, nominal=0.5), true)
    slope = scope.state(Variable(f"ramp_rate_{joint}_{angle}_s", f"{unit}/s"))
    scope.angle[joint] = scope.state(Variable(f"joint_{joint}_{angle}", unit, nominal=0.5), true)
    scope.start[joint] = true
    scope.rate[joint] = scope.state(Variable(f"joint_rate_{joint}_{angle}_s", f"{unit}/s"))
    omega = scope.p("follow_rate_per_s")
    acceleration = omega**2 * (ramp - scope.angle[joint]) + 2 * omega * (slope - scope.rate[joint])
    states = scope.states
    states[slope.name()].begin = (true - ramp) / scope.step_s
    states[ramp.name()].rate = slope
    states[ramp.name()].finish = true
    states[scope.angle[joint].name()].rate = scope.rate[joint]
    states[scope.rate[joint].name()].rate = acceleration
    return acceleration


def _estimate(
    scope: Scope,
    drive: Drive,
    payload: Expr,
    needed: Sequence[Expr],
    acceleration: Sequence[Expr],
    currents: Sequence[Expr],
) -> None:
    """Update payload and friction shares at the end of a step, one joint after the other.

    `needed` is the torque on each joint as offset and slope over the payload.
    """
    offset, slope = needed
    shares = [scope.state(Variable(f"friction_share_{j}", "1")) for j in scope.joints]
    spread = [scope.p("payload_spread_kg")] + [scope.p("friction_spread")] * len(shares)
    count = len(spread)
    covariance = ca.SX.zeros(count, count)
    entries: dict[tuple[int, int], Expr] = {}
    for row in range(count):
        for column in range(row + 1):
            unit = "1" if column else "kg" if row else "kg2"
            entry = scope.state(
                Variable(f"covariance_{row + 1}_{column + 1}", unit),
                spread[row] ** 2 if row == column else 0.0,
            )
            entries[row, column] = covariance[row, column] = covariance[column, row] = entry
    covariance[0, 0] += scope.p("payload_drift_kg_s") ** 2 * scope.step_s
    estimate = ca.vertcat(payload, *shares)
    for index, j in enumerate(scope.joints):
        weight = scope.rate[j] ** 2 / (scope.rate[j] ** 2 + scope.p("learning_rate_rad_s") ** 2)
        current = (currents[index] - scope.current_bias[j]) / (1 + scope.current_scale[j])
        given = (
            scope.torque_scale[j] * scope.p("torque_constant_{j}_nm_a", j) * current
            + scope.joint_torque[j]
            - drive.inertia(scope, j) * acceleration[index]
            - scope.friction[j]
        )
        regressor = ca.SX.zeros(count)
        regressor[0], regressor[1 + index] = slope[index], scope.friction[j]
        surprise = given - offset[index] - ca.dot(regressor, estimate)
        gain = covariance @ regressor
        noise = scope.p("torque_noise_nm") ** 2
        scale = weight / (noise + weight * ca.dot(regressor, gain))
        estimate = estimate + gain * (scale * surprise)
        covariance = covariance - scale * (gain @ gain.T)
    largest = scope.parameters["payload_known_kg"][0].maximum
    scope.states[payload.name()].finish = ca.fmin(ca.fmax(estimate[0], 0), largest)
    for index, share in enumerate(shares):
        scope.states[share.name()].finish = estimate[1 + index]
    for (row, column), entry in entries.items():
        scope.states[entry.name()].finish = covariance[row, column]
