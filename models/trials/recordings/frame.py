"""Transformation from the motion capture's frame to the world frame."""

from __future__ import annotations

from typing import Final

import numpy as np

from models.trials.recordings.mapping import MocapFrame
from models.trials.trial import Array, TrialMeta

_TO_Z_UP: Final = {
    "x": np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]),
    "y": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
    "z": np.eye(3),
}
"""Rotation from the file's upward axis to z, by that axis."""
_OVER: Final = np.diag([1.0, -1.0, -1.0])
"""Half a turn about x, for a link that points down an axis."""


def to_world(positions_m: dict[str, Array], frame: MocapFrame, default_up: str) -> dict[str, Array]:
    """Positions (n, 3) in the world frame; `default_up` is used if the map does not state `up`."""
    rotation = world_rotation(frame, default_up)
    origin_m = _about_z(frame.yaw_deg) @ np.array(frame.origin_m)
    return {name: position @ rotation.T - origin_m for name, position in positions_m.items()}


def world_rotation(frame: MocapFrame, default_up: str) -> Array:
    """Rotation from the file's axes to the world's, shape (3, 3); a reflection with `mirror`."""
    up = frame.up or default_up
    upward = _TO_Z_UP[up.removeprefix("-")]
    turned = _about_z(frame.yaw_deg) @ (_OVER @ upward if up != up[-1] else upward)
    signs = [-1.0 if axis == frame.mirror else 1.0 for axis in "xyz"]
    return np.asarray(turned * signs)  # signs belong to the file's axes


def _about_z(yaw_deg: float) -> Array:
    yaw = np.radians(yaw_deg)
    return np.array(
        [[np.cos(yaw), -np.sin(yaw), 0.0], [np.sin(yaw), np.cos(yaw), 0.0], [0.0, 0.0, 1.0]]
    )


def nominal_markers_m(meta: TrialMeta) -> Array:
    """Markers of the straight link at zero angle, shape (markers, 3)."""
    layout = meta.layout
    return np.array(
        [(x, y, meta.base_offset_m + z) for z in layout.rows_m for x, y in layout.corners_m]
    )


def fit_rigid_motion(measured_m: Array, nominal_m: Array) -> tuple[Array, Array]:
    """Rotation (3, 3) and shift (3,) that best map measured points to nominal ones, (k, 3) each.

    nominal ≈ rotation @ measured + shift, by least squares with the singular value decomposition
    (Kabsch 1976). A pre-bent link looks like a tilted frame, so this is an option, not the default.
    """
    centre, target = measured_m.mean(axis=0), nominal_m.mean(axis=0)
    u, _, vt = np.linalg.svd((measured_m - centre).T @ (nominal_m - target))
    mirror = np.diag([1.0, 1.0, np.sign(np.linalg.det(vt.T @ u.T))])
    rotation = np.asarray(vt.T @ mirror @ u.T)
    return rotation, target - rotation @ centre
