"""Weights: payloads against the load in current and bend, gravity, pressure, their units."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import Final

import numpy as np

from models.shared.kinematics import base_rotation, pointing_angles_rad
from models.trials.checks import causes
from models.trials.checks.causes import ImportFinding
from models.trials.checks.motion import (
    LEAST_MOTION_RAD,
    MOVING_RAD_S,
    STANDARD_M_S2,
    current_terms,
)
from models.trials.recordings.series import nominal_scale
from models.trials.trial import Trial

# --- payloads of several trials ------------------------------------------------------------------

CLEAR: Final = 0.5
"""Smallest fraction of the current that follows the weight, to estimate the load."""
LEAST_BEND: Final = 0.02
"""Smallest bend of the link, relative to the angle, for an estimate of the load."""
REPEATED_LOAD: Final = 0.25
"""Relative difference of the load between trials of one payload and motion; on the rig it is 1 to
2 %."""
FALL: Final = 0.1
"""Relative decrease of the load towards a larger payload that is significant."""
BETWEEN: Final = 0.2
"""Distance of a payload from the interpolation of its neighbours' loads, relative to the range of
the payloads. The rig's load is in proportion to the payload within 3 %."""


def judge_payloads(trials: Sequence[Trial]) -> list[ImportFinding]:
    """Findings on payloads that do not match the load, among trials of one motion.

    The load is the current in proportion to the angle's sine (weight times lever, and inertia), or
    the bend in proportion to the angle. It is compared between trials, not with a nominal link: it
    must be equal for equal payloads, larger for a larger one, and between those of its neighbours.
    """
    findings: list[ImportFinding] = []
    for group in _by_motion(trials):
        by_current = _of_one_motion(group, _current_load, "current")
        by_bend = _of_one_motion(group, _bend_load, "bend")
        if by_current and by_bend == []:
            findings += causes.SERVO_LOG.raised(contradiction=by_current[0].text)
        else:
            findings += by_current or (by_bend if by_current is None else []) or []
    return findings


def _by_motion(trials: Sequence[Trial]) -> list[list[Trial]]:
    groups: dict[tuple[object, ...], list[Trial]] = defaultdict(list)
    for t in trials:
        moved = (t.meta.dof, t.meta.motion, t.meta.period_s, t.meta.amplitude_rad)
        groups[(*moved, t.meta.phase_2_rad, t.meta.pressure_pa)].append(t)
    return list(groups.values())


def _moved_most(trials: Sequence[Trial]) -> int:
    """One joint for all: with similar motions, trials would differ in the joint that moves most."""
    return int(np.argmax(np.mean([t.angle_rad.std(axis=0) for t in trials], axis=0)))


def _current_load(trial: Trial, joint: int) -> float | None:
    """Current per sine of a joint's angle; None if it is not significant."""
    angle, current = trial.angle_rad[:, joint], trial.current_a[:, joint]
    if angle.std() < LEAST_MOTION_RAD or not np.isfinite(current).all():
        return None
    load = float(current_terms(current, angle, trial.step_s)[0][1])
    return abs(load) if abs(load) * np.sin(angle).std() > CLEAR * current.std() else None


def _bend_load(trial: Trial, joint: int) -> float | None:
    """Bend in a joint's plane per angle; None if the tip is occluded or the bend is small."""
    visible = np.isfinite(trial.tip_m).all(axis=1)
    angle = trial.angle_rad[visible, joint]
    if visible.mean() < 0.5 or angle.std() < LEAST_MOTION_RAD:
        return None
    bend = pointing_angles_rad(trial.tip_m[visible])[:, joint] - angle
    moved = angle - angle.mean()
    load = float(moved @ bend / (moved @ moved))
    return abs(load) if abs(load) > LEAST_BEND else None


