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

    Parameters
    ----------
    angle_rad : ndarray, shape (n, dof)
        Joint angles in rad; with one column joint 2 is at zero.

    Returns
    -------
    ndarray, shape (n, 3, 3)
        R = R_y(angle_1) R_x(-angle_2); its columns are the plate's axes in the world frame.

    Examples
    --------
    >>> base_rotation(np.array([[0.0], [np.pi / 2]])).round(6)[1] + 0.0
    array([[ 0.,  0.,  1.],
           [ 0.,  1.,  0.],
           [-1.,  0.,  0.]])
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

    Parameters
    ----------
    angle_rad : ndarray, shape (n, dof)
        Joint angles.
    base_offset_m : float
        Distance of the plate from the joint axes.
    corners_m : sequence of (float, float)
        Distances from the link's axis along x and y.

    Returns
    -------
    ndarray, shape (n, corners, 3)
        In the world frame.
    """
    body = np.array([[x, y, base_offset_m] for x, y in corners_m])
    return np.asarray(np.einsum("nij,cj->nci", base_rotation(angle_rad), body))


def rigid_tip_m(angle_rad: Array, base_offset_m: float, length_m: float) -> Array:
    """Tip of a link that does not bend.

    Parameters
    ----------
    angle_rad : ndarray, shape (n, dof)
        Joint angles.
    base_offset_m, length_m : float
        Distance of the base plate from the joint axes, and length of the link.

    Returns
    -------
    ndarray, shape (n, 3)
        In the world frame, in m.

    Examples
    --------
    >>> rigid_tip_m(np.array([[0.0], [np.pi / 6]]), base_offset_m=0.06, length_m=0.94).round(3)
    array([[0.   , 0.   , 1.   ],
           [0.5  , 0.   , 0.866]])
    """
    return base_rotation(angle_rad)[:, :, 2] * (base_offset_m + length_m)


def pointing_angles_rad(position_m: Array) -> Array:
    """Joint angles of a straight link through a point: the inverse of `rigid_tip_m`.

    Parameters
    ----------
    position_m : ndarray, shape (n, 3)
        Any point on the link's axis, world frame, in m.

    Returns
    -------
    ndarray, shape (n, 2)
        Angle 1 and angle 2 in rad.
    """
    x, y, z = position_m.T
    return np.column_stack([np.arctan2(x, z), np.arctan2(y, np.hypot(x, z))])
