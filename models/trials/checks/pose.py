"""Pose of the markers at rest against the nominal link: names, scale, frame, origin.

The measured markers are the nominal ones under a rigid motion (Kabsch 1976). The residual of the
best motion reveals exchanged names, mirrored corners and a wrong scale; the motion itself reveals
a wrong origin, upward axis and yaw.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, permutations
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from firmware_py.display_units import ANGLE
from firmware_py.link.link_description import STUDY_LINK
from firmware_py.link.marker_layout import MarkerLayout
from models.shared.kinematics import base_rotation
from models.shared.link_scale import LinkScale
from models.trials.checks import causes
from models.trials.checks.causes import ImportFinding
from models.trials.recordings.mapping import RecordingMap
from models.trials.recordings.series import fit_rigid_motion, nominal_markers_m, world_rotation
from models.trials.trial import Array, TrialMeta

Order = NDArray[np.intp]

LEAST_MARKERS: Final = 4
"""Fewest markers that determine a pose."""
MOST_SAG: Final = 3.0
"""Largest sag, relative to the nominal link's: half its stiffness, and creep [assumed]."""
LEAST_SAG_M: Final = 0.005
"""Sag below which a link counts as straight: the limits of an upright link are as large."""
LYING_RAD: Final = np.radians(30.0)
"""Tilt above which the upward axis is wrong, as opposed to a tilted frame."""
SMALL_TILT_RAD: Final = causes.TILT.limits[1]
ZERO_RAD: Final = 0.14
"""Angle at rest above which an upright link tells of a wrong zero: the servo's first samples may
miss those of the markers by 5° where a recording starts in the motion."""
UNLIKE_SPACING: Final = 0.03
"""Relative difference of the scales along and across the link above which its size is wrong."""


@dataclass(frozen=True)
class RestPose:
    """Pose of the link at rest, compared with the nominal link."""

    names: tuple[str, ...]  # Markers visible at rest, in the order of a trial
    measured_m: Array  # Mean places at rest, (k, 3)
    nominal_m: Array  # Nominal places at the angles of the rest, with a lying link's sag, (k, 3)
    rest_rad: Array  # Joint angles at rest, (dof,); zeros if unknown
    offset_m: Array  # Crossing of the joint axes, from the markers, (3,)
    crossing_m: Array  # The same if the whole tilt belongs to the frame, none to the link, (3,)
    tip_aside_m: float  # Distance of the highest markers from their nominal place, horizontally
    tilt_rad: float  # Tilt of the link against the nominal one
    yaw_rad: float  # Turn about z against the nominal link
    tilt_turned_rad: float  # Tilt against the nominal link at the angles of the other sign
    tilt_upright_rad: float  # Tilt against the nominal link at zero angles
    axis: Array  # Direction of the link, (3,)
    scale: float  # Measured distances, relative to the nominal ones
    spacing: tuple[float, float]  # The same along the link and across it; NaN if unknown
    size_m: tuple[float, float]  # Length and width of the nominal link
    misfit_m: Array  # Distance of each marker from its place after the best rigid motion, (k,)
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
    rest_rad = np.zeros(meta.dof) if rest_rad is None else np.asarray(rest_rad)
    turn = base_rotation(np.atleast_2d(rest_rad))[0]
    sag = nominal_sag_m(meta, turn)[places]
    order, wording = _order(names, measured, upright @ turn.T + sag, layout)
    nominal = upright @ turn.T + _stiffness_ratio(upright @ turn.T, sag, order, measured) * sag
    placed = nominal[order]
    rotation, shift = fit_rigid_motion(placed, measured)  # measured = rotation nominal + shift
    rows = np.array(places) // layout.corners
    heights = [
        measured[rows == r, 2].mean() if (rows == r).any() else np.nan for r in range(layout.rows)
    ]
    highest = placed[:, 2] >= placed[:, 2].max() - 0.05
    aside = (measured - placed @ _about_z(rotation).T)[highest].mean(axis=0)
    sizes = [np.sqrt(np.sum((p - p.mean(axis=0)) ** 2)) for p in (measured, placed)]
    return RestPose(
        names=names,
        measured_m=measured,
        nominal_m=nominal,
        rest_rad=rest_rad,
        offset_m=_origin_m(measured, placed, rotation, shift),
        crossing_m=shift,
        tip_aside_m=float(np.hypot(aside[0], aside[1])),
        tilt_rad=_tilt_rad(rotation),
        yaw_rad=_yaw_rad(rotation),
        tilt_turned_rad=_tilt_rad(rotation @ turn @ turn),
        tilt_upright_rad=_tilt_rad(rotation @ turn),
        axis=rotation @ turn[:, 2],
        scale=float(sizes[0] / sizes[1]),
        spacing=_spacing((measured - shift) @ (rotation @ turn), upright[order], rows[order]),
        size_m=(meta.link_length_m, meta.link_width_m),
        misfit_m=np.linalg.norm(placed @ rotation.T + shift - measured, axis=1),
        row_heights_m=np.array(heights),
        sag_m=float(np.linalg.norm(sag, axis=1).max()),
        order=wording,
        mirrored=_mirrored(upright, order, layout, rotation @ turn, measured),
    )


