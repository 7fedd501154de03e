"""Pose of the markers at rest against the nominal link: origin, tilt, yaw, scale, exchanged names.

The measured markers are the nominal ones under a rigid motion (Kabsch 1976). The residual of the
best motion reveals exchanged names, mirrored corners and a wrong scale; the motion itself reveals a
wrong origin, upward axis and yaw.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, permutations
from typing import Final

import numpy as np
from numpy.typing import NDArray

from firmware_py.link.marker_layout import MarkerLayout
from models.shared.kinematics import base_rotation
from models.trials.importers.mocap_frame import fit_rigid_motion, nominal_markers_m
from models.trials.trial import Array, TrialMeta
from models.trials.verdict.sag import nominal_sag_m

Order = NDArray[np.intp]

MOST_PERMUTED: Final = 5
"""Most rows or corners of which every order is tried: 120 orders."""
LEAST_MARKERS: Final = 4
"""Fewest markers that determine a pose."""
MOST_SAG: Final = 3.0
"""Largest sag, relative to the nominal link's: half its stiffness, and creep [assumed]."""
LEAST_SAG_M: Final = 0.005
"""Sag below which a link counts as straight: the limits of an upright link are as large."""
_BETTER: Final = 0.35
"""Fraction to which another order of the names must reduce the misfit [assumed]."""
_PER_RAD_M: Final = 0.001
"""Cost of a turn in terms of misfit: it decides between orders within 3 mm [assumed]."""
_SAME_PLACE_M: Final = 0.002
"""Largest distance between equal corners."""
_FAR_M: Final = 0.015
"""Misfit of a marker above which other orders of the names are tried."""


@dataclass(frozen=True)
class RestPose:
    """Pose of the link at rest, compared with the nominal link."""

    names: tuple[str, ...]  # Markers visible at rest, in the order of a trial
    measured_m: Array  # Mean places at rest, (k, 3)
    # Nominal places at the angle of the rest, with the sag of a lying link, (k, 3)
    nominal_m: Array
    offset_m: Array  # Crossing of the joint axes, from the markers, (3,)
    # The same if the whole tilt belongs to the frame and none to the link, (3,)
    crossing_m: Array
    # Distance of the highest markers' centre from its nominal place, horizontally
    tip_aside_m: float
    tilt_rad: float  # Tilt of the link against the nominal one
    yaw_rad: float  # Turn about z against the nominal link
    tilt_turned_rad: float  # Tilt against the nominal link with the joint angles of the other sign
    axis: Array  # Direction of the link, (3,)
    scale: float  # Measured distances, relative to the nominal ones
    # Distance of each marker from its nominal place after the best rigid motion, (k,)
    misfit_m: Array
    row_heights_m: Array  # Mean height of each row, (rows,); NaN if it was occluded
    sag_m: float  # Sag of the tip of a nominal link under its weight
    order: str  # Order of the names that fits, in words; "" if the names are in order
    # Direction of the single mirrored axis, (3,), if that order is the same reflection of the
    # section in every row, or if the rows are reversed and below the origin
    mirrored: Array | None


def rest_pose(
    markers_m: Mapping[str, Array], meta: TrialMeta, rest_rad: Array | None = None
) -> RestPose | None:
    """Pose from the mean place (3,) of each marker at rest; None for fewer than `LEAST_MARKERS`.

    `markers_m` is NaN for an occluded marker; `rest_rad` (dof,) are the joint angles.
    """
    layout = meta.layout
    names = tuple(n for n in layout.names if n in markers_m and np.isfinite(markers_m[n]).all())
    if len(names) < LEAST_MARKERS:
        return None
    measured = np.array([markers_m[n] for n in names])
    places = [layout.names.index(n) for n in names]
    upright = nominal_markers_m(meta)[places]
    turn = np.eye(3) if rest_rad is None else base_rotation(np.atleast_2d(rest_rad))[0]
    sag = nominal_sag_m(meta, turn)[places]
    order, wording = _order(names, measured, upright @ turn.T + sag, layout)
    ratio = _stiffness_ratio(upright @ turn.T, sag, order, measured)
    nominal = upright @ turn.T + ratio * sag
    placed = nominal[order]
    rotation, shift = fit_rigid_motion(placed, measured)  # measured = rotation nominal + shift
    axis = rotation @ turn[:, 2]
    tilt = _tilt_rad(rotation)
    rows = np.array(places) // layout.corners
    heights = [
        measured[rows == r, 2].mean() if (rows == r).any() else np.nan for r in range(layout.rows)
    ]
    highest = placed[:, 2] >= placed[:, 2].max() - 0.05
    aside = (measured - placed @ _about_z(rotation).T)[highest].mean(axis=0)
    return RestPose(
        names,
        measured,
        nominal,
        _origin_m(measured, placed, rotation, shift),
        shift,
        float(np.hypot(aside[0], aside[1])),
        tilt,
        float(np.arctan2(rotation[1, 0] - rotation[0, 1], rotation[0, 0] + rotation[1, 1])),
        _tilt_rad(rotation @ turn @ turn),
        axis,
        _scale(measured, placed),
        np.linalg.norm(placed @ rotation.T + shift - measured, axis=1),
        np.array(heights),
        float(np.linalg.norm(sag, axis=1).max()),
        wording,
        _mirrored(upright, order, layout, rotation @ turn, measured),
    )


