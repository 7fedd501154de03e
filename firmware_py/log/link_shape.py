"""Shape of the bending link in space, from joint angles and the predicted tip.

A tick determines the pose of the base plate and the position of the tip. Between them the link has
the slope of the plant's link under a tip force (`models.plant.components.link`): root bend φ at the
plate, and (2σ − σ²) of the span's bend ψ at the fraction σ of the length, with ψ/φ from the plant's
stiffnesses. φ is chosen so that the lateral distance of the tip is the predicted one. The residual
along the link, a few millimetres, is distributed over its length.
"""

from __future__ import annotations

from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

__all__ = ["LinkPose", "LinkShape", "pose_link"]

Array = NDArray[np.float64]

STATIONS: Final = 9
"""Points on the centre line, in addition to the marker rows."""
_CELLS: Final = 24
"""Cells of the midpoint rule along the link: 0.1 mm at a bend of 0.5 rad."""


class LinkShape(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Constants of a link that determine its shape for given angles and tip."""

    base_offset_m: float  # Height of the base plate above the joint axes
    length_m: float  # From the base plate to the last marker row
    # Positions of the markers, as in `firmware_py.link.marker_layout.MarkerLayout`
    rows_m: tuple[float, ...]
    corners_m: tuple[tuple[float, float], ...]
    bend_ratio: float  # Ratio of the bends of span and root under a force at the tip


class LinkPose(msgspec.Struct, frozen=True):
    """Pose of the link at one time, in the world frame and in m."""

    centre: Array  # (stations, 3), centre line from the base plate to the tip
    # (stations, corners, 3), corners of the section at each station, in the order of the layout
    edges: Array
    markers: Array  # (markers, 3)
    rigid_tip: Array  # (3,), tip of a rigid link


def pose_link(shape: LinkShape, angle_rad: Array, tip_m: Array) -> LinkPose:
    """Return the pose of the link for joint angles of shape (dof,) and a tip of shape (3,)."""
    turn = _base_rotation(angle_rad)
    own = turn.T @ tip_m - (0.0, 0.0, shape.base_offset_m)
    sideways_m = float(np.hypot(own[0], own[1]))
    towards = own[:2] / sideways_m if sideways_m > 0 else np.array([1.0, 0.0])
    root_rad = _root_bend(shape, sideways_m)
    stations = np.linspace(0.0, 1.0, STATIONS)
    rows = np.array(shape.rows_m) / shape.rows_m[-1]
    centre, sections = _sections(shape, root_rad, towards, own, np.concatenate([stations, rows]))
    corners = np.array([(x, y, 0.0) for x, y in shape.corners_m])
    placed = centre[:, None] + np.einsum("nij,cj->nci", sections, corners)
    lift = np.array([0.0, 0.0, shape.base_offset_m])
    return LinkPose(
        centre=(centre[:STATIONS] + lift) @ turn.T,
        edges=(placed[:STATIONS] + lift) @ turn.T,
        markers=((placed[STATIONS:] + lift) @ turn.T).reshape(-1, 3),
        rigid_tip=turn[:, 2] * (shape.base_offset_m + shape.length_m),
    )


def _sections(
    shape: LinkShape, root_rad: float, towards: Array, tip: Array, fractions: Array
) -> tuple[Array, Array]:
    """Return centres and rotations of sections along the length, in the frame of the base plate."""
    grid = (np.arange(_CELLS) + 0.5) / _CELLS
    slope = _slope(shape, root_rad, grid)
    edges = np.linspace(0.0, 1.0, _CELLS + 1)
    run = np.concatenate([[0.0], np.cumsum(np.sin(slope))]) * shape.length_m / _CELLS
    rise = np.concatenate([[0.0], np.cumsum(np.cos(slope))]) * shape.length_m / _CELLS
    across = np.interp(fractions, edges, run)
    centre = np.column_stack(
        [across * towards[0], across * towards[1], np.interp(fractions, edges, rise)]
    )
    last = np.array([run[-1] * towards[0], run[-1] * towards[1], rise[-1]])
    centre += fractions[:, None] * (tip - last)
    angle = _slope(shape, root_rad, fractions)
    x, y = towards
    zero, sine, cosine = np.zeros_like(angle), np.sin(angle), np.cos(angle)
    less = 1.0 - cosine
    rows = [
        [1.0 - x * x * less, -x * y * less, x * sine],
        [-x * y * less, 1.0 - y * y * less, y * sine],
        [-x * sine, -y * sine, cosine + zero],
    ]
    return centre, np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def _slope(shape: LinkShape, root_rad: float, fractions: Array) -> Array:
    """Return the angles between sections and base plate."""
    spread = 2.0 * fractions - fractions**2
    return np.asarray(root_rad * (1.0 + shape.bend_ratio * spread))


def _root_bend(shape: LinkShape, sideways_m: float) -> float:
    """Return the root bend that gives a lateral distance of the tip."""
    grid = (np.arange(_CELLS) + 0.5) / _CELLS
    growth = _slope(shape, 1.0, grid)
    wanted = min(sideways_m / shape.length_m, 0.9)  # no link bends farther
    bend = wanted / float(growth.mean())
    for _ in range(3):  # Newton's method, from the first-order solution
        error = float(np.sin(bend * growth).mean()) - wanted
        bend -= error / float((np.cos(bend * growth) * growth).mean())
    return bend


def _base_rotation(angle_rad: Array) -> Array:
    """Return R_y(angle 1) R_x(−angle 2), as `models.shared.kinematics.base_rotation` does."""
    q1, q2 = float(angle_rad[0]), float(angle_rad[1]) if len(angle_rad) > 1 else 0.0
    c1, s1, c2, s2 = np.cos(q1), np.sin(q1), np.cos(q2), np.sin(q2)
    return np.array(
        [[c1, -s1 * s2, s1 * c2], [0.0, c2, s2], [-s1, -c1 * s2, c1 * c2]], dtype=np.float64
    )
