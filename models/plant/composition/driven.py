"""Link driven by the measured angles, without a servo loop between the data and the load.

The angle is measured at the end of each step. A ramp connects two samples, and a critically damped
second-order filter follows it, so that the acceleration of the link's base is smooth for any
quantisation and step (ω = `follow_rate_per_s`; the filter lags an acceleration a by a/ω², 0.1 mrad
in the study). The current is the one that the motion needs::

    k_t i = M_q (q̈, b̈) + h_q + J q̈ + F − τ_joint

with friction F of the plant's effects; the bends' acceleration b̈ follows from their own equations.

The ramp changes slope at the samples only, so the filter's q̈ is a saw-tooth. With ω h = 2, as in
the study, it has decayed to zero where the current is sampled. The bends take up the saw-tooth, but
the rotor would seem to have no inertia. Its J q̈ therefore uses the mean of q̈ over the step, which
is the change of q̇ per step.

Composition of a load on joints that move as measured; outputs are torque and load signals.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import casadi as ca

from models.plant.components.drive import SI_UNIT_OF, Drive
from models.plant.components.goal import declare_step_length
from models.plant.components.link import solve_symmetric
from models.plant.components.load import PlantLoad
from models.plant.composition.parts import (
    COORDINATE_NAME,
    apply_effects,
    apply_load_torques,
    build_step_model,
    current_at_phase,
    current_variable,
    lag_outputs,
    measured_current,
    payload_variable,
    set_initial_equilibrium,
    start_in_motion,
)
from models.plant.effects import Effect
from models.plant.parameter import Parameter
from models.plant.scope import Expr, Scope
from models.plant.step_model import StepModel, Variable

FOLLOW_RATE: Final = Parameter(
    name="follow_rate_per_s", unit="1/s", value=120.0, low=20.0, high=400.0,
    description="bandwidth that follows the measured angle",
    source="ten times the first mode, a tenth of the internal rate",
)  # fmt: skip


def compose_driven(
    name: str, scope: Scope, drive: Drive, load: PlantLoad, effects: Sequence[Effect]
) -> StepModel:
    """Compose the link driven by measured angles, with a known payload and the current as output.

    `identify` fits the link with it: without a loop, a wrong gain cannot hide a wrong stiffness.
    """
    declare_measured_motion(scope, effects)
    scope.payload_kg = scope.input(payload_variable(scope))
    apply_measured_motion(scope, drive, load, effects)
    step_s = declare_step_length(scope)
    outputs: dict[str, tuple[Variable, Expr]] = {}
    for j in scope.joints:
        sampled = drive.sampled_current(scope, j, step_s)
        variable = current_variable(j)
        sampled = current_at_phase(scope, j, sampled)
        outputs[variable.name] = (variable, measured_current(scope, j, sampled))
    return build_step_model(name, scope, outputs | load.outputs(scope), inputs_at_end=True)


def declare_measured_motion(scope: Scope, effects: Sequence[Effect]) -> None:
    """Add the measured angles as inputs; set angle, rate and acceleration by the filter."""
    apply_effects(scope, ("sensor",), effects)
    angle, omega = scope.suffix["angle"], scope.p(FOLLOW_RATE.name)
    unit, step_s = SI_UNIT_OF[angle], declare_step_length(scope)
    for j in scope.joints:
        name = f"{COORDINATE_NAME[angle]}_{j}_{angle}"
        sample = scope.input(Variable(name, unit, 0.0, f"measured, joint {j}"))
        true = scope.true_angle(j, sample)
        ramp = scope.state(Variable(f"ramp_{j}_{angle}", unit, nominal=0.5), true)
        slope = scope.state(Variable(f"ramp_rate_{j}_{angle}_s", f"{unit}/s"))
        joint = scope.state(Variable(f"joint_{j}_{angle}", unit, nominal=0.5), true)
        rate = scope.state(Variable(f"joint_rate_{j}_{angle}_s", f"{unit}/s"))
        before = scope.state(Variable(f"joint_rate_before_{j}_{angle}_s", f"{unit}/s"))
        scope.start[j], scope.angle[j], scope.rate[j] = true, joint, rate
        scope.acceleration[j] = omega**2 * (ramp - joint) + 2 * omega * (slope - rate)
        states = scope.states
        scope.mean_acceleration[j] = (rate - before) / step_s
        states[before.name()].begin = rate
        states[slope.name()].begin = (true - ramp) / scope.step_s
        states[ramp.name()].rate = slope
        states[ramp.name()].finish = true
        states[joint.name()].rate = rate
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
    bend_force = (
        ca.vertcat(*scope.bend_torque.values()) - force[count:] - mass[count:, :count] @ base
    )
    bending = solve_symmetric(mass[count:, count:], bend_force)
    for rate, value in zip(scope.bend_rate.values(), ca.vertsplit(bending), strict=True):
        scope.states[rate.name()].rate = value
    set_initial_equilibrium(scope, force)
    needed = mass[:count, :] @ ca.vertcat(base, bending) + force[:count]
    for index, j in enumerate(scope.joints):
        torque = needed[index] + drive.reflected_inertia(scope, j) * scope.mean_acceleration[j]
        torque += scope.friction[j] - scope.joint_torque[j]
        scope.current[j] = torque / drive.torque_constant(scope, j)


EFFORT_NAME: Final = {"nm": "torque", "n": "force"}
"""Name of the torque or force that a joint's motion needs, by its unit suffix."""


def compose_imposed(
    name: str, scope: Scope, drive: Drive, load: PlantLoad, effects: Sequence[Effect]
) -> StepModel:
    """Compose a load on joints whose coordinates are inputs (drive `measured`).

    Effects of the command do not act: there is no goal.
    """
    declare_measured_motion(scope, effects)
    scope.payload_kg = scope.input(payload_variable(scope))
    apply_measured_motion(scope, drive, load, effects)
    start_in_motion(scope)
    torque = scope.suffix["torque"]
    outputs: dict[str, tuple[Variable, Expr]] = {}
    for j in scope.joints:
        variable = Variable(
            f"{EFFORT_NAME[torque]}_{j}_{torque}", SI_UNIT_OF[torque], 0.0, f"measured, joint {j}"
        )
        outputs[variable.name] = (variable, scope.current[j])
    lagged = lag_outputs(scope, outputs | load.outputs(scope))
    return build_step_model(name, scope, lagged, inputs_at_end=True)
