"""Kinematics of the base joint and of a rigid link on it.

The world frame is right-handed, z up. Joint 1 turns about y (positive: tip towards +x); joint 2
turns about -x and moves with joint 1 (positive: tip towards +y) (docs/sources.md, "The link").
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

__all__ = ["base_corners_m", "base_rotation", "pointing_angles_rad", "rigid_tip_m"]

Array = NDArray[np.float64]


def base_rotation(angle_rad: Array) -> Array:
    """Rotation of the base plate.

    Shapes: `angle_rad` (n, dof).
    `angle_rad`: joint angles in rad; with one column joint 2 is at zero.
    Returns shape (n, 3, 3), R = R_y(angle_1) R_x(-angle_2); its columns are the plate's axes in the
    world frame.
    """
    q1 = angle_rad[:, 0]
    q2 = angle_rad[:, 1] if angle_rad.shape[1] > 1 else np.zeros_like(q1)
    c1, s1, c2, s2 = np.cos(q1), np.sin(q1), np.cos(q2), np.sin(q2)
    zero = np.zeros_like(q1)
    rows = [
        [c1, -s1 * s2, s1 * c2],
        [zero, c2, s2],
        [-s1, -c1 * s2, c1 * c2],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def base_corners_m(
    angle_rad: Array, base_offset_m: float, corners_m: Sequence[tuple[float, float]]
) -> Array:
    """Places on the base plate below the markers of a row, in their order.

    Shapes: `angle_rad` (n, dof).
    Returns shape (n, corners, 3), in the world frame.
    """
    body = np.array([[x, y, base_offset_m] for x, y in corners_m])
    return np.asarray(np.einsum("nij,cj->nci", base_rotation(angle_rad), body))


def rigid_tip_m(angle_rad: Array, base_offset_m: float, length_m: float) -> Array:
    """Tip of a link that does not bend.

    Shapes: `angle_rad` (n, dof).
    `base_offset_m`, `length_m`: distance of the base plate from the joint axes, and length of the
    link.
    Returns shape (n, 3), in the world frame, in m.
    """
    return base_rotation(angle_rad)[:, :, 2] * (base_offset_m + length_m)


def pointing_angles_rad(position_m: Array) -> Array:
    """Joint angles of a straight link through a point: the inverse of `rigid_tip_m`.

    Shapes: `position_m` (n, 3).
    `position_m`: any point on the link's axis, world frame, in m.
    Returns shape (n, 2), angle 1 and angle 2 in rad.
    """
    x, y, z = position_m.T
    return np.column_stack([np.arctan2(x, z), np.arctan2(y, np.hypot(x, z))])
