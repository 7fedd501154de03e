"""Findings on the payloads of trials: the load in current or bend, against the declared payload.

Findings on conditions of the link: size and direction of gravity, conditions without effect.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from models.shared.kinematics import base_rotation, pointing_angles_rad
from models.trials.checks.finding import REPEATED_LOAD, ImportFinding
from models.trials.checks.motion import LEAST_MOTION_RAD, MOVING_RAD_S, current_terms
from models.trials.trial import Array, Trial

_CLEAR: Final = 0.5
"""Smallest fraction of the current that follows the angle's sine, to estimate the load."""
_LEAST_BEND: Final = 0.02
"""Smallest bend of the link, relative to the angle, for an estimate of the load."""
_FALL: Final = 0.1
"""Relative decrease of the load towards a larger payload that is significant."""
_BETWEEN: Final = 0.2
"""Distance of a payload from the interpolation of its neighbours' loads, relative to the range of
the payloads. The rig's load is in proportion to the payload within 3 %."""


def judge_payloads(trials: Sequence[Trial]) -> list[ImportFinding]:
    """Findings on payloads that do not match the load, among trials of one motion.

    The load is the current in proportion to the angle's sine (weight times lever, and inertia), or
    the bend in proportion to the angle. It is compared between trials, not with a nominal link: it
    must be equal for equal payloads, larger for a larger one, and between those of its neighbours.
    """
    groups: dict[tuple[object, ...], list[Trial]] = defaultdict(list)
    for t in trials:
        moved = (t.meta.dof, t.meta.motion, t.meta.period_s, t.meta.amplitude_rad)
        groups[(*moved, t.meta.phase_2_rad, t.meta.pressure_pa)].append(t)
    found = []
    for group in groups.values():
        # One joint for all: with similar motions, trials would differ in the joint that moves most.
        joint = int(np.argmax(np.mean([t.angle_rad.std(axis=0) for t in group], axis=0)))
        for load, what in ((_current_load, "current"), (_bend_load, "bend")):
            loads = [load(t, joint) for t in group]
            if all(value is not None for value in loads):
                found += _of_one_motion(group, [v for v in loads if v is not None], what)
                break
    return found


def _current_load(trial: Trial, joint: int) -> float | None:
    """Current per sine of a joint's angle; None if it is not significant."""
    angle, current = trial.angle_rad[:, joint], trial.current_a[:, joint]
    if angle.std() < LEAST_MOTION_RAD or not np.isfinite(current).all():
        return None
    load = float(current_terms(current, angle, trial.step_s)[0][1])
    return abs(load) if abs(load) * np.sin(angle).std() > _CLEAR * current.std() else None


def _bend_load(trial: Trial, joint: int) -> float | None:
    """Bend in a joint's plane per angle; None if the tip is occluded or the bend is small."""
    seen = np.isfinite(trial.tip_m).all(axis=1)
    angle = trial.angle_rad[seen, joint]
    if seen.mean() < 0.5 or angle.std() < LEAST_MOTION_RAD:
        return None
    bend = pointing_angles_rad(trial.tip_m[seen])[:, joint] - angle
    moved = angle - angle.mean()
    load = float(moved @ bend / (moved @ moved))
    return abs(load) if abs(load) > _LEAST_BEND else None


def _of_one_motion(
    trials: Sequence[Trial], loads: Sequence[float], what: str
) -> list[ImportFinding]:
    by_payload: dict[float, dict[str, float]] = defaultdict(dict)
    for trial, load in sorted(zip(trials, loads, strict=True), key=lambda p: p[0].meta.payload_kg):
        by_payload[trial.meta.payload_kg][trial.name] = load
    for payload_kg, named in by_payload.items():
        low, high = min(named, key=named.__getitem__), max(named, key=named.__getitem__)
        if named[high] > (1 + REPEATED_LOAD) * named[low]:
            return [
                _finding(
                    f"{low} and {high} are both of {payload_kg:g} kg, but the {what} shows "
                    f"{named[high] / named[low]:.2f} times the load in the second"
                )
            ]  # fmt: skip
    means = {
        payload_kg: float(np.mean([*named.values()])) for payload_kg, named in by_payload.items()
    }
    return _between_payloads(means, what)


def _between_payloads(means: Mapping[float, float], what: str) -> list[ImportFinding]:
    payloads, loads = list(means), list(means.values())
    for k in range(len(payloads) - 1):
        if loads[k + 1] < (1 - _FALL) * loads[k]:
            return [
                _finding(
                    f"the {what} shows less load in the trials of {payloads[k + 1]:g} kg than in "
                    f"those of {payloads[k]:g} kg"
                )
            ]  # fmt: skip
    for k in range(1, len(payloads) - 1):
        around_kg, around = (v[k - 1 : k + 2 : 2] for v in (payloads, loads))
        if around[1] <= (1 + REPEATED_LOAD) * around[0]:
            continue
        seen_kg = float(np.interp(loads[k], around, around_kg))
        if abs(seen_kg - payloads[k]) > _BETWEEN * (payloads[-1] - payloads[0]):
            return [
                _finding(
                    f"the {what} shows {seen_kg:.2g} kg in the trials of {payloads[k]:g} kg, by "
                    f"those of {around_kg[0]:g} and {around_kg[1]:g} kg"
                )
            ]  # fmt: skip
    return []