def nominal_sag_m(meta: TrialMeta, turn: Array) -> Array:
    """Displacement of each marker of a nominal link by weight, in the world frame, shape (k, 3).

    The weight of payload, hardware and link act by their components across the link: an upright
    link at zero angle does not sag, a lying one does.
    """
    axis, gravity, places = turn[:, 2], np.array(meta.gravity), nominal_markers_m(meta)
    across = gravity - (gravity @ axis) * axis
    size_m_s2 = float(np.linalg.norm(across))
    if size_m_s2 < 1e-6:
        return np.zeros_like(places)
    direction = across / size_m_s2
    link = msgspec.structs.replace(
        STUDY_LINK, length_m=meta.link_length_m, width_m=meta.link_width_m,
        pressure_pa=meta.pressure_pa or STUDY_LINK.pressure_pa,
    )  # fmt: skip
    scale = LinkScale(link)
    sunk, slope = scale.deflection(
        places[:, 2] - meta.base_offset_m,
        (scale.tip_mass_kg + meta.payload_kg) * size_m_s2,
        scale.mass_kg * size_m_s2 / meta.link_length_m,
    )
    in_section = (places * [1.0, 1.0, 0.0]) @ turn.T
    return np.asarray(np.outer(sunk, direction) - np.outer(slope * (in_section @ direction), axis))


def _stiffness_ratio(straight: Array, sag: Array, order: Order, measured: Array) -> float:
    """Multiple of the nominal sag, up to `MOST_SAG`, that minimises the remaining lean."""
    if np.abs(sag).max() < LEAST_SAG_M:
        return 0.0
    ratios = np.linspace(0.0, MOST_SAG, 13)
    tilts = [_tilt_rad(fit_rigid_motion((straight + r * sag)[order], measured)[0]) for r in ratios]
    return float(ratios[int(np.argmin(tilts))])


def _spacing(measured: Array, nominal: Array, rows: Order) -> tuple[float, float]:
    """Measured over nominal distances of the rows along the link, and of the corners across it.

    Both places are in the frame of the link.
    """
    along = [np.std([p[rows == r, 2].mean() for r in np.unique(rows)]) for p in (measured, nominal)]
    across = [
        np.linalg.norm(np.concatenate([v - v.mean(axis=0) for r in np.unique(rows)
                                       if len(v := p[rows == r, :2])]))
        for p in (measured, nominal)
    ]  # fmt: skip
    ratios = [a / b if b > SAME_CORNER_M else np.nan for a, b in (along, across)]
    return float(ratios[0]), float(ratios[1])


def _tilt_rad(rotation: Array) -> float:
    return float(np.arccos(np.clip(rotation[2, 2], -1, 1)))


def _yaw_rad(rotation: Array) -> float:
    return float(np.arctan2(rotation[1, 0] - rotation[0, 1], rotation[0, 0] + rotation[1, 1]))


def _about_z(rotation: Array) -> Array:
    """Yaw of a rotation, as a rotation about the vertical."""
    c, s = np.cos(yaw := _yaw_rad(rotation)), np.sin(yaw)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])


