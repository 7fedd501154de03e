"""From the frame of the motion capture to the world frame: z up, origin at the joint axes."""

from __future__ import annotations

from typing import Final

import numpy as np

from models.trials.importers.mapping import Frame
from models.trials.trial import Array, TrialMeta

_TO_Z_UP: Final = {
    "x": np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]),
    "y": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
    "z": np.eye(3),
}
"""By the file's upward axis: a right-handed turn that makes it the z axis."""


def to_world(positions_m: dict[str, Array], frame: Frame, default_up: str) -> dict[str, Array]:
    """Turn and shift positions, each (n, 3), as the map's `[frame]` says."""
    yaw = np.radians(frame.yaw_deg)
    about_z = np.array(
        [[np.cos(yaw), -np.sin(yaw), 0.0], [np.sin(yaw), np.cos(yaw), 0.0], [0.0, 0.0, 1.0]]
    )
    turn = about_z @ _TO_Z_UP[frame.up or default_up]
    origin_m = about_z @ np.array(frame.origin_m)
    return {name: position @ turn.T - origin_m for name, position in positions_m.items()}


def nominal_markers_m(meta: TrialMeta) -> Array:
    """Markers of the straight, upright link at zero angle, shape (16, 3).

    docs/sources.md, "The link".
    """
    half = 0.5 * meta.link_width_m
    return np.array(
        [
            (sx * half, sy * half, meta.base_offset_m + meta.link_length_m * row / 4)
            for row in (1, 2, 3, 4)
            for sy in (1, -1)
            for sx in (1, -1)
        ]
    )


def align_to_rest(measured_m: Array, nominal_m: Array) -> tuple[Array, Array]:
    """Rotation (3, 3) and shift (3,) that best lay measured points on nominal ones.

    Least squares over rigid motions by the singular value decomposition (Kabsch 1976). It sees a
    pre-bent link as a tilted frame, so it is an option, not the default.
    """
    centre, target = measured_m.mean(axis=0), nominal_m.mean(axis=0)
    u, _, vt = np.linalg.svd((measured_m - centre).T @ (nominal_m - target))
    mirror = np.diag([1.0, 1.0, np.sign(np.linalg.det(vt.T @ u.T))])
    rotation = np.asarray(vt.T @ mirror @ u.T)
    return rotation, target - rotation @ centre