def _finding(text: str) -> ImportFinding:
    return ImportFinding("warning", "payload", text, "correct payload_kg where it is wrong")


GRAVITY_M_S2: Final = (9.7, 9.9)
"""Gravity on the ground, 9.76 to 9.83 m/s², with a margin; a balloon carries part of it."""
STANDARD_M_S2: Final = 9.81
_FAST: Final = 0.5
"""Largest ratio of inertia to weight at which the current indicates the weight's direction."""
"""Smallest fraction of the current due to the weight that indicates its direction."""
_LEAST_LEVER: Final = 0.1
"""Smallest root mean square lever along an axis, relative to the link's, that resolves the axis."""
_ALONG: Final = 0.5
"""Smallest cosine of the angle between the estimated weight and the stated gravity."""
_STEP_RAD: Final = 1e-4


def judge_conditions(trial: Trial, *, is_described: bool = False) -> list[ImportFinding]:
    """Findings on conditions of a trial of the link; none for another plant.

    `is_described` says that gravity comes from a link's file, which states the effective weight.
    """
    if not trial.meta.link_length_m:
        return []
    size = [] if is_described else _size(trial)
    return [*judge_undeclared(trial), *(size or _direction(trial))]


def judge_undeclared(trial: Trial) -> list[ImportFinding]:
    """Finding on `[conditions]` of a trial of the link, whose plants do not declare any."""
    names = list(trial.meta.conditions)
    if not names or not trial.meta.link_length_m:
        return []
    own = [name for name in names if hasattr(trial.meta, name)]
    instead = f", and give {', '.join(own)} above it" if own else ""
    return [
        ImportFinding(
            "refused", "conditions",
            f"[conditions] names {', '.join(names)}, which no plant of the link declares",
            f"take [conditions] out, which is for plants with [signals]{instead}",
        )
    ]  # fmt: skip


def _size(trial: Trial) -> list[ImportFinding]:
    """Finding on a magnitude of gravity that is wrong unless a balloon carries part of the link."""
    size = math.hypot(*trial.meta.gravity)
    low, high = GRAVITY_M_S2
    if low <= size <= high:
        return []
    stated = f"gravity_m_s2 is [{_listed(trial.meta.gravity)}], {size:.3g} m/s²"
    remedy = "leave it out for an upright link, or give the direction with 9.81 m/s²"
    if size > high or math.isclose(size, 1.0, rel_tol=1e-6):
        unit = "" if size > high else ": that is in g"
        return [ImportFinding("refused", "gravity", stated + unit, remedy)]
    return [
        ImportFinding(
            "warning", "gravity",
            f"{stated}: right only where a balloon carries the rest of the weight "
            "(effective_weight in link.toml)",
            f"otherwise {remedy}",
        )
    ]  # fmt: skip


def _direction(trial: Trial) -> list[ImportFinding]:
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
        if swing_1_s2 * reach_m > _FAST * STANDARD_M_S2:
            continue
        lever = -_turned_by(trial.angle_rad, j)
        told = np.sqrt((lever**2).mean(axis=0)) > _LEAST_LEVER
        design = np.column_stack([lever[:, told], np.tanh(rate / MOVING_RAD_S)])
        terms, *_ = np.linalg.lstsq(design, current, rcond=None)
        left, weight = current - design @ terms, design[:, :-1] @ terms[:-1]
        is_clear = np.linalg.norm(weight) > _CLEAR * np.linalg.norm(current)
        if terms[-1] < max(0.2 * left.std(), 0.1 * current.std()) or not is_clear:
            continue
        shown, due = np.zeros(3), np.where(told, stated, 0.0)
        shown[told] = terms[:-1]
        sizes = float(np.linalg.norm(shown) * np.linalg.norm(due))
        if np.linalg.norm(due) < _CLEAR * np.linalg.norm(stated) or sizes == 0.0:
            continue
        if shown @ due < _ALONG * sizes:
            return [
                ImportFinding(
                    "warning", "gravity",
                    f"current {j + 1} holds a weight that pulls along "
                    f"[{_listed(shown / np.linalg.norm(shown))}], gravity_m_s2 is "
                    f"[{_listed(trial.meta.gravity)}]",
                    "correct gravity_m_s2 (leave it out for an upright link), or the signs of "
                    f"angle_{j + 1}_rad and current_{j + 1}_a",
                )
            ]  # fmt: skip
    return []


def _turned_by(angle_rad: Array, joint: int) -> Array:
    """Change of the link's direction per angle of a joint, shape (n, 3)."""
    ends = []
    for step_rad in (_STEP_RAD, -_STEP_RAD):
        moved = angle_rad.copy()
        moved[:, joint] += step_rad
        ends.append(base_rotation(moved)[:, :, 2])
    return np.asarray((ends[0] - ends[1]) / (2 * _STEP_RAD))


def _listed(vector: Array | tuple[float, ...]) -> str:
    """Components in words, without a negative zero."""
    return ", ".join(f"{round(float(v), 2) + 0.0:g}" for v in vector)