def _origin_m(measured: Array, nominal: Array, rotation: Array, shift: Array) -> Array:
    """Crossing of the joint axes, without a small tilt.

    A link that leans by bending would shift the crossing sideways by lean times height. Within 5°
    the lean cannot be separated from a tilt of the frame, so only yaw is kept of the rotation.
    """
    if _tilt_rad(rotation) > SMALL_TILT_RAD:
        return shift
    apart = measured - nominal @ _about_z(rotation).T
    lowest = nominal[:, 2] <= nominal[:, 2].min() + 0.05
    return np.array([*apart[lowest].mean(axis=0)[:2], apart[:, 2].mean()])


FAR_M: Final = causes.SHAPE.limits[1]
"""Misfit of a marker above which other orders of the names are tried."""
BETTER: Final = 0.35
"""Fraction to which another order of the names must reduce the misfit [assumed]."""
COST_OF_TURN_M: Final = 0.001
"""Cost of a radian in terms of misfit: it decides between orders within 3 mm [assumed]."""
MOST_PERMUTED: Final = 5
"""Most rows or corners of which every order is tried: 120 orders."""
SAME_CORNER_M: Final = 0.002
"""Largest distance between equal corners."""


def _misfit(measured: Array, nominal: Array) -> tuple[float, float]:
    """Residual of the best rigid motion in m, and its angle in rad."""
    rotation, shift = fit_rigid_motion(nominal, measured)
    left = float(np.sqrt(np.mean((nominal @ rotation.T + shift - measured) ** 2) * 3))
    return left, float(np.arccos(np.clip((np.trace(rotation) - 1) / 2, -1, 1)))


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
    if np.linalg.norm(nominal @ rotation.T + shift - measured, axis=1).max() < FAR_M:
        return same, ""
    misfit = _misfit(measured, nominal)[0]
    found = _exchanged_pairs(names, measured, nominal, misfit, layout)
    if found is not None:
        return found
    of_one_row = [("corner", row) for row in range(layout.rows)] if layout.rows > 1 else []
    for group in (of_one_row, [("corner", None), ("row", None)]):
        best = (np.inf, same, "")
        for kind, only in group:
            for order in _orders(layout.corners if kind == "corner" else layout.rows):
                moved = _permuted(names, order, kind, layout, only)
                if moved is None:
                    continue
                now, turn_rad = _misfit(measured, nominal[moved])
                # Corners that are all turned are a yaw, which the rigid motion contains.
                if now >= min(BETTER * misfit, FAR_M) or (kind == "corner" and misfit - now < 1e-3):
                    continue
                cost = now + COST_OF_TURN_M * turn_rad
                if cost < best[0]:
                    listed = ", ".join(str(o + 1) for o in order)
                    of = "" if only is None else f" of row {only + 1}"
                    best = cost, moved, f"{kind}s{of} are named in the order {listed}"
        if best[2]:
            return best[1], best[2]
    return same, ""


def _orders(count: int) -> Iterator[tuple[int, ...]]:
    """Other orders of rows or corners: all if there are few, else cyclic and reversed ones."""
    same = tuple(range(count))
    turned = [same[k:] + same[:k] for k in range(count)]
    every = permutations(same) if count <= MOST_PERMUTED else turned + [t[::-1] for t in turned]
    return (order for order in every if order != same)


def _permuted(
    names: Sequence[str], order: Sequence[int], kind: str, layout: MarkerLayout, only: int | None
) -> Order | None:
    """Indices of the markers whose places others have; None if one of them was not seen."""
    moved = []
    for name in names:
        row, corner = divmod(layout.names.index(name), layout.corners)
        if only in (None, row):
            row, corner = (order[row], corner) if kind == "row" else (row, order[corner])
        other = layout.row(row)[corner]
        if other not in names:
            return None
        moved.append(names.index(other))
    return np.array(moved)


def _exchanged_pairs(
    names: Sequence[str], measured: Array, nominal: Array, misfit: float, layout: MarkerLayout
) -> tuple[Order, str] | None:
    """Up to three pairs of exchanged names; None if they mirror the link with a pair per row."""
    order, now = np.arange(len(names)), misfit
    pairs: list[str] = []
    for _ in range(3):
        tried = []
        for i, j in combinations(range(len(names)), 2):
            other = order.copy()
            other[[i, j]] = other[[j, i]]
            tried.append((_misfit(measured, nominal[other])[0], i, j))
        least, i, j = min(tried)
        if least > 0.9 * now:
            break
        order[[i, j]], now = order[[j, i]], least
        pairs.append(f"{names[i]} and {names[j]} are swapped")
        if now < min(BETTER * misfit, FAR_M / 2):
            return None if _is_in_all_rows(names, order, layout) else (order, ", ".join(pairs))
    return None


