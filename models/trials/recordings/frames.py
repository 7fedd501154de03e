"""Frames: from that of the motion capture to the world, and alignment by markers at rest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from firmware_py.core.errors import InputError
from firmware_py.link.marker_layout import square_corners_m
from models.shared.kinematics import base_rotation
from models.trials.recordings.mapping import BASE_MARKERS, MocapFrame, RecordingMap
from models.trials.recordings.series import Series, marker_columns, with_angles
from models.trials.trial import Array, TrialMeta

_TO_Z_UP: Final = {
    "x": np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]),
    "y": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
    "z": np.eye(3),
}
"""Rotation from the file's upward axis to z, by that axis."""
_OVER: Final = np.diag([1.0, -1.0, -1.0])
"""Half a turn about x, for a link that points down an axis."""


def in_world(series: Series, markers: Sequence[str], frame: MocapFrame, default_up: str) -> Series:
    """Series whose markers are turned from the frame of the file into the world frame."""
    columns = dict(series.columns)
    for name in filter(series.has, markers):  # one by one: one copy of a long capture, not four
        columns |= marker_columns({name: to_world(series.position_m(name), frame, default_up)})
    return replace(series, columns=columns)


def to_world(position_m: Array, frame: MocapFrame, default_up: str) -> Array:
    """Positions (…, 3) in the world frame; `default_up` is used if the map does not state `up`."""
    rotation = world_rotation(frame, default_up)
    origin_m = _about_z(frame.yaw_deg) @ np.array(frame.origin_m)
    if np.array_equal(rotation, np.eye(3)) and not origin_m.any():
        return position_m  # a marker of which one coordinate is missing keeps the others
    return np.asarray(position_m @ rotation.T - origin_m)


def world_rotation(frame: MocapFrame, default_up: str) -> Array:
    """Rotation from the file's axes to the world's, shape (3, 3); a reflection with `mirror`."""
    up = frame.up or default_up
    upward = _TO_Z_UP[up.removeprefix("-")]
    turned = _about_z(frame.yaw_deg) @ (_OVER @ upward if up != up[-1] else upward)
    signs = [-1.0 if axis == frame.mirror else 1.0 for axis in "xyz"]
    return np.asarray(turned * signs)  # signs belong to the file's axes


def _about_z(yaw_deg: float) -> Array:
    return np.asarray(Rotation.from_euler("z", yaw_deg, degrees=True).as_matrix())


def nominal_markers_m(meta: TrialMeta) -> Array:
    """Markers of the straight link at zero angle, shape (markers, 3)."""
    layout = meta.layout
    return np.array(
        [(x, y, meta.base_offset_m + z) for z in layout.rows_m for x, y in layout.corners_m]
    )


def fit_rigid_motion(measured_m: Array, nominal_m: Array) -> tuple[Array, Array]:
    """Rotation (3, 3) and shift (3,) that best map measured points to nominal ones, (k, 3) each.

    nominal ≈ rotation @ measured + shift, by least squares with the singular value decomposition
    (Kabsch 1976).
    """
    centre, target = measured_m.mean(axis=0), nominal_m.mean(axis=0)
    u, _, vt = np.linalg.svd((measured_m - centre).T @ (nominal_m - target))
    mirror = np.diag([1.0, 1.0, np.sign(np.linalg.det(vt.T @ u.T))])
    rotation = np.asarray(vt.T @ mirror @ u.T)
    return rotation, target - rotation @ centre


# --- alignment at rest ----------------------------------------------------------------------------

_REST_RANGE_M: Final = 3e-3
"""Largest displacement of a marker at rest."""


def first_angles(series: list[Series], dof: int) -> Array | None:
    """Joint angles in the first samples, at rest; None if they were not measured."""
    angles = with_angles(series, dof)
    if angles is None:
        return None
    first = np.asarray(np.nanmedian(angles[1][:5], axis=0))
    return first if np.isfinite(first).all() else None


def rest_means_m(series: Series, markers: Sequence[str]) -> dict[str, Array]:
    """Mean place (3,) of each marker in the leading samples in which none has moved.

    It is NaN for a marker that was occluded in all of them.
    """
    names = [name for name in markers if series.has(name)]
    if not names:
        return {}
    places_m = series.positions_m(names)
    first = np.argmax(np.isfinite(places_m), axis=0)
    first_m = np.take_along_axis(places_m, first[None], axis=0)
    moved = (np.abs(places_m - first_m) > _REST_RANGE_M).any(axis=(1, 2))  # NaN does not count
    rest_m = places_m[: max(int(np.argmax(moved)), 1)] if moved.any() else places_m
    known = np.asarray(np.isfinite(rest_m).all(axis=2))
    return {
        name: rest_m[known[:, k], k].mean(axis=0) if known[:, k].any() else np.full(3, np.nan)
        for k, name in enumerate(names)
    }


def align_markers(
    series: list[Series], mapping: RecordingMap, rest_rad: Array | None = None
) -> list[Series]:
    """Move the markers onto the nominal robot, by rest pose or base as the map says.

    `rest_rad` (dof,) are the joint angles at rest.
    """
    if mapping.frame.align == "none":
        return series
    meta = mapping.meta(0)
    if mapping.frame.align == "base":
        names: Sequence[str] = BASE_MARKERS
        corners_m = square_corners_m(meta.link_width_m)
        places_m = np.array([(x, y, meta.base_offset_m) for x, y in corners_m])
    else:
        names, places_m = meta.layout.names, nominal_markers_m(meta)
    turn = np.eye(3) if rest_rad is None else base_rotation(np.atleast_2d(rest_rad))[0]
    nominal = dict(zip(names, places_m @ turn.T, strict=True))
    return [_moved_onto(s, nominal, mapping) if s.has("m01") else s for s in series]


def _moved_onto(series: Series, nominal: dict[str, Array], mapping: RecordingMap) -> Series:
    """Series whose markers at rest are moved onto nominal places by the best rigid motion.

    A link with a prebend looks like a tilted frame, so aligning by the link itself is an option.
    """
    by_base = mapping.frame.align == "base"
    means_m = rest_means_m(series, mapping.known_markers)
    visible = [n for n in nominal if n in means_m and np.isfinite(means_m[n]).all()]
    least = 3 if by_base else 4
    if len(visible) < least:
        raise InputError(
            series.path,
            f"shows {len(visible)} markers {'of the base ' if by_base else ''}at rest",
            f"align needs at least {least}" + (": map b01 … b04" if by_base else ""),
        )
    rotation, shift_m = fit_rigid_motion(
        np.array([means_m[n] for n in visible]), np.array([nominal[n] for n in visible])
    )
    moved = {n: series.position_m(n) @ rotation.T + shift_m for n in means_m}
    return replace(series, columns=series.columns | marker_columns(moved))
