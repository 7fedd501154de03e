"""Weights: payloads against the load in current and bend, gravity, pressure, their units."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from typing import Final, NamedTuple

import msgspec
import numpy as np

from firmware_py.link.link_description import STUDY_LINK
from models.shared.kinematics import base_rotation, pointing_angles_rad
from models.shared.link_scale import LinkScale
from models.trials.checks import causes
from models.trials.checks.causes import ImportFinding
from models.trials.checks.motion import LEAST_MOTION_RAD, MOVING_RAD_S, current_terms
from models.trials.trial import Array, Trial

CLEAR: Final = 0.5
"""Smallest fraction of the current that follows the angle's sine, to estimate the load."""
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
    found = []
    for group in _by_motion(trials):
        joint = _moved_most(group)
        by_current, by_bend = (
            _of_one_motion(group, joint, *load)
            for load in ((_current_load, "current"), (_bend_load, "bend"))
        )
        if by_current and by_bend == "":
            found += causes.SERVO_LOG.raised(text=by_current)
        elif text := by_current or (by_bend if by_current is None else ""):
            found += causes.PAYLOAD.raised(text=text)
    return found


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
    seen = np.isfinite(trial.tip_m).all(axis=1)
    angle = trial.angle_rad[seen, joint]
    if seen.mean() < 0.5 or angle.std() < LEAST_MOTION_RAD:
        return None
    bend = pointing_angles_rad(trial.tip_m[seen])[:, joint] - angle
    moved = angle - angle.mean()
    load = float(moved @ bend / (moved @ moved))
    return abs(load) if abs(load) > LEAST_BEND else None


def _of_one_motion(
    trials: Sequence[Trial], joint: int, load: Callable[[Trial, int], float | None], what: str
) -> str | None:
    """What contradicts the payloads of one motion, "" for nothing; None if a load is unknown."""
    by_payload: dict[float, dict[str, float]] = defaultdict(dict)
    for trial in sorted(trials, key=lambda t: t.meta.payload_kg):
        known = load(trial, joint)
        if known is None:
            return None
        by_payload[trial.meta.payload_kg][trial.name] = known
    for payload_kg, named in by_payload.items():
        low, high = min(named, key=named.__getitem__), max(named, key=named.__getitem__)
        if named[high] > (1 + REPEATED_LOAD) * named[low]:
            return (
                f"{low} and {high} are both of {payload_kg:g} kg, but the {what} shows "
                f"{named[high] / named[low]:.2f} times the load in the second"
            )
    means = {kg: float(np.mean([*named.values()])) for kg, named in by_payload.items()}
    return _between_payloads(means, what)


def _between_payloads(means: Mapping[float, float], what: str) -> str:
    payloads, loads = list(means), list(means.values())
    for k in range(len(payloads) - 1):
        if loads[k + 1] < (1 - FALL) * loads[k]:
            return (
                f"the {what} shows less load in the trials of {payloads[k + 1]:g} kg than in those "
                f"of {payloads[k]:g} kg"
            )
    for k in range(1, len(payloads) - 1):
        around_kg, around = (v[k - 1 : k + 2 : 2] for v in (payloads, loads))
        if around[1] <= (1 + REPEATED_LOAD) * around[0]:
            continue
        shown_kg = float(np.interp(loads[k], around, around_kg))
        if abs(shown_kg - payloads[k]) > BETWEEN * (payloads[-1] - payloads[0]):
            return (
                f"the {what} shows {shown_kg:.2g} kg in the trials of {payloads[k]:g} kg, by those "
                f"of {around_kg[0]:g} and {around_kg[1]:g} kg"
            )
    return ""


STANDARD_M_S2: Final = 9.81
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


UPRIGHT: Final = 0.9
"""Least gravity along an upright or hanging link, relative to standard gravity."""


class PayloadFactor(NamedTuple):
    """Weight that the current shows, per weight that `payload_kg` states."""

    by_current: float  # With the plant's torque constant
    error: float  # Its standard error
    by_own_weight: float  # With the weight of the link itself as the measure


