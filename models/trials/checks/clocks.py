"""Clocks of a recording, and base markers, whose motion the clocks are compared by."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from firmware_py.errors import InputError
from models.shared.kinematics import base_rotation
from models.trials.checks import causes
from models.trials.checks.causes import ImportFinding
from models.trials.checks.motion import LEAST_MOTION_RAD
from models.trials.clock import Synchronisation, synchronise
from models.trials.recordings.mapping import BASE_MARKERS
from models.trials.recordings.series import Series, row_centre_m
from models.trials.trial import Array, TrialMeta

RATES_HZ: Final = (30, 50, 60, 100, 120, 150, 180, 200, 240, 250, 300, 360)
"""Usual frame rates of motion capture."""
FITS: Final = 0.98
"""Correlation at which another frame rate explains a motion that does not fit."""


def judge_clock(clock: Synchronisation) -> list[ImportFinding]:
    """Findings if the clock's offset is uncertain, or drifts during the motion."""
    found = causes.CLOCK_ERROR.beyond(clock.error_s)
    for drift in clock.drifts:
        least_s = max(causes.CLOCK_DRIFT_S, causes.DRIFT_DEVIATIONS * drift.deviation_s)
        if abs(drift.change_s) > least_s:
            change_s = abs(drift.change_s)
            return found + causes.CLOCK_DRIFT.found(change_s=change_s, over_s=drift.over_s)
    return found


def judge_given_offset(
    given_s: float, found: Synchronisation | None, apart_s: float
) -> list[ImportFinding]:
    """Finding if the user's offset differs from the estimate of signal or motion, if there is one.

    `apart_s` is added to both in the message, because clocks may count from an epoch.
    """
    if found is None:
        return []
    differs_s = abs(given_s - found.offset_s)
    if differs_s <= 3 * found.error_s + causes.GIVEN_CLOCK_S:
        return []
    return causes.GIVEN_CLOCK.found(
        given_s=given_s + apart_s, differs_s=differs_s, found_s=found.offset_s + apart_s,
        error_s=found.error_s, by="sync signal" if found.by == "sync" else "motion",
    )  # fmt: skip


def judge_common_clock(
    series: list[Series], meta: TrialMeta, remedy: str
) -> tuple[Synchronisation | None, list[ImportFinding]]:
    """Clock of one file by its motion, and a finding if the markers lag or lead the angles."""
    angles = [s for s in series if "angle_1_rad" in s.columns]
    if not angles or not any("m01_x_m" in s.columns for s in series):
        return None, []
    if not np.nanstd(angles[0].columns["angle_1_rad"]) > LEAST_MOTION_RAD:
        return None, []
    try:
        clock = synchronise(angles, series, meta)
    except InputError:
        return None, []  # the checks of the motion report signs and joints
    sure = abs(clock.offset_s) > clock.error_s
    late = "late" if clock.offset_s > 0 else "early"
    return clock, causes.COMMON_CLOCK.beyond(
        clock.offset_s if sure else 0.0, late_s=abs(clock.offset_s), late=late, remedy=remedy
    )


def judge_frame_rate(
    servo: list[Series], mocap: list[Series], meta: TrialMeta
) -> list[ImportFinding]:
    """Finding if two files that do not fit do so once the motion capture has another rate."""
    ratios = sorted({a / b for a in RATES_HZ for b in RATES_HZ if a != b}, key=lambda r: abs(r - 1))
    best = 0.0, 1.0
    for factor in ratios:
        stretched = [replace(s, time_s=factor * s.time_s) for s in mocap]
        try:
            clock = synchronise(servo, stretched, meta)
        except InputError:
            continue
        best = max(best, (clock.correlation, factor))
    if best[0] < FITS:
        return []
    file = mocap[0].path.name
    return causes.FRAME_RATE.found(file=file, factor=best[1], correlation=best[0])


STILL: Final = 0.2
"""Motion of the base's markers, relative to that of a plate that turns with the link, below which
they are not on that plate."""
LEAST_TURN_RAD: Final = 0.1
"""Turn of the link from end to end at which the base's motion is judged."""


