"""Probing motion of a plan: its goals, and the features of its currents that depend on stiffness
and payload.

The motion has four tones around the first mode of the link with the heaviest payload. Below the
mode a stiffer link needs the current of a lighter payload; around it the two differ. The twin
predicts the currents over a grid of stiffness and payload. They are reduced to a few features
(principal components of the whitened currents). The noise includes what the plant does not know:
friction, damping, hysteresis, creep, the servo's inertia, gain and timing. So the features are
those in which stiffness and payload stand out from all of that.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from firmware_py.core.errors import InputError
from firmware_py.goals.stiffness_estimate import ProbeDesign
from firmware_py.goals.tip_plan import as_columns
from firmware_py.link.link_description import STUDY_LINK
from firmware_py.safety.limits import Limits
from models.plan.tip_twin import MOVING_RAD_S, TipTwin, TwinRun
from models.plant.linear_twin import STIFFNESS, link_modes
from models.plant.plant import Plant

Array = NDArray[np.float64]
TONES: Final = (
    (0.54, 0.030, 0.0, 1.0),
    (1.08, 0.012, 0.0, 0.67),
    (1.62, 0.012, 0.25, 0.92),
    (2.20, 0.010, 0.5, 1.0),
)
"""Tones by their frequency over that of the first mode with the heaviest payload, amplitude in rad,
and the parts of the motion between which the amplitude rises and falls.