def _of_one_motion(
    trials: Sequence[Trial], load: Callable[[Trial, int], float | None], signal: str
) -> list[ImportFinding] | None:
    """Finding on what contradicts the payloads of one motion; None if a load is unknown."""
    joint = _moved_most(trials)
    loads: dict[float, dict[str, float]] = defaultdict(dict)
    for trial in sorted(trials, key=lambda t: t.meta.payload_kg):
        known = load(trial, joint)
        if known is None:
            return None
        loads[trial.meta.payload_kg][trial.name] = known
    for payload_kg, named in loads.items():
        low, high = min(named, key=named.__getitem__), max(named, key=named.__getitem__)
        ratio = named[high] / named[low]
        if ratio > 1 + REPEATED_LOAD:
            return causes.SAME_PAYLOAD.raised(
                low=low, high=high, payload_kg=payload_kg, signal=signal, ratio=ratio
            )
    means = [(kg, float(np.mean([*named.values()]))) for kg, named in loads.items()]
    for (less_kg, less), (payload_kg, more) in pairwise(means):
        if more < (1 - FALL) * less:
            return causes.LESS_LOAD.raised(signal=signal, payload_kg=payload_kg, less_kg=less_kg)
    for below, (payload_kg, mean), above in zip(means, means[1:], means[2:], strict=False):
        around_kg, around = zip(below, above, strict=True)
        if around[1] <= (1 + REPEATED_LOAD) * around[0]:
            continue
        shown_kg = float(np.interp(mean, around, around_kg))
        if abs(shown_kg - payload_kg) > BETWEEN * (means[-1][0] - means[0][0]):
            return causes.PAYLOAD_BETWEEN.raised(
                signal=signal, shown_kg=shown_kg, payload_kg=payload_kg, around_kg=around_kg
            )
    return []


# --- their unit, with a plant --------------------------------------------------------------------

UNITS: Final = (
    ("in pounds", 0.45359), ("in newtons", 1 / 9.81), ("in ounces", 0.02835), ("in grams", 1e-3),
    ("in kg that were divided by 2.2 as if they were pounds", 2.2046),
)  # fmt: skip
"""Units that payloads may be in, and the kg in one of them."""
UNIT_ERROR: Final = 0.2
"""Relative error of a factor at which it still fits a unit, beside two standard errors [assumed:
friction and bend shift it by up to 10 %, a single step of a fit by 16 %]."""
NOT_ONE: Final = 0.3
"""Least relative difference of a factor from one, beside three standard errors."""


def payload_unit_cause(factor: float, error: float) -> str | None:
    """Unit that payloads seem to be in, like "in pounds"; None if 1 or no common unit fits.

    `factor` is the measured weight in kg per `payload_kg`, `error` its standard error.
    """
    if factor <= 0 or abs(math.log(factor)) < NOT_ONE or abs(factor - 1) < 3 * error:
        return None
    misses = {name: abs(factor - kg) / max(UNIT_ERROR * kg, 2 * error) for name, kg in UNITS}
    name = min(misses, key=misses.__getitem__)
    return name if misses[name] <= 1 else None


def judge_payload_unit(trials: Sequence[Trial], value: Mapping[str, float]) -> list[ImportFinding]:
    """Finding on payloads in another unit than kg, or a torque constant of another servo.

    `value` are the parameters of a plant of the link, by name.
    """
    for group in _by_motion(trials):
        factors = _payload_factors(group, value)
        if factors is None:
            continue
        factor, error, by_link = factors
        if abs(math.log(by_link)) < abs(math.log(by_link / factor)):  # the link weighs as much less
            if abs(math.log(factor)) > NOT_ONE:
                return causes.TORQUE_CONSTANT.raised(factor=factor)
        elif unit := payload_unit_cause(factor, error):
            return causes.PAYLOAD_UNIT.raised(factor=factor, error=error, unit=unit)
    return []


