"""Library of physical terms for discrepancy modelling, and the residuals of the plant's equations.

Three equations of the plant keep a residual where an effect is missing: torque on the joint and
bend, both of the link driven by the measured angle, and the command, the goal for which the
measured motion and current would be right. Each term of the library is an effect of the catalogue.
Periodic terms have the orders and the phase of the rig. A scale error of the mocap moves the tip
along the link, which none of the three equations contains, so it has no term.
Columns equal to another's are left out: in the bend a tilted mocap frame and an offset of the
encoder equal a prebend, in the torque a bias of the current equals that of a load.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from scipy.signal import lfilter, savgol_filter

from models.gap.residuals.spectrum import Array
from models.trials.trial import Trial

CREEP_S: Final = 3.0
PLAY_NM: Final = 0.5
YIELD_RAD_S: Final = 0.005
STRIBECK_RAD_S: Final = 0.1
BREAKAWAY_RAD: Final = 0.01
COGGING_PERIODS: Final = 24.0
RIPPLE_PERIODS: Final = 16.0
"""Parameters inside a column, at the catalogue's defaults: a linear library cannot fit them."""


@dataclass(frozen=True)
class Equation:
    """Residual of an equation of the plant in one trial, and the terms that could explain it."""

    missing: Array  # (n,)
    # (n,), library by effect; a name in parentheses is no effect and is never named
    columns: dict[str, Array]
    counts: Any  # (n,), rows on which the equation is determined


@dataclass(frozen=True)
class LinkMotion:
    """Measured motion of the link in one trial, and the loads that follow from it."""

    step_s: float
    time_s: Array  # (n,), time since the motion began; zero before
    angle: Array  # (n,), of the joint, in rad and s
    rate: Array
    acceleration: Array
    leaning: Array  # (n,), angle of the tip, and its difference from the joint's, in rad
    bend: Array
    radius_m: float  # From the joint's axis to the tip
    load_nm: Array  # (n,), torque of gravity; torque per metre of the payload's offset
    off_axis_nm: Array
    gravity_per_rad_nm: Array  # (n,)
    direction: Array  # (n,), smooth sign of the rate


def link_motion(trial: Trial, p: dict[str, float]) -> LinkMotion:
    meta, step_s = trial.meta, trial.step_s
    angle = trial.columns["angle_1_rad"]
    rate = derivative(angle, step_s)
    leaning = np.arctan2(trial.columns["tip_x_m"], trial.columns["tip_z_m"])
    radius = meta.base_offset_m + meta.link_length_m
    own = p["link_mass_kg"] * (meta.base_offset_m + meta.link_length_m / 2)
    gravity = p["gravity_m_s2"]
    per_gravity = own + (p["tip_mass_kg"] + meta.payload_kg) * radius
    return LinkMotion(
        step_s=step_s,
        time_s=np.maximum(step_s * (np.arange(len(trial)) - meta.rest_samples), 0.0),
        angle=angle,
        rate=rate,
        acceleration=derivative(angle, step_s, 2),
        leaning=leaning,
        bend=leaning - angle,
        radius_m=radius,
        load_nm=gravity * per_gravity * np.sin(leaning),
        off_axis_nm=meta.payload_kg * gravity * radius * np.cos(angle),
        gravity_per_rad_nm=gravity * per_gravity * np.cos(angle),
        direction=np.tanh(rate / p["friction_speed_1_rad_s"]),
    )


def missing_in_equations(
    trial: Trial, p: dict[str, float], twin: dict[str, Array], driven: dict[str, Array]
) -> dict[str, Equation]:
    """Residual and library of each equation.

    Shapes: `twin`, `driven` (n,).
    `twin`, `driven`: measured minus simulated signals: of the closed loop, and of the link whose
    joint moves as measured.
    """
    motion = link_motion(trial, p)
    constant, runs = p["torque_constant_1_nm_a"], motion.time_s > 0
    leaning = motion.leaning
    across = np.cos(leaning) * driven["tip_x_m"] - np.sin(leaning) * driven["tip_z_m"]
    # The cascade solved for its goal: i = k_v (e + ∫e / T_i), e = k_p (goal − q) − q̇.
    leak = motion.step_s / p["velocity_integral_time_1_s"]
    error = lfilter([1, -1], [1 + leak, -1], twin["current_1_a"]) / p["velocity_gain_1_a_s_rad"]
    gain = p["position_gain_1_per_s"]
    goal = twin["angle_1_rad"] + (derivative(twin["angle_1_rad"], motion.step_s) + error) / gain
    moves = runs & (np.abs(motion.rate) > 2 * p["friction_speed_1_rad_s"])
    torque = _torque_terms(motion, p["gravity_m_s2"], constant * trial.columns["current_1_a"])
    return {
        "torque": Equation(constant * driven["current_1_a"], torque, moves),
        "bend": Equation(across / motion.radius_m, _bend_terms(motion), np.ones(len(trial)) > 0),
        "command": Equation(goal, _command_terms(trial), runs),
    }


