"""Findings on conditions of the link: size and direction of gravity, conditions without effect."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from models.shared.kinematics import base_rotation
from models.trials.trial import Array, Trial
from models.trials.verdict.finding import ImportFinding
from models.trials.verdict.motion_findings import MOVING_RAD_S

GRAVITY_M_S2: Final = (9.7, 9.9)
"""Gravity on the ground, 9.76 to 9.83 m/s², with a margin; a balloon carries part of it."""
STANDARD_M_S2: Final = 9.81
_FAST: Final = 0.5
"""Largest ratio of inertia to weight at which the current indicates the weight's direction."""
_CLEAR: Final = 0.5
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