def _is_in_all_rows(names: Sequence[str], order: Order, layout: MarkerLayout) -> bool:
    """Whether names are exchanged in the same way in every row, as in a left-handed file."""
    row, corner = np.divmod([layout.names.index(name) for name in names], layout.corners)
    changed = order != np.arange(len(names))
    if layout.rows == 1 or (row[order] != row).any():
        return False
    return int(changed.sum()) == layout.rows * len(set(corner[changed]))


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
    if np.linalg.det(reflection) > 0 or left > SAME_CORNER_M:
        return None
    values, vectors = np.linalg.eigh(0.5 * (reflection + reflection.T))
    return np.asarray(turn[:, :2] @ vectors[:, int(np.argmin(values))])


UNITS: Final = (("mm", 1e3), ("cm", 1e2), ("inches", 39.37), ("feet", 3.281), ("km", 1e-3))
"""Units in which lengths may be, and how many of them are 1 m."""
SAME_UNIT: Final = 0.05
"""Largest relative error at which a unit is recognised."""


def unit_of_length(ratio: float) -> str:
    """Unit in words, if a length is this many times what it is in m; else empty."""
    named = [unit for unit, per_m in UNITS if abs(ratio / per_m - 1) < SAME_UNIT]
    return f": it is in {named[0]}" if named else ""


def judge_pose(pose: RestPose, mapping: RecordingMap, default_up: str) -> list[ImportFinding]:
    """Findings on a pose before alignment, the most likely cause first.

    `default_up` is the upward axis of the format, used if the map does not state one.
    """
    size = _scale(pose)
    if size and unit_of_length(pose.scale):
        return size  # the shape in another unit fits no order of the names
    found = [*(_names(pose, mapping, default_up) or size)]
    if mapping.frame.align == "rest" and pose.sag_m > ORIGIN_M:
        found += causes.SAG.raised(sag_m=pose.sag_m)
    if zero := _encoder_zero(pose):
        return found + zero
    if mapping.frame.align == "none" and not any(f.level == "refused" for f in size):
        found += _frame(pose, mapping, default_up)
        if not size:  # which shifts the height of the rows
            found += _origin(pose, mapping)
    if not found:
        worst = int(np.argmax(pose.misfit_m))
        found += causes.SHAPE.beyond(pose.misfit_m[worst], name=pose.names[worst])
    return found


def _scale(pose: RestPose) -> list[ImportFinding]:
    """Finding on a wrong unit of length, or a wrong length or width of the link."""
    along, across = pose.spacing
    if not abs(along - across) > UNLIKE_SPACING * across:  # or one of them is unknown
        unit = unit_of_length(pose.scale)
        return causes.SCALE.beyond(pose.scale - 1, scale=pose.scale, unit=unit)
    return [
        *causes.ROW_SPACING.beyond(
            along - 1, ratio=along, other=across, found_m=along * pose.size_m[0]
        ),
        *causes.CORNER_SPACING.beyond(
            across - 1, ratio=across, other=along, found_m=across * pose.size_m[1]
        ),
    ]


def _encoder_zero(pose: RestPose) -> list[ImportFinding]:
    """Finding if the link stands upright at rest while an angle reads something else."""
    joint = int(np.argmax(np.abs(pose.rest_rad)))
    rest_rad = float(pose.rest_rad[joint])
    upright = pose.tilt_upright_rad < min(SMALL_TILT_RAD, pose.tilt_rad / 3)
    if not upright or abs(rest_rad) < ZERO_RAD:
        return []
    return causes.ZERO.raised(joint=joint + 1, rest_rad=rest_rad, offset_rad=-rest_rad)