def judge_fixed_base(series: Sequence[Series], meta: TrialMeta) -> list[ImportFinding]:
    """Finding on base markers that stand still while the link turns."""
    names = meta.layout.row(0)
    for s in series:
        if not all(f"{name}_z_m" in s.columns for name in (*BASE_MARKERS, *names)):
            continue
        root_m = row_centre_m(np.array([s.position_m(n) for n in names]), meta.layout.corners_m)
        base_m = np.stack([s.position_m(n) for n in BASE_MARKERS], axis=1)
        seen = np.isfinite(root_m).all(axis=1) & np.isfinite(base_m).all(axis=(1, 2))
        if seen.sum() < 3:
            continue
        # From the base's centre the link turns a little more than the joint, by its bend.
        from_base_m = (root_m - base_m.mean(axis=1))[seen]
        first = from_base_m[0] / np.linalg.norm(from_base_m[0])
        cosines = from_base_m @ first / np.linalg.norm(from_base_m, axis=1)
        turn_rad = float(np.percentile(np.arccos(np.clip(cosines, -1, 1)), 95))
        moved_m = np.linalg.norm(base_m[seen] - base_m[seen][0], axis=2)
        due_m = turn_rad * meta.link_width_m / 2
        most_m = float(np.percentile(moved_m, 95, axis=0).max())
        if turn_rad > LEAST_TURN_RAD and most_m < STILL * due_m:
            return causes.FIXED_BASE.found(moved_m=most_m, due_m=due_m)
    return []


def judge_base_offset(series: Sequence[Series], meta: TrialMeta) -> list[ImportFinding]:
    """Finding if the base's markers move on circles of another height than `base_offset_m`.

    A marker at p on the plate is at b = c + R(angles) p, and c is the crossing of the joint axes:
    linear in c and in the p of all markers, whose mean height is the base offset. No frame or
    origin of the map enters but its axes.
    """
    angles = [f"angle_{j}_rad" for j in range(1, meta.dof + 1)]
    servo = next((s for s in series if all(n in s.columns for n in angles)), None)
    mocap = next((s for s in series if f"{BASE_MARKERS[0]}_x_m" in s.columns), None)
    if servo is None or mocap is None:
        return []
    inside = (mocap.time_s >= servo.time_s[0]) & (mocap.time_s <= servo.time_s[-1])
    time_s = mocap.time_s[inside]
    angle_rad = np.column_stack([np.interp(time_s, servo.time_s, servo.columns[n]) for n in angles])
    names = [n for n in BASE_MARKERS if f"{n}_x_m" in mocap.columns]
    base_m = np.stack([mocap.position_m(n)[inside] for n in names], axis=1)
    kept = np.isfinite(angle_rad).all(axis=1) & np.isfinite(base_m).all(axis=(1, 2))
    if kept.sum() < 20 or angle_rad[kept].std(axis=0).max() < LEAST_MOTION_RAD:
        return []
    found_m, error_m = _height_above_axes(base_rotation(angle_rad[kept]), base_m[kept].mean(axis=1))
    off_m = found_m - meta.base_offset_m
    if abs(off_m) <= 3 * error_m:
        return []
    return causes.BASE_OFFSET.beyond(
        off_m, markers="the base's markers", found_m=found_m, error_m=error_m,
        stated_m=meta.base_offset_m,
    )  # fmt: skip


def _height_above_axes(turn: Array, centre_m: Array) -> tuple[float, float]:
    """Height of a plate's centre (n, 3) above the crossing of the axes, with its standard error.

    `turn` (n, 3, 3) is the plate's rotation. Neighbouring samples share their errors, so residuals
    count once in ten.
    """
    count = len(turn)
    design = np.concatenate([np.broadcast_to(np.eye(3), (count, 3, 3)), turn], axis=2)
    flat, target = design.reshape(-1, 6), centre_m.reshape(-1)
    terms, *_ = np.linalg.lstsq(flat, target, rcond=None)
    left = target - flat @ terms
    covariance = np.linalg.pinv(flat.T @ flat) * 10 * left @ left / max(len(left) - 6, 1)
    return float(terms[5]), float(np.sqrt(covariance[5, 5]))
