"""Base plate: markers on a fixed stand, and the height of the plate above the joint axes.

The plate turns about the crossing of the joint axes, `base_offset_m` below it. Its markers move
on circles of that height. Without them the first marker row tells it: the link bends below that
row in proportion to the bend measured above it, so the fit separates bend and height by the
curvature of the row's path.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from scipy.optimize import least_squares

from models.shared.kinematics import base_rotation, pointing_angles_rad
from models.trials.checks import causes
from models.trials.checks.causes import ImportFinding
from models.trials.checks.motion import LEAST_MOTION_RAD
from models.trials.recordings.mapping import BASE_MARKERS
from models.trials.recordings.series import Series, row_centre_m, with_angles, with_markers
from models.trials.trial import Array, Trial, TrialMeta

SURE_ERRORS: Final = 3.0
"""Number of standard errors that a wrong base offset must exceed."""
FEWEST_ROWS: Final = 20


def judge_fixed_base(series: Sequence[Series], meta: TrialMeta) -> list[ImportFinding]:
    """Finding on base markers that stand still while the link turns by 0.1 rad and more.

    They move by less than a fifth of what a plate that turns with the link would move.
    """
    names = meta.layout.row(0)
    s = with_markers(series, *BASE_MARKERS, *names)
    if s is None:
        return []
    root_m = row_centre_m(s.positions_m(names), meta.layout)
    base_m = s.positions_m(BASE_MARKERS)
    visible = np.isfinite(root_m).all(axis=1) & np.isfinite(base_m).all(axis=(1, 2))
    if visible.sum() < 3:
        return []
    # From the base's centre the link turns a little more than the joint, by its bend.
    from_base_m = (root_m - base_m.mean(axis=1))[visible]
    first = from_base_m[0] / np.linalg.norm(from_base_m[0])
    cosines = from_base_m @ first / np.linalg.norm(from_base_m, axis=1)
    turn_rad = float(np.percentile(np.arccos(np.clip(cosines, -1, 1)), 95))
    moved_m = np.linalg.norm(base_m[visible] - base_m[visible][0], axis=2)
    most_m = float(np.percentile(moved_m, 95, axis=0).max())
    due_m = turn_rad * meta.link_width_m / 2
    if turn_rad > 0.1 and most_m < 0.2 * due_m:
        return causes.FIXED_BASE.raised(moved_m=most_m, due_m=due_m)
    return []


def judge_base_offset(series: Sequence[Series], meta: TrialMeta) -> list[ImportFinding]:
    """Finding if the base's markers move on circles of another height than `base_offset_m`.

    Their centre is at b = c + R(angles) p: linear in the crossing c of the joint axes and in p,
    whose height is the base offset. Of the map's frame only the direction of the axes enters.
    """
    angles, mocap = with_angles(series, meta.dof), with_markers(series, *BASE_MARKERS)
    if angles is None or mocap is None:
        return []
    servo, measured_rad = angles
    inside = (mocap.time_s >= servo.time_s[0]) & (mocap.time_s <= servo.time_s[-1])
    time_s = mocap.time_s[inside]
    angle_rad = np.column_stack([np.interp(time_s, servo.time_s, q) for q in measured_rad.T])
    centre_m = mocap.positions_m(BASE_MARKERS)[inside].mean(axis=1)
    visible = np.isfinite(np.column_stack([angle_rad, centre_m])).all(axis=1)
    if visible.sum() < FEWEST_ROWS or angle_rad[visible].std(axis=0).max() < LEAST_MOTION_RAD:
        return []
    turn = base_rotation(angle_rad[visible])
    design = np.concatenate([np.broadcast_to(np.eye(3), turn.shape), turn], axis=2).reshape(-1, 6)
    target = centre_m[visible].reshape(-1)
    terms, *_ = np.linalg.lstsq(design, target, rcond=None)
    error_m = _error(design, target - design @ terms, 5)
    return _compared(terms[5], error_m, meta, causes.BASE_OFFSET)


def judge_root_path(trial: Trial) -> list[ImportFinding]:
    """Finding if the first marker row moves about axes at another height than `base_offset_m`.

    With the measured turn s from the first row to the second, the first row is at

        c + T [h z(q) + l z(q + a s + b sin q)],    z(q) = R(q) e_z

    where l is its height above the plate. Fitted are the crossing c of the joint axes, a small
    tilt T of the frame, the height h of the plate, and the ratios a and b of the bend below.
    """
    meta, angle = trial.meta, trial.angle_rad
    if meta.layout.rows < 2 or angle.std(axis=0).max() < 3 * LEAST_MOTION_RAD:
        return []
    rows_m = trial.marker_rows_m
    first_m, second_m = (row_centre_m(rows_m[:, k], meta.layout) for k in (0, 1))
    visible = np.flatnonzero(np.isfinite(np.column_stack([angle, first_m, second_m])).all(axis=1))
    if len(visible) < FEWEST_ROWS:
        return []
    visible = visible[:: len(visible) // 400 + 1]
    angle, first_m, second_m = angle[visible], first_m[visible], second_m[visible]
    above = pointing_angles_rad(second_m - first_m)[:, : meta.dof] - angle
    base, height_m = base_rotation(angle)[:, :, 2], meta.layout.rows_m[0]

    def residual_m(p: Array) -> Array:
        h, a, b, tilt, crossing_m = p[0], p[1], p[2], np.array([*p[3:5], 0.0]), p[5:]
        below = base_rotation(angle + a * above + b * np.sin(angle))[:, :, 2]
        place_m = h * base + height_m * below
        return np.asarray((crossing_m + place_m + np.cross(tilt, place_m) - first_m).ravel())

    start = np.array([meta.base_offset_m, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    fit = least_squares(residual_m, start, x_scale=[0.01, 0.1, 0.1, 0.01, 0.01, 0.01, 0.01, 0.01])
    if np.sqrt(np.mean(fit.fun**2)) > 0.002:  # on the rigs it is below 0.4 mm
        return []
    return _compared(fit.x[0], _error(fit.jac, fit.fun, 0), meta, causes.ROOT_PATH)


def _error(design: Array, residual: Array, k: int) -> float:
    """Standard error of a fitted term; neighbouring samples share errors, so one in ten counts."""
    return float(np.sqrt(10 * residual.var() * np.linalg.pinv(design.T @ design)[k, k]))


def _compared(
    fits_m: float, error_m: float, meta: TrialMeta, cause: causes.Cause
) -> list[ImportFinding]:
    off_m = fits_m - meta.base_offset_m
    if abs(off_m) <= SURE_ERRORS * error_m:
        return []
    return cause.beyond(off_m, fits_m=fits_m, stated_m=meta.base_offset_m)
