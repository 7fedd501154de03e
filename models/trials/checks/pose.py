"""Sag of a nominal link of given size under its weight at rest (Timoshenko beam).

The weight F of payload and hardware at the tip, and the link's weight q per length, act by their
components across the link. With a root patch of stiffness k, bending stiffness EI and shear
stiffness kGA (docs/sources.md, "The link") they displace a point at height z above the base plate
by

    w(z) = (F L + q L² / 2) z / k + F z / kGA + F (L z² / 2 - z³ / 6) / EI
           + q z² (6 L² - 4 L z + z²) / (24 EI).

An upright link at zero angle does not sag, a lying one does.

Pose of the markers at rest against the nominal link: origin, tilt, yaw, scale, exchanged names.

The measured markers are the nominal ones under a rigid motion (Kabsch 1976). The residual of the
best motion reveals exchanged names, mirrored corners and a wrong scale; the motion itself reveals a
wrong origin, upward axis and yaw.

Findings on the rest pose: wrong names, scale, upward axis, origin, yaw, and their remedies.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, permutations
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from firmware_py.display_units import ANGLE, LENGTH
from firmware_py.link.link_description import STUDY_LINK
from firmware_py.link.marker_layout import MarkerLayout
from models.shared.kinematics import base_rotation
from models.shared.link_scale import LinkScale
from models.trials.checks.finding import (
    OFFSET_M,
    SCALE,
    SHAPE_M,
    TILT_RAD,
    YAW_RAD,
    ImportFinding,
    level_of,
)
from models.trials.recordings.mapping import RecordingMap
from models.trials.recordings.series import fit_rigid_motion, nominal_markers_m, world_rotation
from models.trials.trial import Array, TrialMeta


def nominal_sag_m(meta: TrialMeta, turn: Array) -> Array:
    """Displacement of each marker of a nominal link by weight, in the world frame, shape (k, 3)."""
    axis = turn[:, 2]
    gravity = np.array(meta.gravity)
    across = gravity - (gravity @ axis) * axis
    size_m_s2 = float(np.linalg.norm(across))
    places = nominal_markers_m(meta)
    if size_m_s2 < 1e-6:
        return np.zeros_like(places)
    direction = across / size_m_s2
    link = msgspec.structs.replace(
        STUDY_LINK, length_m=meta.link_length_m, width_m=meta.link_width_m,
        pressure_pa=meta.pressure_pa or STUDY_LINK.pressure_pa,
    )  # fmt: skip
    scale, length_m = LinkScale(link), meta.link_length_m
    tip_n = (scale.tip_mass_kg + meta.payload_kg) * size_m_s2
    own_n_m = scale.mass_kg * size_m_s2 / length_m
    root = (tip_n * length_m + own_n_m * length_m**2 / 2) / scale.root_nm_rad

    def displaced(z: Array) -> Array:
        bent = tip_n * (length_m * z**2 / 2 - z**3 / 6)
        bent += own_n_m * z**2 * (6 * length_m**2 - 4 * length_m * z + z**2) / 24
        return (root + tip_n / scale.shear_n) * z + bent / scale.bending_n_m2

    z = places[:, 2] - meta.base_offset_m
    slope = (displaced(z + 1e-4) - displaced(z - 1e-4)) / 2e-4
    in_section = (places * [1.0, 1.0, 0.0]) @ turn.T
    sunk = np.outer(displaced(z), direction)  # the section also turns with the link
    return np.asarray(sunk - np.outer(slope * (in_section @ direction), axis))


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


_LYING_RAD = np.radians(30.0)
"""Tilt above which the upward axis is wrong, as opposed to a tilted frame."""


def judge_pose(pose: RestPose, mapping: RecordingMap, default_up: str) -> list[ImportFinding]:
    """Findings on a pose before alignment, the most likely cause first.

    `default_up` is the upward axis of the format, used if the map does not state one.
    """
    found = _names(pose, mapping, default_up)
    level = level_of(pose.scale - 1, SCALE)
    if level and not found:
        found.append(
            ImportFinding(
                level, "scale",
                f"the markers' distances are {pose.scale:.3f} times those of the link",
                "correct link_length_m and link_width_m, or the unit of length",
            )
        )  # fmt: skip
    if mapping.frame.align == "rest" and pose.sag_m > OFFSET_M[0]:
        found.append(
            ImportFinding(
                "warning", "sag",
                f'align = "rest" takes the link for straight, but at rest it sags by about '
                f"{LENGTH.text(pose.sag_m, 0)}",
                'align by the base\'s markers, or give the frame with align = "none"',
            )
        )  # fmt: skip
    aligned = mapping.frame.align != "none"
    if not aligned and level != "refused":
        found += _frame(pose, mapping, default_up)
    worst = int(np.argmax(pose.misfit_m))
    level = level_of(pose.misfit_m[worst], SHAPE_M)
    if level and not found:
        found.append(
            ImportFinding(
                level, "shape",
                f"{pose.names[worst]} is {LENGTH.text(pose.misfit_m[worst], 0)} from its place on "
                "the link",
                "check its name under [markers], its place, and the size of the link",
            )
        )  # fmt: skip
    return found


def judge_base(pose: RestPose) -> list[ImportFinding]:
    """Findings on the pose of the link's markers after the alignment by the base's."""
    wrong = []
    if pose.tilt_rad > TILT_RAD[1]:
        wrong.append(f"leans by {ANGLE.text(pose.tilt_rad)}")
    if pose.tilt_rad < _LYING_RAD and abs(pose.yaw_rad) > YAW_RAD[1]:
        wrong.append(f"is turned by {ANGLE.text(pose.yaw_rad)}")
    if np.linalg.norm(pose.offset_m) > OFFSET_M[1]:
        wrong.append(f"is {np.linalg.norm(pose.offset_m):.3f} m off")
    if not wrong:
        return []
    return [
        ImportFinding(
            "refused", "base", f"by the base's markers the link {' and '.join(wrong)}",
            "correct b01 … b04 under [markers]: the corners (+x, +y), (-x, +y), (+x, -y), (-x, -y) "
            "of the base plate",
        )
    ]  # fmt: skip


def _names(pose: RestPose, mapping: RecordingMap, default_up: str) -> list[ImportFinding]:
    if not pose.order:
        return []
    if pose.mirrored is None:
        return [ImportFinding("refused", "swapped", pose.order, "correct [markers] in MAP.toml")]
    order = f"the {pose.order}, the other way round"
    if mapping.frame.mirror:
        return [
            ImportFinding(
                "refused", "swapped",
                f'with mirror = "{mapping.frame.mirror}" the axes are left-handed, or {order}',
                "leave mirror out of [frame], or correct [markers] in MAP.toml",
            )
        ]  # fmt: skip
    in_file = np.abs(world_rotation(mapping.frame, default_up).T @ pose.mirrored)
    axis = "xyz"[int(np.argmax(in_file))]
    return [
        ImportFinding(
            "refused", "swapped",
            f"the file's axes are left-handed (one axis is mirrored), or {order}",
            f'set mirror = "{axis}" under [frame]; correct [markers] only where the names really '
            "are in that order",
        )
    ]  # fmt: skip


def _frame(pose: RestPose, mapping: RecordingMap, default_up: str) -> list[ImportFinding]:
    if pose.tilt_rad > _LYING_RAD:
        return [_upward_axis(pose, mapping, default_up)]
    found = []
    level = level_of(pose.yaw_rad, YAW_RAD)
    if level:
        turn = (mapping.frame.yaw_deg - np.degrees(pose.yaw_rad) + 180.0) % 360.0 - 180.0
        found.append(
            ImportFinding(
                level, "yaw",
                f"the corners of the link are turned by {ANGLE.text(pose.yaw_rad)} about the "
                "vertical",
                f"set yaw_deg = {turn:.1f} under [frame], or correct the order of the corners",
            )
        )  # fmt: skip
    level = level_of(pose.tilt_rad, TILT_RAD)
    if level and pose.tilt_turned_rad < pose.tilt_rad / 3:
        found.append(
            ImportFinding(
                "refused", "sign",
                f"the link leans by {ANGLE.text(pose.tilt_rad)} against its angles at rest, and "
                "not at all against these with the other sign: the servo counts the other way",
                "set scale = -1.0 for the angle and its goal, or correct up, mirror and yaw_deg",
            )
        )  # fmt: skip
    elif level or _is_tilt(pose):
        found.append(
            ImportFinding(
                level or "warning", "tilt",
                f"the link leans by {ANGLE.text(pose.tilt_rad)} at rest, which puts its tip "
                f"{LENGTH.text(pose.tip_aside_m, 0)} aside: a prebend of the link, or a tilted "
                "frame",
                "level the motion capture's frame, or map markers of the base and set "
                'align = "base"',
            )
        )  # fmt: skip
    return found + _origin(pose, mapping)


def _is_tilt(pose: RestPose) -> bool:
    """Whether a lean about the origin, and not a shift, displaces the lowest markers sideways."""
    aside_m, shift_m = (float(np.hypot(*v[:2])) for v in (pose.offset_m, pose.crossing_m))
    return shift_m < OFFSET_M[0] < min(aside_m, pose.tip_aside_m)


def _origin(pose: RestPose, mapping: RecordingMap) -> list[ImportFinding]:
    tilted = _is_tilt(pose)
    x, y, z = offset = np.array([0.0, 0.0, pose.offset_m[2]]) if tilted else pose.offset_m
    distance = float(np.linalg.norm(offset))
    level = level_of(distance, OFFSET_M)
    if not level:
        return []
    where = []
    if abs(z) > OFFSET_M[0] / 2:
        where.append(f"{abs(z):.3f} m too {'low' if z > 0 else 'high'}")
    if np.hypot(x, y) > OFFSET_M[0] / 2:
        where.append(f"{np.hypot(x, y):.3f} m aside ({-x:+.3f}, {-y:+.3f})")
    upright = msgspec.structs.replace(mapping.frame, up="z", mirror=None)
    new = np.array(mapping.frame.origin_m) + world_rotation(upright, "z").T @ offset
    place = ", ".join(f"{v:.3f}" for v in new)
    remedy = f"set origin_m = [{place}] under [frame], or correct base_offset_m"
    moved_m = np.hypot(*(pose.offset_m - pose.crossing_m)[:2])
    if not tilted and moved_m > OFFSET_M[0]:  # the lean displaces it by as much
        remedy = "correct the tilt first, then origin_m under [frame]"
    return [
        ImportFinding(
            level, "origin", f"the origin is {' and '.join(where) or f'{distance:.3f} m off'}",
            remedy,
        )
    ]  # fmt: skip


def _upward_axis(pose: RestPose, mapping: RecordingMap, default_up: str) -> ImportFinding:
    now = mapping.frame.up or default_up
    in_file = world_rotation(mapping.frame, default_up).T @ pose.axis
    k = int(np.argmax(np.abs(in_file)))
    axis, sign = "xyz"[k], "-" if in_file[k] < 0 else ""
    remedy = f'set up = "{sign}{axis}" under [frame]'
    return ImportFinding(
        "refused", "up axis",
        f"the file is {sign}{axis}-up: the link points along its {sign}{axis} axis, the map takes "
        f"{now} for up",
        remedy,
    )  # fmt: skip