def _torque_terms(m: LinkMotion, gravity: float, servo_torque: Array) -> dict[str, Array]:
    payload = gravity * m.radius_m * np.sin(m.leaning) - m.radius_m**2 * m.acceleration
    return {
        "load_offset": np.ones(len(m.angle)), "coulomb_friction": m.direction,
        "viscous_friction": m.rate,
        "stribeck_friction": m.direction * np.exp(-((m.rate / STRIBECK_RAD_S) ** 2)),
        "load_dependent_friction": np.abs(m.load_nm) * m.direction,
        "aerodynamic_drag": m.rate * np.abs(m.rate), "torque_constant_drift": servo_torque,
        "unmodelled_payload": payload, "payload_offset": m.off_axis_nm,
        "encoder_offset": m.gravity_per_rad_nm, "cogging": np.sin(COGGING_PERIODS * m.angle),
        "stiction": m.direction * (1 - slid_memory(m.angle) ** 2),
        "sensor_lag": derivative(servo_torque, m.step_s),
    }  # fmt: skip


def _bend_terms(m: LinkMotion) -> dict[str, Array]:
    bend, bend_rate, fraction = m.bend, derivative(m.bend, m.step_s), m.step_s / CREEP_S
    start = [bend[0] * (1 - fraction)]
    return {
        "prebend": np.ones(len(bend)), "sync_offset": m.rate, "directional_stiffness": np.abs(bend),
        "stiffness_softening": bend * np.abs(bend), "stiffness_hardening": bend**3,
        "pressure_leak": m.time_s * bend, "hysteresis": np.tanh(bend_rate / YIELD_RAD_S),
        "creep": lfilter([fraction], [1, fraction - 1], bend, zi=start)[0],
        "backlash": np.tanh(m.load_nm / PLAY_NM), "joint_elasticity": bend,
        "unmodelled_payload": np.sin(m.leaning), "payload_offset": m.off_axis_nm,
        "aerodynamic_drag": m.rate * np.abs(m.rate), "(damping)": bend_rate,
        "encoder_ripple": np.sin(RIPPLE_PERIODS * m.angle),
    }  # fmt: skip


def slid_memory(angle: Array) -> Array:
    """Direction in which a joint has slid, forgotten over `BREAKAWAY_RAD` of sliding back.

    Shapes: `angle` (n,).
    """
    moved = np.diff(angle, prepend=angle[0])
    result = np.zeros(len(angle))
    for k in range(1, len(angle)):
        kept = np.exp(-abs(moved[k]) / BREAKAWAY_RAD)
        result[k] = np.sign(moved[k]) * (1 - kept) + result[k - 1] * kept
    return result


def _command_terms(trial: Trial) -> dict[str, Array]:
    current = trial.columns["current_1_a"]
    limited = np.abs(current) > 0.95 * np.abs(current).max()
    return {
        "dead_time": derivative(trial.columns["goal_1_rad"], trial.step_s),
        "position_gain_change": trial.columns["goal_1_rad"] - trial.columns["angle_1_rad"],
        "current_scale": current,
        "current_saturation": np.sign(current) * limited,
        "(constant)": np.ones(len(trial)),
    }


def derivative(rows: Array, step_s: float, order: int = 1) -> Array:
    """Derivative of smoothed rows (PySINDy's `SmoothedFiniteDifference` smooths alike).

    Shapes: `rows` (n,).
    """
    return np.asarray(savgol_filter(rows, 9, 3, deriv=order, delta=step_s))