def _payload_factors(
    trials: Sequence[Trial], value: Mapping[str, float]
) -> tuple[float, float, float] | None:
    """Weight that the current shows per weight that `payload_kg` states, from trials of one motion.

    The current of a joint holds the link's weight and the payload's at the tip, x beside the axis:

        K i = a sin(q) + s m (g + w²r) x + friction,    w² = var(dq/dt)/var(q)

    The inertia of a motion with the frequency w adds w² times the distance r from the axis. The
    factor s comes with its standard error from the slope over m with the torque constant K, and
    without it in terms of a, the moment of the link that the plant knows. None if unknown.
    """
    joint, gravity = _moved_most(trials), -trials[0].meta.gravity[2]
    one_gravity = len({abs(t.meta.gravity[2]) for t in trials}) == 1
    upright = one_gravity and abs(gravity) >= 0.9 * STANDARD_M_S2
    if np.ptp([t.meta.payload_kg for t in trials]) < 1e-6 or not upright:
        return None
    rows, targets = [], []
    for t in trials:
        q, current, kg = t.angle_rad[:, joint], t.current_a[:, joint], t.meta.payload_kg
        if q.std() < LEAST_MOTION_RAD or not np.isfinite(current).all():
            return None
        rate = np.gradient(q, t.step_s)
        swing_1_s2, reach_m = rate.var() / q.var(), t.meta.base_offset_m + t.meta.link_length_m
        tip_m = t.tip_m[:, joint]
        aside_m = np.where(np.isfinite(tip_m), tip_m, reach_m * np.sin(q))
        lever = (-t.meta.gravity[2] + swing_1_s2 * reach_m) * aside_m
        friction = np.tanh(rate / MOVING_RAD_S)
        design = [-np.sin(q), -kg * lever, friction, kg * friction, np.ones_like(q)]
        rows.append(np.column_stack(design))
        targets.append(current)
    matrix, target = np.concatenate(rows), np.concatenate(targets)
    terms, *_ = np.linalg.lstsq(matrix, target, rcond=None)
    link_a, per_kg = terms[:2]
    # Neighbouring samples share their errors, so residuals count once in thirty.
    variance = 30 * (target - matrix @ terms).var()
    error = math.sqrt(variance * np.linalg.pinv(matrix.T @ matrix)[1, 1])
    constant = value[f"torque_constant_{joint + 1}_nm_a"]
    base_m, length_m = value["base_offset_m"], value["link_length_m"]
    masses = (
        (value["link_mass_kg"], base_m + length_m / 2, length_m**2 / 12),
        (value["tip_mass_kg"], base_m + length_m, 0.0),
        (value["base_mass_kg"], base_m, 0.0),
    )
    link_nm = sum(m * (gravity * r + swing_1_s2 * (r**2 + extra)) for m, r, extra in masses)
    link_nm += swing_1_s2 * value[f"rotor_inertia_{joint + 1}_kg_m2"]
    if per_kg <= 0 or link_a * link_nm <= 0:
        return None
    return float(per_kg * constant), error * constant, float(per_kg / link_a * link_nm)


# --- conditions of one trial ---------------------------------------------------------------------

GRAVITY_M_S2: Final = (9.7, 9.9)
"""Gravity on the ground, 9.76 to 9.83 m/s², with a margin; a balloon carries part of it."""


def judge_conditions(trial: Trial, *, is_described: bool = False) -> list[ImportFinding]:
    """Findings on conditions of a trial of the link; none for another plant.

    `is_described` says that gravity comes from a link's file, which states the effective weight.
    """
    if not trial.meta.link_length_m:
        return []
    gravity = [] if is_described else _gravity_size(trial)
    return [*judge_undeclared(trial), *gravity, *_payload_size(trial)]


def judge_undeclared(trial: Trial) -> list[ImportFinding]:
    """Finding on `[conditions]` of a trial of the link, whose plants do not declare any."""
    names = list(trial.meta.conditions)
    return causes.CONDITIONS.raised(names=names) if names and trial.meta.link_length_m else []


def _payload_size(trial: Trial) -> list[ImportFinding]:
    """Finding on a payload that no link of this size and pressure carries at these angles."""
    meta, angle = trial.meta, trial.angle_rad
    limit_nm = nominal_scale(meta).limit_moment_nm
    axis = base_rotation(angle[np.isfinite(angle).all(axis=1)])[:, :, 2]
    across = np.linalg.norm(np.cross(axis, meta.gravity), axis=1).max(initial=0.0)
    moment_nm = meta.payload_kg * across * (meta.base_offset_m + meta.link_length_m)
    return causes.PAYLOAD_SIZE.beyond(
        moment_nm / limit_nm, payload_kg=meta.payload_kg, moment_nm=moment_nm, limit_nm=limit_nm
    )


def _gravity_size(trial: Trial) -> list[ImportFinding]:
    """Finding on a magnitude of gravity that is wrong unless a balloon carries part of the link."""
    size, (low, high) = math.hypot(*trial.meta.gravity), GRAVITY_M_S2
    if low <= size <= high:
        return []
    is_wrong = size > high or math.isclose(size, 1.0, rel_tol=1e-6)  # such as 1 for 1 g
    cause = causes.GRAVITY_SIZE if is_wrong else causes.GRAVITY_LOW
    return cause.raised(stated=trial.meta.gravity, size_m_s2=size)
