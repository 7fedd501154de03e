"""Twin: the plant in closed loop, from goals to all measured signals; its joints are states."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca

from models.plant.components.drive import SI_UNIT_OF, Drive, declare_presliding
from models.plant.components.link import solve_symmetric
from models.plant.components.load import PlantLoad
from models.plant.composition.parts import (
    COORDINATE_NAME,
    apply_effects,
    apply_load_torques,
    build_step_model,
    current_variable,
    lag_outputs,
    measured_current,
    payload_variable,
    sampled_currents,
    set_initial_equilibrium,
    start_in_motion,
)
from models.plant.effects import Effect
from models.plant.scope import Expr, Scope, substitute
from models.plant.step_model import StepModel, Variable


def compose_twin(
    name: str, scope: Scope, drive: Drive, load: PlantLoad, effects: Sequence[Effect]
) -> StepModel:
    """Compose the plant in closed loop."""
    apply_effects(scope, ("sensor",), effects)
    drive.declare(scope)
    scope.payload_kg = scope.input(payload_variable(scope))
    for j in scope.joints:
        declare_joint_states(scope, j, scope.start[j])
        if drive.has_presliding:
            declare_presliding(scope, j)
    load.declare(scope)
    apply_effects(scope, ("command",), effects)
    apply_load_torques(scope, load, effects)
    drive.apply_control(scope)
    for j, drive_torque in scope.gear_drive_torque.items():
        scope.friction[j] = substitute(scope.friction[j], [(drive_torque, scope.motor_torque[j])])
    mass, force = load.motion_equations(scope)
    base_reaction = mass[:, : len(scope.joints)] @ ca.vertcat(*scope.windup_acceleration.values())
    torque = []
    for index, j in enumerate(scope.joints):
        mass[index, index] += drive.reflected_inertia(scope, j)
        torque.append(scope.motor_torque[j] - scope.friction[j] + scope.joint_torque[j])
    torque = ca.vertcat(*torque, *scope.bend_torque.values())
    acceleration = ca.vertsplit(solve_symmetric(mass, torque - force + base_reaction))
    rates = (*scope.rate.values(), *scope.bend_rate.values())
    for rate, value in zip(rates, acceleration, strict=True):
        scope.states[rate.name()].rate = value
    set_initial_equilibrium(scope, force)
    start_in_motion(scope)
    outputs: dict[str, tuple[Variable, Expr]] = {}
    angle = scope.suffix["angle"]
    for j in scope.joints:
        variable = Variable(
            f"{COORDINATE_NAME[angle]}_{j}_{angle}", SI_UNIT_OF[angle], 0.0, f"measured, joint {j}"
        )
        outputs[variable.name] = (variable, reported_angle(scope, j))
    for j, current in scope.current.items():
        variable = current_variable(j)
        outputs[variable.name] = (variable, measured_current(scope, j, current))
    lagged = lag_outputs(scope, outputs | load.outputs(scope))
    return build_step_model(name, scope, sampled_currents(scope, lagged))


def reported_angle(scope: Scope, joint: int) -> Expr:
    """Measured coordinate of a joint after its low-pass, to second order in its time."""
    measured = scope.measured_angle(joint)
    if joint not in scope.sensor_lag:
        return measured
    lag_s, rate = scope.sensor_lag[joint].angle_s, scope.rate[joint]
    return measured - lag_s * rate + lag_s**2 * scope.states[rate.name()].rate


def declare_joint_states(scope: Scope, joint: int, initial: Expr) -> None:
    """Add the coordinate of a joint and its rate as states."""
    angle = scope.suffix["angle"]
    unit = SI_UNIT_OF[angle]
    scope.angle[joint] = scope.state(Variable(f"joint_{joint}_{angle}", unit, nominal=0.5), initial)
    scope.rate[joint] = scope.state(Variable(f"joint_rate_{joint}_{angle}_s", f"{unit}/s"))
    scope.states[f"joint_{joint}_{angle}"].rate = scope.rate[joint]
