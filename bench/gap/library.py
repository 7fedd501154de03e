"""Library of physical terms for discrepancy modelling, and what the plant's equations miss.

Three equations of the plant are left with a residual where something is missing: torque on the
joint and bend, both of the link driven by the measured angle, and the command, the goal for which
the measured motion and current would be right. Each term of the library is an effect of the
catalogue. Columns equal to another's are left out: in the bend a tilted mocap frame and an offset
of the encoder look like a prebend, in the torque a current's bias looks like a load's.
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
"""Shapes inside a column, at the catalogue's defaults: a linear library cannot fit them."""


@dataclass(frozen=True)
class Equation:
    """What an equation of the plant misses in one trial, and what could explain it.

    Attributes
    ----------
    missing : ndarray, shape (n,)
        Residual of the equation.
    columns : dict of str to ndarray, shape (n,)
        Library by effect; a name in parentheses is no effect and never named.
    counts : ndarray of bool, shape (n,)
        Rows on which the equation says something.
    """

    missing: Array
    columns: dict[str, Array]
    counts: Any


def missing_in_equations(
    trial: Trial, p: dict[str, float], twin: dict[str, Array], driven: dict[str, Array]
) -> dict[str, Equation]:
    """Residual and library of each equation.

    Parameters
    ----------
    trial : Trial
        As measured.
    p : dict of str to float
        Parameters of the refitted plant.
    twin, driven : dict of str to ndarray, shape (n,)
        Measured minus simulated signals: of the closed loop, and of the link whose joint moves as
        measured.
    """
    meta, step_s = trial.meta, trial.step_s
    angle, current = trial.columns["angle_1_rad"], trial.columns["current_1_a"]
    rate, acceleration = derivative(angle, step_s), derivative(angle, step_s, 2)
    leaning = np.arctan2(trial.columns["tip_x_m"], trial.columns["tip_z_m"])
    bend, radius = leaning - angle, meta.base_offset_m + meta.link_length_m
    own = p["link_mass_kg"] * (meta.base_offset_m + meta.link_length_m / 2)
    gravity, constant = p["gravity_m_s2"], p["torque_constant_1_nm_a"]
    per_gravity = own + (p["tip_mass_kg"] + meta.payload_kg) * radius
    load = gravity * per_gravity * np.sin(leaning)
    direction, one = np.tanh(rate / p["friction_speed_1_rad_s"]), np.ones(len(trial))
    time_s = np.maximum(step_s * (np.arange(len(trial)) - meta.rest_samples), 0.0)
    off_axis = meta.payload_kg * gravity * radius * np.cos(angle)
    share = step_s / CREEP_S
    crept = lfilter([share], [1, share - 1], bend, zi=[bend[0] * (1 - share)])[0]
    runs, bend_rate = time_s > 0, derivative(bend, step_s)
    torque = {
        "load_offset": one, "coulomb_friction": direction, "viscous_friction": rate,
        "stribeck_friction": direction * np.exp(-((rate / STRIBECK_RAD_S) ** 2)),
        "load_dependent_friction": np.abs(load) * direction,
        "aerodynamic_drag": rate * np.abs(rate), "torque_constant_drift": constant * current,
        "unmodelled_payload": gravity * radius * np.sin(leaning) - radius**2 * acceleration,
        "payload_offset": off_axis, "encoder_offset": gravity * per_gravity * np.cos(angle),
    }  # fmt: skip
    bending = {
        "prebend": one, "sync_offset": rate, "directional_stiffness": np.abs(bend),
        "stiffness_softening": bend * np.abs(bend), "stiffness_hardening": bend**3,
        "pressure_leak": time_s * bend, "hysteresis": np.tanh(bend_rate / YIELD_RAD_S),
        "creep": crept, "backlash": np.tanh(load / PLAY_NM), "joint_elasticity": bend,
        "unmodelled_payload": np.sin(leaning), "payload_offset": off_axis,
        "aerodynamic_drag": rate * np.abs(rate), "(damping)": bend_rate,
    }  # fmt: skip
    command = {
        "dead_time": derivative(trial.columns["goal_1_rad"], step_s), "current_scale": current,
        "current_saturation": np.sign(current) * (np.abs(current) > 0.95 * np.abs(current).max()),
        "(constant)": one,
    }  # fmt: skip
    across = np.cos(leaning) * driven["tip_x_m"] - np.sin(leaning) * driven["tip_z_m"]
    # The cascade solved for its goal: i = k_v (e + ∫e / T_i), e = k_p (goal − q) − q̇.
    leak = step_s / p["velocity_integral_time_1_s"]
    error = lfilter([1, -1], [1 + leak, -1], twin["current_1_a"]) / p["velocity_gain_1_a_s_rad"]
    gain = p["position_gain_1_per_s"]
    goal = twin["angle_1_rad"] + (derivative(twin["angle_1_rad"], step_s) + error) / gain
    moves = runs & (np.abs(rate) > 2 * p["friction_speed_1_rad_s"])
    return {
        "torque": Equation(constant * driven["current_1_a"], torque, moves),
        "bend": Equation(across / radius, bending, one > 0),
        "command": Equation(goal, command, runs),
    }


def derivative(rows: Array, step_s: float, order: int = 1) -> Array:
    """Derivative of smoothed rows (PySINDy's `SmoothedFiniteDifference` smooths alike)."""
    return np.asarray(savgol_filter(rows, 9, 3, deriv=order, delta=step_s))