def payload_factor(trials: Sequence[Trial], value: Mapping[str, float]) -> PayloadFactor | None:
    """Factor on all payloads, from trials of one motion and two payloads or more; else None.

    The current of a joint holds the link's own weight and the payload's at the tip, which is x
    beside the axis:

        K i = own sin(q) + s m (g + w²r) x + friction,    w² = var(dq/dt)/var(q)

    The inertia of a motion with the frequency w adds w² times the distance r from the axis. s
    comes from the slope over m with the torque constant K, or without it in terms of `own`.
    `value` are the parameters of a plant of the link, by name.
    """
    joint = _moved_most(trials)
    payloads = [t.meta.payload_kg for t in trials]
    along = [abs(t.meta.gravity[2]) for t in trials]
    if np.ptp(payloads) < 1e-6 or np.ptp(along) > 0 or along[0] < UPRIGHT * STANDARD_M_S2:
        return None
    rows, targets = [], []
    for t in trials:
        q, current = t.angle_rad[:, joint], t.current_a[:, joint]
        if q.std() < LEAST_MOTION_RAD or not np.isfinite(current).all():
            return None
        rate = np.gradient(q, t.step_s)
        swing_1_s2, reach_m = rate.var() / q.var(), t.meta.base_offset_m + t.meta.link_length_m
        aside_m = t.tip_m[:, joint]
        aside_m = np.where(np.isfinite(aside_m), aside_m, reach_m * np.sin(q))
        lever = (-t.meta.gravity[2] + swing_1_s2 * reach_m) * aside_m
        friction = np.tanh(rate / MOVING_RAD_S)
        kg = t.meta.payload_kg
        design = [-np.sin(q), -kg * lever, friction, kg * friction, np.ones_like(q)]
        rows.append(np.column_stack(design))
        targets.append(current)
    matrix, target = np.concatenate(rows), np.concatenate(targets)
    terms, *_ = np.linalg.lstsq(matrix, target, rcond=None)
    left = target - matrix @ terms
    # Neighbouring samples share their errors, so residuals count once in thirty.
    covariance = np.linalg.pinv(matrix.T @ matrix) * 30 * left.var()
    per_kg, own_a = float(terms[1]), float(terms[0])
    constant = value[f"torque_constant_{joint + 1}_nm_a"]
    base_m, length_m = value["base_offset_m"], value["link_length_m"]
    masses = (
        (value["link_mass_kg"], base_m + length_m / 2, length_m**2 / 12),
        (value["tip_mass_kg"], base_m + length_m, 0.0),
        (value["base_mass_kg"], base_m, 0.0),
    )
    gravity = -trials[0].meta.gravity[2]
    own_nm = sum(m * (gravity * r + swing_1_s2 * (r**2 + extra)) for m, r, extra in masses)
    own_nm += swing_1_s2 * value[f"rotor_inertia_{joint + 1}_kg_m2"]
    if per_kg <= 0 or own_a * own_nm <= 0:
        return None
    error = math.sqrt(covariance[1, 1]) * constant
    return PayloadFactor(per_kg * constant, error, float(per_kg / own_a * own_nm))


def judge_payload_unit(trials: Sequence[Trial], value: Mapping[str, float]) -> list[ImportFinding]:
    """Finding on payloads in another unit than kg, or a torque constant of another servo."""
    for group in _by_motion(trials):
        found = payload_factor(group, value)
        if found is None:
            continue
        by_current, by_own = math.log(found.by_current), math.log(found.by_own_weight)
        if abs(by_own) < abs(by_own - by_current):  # the link's own weight is off as well
            if abs(by_current) > NOT_ONE:
                return causes.TORQUE_CONSTANT.raised(factor=found.by_current)
        elif unit := payload_unit_cause(found.by_current, found.error):
            return causes.PAYLOAD_UNIT.raised(factor=found.by_current, error=found.error, unit=unit)
    return []


GRAVITY_M_S2: Final = (9.7, 9.9)
"""Gravity on the ground, 9.76 to 9.83 m/s², with a margin; a balloon carries part of it."""
PRESSURE_PA: Final = 1e3
"""Pressure below which the unit is not Pa: the link has some tens of kPa."""
FAST: Final = 0.5
"""Largest ratio of inertia to weight at which the current indicates the weight's direction."""
LEAST_LEVER: Final = 0.1
"""Smallest root mean square lever along an axis, relative to the link's, that resolves the axis."""
ALONG: Final = 0.5
"""Smallest cosine of the angle between the estimated weight and the stated gravity."""
STEP_RAD: Final = 1e-4


def judge_conditions(trial: Trial, *, is_described: bool = False) -> list[ImportFinding]:
    """Findings on conditions of a trial of the link; none for another plant.

    `is_described` says that gravity comes from a link's file, which states the effective weight.
    """
    meta = trial.meta
    if not meta.link_length_m:
        return []
    found = judge_undeclared(trial)
    if 0 < meta.pressure_pa < PRESSURE_PA:
        found += causes.PRESSURE_UNIT.raised(pressure_pa=meta.pressure_pa)
    gravity = [] if is_described else _gravity_size(trial)
    return [*found, *(gravity or _gravity_direction(trial)), *_payload_size(trial)]