def _stiffness_ratio(straight: Array, sag: Array, order: Order, measured: Array) -> float:
    """Multiple of the nominal sag, up to `MOST_SAG`, that minimises the remaining lean."""
    if np.abs(sag).max() < LEAST_SAG_M:
        return 0.0
    ratios = np.linspace(0.0, MOST_SAG, 13)
    tilts = [_tilt_rad(fit_rigid_motion((straight + r * sag)[order], measured)[0]) for r in ratios]
    return float(ratios[int(np.argmin(tilts))])


def _tilt_rad(rotation: Array) -> float:
    return float(np.arccos(np.clip(rotation[2, 2], -1, 1)))


def _scale(measured: Array, nominal: Array) -> float:
    sizes = [np.sqrt(np.sum((p - p.mean(axis=0)) ** 2)) for p in (measured, nominal)]
    return float(sizes[0] / sizes[1])


def _origin_m(measured: Array, nominal: Array, rotation: Array, shift: Array) -> Array:
    """Crossing of the joint axes, without a small tilt.

    A link that leans by bending would shift the crossing sideways by lean times height. Within 5°
    the lean cannot be separated from a tilt of the frame, so only yaw is kept of the rotation.
    """
    if rotation[2, 2] < np.cos(np.radians(5.0)):
        return shift
    about_z = _about_z(rotation)
    lowest = nominal[:, 2] <= nominal[:, 2].min() + 0.05
    apart = (measured - nominal @ about_z.T)[lowest].mean(axis=0)
    up = (measured - nominal @ about_z.T)[:, 2].mean()
    return np.array([apart[0], apart[1], up])


def _about_z(rotation: Array) -> Array:
    """Yaw of a rotation, as a rotation about the vertical."""
    yaw = np.arctan2(rotation[1, 0] - rotation[0, 1], rotation[0, 0] + rotation[1, 1])
    return np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1.0]])


def _mirrored(
    upright: Array, order: Order, layout: MarkerLayout, turn: Array, measured: Array
) -> Array | None:
    """Axis of the reflection that an order of the names amounts to; None if it is none."""
    if layout.rows == 1:
        return None
    if (upright[order, 2] != upright[:, 2]).any():  # rows: mirrored if the link is below zero
        return turn[:, 2] if measured[:, 2].max() < 0 else None
    named, placed = upright[:, :2], upright[order, :2]
    u, _, vt = np.linalg.svd(placed.T @ named)
    reflection = u @ vt  # placed = reflection named
    left = np.abs(named @ reflection.T - placed).max()
    if np.linalg.det(reflection) > 0 or left > _SAME_PLACE_M:
        return None
    values, vectors = np.linalg.eigh(0.5 * (reflection + reflection.T))
    return np.asarray(turn[:, :2] @ vectors[:, int(np.argmin(values))])


def _misfit(measured: Array, nominal: Array) -> float:
    rotation, shift = fit_rigid_motion(nominal, measured)
    return float(np.sqrt(np.mean((nominal @ rotation.T + shift - measured) ** 2) * 3))