The tone near the mode of heavy payloads comes first, because they swing for long; light payloads
have their mode near the last ones and come to rest soon. Chosen on rigs with 0.85 to 1.25 times the
stiffness, 0.8 and 1.3 times the damping, 0.4 and 1.3 kg: tones of one amplitude over the whole
motion are no more informative and leave 20 mm of swing after it instead of 6 mm."""
PERIODS: Final = 4.44
REST_PERIODS: Final = 3.0
"""Duration of the tones and of the rest after them in periods of the first mode with the heaviest
payload: about 3.3 s and 2.2 s for the link of the study and 2 kg."""
STIFFNESS_GRID: Final = 0.05 * np.arange(-6, 7)
PAYLOAD_STEP_KG: Final = 0.125
"""Relative changes of stiffness, and step of the payloads, on the grid [assumed]; its payloads are
those of the plan and a step more. The step is that of the study's link, scaled to the largest
payload of another link."""
FEATURES: Final = 14
"""Number of features: further ones add at most 0.3 standard deviations on the grid."""
NOISE_A: Final = 0.055
CORRELATION: Final = 0.9
"""Deviation of a current's sample from the twin, and its correlation from sample to sample, as
measured on the rig (`firmware_py.goals.stiffness_estimate`)."""
RESTING_A: Final = 0.3
"""Deviation at the joint rate `MOVING_RAD_S`, more below it [assumed]."""
UNKNOWN: Final = {
    "coulomb_friction_": 0.3, "viscous_friction_": 0.3, "load_dependent_friction_": 0.3,
    "rotor_inertia_": 0.02, "position_gain_": 0.02, "root_damping": 0.3, "span_damping": 0.3,
    "hysteresis_share": 0.3, "creep_share": 0.3, "directional_stiffness": 0.3,
}  # fmt: skip
"""Relative standard deviations of uncertain plant parameters, by prefix; names that end in `_` have
one value for each joint [assumed]."""
UNKNOWN_DELAY_S: Final = 0.002
UNKNOWN_BIAS_A: Final = 0.05
"""The same for the timing of the currents and a constant offset of each [assumed]."""


def probe_goals(mode_rad_s: float, dof: int, period_s: float) -> Array:
    """Goals of a probing motion, shape (n, dof), from rest to rest at zero.

    The second joint moves a quarter of a period later.
    """
    period_rows = 2.0 * np.pi / mode_rad_s / period_s
    rows, still = (round(n * period_rows) for n in (PERIODS, REST_PERIODS))
    angle, part = mode_rad_s * period_s * np.arange(rows), np.arange(rows) / (rows - 1)
    goals = np.zeros((rows + still, dof))
    for k, (over_mode, amplitude_rad, begin, end) in enumerate(TONES):
        inside = np.clip((part - begin) / (end - begin), 0.0, 1.0)
        size = amplitude_rad * np.sin(np.pi * inside) ** 2
        for j in range(dof):
            goals[:rows, j] += size * np.sin(over_mode * angle + 0.5 * np.pi * j + k)
    return goals


def design_probe(
    plant: Plant, twin: TipTwin, payloads_kg: Sequence[float], limits: Limits
) -> ProbeDesign:
    linear = plant.linearise(payloads_kg[-1], dof=twin.dof, period_s=twin.period_s)
    # Modes that the tones can excite, by their damping ratio [assumed]
    light = [m.frequency_rad_s for m in link_modes(linear) if m.damping < 0.3]
    mode_rad_s = min(light, default=np.inf)
    if mode_rad_s * TONES[-1][0] * twin.period_s > 0.5 * np.pi:
        raise InputError("--probe", "finds no slow mode of the link", "leave it out")
    goals = probe_goals(mode_rad_s, twin.dof, twin.period_s)
    over_study = (plant.link or STUDY_LINK).payload_kg / STUDY_LINK.payload_kg
    step_kg = PAYLOAD_STEP_KG * (over_study or 1.0)
    low = max(0.0, payloads_kg[0] - step_kg)
    masses = low + step_kg * np.arange(np.ceil((payloads_kg[-1] - low) / step_kg - 1e-9) + 2)
    currents = []
    for change in STIFFNESS_GRID:
        other = twin.scaled({STIFFNESS: 1.0 + change})
        for mass in masses:
            run = other.run(goals, mass)
            _check(run, limits, f"{mass:g} kg and {1.0 + change:g} times the stiffness")
            currents.append(run.current_a.T.ravel())
    factor = np.linalg.cholesky(_noise(twin, goals, payloads_kg))
    white = np.linalg.solve(factor, np.transpose(currents)).T
    _, _, directions = np.linalg.svd(white - white.mean(axis=0), full_matrices=False)
    used = directions[:FEATURES]
    weights = np.linalg.solve(factor.T, used.T).T.reshape(len(used), twin.dof, len(goals))
    expected = (white @ used.T).reshape(len(STIFFNESS_GRID), len(masses), -1)
    return ProbeDesign(
        goals_rad=as_columns(goals, 7),
        weights=tuple(as_columns(w.T, 5) for w in weights),
        stiffness=tuple(np.round(STIFFNESS_GRID, 6).tolist()),
        payloads_kg=tuple(np.round(masses, 6).tolist()),
        expected=tuple(tuple(map(tuple, row)) for row in np.round(expected, 4).tolist()),
    )


def expected_deviation(probe: ProbeDesign, payload_kg: float, *, known: bool = False) -> float:
    """Expected standard deviation of the relative stiffness after the motion.

    `known`: whether the payload is known.
    """
    p, masses = np.array(probe.expected), np.array(probe.payloads_kg)
    i = int(np.argmin(np.abs(probe.stiffness)))
    j = int(np.clip(np.argmin(np.abs(masses - payload_kg)), 1, len(masses) - 2))
    by_k, by_m = (g[i, j] for g in np.gradient(p, probe.stiffness, masses, axis=(0, 1)))
    information = by_k @ by_k - (0.0 if known else (by_k @ by_m) ** 2 / (by_m @ by_m))
    return float(1.0 / np.sqrt(max(information, 1e-12)))


def _noise(twin: TipTwin, goals: Array, payloads_kg: Sequence[float]) -> Array:
    """Covariance of the currents about the twin, joint after joint, uncertain parameters included.

    Slopes by the parameters differ with the payload: those of the lightest, middle and heaviest
    payload each have a third of the variance.
    """
    rows, dof = len(goals), twin.dof
    lag = np.abs(np.subtract.outer(np.arange(rows), np.arange(rows)))
    total = np.kron(np.eye(dof), NOISE_A**2 * CORRELATION**lag)
    masses = payloads_kg[0], 0.5 * (payloads_kg[0] + payloads_kg[-1]), payloads_kg[-1]
    slopes, slowest = [], np.full((rows, dof), np.inf)
    for mass in masses:
        run = twin.run(goals, mass)
        rate = np.abs(np.gradient(run.angle_rad, twin.period_s, axis=0))
        slowest = np.minimum(slowest, rate)
        for begins, deviation in UNKNOWN.items():
            step = min(0.05, 0.1 * deviation)
            for name in twin.parameters(begins) if begins.endswith("_") else (begins,):
                other = twin.scaled({name: 1.0 + step})
                change = other.run(goals, mass).current_a - run.current_a
                slopes.append(deviation / step * change)
        late = UNKNOWN_DELAY_S * np.gradient(run.current_a, twin.period_s, axis=0)
        slopes += [late * unit for unit in np.eye(dof)]
    resting = RESTING_A**2 * MOVING_RAD_S**2 / np.maximum(slowest**2, 1e-4)
    total += np.diag(np.minimum(resting, 1.0).T.ravel())
    flat = np.array([s.T.ravel() for s in slopes]) / np.sqrt(len(masses))
    total += flat.T @ flat
    return np.asarray(total + np.kron(np.eye(dof), np.full((rows, rows), UNKNOWN_BIAS_A**2)))


def _check(run: TwinRun, limits: Limits, whose: str) -> None:
    """Refuse a motion whose predicted currents or angles use more than 0.9 of the limits."""
    current_a = np.max(np.abs(run.current_a))
    away_rad = np.max(np.abs(run.angle_rad[1:] - run.goals_rad[:-1]))
    for value, unit, limit, name in (
        (current_a, "A of current", limits.current_a, "current_a"),
        (away_rad, "rad of following error", limits.following_error_rad, "following_error_rad"),
    ):
        if value > 0.9 * limit:
            raise InputError(
                "--probe", f"takes {value:.3g} {unit} with {whose}, more than 90% of "
                f"limits.{name}, {limit:g}", "leave it out, or widen the limit",
            )  # fmt: skip