def judge_undeclared(trial: Trial) -> list[ImportFinding]:
    """Finding on `[conditions]` of a trial of the link, whose plants do not declare any."""
    names = list(trial.meta.conditions)
    if not names or not trial.meta.link_length_m:
        return []
    own = [name for name in names if hasattr(trial.meta, name)]
    instead = f", and give {', '.join(own)} above it" if own else ""
    return causes.CONDITIONS.raised(names=", ".join(names), instead=instead)


def _payload_size(trial: Trial) -> list[ImportFinding]:
    """Finding on a payload that no link of this size and pressure carries at these angles."""
    meta, angle = trial.meta, trial.angle_rad
    size = {"length_m": meta.link_length_m, "width_m": meta.link_width_m}
    known = meta.pressure_pa if meta.pressure_pa >= PRESSURE_PA else STUDY_LINK.pressure_pa
    link = msgspec.structs.replace(STUDY_LINK, pressure_pa=known, **size)
    limit_nm = LinkScale(link).limit_moment_nm
    axis = base_rotation(angle[np.isfinite(angle).all(axis=1)])[:, :, 2]
    across = np.linalg.norm(np.cross(axis, meta.gravity), axis=1).max(initial=0.0)
    moment_nm = meta.payload_kg * across * (meta.base_offset_m + meta.link_length_m)
    return causes.PAYLOAD_SIZE.beyond(
        moment_nm / limit_nm, payload_kg=meta.payload_kg, moment_nm=moment_nm, limit_nm=limit_nm
    )


def _gravity_size(trial: Trial) -> list[ImportFinding]:
    """Finding on a magnitude of gravity that is wrong unless a balloon carries part of the link."""
    size, stated = math.hypot(*trial.meta.gravity), _listed(trial.meta.gravity)
    low, high = GRAVITY_M_S2
    if low <= size <= high:
        return []
    if size > high or math.isclose(size, 1.0, rel_tol=1e-6):
        unit = "" if size > high else ": that is in g"
        return causes.GRAVITY_SIZE.raised(stated=stated, size_m_s2=size, unit=unit)
    return causes.GRAVITY_LOW.raised(stated=stated, size_m_s2=size)


def _gravity_direction(trial: Trial) -> list[ImportFinding]:
    """Finding if the currents hold a weight in another direction than the stated gravity.

    A joint holds the torque of gravity g on the link with direction u: its current is in proportion
    to -g·∂u/∂angle, and friction adds a term with its sign. The friction term must be along the
    motion; otherwise the current's sign is in doubt, which `judge_motion` reports.
    """
    stated = np.array(trial.meta.gravity)
    reach_m = trial.meta.base_offset_m + trial.meta.link_length_m
    for j in range(trial.meta.dof):
        current, angle = trial.current_a[:, j], trial.angle_rad[:, j]
        rate = np.gradient(angle, trial.step_s)
        if not np.isfinite(current + rate).all() or rate.std() < MOVING_RAD_S:
            continue
        swing_1_s2 = rate.var() / angle.var()
        if swing_1_s2 * reach_m > FAST * STANDARD_M_S2:
            continue
        lever = -_turned_by(trial.angle_rad, j)
        known = np.sqrt((lever**2).mean(axis=0)) > LEAST_LEVER
        design = np.column_stack([lever[:, known], np.tanh(rate / MOVING_RAD_S)])
        terms, *_ = np.linalg.lstsq(design, current, rcond=None)
        left, weight = current - design @ terms, design[:, :-1] @ terms[:-1]
        is_clear = np.linalg.norm(weight) > CLEAR * np.linalg.norm(current)
        if terms[-1] < max(0.2 * left.std(), 0.1 * current.std()) or not is_clear:
            continue
        shown, due = np.zeros(3), np.where(known, stated, 0.0)
        shown[known] = terms[:-1]
        sizes = float(np.linalg.norm(shown) * np.linalg.norm(due))
        if np.linalg.norm(due) < CLEAR * np.linalg.norm(stated) or sizes == 0.0:
            continue
        if shown @ due < ALONG * sizes:
            return causes.GRAVITY_DIRECTION.raised(
                joint=j + 1, shown=_listed(shown / np.linalg.norm(shown)),
                stated=_listed(trial.meta.gravity),
            )  # fmt: skip
    return []


def _turned_by(angle_rad: Array, joint: int) -> Array:
    """Change of the link's direction per angle of a joint, shape (n, 3)."""
    step = STEP_RAD * np.eye(angle_rad.shape[1])[joint]
    ends = [base_rotation(angle_rad + way * step)[:, :, 2] for way in (1, -1)]
    return np.asarray((ends[0] - ends[1]) / (2 * STEP_RAD))


def _listed(vector: Array | tuple[float, ...]) -> str:
    """Components in words, without a negative zero."""
    return ", ".join(f"{round(float(v), 2) + 0.0:g}" for v in vector)
