"""Kinematics of the base joint and of a rigid link on it.

The world frame is right-handed, z up. Joint 1 turns about y (positive: tip towards +x); joint 2
turns about -x and moves with joint 1 (positive: tip towards +y) (docs/sources.md, "The link").
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def base_rotation(angle_rad: Array) -> Array:
    """Rotation R = R_y(angle_1) R_x(-angle_2) of the base plate, shape (n, 3, 3).

    `angle_rad` has the shape (n, dof); with one column joint 2 is at zero. The columns of R are the
    plate's axes in the world frame.
    """
    q1 = angle_rad[:, 0]
    q2 = angle_rad[:, 1] if angle_rad.shape[1] > 1 else np.zeros_like(q1)
    c1, s1, c2, s2 = np.cos(q1), np.sin(q1), np.cos(q2), np.sin(q2)
    rows = [[c1, -s1 * s2, s1 * c2], [np.zeros_like(q1), c2, s2], [-s1, -c1 * s2, c1 * c2]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def base_corners_m(
    angle_rad: Array, base_offset_m: float, corners_m: Sequence[tuple[float, float]]
) -> Array:
    """Corners on the base plate below the markers of a row, world frame, shape (n, corners, 3)."""
    body = np.array([[x, y, base_offset_m] for x, y in corners_m])
    return np.asarray(np.einsum("nij,cj->nci", base_rotation(angle_rad), body))


def rigid_tip_m(angle_rad: Array, base_offset_m: float, length_m: float) -> Array:
    """Tip of a rigid link in the world frame, shape (n, 3)."""
    return base_rotation(angle_rad)[:, :, 2] * (base_offset_m + length_m)


def pointing_angles_rad(position_m: Array) -> Array:
    """Angles (n, 2) of a straight link through points (n, 3): the inverse of `rigid_tip_m`."""
    x, y, z = position_m.T
    return np.column_stack([np.arctan2(x, z), np.arctan2(y, np.hypot(x, z))])