def _names(pose: RestPose, mapping: RecordingMap, default_up: str) -> list[ImportFinding]:
    if not pose.order:
        return []
    if pose.mirrored is None:
        return causes.ORDER.raised(order=pose.order)
    if mapping.frame.mirror:
        return causes.MIRROR_OR_ORDER.raised(order=pose.order, mirror=mapping.frame.mirror)
    in_file = np.abs(world_rotation(mapping.frame, default_up).T @ pose.mirrored)
    return causes.LEFT_HANDED.raised(order=pose.order, axis="xyz"[int(np.argmax(in_file))])


def _frame(pose: RestPose, mapping: RecordingMap, default_up: str) -> list[ImportFinding]:
    """Findings on upward axis, yaw and tilt."""
    if pose.tilt_rad > LYING_RAD:
        in_file = world_rotation(mapping.frame, default_up).T @ pose.axis
        k = int(np.argmax(np.abs(in_file)))
        up = f"{'-' if in_file[k] < 0 else ''}{'xyz'[k]}"
        return causes.UP_AXIS.raised(up=up, now=mapping.frame.up or default_up)
    yaw_deg = (mapping.frame.yaw_deg - np.degrees(pose.yaw_rad) + 180.0) % 360.0 - 180.0
    found = causes.CORNERS_TURNED.beyond(pose.yaw_rad, yaw_deg=yaw_deg)
    level = causes.TILT.level(pose.tilt_rad)
    if level and pose.tilt_turned_rad < pose.tilt_rad / 3:
        found += causes.LEANS_AGAINST.raised(tilt_rad=pose.tilt_rad)
    elif level or _is_tilt(pose):
        found.append(
            causes.TILT.at(level or "warning", tilt_rad=pose.tilt_rad, aside_m=pose.tip_aside_m)
        )
    return found


ORIGIN_M: Final = causes.ORIGIN.limits[0]


def _is_tilt(pose: RestPose) -> bool:
    """Whether a lean about the origin, and not a shift, displaces the lowest markers sideways."""
    aside_m, shift_m = (float(np.hypot(*v[:2])) for v in (pose.offset_m, pose.crossing_m))
    return shift_m < ORIGIN_M < min(aside_m, pose.tip_aside_m)


def _origin(pose: RestPose, mapping: RecordingMap) -> list[ImportFinding]:
    """Finding on the origin of an upright link."""
    if pose.tilt_rad > LYING_RAD:
        return []
    tilted = _is_tilt(pose)
    x, y, z = offset = np.array([0.0, 0.0, pose.offset_m[2]]) if tilted else pose.offset_m
    distance = float(np.linalg.norm(offset))
    where = []
    if abs(z) > ORIGIN_M / 2:
        where.append(f"{abs(z):.3f} m too {'low' if z > 0 else 'high'}")
    if np.hypot(x, y) > ORIGIN_M / 2:
        where.append(f"{np.hypot(x, y):.3f} m aside ({-x:+.3f}, {-y:+.3f})")
    upright = msgspec.structs.replace(mapping.frame, up="z", mirror=None)
    new = np.array(mapping.frame.origin_m) + world_rotation(upright, "z").T @ offset
    place = ", ".join(f"{v:.3f}" for v in new)
    remedy = f"set origin_m = [{place}] under [frame], or correct base_offset_m"
    moved_m = np.hypot(*(pose.offset_m - pose.crossing_m)[:2])
    if not tilted and moved_m > ORIGIN_M:  # the lean displaces it by as much
        remedy = "correct the tilt first, then origin_m under [frame]"
    return causes.ORIGIN.beyond(
        distance, where=" and ".join(where) or f"{distance:.3f} m off", remedy=remedy
    )


def judge_base(pose: RestPose) -> list[ImportFinding]:
    """Findings on the pose of the link's markers after the alignment by the base's."""
    wrong = []
    if pose.tilt_rad > causes.TILT.limits[1]:
        wrong.append(f"leans by {ANGLE.text(pose.tilt_rad)}")
    if pose.tilt_rad < LYING_RAD and abs(pose.yaw_rad) > causes.CORNERS_TURNED.limits[1]:
        wrong.append(f"is turned by {ANGLE.text(pose.yaw_rad)}")
    if (distance_m := np.linalg.norm(pose.offset_m)) > causes.ORIGIN.limits[1]:
        wrong.append(f"is {distance_m:.3f} m off")
    return causes.BASE_ORDER.raised(wrong=" and ".join(wrong)) if wrong else []