def _order(
    names: Sequence[str], measured: Array, nominal: Array, layout: MarkerLayout
) -> tuple[Order, str]:
    """Order of the nominal places that fits the measured ones, and its description.

    Candidates are single markers exchanged, then corners exchanged in one row, then corners in all
    rows and rows exchanged. The first kind that reduces the misfit to a third is accepted. Reversed
    rows resemble mirrored corners of a link upside down: of equally good fits, the smaller turn is
    chosen.
    """
    same = np.arange(len(names))
    rotation, shift = fit_rigid_motion(nominal, measured)
    far = np.linalg.norm(nominal @ rotation.T + shift - measured, axis=1)
    misfit = _misfit(measured, nominal)
    if far.max() < _FAR_M:
        return same, ""
    found = _exchanged_pairs(names, measured, nominal, misfit, layout)
    if found is not None:
        return found
    index = {name: k for k, name in enumerate(names)}
    kinds = [("corner", row) for row in range(layout.rows)] if layout.rows > 1 else []
    for group in (kinds, [("corner", None), ("row", None)]):
        best = (np.inf, same, "")
        for kind, only in group:
            for order in _orders(layout.corners if kind == "corner" else layout.rows):
                moved = _permuted(index, order, kind, layout, only)
                if moved is None:
                    continue
                now = _misfit(measured, nominal[moved])
                # Corners that are all turned are a yaw, which the rigid motion contains.
                if kind == "corner" and misfit - now < 1e-3:
                    continue
                if now < _BETTER * misfit and now < _FAR_M:
                    cost = now + _PER_RAD_M * _turn_rad(measured, nominal[moved])
                    listed = ", ".join(str(o + 1) for o in order)
                    of = "" if only is None else f" of row {only + 1}"
                    best = min(
                        best, (cost, moved, f"{kind}s{of} are named in the order {listed}"),
                        key=lambda choice: choice[0],
                    )  # fmt: skip
        if best[2]:
            return best[1], best[2]
    return same, ""


def _turn_rad(measured: Array, nominal: Array) -> float:
    """Angle of the best rotation between nominal and measured places."""
    rotation, _ = fit_rigid_motion(nominal, measured)
    return float(np.arccos(np.clip((np.trace(rotation) - 1) / 2, -1, 1)))


def _orders(count: int) -> Iterator[tuple[int, ...]]:
    """Other orders of rows or corners: all if there are few, else cyclic and reversed ones."""
    same = tuple(range(count))
    if count <= MOST_PERMUTED:
        yield from (order for order in permutations(same) if order != same)
        return
    for k in range(count):
        turned = same[k:] + same[:k]
        yield from (order for order in (turned, turned[::-1]) if order != same)


def _permuted(
    index: Mapping[str, int],
    order: Sequence[int],
    kind: str,
    layout: MarkerLayout,
    only: int | None,
) -> Order | None:
    moved = []
    for name in index:
        row, corner = divmod(layout.names.index(name), layout.corners)
        if only not in (None, row):
            moved.append(index[name])
            continue
        row, corner = (order[row], corner) if kind == "row" else (row, order[corner])
        other = layout.row(row)[corner]
        if other not in index:
            return None
        moved.append(index[other])
    return np.array(moved)


def _exchanged_pairs(
    names: Sequence[str], measured: Array, nominal: Array, misfit: float, layout: MarkerLayout
) -> tuple[Order, str] | None:
    """Up to three pairs of exchanged names; None if they mirror the link with a pair per row."""
    order, now = np.arange(len(names)), misfit
    said: list[str] = []
    for _ in range(3):
        least, pair = now, (-1, -1)
        for i, j in combinations(range(len(names)), 2):
            trial = order.copy()
            trial[[i, j]] = trial[[j, i]]
            value = _misfit(measured, nominal[trial])
            if value < least:
                least, pair = value, (i, j)
        if least > 0.9 * now:
            break
        i, j = pair
        order[[i, j]] = order[[j, i]]
        said.append(f"{names[i]} and {names[j]} are swapped")
        now = least
        if now < _BETTER * misfit and now < _FAR_M / 2:
            return None if _is_in_all_rows(names, order, layout) else (order, ", ".join(said))
    return None


def _is_in_all_rows(names: Sequence[str], order: Order, layout: MarkerLayout) -> bool:
    """Whether names are exchanged in the same way in every row, as in a left-handed file."""
    places = np.array([layout.names.index(name) for name in names])
    row, corner = np.divmod(places, layout.corners)
    changed = order != np.arange(len(names))
    if layout.rows == 1 or (row[order] != row).any():
        return False
    return int(changed.sum()) == layout.rows * len(set(corner[changed]))
