"""Pose of the markers at rest against the nominal link: names, scale, frame, origin.

The measured markers are the nominal ones under a rigid motion (Kabsch 1976). The residual of the
best motion reveals exchanged names, mirrored corners and a wrong scale; the motion itself reveals
a wrong origin, upward axis and yaw.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

from firmware_py.core.units import ANGLE, LENGTH
from firmware_py.link.marker_layout import MarkerLayout
from models.shared.kinematics import base_rotation
from models.trials.checks import causes
from models.trials.checks.causes import ImportFinding
from models.trials.recordings.frames import fit_rigid_motion, nominal_markers_m, world_rotation
from models.trials.recordings.mapping import RecordingMap
from models.trials.recordings.series import nominal_scale
from models.trials.trial import Array, TrialMeta

Order = NDArray[np.intp]

LYING_RAD: Final = np.radians(30.0)
"""Tilt above which the upward axis is wrong, as opposed to a tilted frame."""
ORIGIN_M, _ = causes.ORIGIN.limits
_, SMALL_TILT_RAD = causes.TILT.limits


class RestPose:
    """Pose of the link at rest, compared with the nominal link.

    It follows from the mean places, (k, 3), of the markers `names` in the order of a trial, and the
    joint angles, (dof,).
    """

    def __init__(
        self, names: Sequence[str], measured_m: Array, meta: TrialMeta, rest_rad: Array
    ) -> None:
        self.names, self.measured_m, self.meta, self.rest_rad = names, measured_m, meta, rest_rad
        layout, indices = meta.layout, _indices(names, meta.layout)
        self.turn: Array = base_rotation(rest_rad[None])[0]
        straight_m = nominal_markers_m(meta)[indices] @ self.turn.T
        sag_m = nominal_sag_m(meta, self.turn)[indices]
        self.sag_m = float(np.linalg.norm(sag_m, axis=1).max())  # Of a nominal link
        # Index of the nominal place at which each marker is, and what the names are in words
        self.places = at = _places(names, measured_m, straight_m + sag_m, layout)
        self.order = order_words(names, at, layout)
        sag_m = _stiffness_ratio(straight_m[at], sag_m[at], measured_m) * sag_m
        self.nominal_m = straight_m + sag_m
        placed_m = self.nominal_m[at]
        # measured = rotation placed + crossing. The joint axes cross there if the whole tilt
        # belongs to the frame, none to the link.
        self.rotation, self.crossing_m = fit_rigid_motion(placed_m, measured_m)
        moved_m = placed_m @ self.rotation.T + self.crossing_m
        self.misfit_m: Array = np.linalg.norm(moved_m - measured_m, axis=1)
        self.scale = _size_m(measured_m) / _size_m(placed_m)
        self.tilt_rad = _tilt_rad(self.rotation)
        r = self.rotation
        self.yaw_rad = float(np.arctan2(r[1, 0] - r[0, 1], r[0, 0] + r[1, 1]))
        # A link that leans by bending would shift the crossing sideways by lean times height.
        # Within 5° the lean cannot be separated from a tilt of the frame, so only yaw is a turn.
        apart_m = measured_m - Rotation.from_rotvec([0.0, 0.0, self.yaw_rad]).apply(placed_m)
        height_m = placed_m[:, 2]
        lowest_m = apart_m[height_m <= height_m.min() + 0.05].mean(axis=0)
        highest_m = apart_m[height_m >= height_m.max() - 0.05].mean(axis=0)
        upright_m = np.array([lowest_m[0], lowest_m[1], apart_m[:, 2].mean()])
        self.offset_m = self.crossing_m if self.tilt_rad > SMALL_TILT_RAD else upright_m
        self.tip_aside_m = float(np.hypot(highest_m[0], highest_m[1]))
        heights_m = np.full((layout.rows, layout.corners), np.nan)
        heights_m.flat[indices] = measured_m[:, 2]
        self.row_heights_m = visible_mean(heights_m.T)


def rest_pose(
    markers_m: Mapping[str, Array], meta: TrialMeta, rest_rad: Array | None = None
) -> RestPose | None:
    """Pose from the mean place (3,) of each marker at rest; None for fewer than four.

    `markers_m` is NaN for an occluded marker; `rest_rad` (dof,) are the joint angles.
    """
    means_m = {name: markers_m[name] for name in meta.layout.names if name in markers_m}
    visible = {name: mean_m for name, mean_m in means_m.items() if np.isfinite(mean_m).all()}
    if len(visible) < 4:
        return None
    rest_rad = np.zeros(meta.dof) if rest_rad is None else np.asarray(rest_rad)
    return RestPose(tuple(visible), np.array([*visible.values()]), meta, rest_rad)


def visible_mean(rows_m: Array) -> Array:
    """Mean over rows (n, …) without those that were not visible; NaN if none was."""
    visible = np.isfinite(rows_m)
    count = visible.sum(axis=0)
    total = np.where(visible, rows_m, 0.0).sum(axis=0)
    return np.asarray(np.where(count > 0, total / np.maximum(count, 1), np.nan))


def _indices(names: Sequence[str], layout: MarkerLayout) -> list[int]:
    return [layout.names.index(name) for name in names]


def _size_m(places_m: Array) -> float:
    return float(np.linalg.norm(places_m - places_m.mean(axis=0)))


def _tilt_rad(rotation: Array) -> float:
    return float(np.arccos(np.clip(rotation[2, 2], -1, 1)))


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
    scale = nominal_scale(meta)
    sunk, slope = scale.deflection(
        places[:, 2] - meta.base_offset_m,
        (scale.tip_mass_kg + meta.payload_kg) * size_m_s2,
        scale.mass_kg * size_m_s2 / meta.link_length_m,
    )
    in_section = (places * [1.0, 1.0, 0.0]) @ turn.T
    return np.asarray(np.outer(sunk, direction) - np.outer(slope * (in_section @ direction), axis))


def _stiffness_ratio(straight: Array, sag: Array, measured: Array) -> float:
    """Multiple of the nominal sag that minimises the remaining lean.

    It is at most 3: half of the nominal stiffness, and creep [assumed]. Below 5 mm a link counts
    as straight: the limits of an upright link are as large.
    """
    if np.abs(sag).max() < 0.005:
        return 0.0
    ratios = np.linspace(0.0, 3.0, 13)
    tilts = [_tilt_rad(fit_rigid_motion(straight + r * sag, measured)[0]) for r in ratios]
    return float(ratios[int(np.argmin(tilts))])


# --- order of the names --------------------------------------------------------------------------

FAR_M: Final = causes.SHAPE.limits[1]
"""Misfit of a marker above which other orders of the names are tried."""
BETTER: Final = 0.35
"""Fraction to which another order of the names must reduce the misfit [assumed]."""


def nearest_order(measured: Array, reference: Array, rotation: Array) -> Order:
    """Indices of the reference points (k, 3) that the measured points (k, 3) are.

    From a first rotation of the reference, nearest pairs and the best rigid motion are computed in
    turn (the iterative closest point of Besl and McKay 1992, with one-to-one pairs).
    """
    for _ in range(4):
        placed = (reference - reference.mean(axis=0)) @ rotation.T + measured.mean(axis=0)
        cost = np.fmin(cdist(measured, placed, "sqeuclidean"), 1e12)  # of a wild marker: finite
        order = linear_sum_assignment(cost)[1]
        rotation, _ = fit_rigid_motion(reference[order], measured)
    return np.asarray(order)


def _places(names: Sequence[str], measured: Array, nominal: Array, layout: MarkerLayout) -> Order:
    """Index of the nominal place at which each marker is, by the shape alone.

    A section has symmetries: reversed rows resemble mirrored corners of a link upside down. A few
    exchanged names are preferred to many; of orders that fit alike, the smallest turn is chosen.
    """
    same = np.arange(len(names))
    rotation, off_m = _fit(nominal, measured)
    if off_m.max() < FAR_M:
        return same
    largest_m = min(BETTER * float(np.sqrt(np.mean(off_m**2))), FAR_M)
    best = (True, np.inf, same)
    for start in (rotation, *Rotation.create_group("O").as_matrix()):
        order = nearest_order(measured, nominal, start)
        turn, off_m = _fit(nominal[order], measured)
        misfit_m = float(np.sqrt(np.mean(off_m**2)))
        if misfit_m < largest_m:
            # Three pairs may be exchanged singly, but not alike in every row.
            is_many = (order != same).sum() > 6 or _of_grid(names, order, layout) is not None
            # A millimetre per radian decides between orders within 3 mm [assumed].
            cost_m = misfit_m + 0.001 * Rotation.from_matrix(turn).magnitude()
            best = min(best, (is_many, cost_m, order), key=lambda b: b[:2])
    return best[2]


def _fit(nominal: Array, measured: Array) -> tuple[Array, Array]:
    """Rotation of the best motion from nominal to measured places, and the remaining distances."""
    rotation, shift = fit_rigid_motion(nominal, measured)
    return rotation, np.linalg.norm(nominal @ rotation.T + shift - measured, axis=1)


def _of_grid(
    names: Sequence[str], order: Order, layout: MarkerLayout
) -> tuple[str, list[int]] | None:
    """Order of "rows", or of "corners" alike in every row, that an order of names amounts to."""
    if layout.rows == 1 or layout.corners == 1:
        return None
    row, corner = np.divmod(_indices(names, layout), layout.corners)
    rows, corners = np.arange(layout.rows), np.arange(layout.corners)
    rows[row], corners[corner] = row[order], corner[order]
    if (row[order] == row).all() and (corner[order] == corners[corner]).all():
        return "corners", corners.tolist()
    if (corner[order] == corner).all() and (row[order] == rows[row]).all():
        return "rows", rows.tolist()
    return None


def order_words(names: Sequence[str], order: Order, layout: MarkerLayout) -> str:
    """Order of names in words; empty if they are in order."""
    if (order == np.arange(len(names))).all():
        return ""
    if of_grid := _of_grid(names, order, layout):
        return f"{of_grid[0]} are named in the order {', '.join(str(k + 1) for k in of_grid[1])}"
    words = []
    for k, place in enumerate(order):
        if order[place] != k:
            words.append(f"{names[k]} is in the place of {names[place]}")
        elif k < place:
            words.append(f"{names[k]} and {names[place]} are swapped")
    return ", ".join(words)


# --- findings ------------------------------------------------------------------------------------

UNITS: Final = (("mm", 1e3), ("cm", 1e2), ("inches", 39.37), ("feet", 3.281), ("km", 1e-3))
"""Units in which lengths may be, and how many of them are 1 m."""


def unit_of_length(ratio: float) -> str:
    """Unit in words, if a length is this many times what it is in m; else empty."""
    named = [unit for unit, per_m in UNITS if abs(ratio / per_m - 1) < 0.05]
    return f": it is in {named[0]}" if named else ""


def judge_pose(pose: RestPose, mapping: RecordingMap, default_up: str) -> list[ImportFinding]:
    """Findings on a pose before alignment, the most likely cause first.

    `default_up` is the upward axis of the format, used if the map does not state one.
    """
    size = _scale(pose)
    if size and unit_of_length(pose.scale):
        return size  # the shape in another unit fits no order of the names
    findings = [*(_names(pose, mapping, default_up) or size)]
    if mapping.frame.align == "rest" and pose.sag_m > ORIGIN_M:
        findings += causes.SAG.raised(sag_m=pose.sag_m)
    if zero := _encoder_zero(pose):
        return findings + zero
    if mapping.frame.align == "none" and not any(f.level == "refused" for f in size):
        findings += _frame(pose, mapping, default_up)
        if not size:  # which shifts the height of the rows
            findings += _origin(pose, mapping)
    if not findings:
        worst = int(np.argmax(pose.misfit_m))
        findings += causes.SHAPE.beyond(pose.misfit_m[worst], name=pose.names[worst])
    return findings


def _scale(pose: RestPose) -> list[ImportFinding]:
    """Finding on a wrong unit of length, or a wrong length or width of the link."""
    along, across = _spacing(pose)
    if not abs(along - across) > 0.03 * across:  # or one of them is unknown
        unit = unit_of_length(pose.scale)
        return causes.SCALE.beyond(pose.scale - 1, scale=pose.scale, unit=unit)
    length_m, width_m = along * pose.meta.link_length_m, across * pose.meta.link_width_m
    return [
        *causes.ROW_SPACING.beyond(along - 1, ratio=along, other=across, fits_m=length_m),
        *causes.CORNER_SPACING.beyond(across - 1, ratio=across, other=along, fits_m=width_m),
    ]


def _spacing(pose: RestPose) -> tuple[float, float]:
    """Measured over nominal distances along the link, and across it; NaN if unknown."""
    indices = np.array(_indices(pose.names, pose.meta.layout))[pose.places]
    row = indices // pose.meta.layout.corners
    in_link_m = (pose.measured_m - pose.crossing_m) @ (pose.rotation @ pose.turn)
    sizes = []
    for place_m in (in_link_m, nominal_markers_m(pose.meta)[indices]):
        centre_m = np.array([place_m[row == r].mean(axis=0) for r in row])
        sizes.append((centre_m[:, 2].std(), np.linalg.norm((place_m - centre_m)[:, :2])))
    along, across = (a / b if b > 0.002 else np.nan for a, b in zip(*sizes, strict=True))
    return float(along), float(across)


def _encoder_zero(pose: RestPose) -> list[ImportFinding]:
    """Finding if the link stands upright at rest while an angle reads something else.

    A reading below 8° is no wrong zero: the servo's first samples may miss those of the markers by
    5° where a recording starts in the motion.
    """
    joint = int(np.argmax(np.abs(pose.rest_rad)))
    rest_rad = float(pose.rest_rad[joint])
    tilt_rad = _tilt_rad(pose.rotation @ pose.turn)
    if tilt_rad >= min(SMALL_TILT_RAD, pose.tilt_rad / 3) or abs(rest_rad) < 0.14:
        return []
    return causes.ZERO.raised(joint=joint + 1, rest_rad=rest_rad, offset_rad=-rest_rad)


def _names(pose: RestPose, mapping: RecordingMap, default_up: str) -> list[ImportFinding]:
    """Finding on an order of the names, or on a left-handed file that looks like one."""
    if not pose.order:
        return []
    axis = _mirrored_axis(pose, world_rotation(mapping.frame, default_up))
    if axis is None:
        return causes.ORDER.raised(order=pose.order)
    if mapping.frame.mirror:
        return causes.MIRROR_OR_ORDER.raised(order=pose.order, mirror=mapping.frame.mirror)
    return causes.LEFT_HANDED.raised(order=pose.order, axis=axis)


def _mirrored_axis(pose: RestPose, from_file: Array) -> str | None:
    """Axis of the file without whose mirror the names are right, with the smallest turn.

    `from_file` is the rotation to the world. Reversed rows are names, unless the link is below the
    origin.
    """
    turns_rad = []
    for signs in 1.0 - 2.0 * np.eye(3):
        mirrored_m = pose.measured_m @ (from_file * signs @ from_file.T)
        rotation, off_m = _fit(pose.nominal_m, mirrored_m)
        turn_rad = Rotation.from_matrix(rotation).magnitude()
        turns_rad.append(turn_rad if off_m.max() < FAR_M else np.inf)
    axis = int(np.argmin(turns_rad))
    along = abs((from_file.T @ pose.rotation @ pose.turn[:, 2])[axis])
    if turns_rad[axis] == np.inf or (along > 0.7 and pose.measured_m[:, 2].max() > 0):
        return None
    return "xyz"[axis]


def _frame(pose: RestPose, mapping: RecordingMap, default_up: str) -> list[ImportFinding]:
    """Findings on upward axis, yaw and tilt."""
    if pose.tilt_rad > LYING_RAD:
        axis = pose.rotation @ pose.turn[:, 2]
        in_file = world_rotation(mapping.frame, default_up).T @ axis
        k = int(np.argmax(np.abs(in_file)))
        up = f"{'-' if in_file[k] < 0 else ''}{'xyz'[k]}"
        return causes.UP_AXIS.raised(up=up, now=mapping.frame.up or default_up)
    yaw_deg = (mapping.frame.yaw_deg - np.degrees(pose.yaw_rad) + 180.0) % 360.0 - 180.0
    findings = causes.CORNERS_TURNED.beyond(pose.yaw_rad, yaw_deg=yaw_deg)
    level = causes.TILT.level(pose.tilt_rad)
    if level and _tilt_rad(pose.rotation @ pose.turn @ pose.turn) < pose.tilt_rad / 3:
        return findings + causes.LEANS_AGAINST.raised(tilt_rad=pose.tilt_rad)
    if not level and not _is_tilt(pose):
        return findings
    measured = {"tilt_rad": pose.tilt_rad, "aside_m": pose.tip_aside_m}
    return [*findings, causes.TILT.at(level or "warning", **measured)]


def _is_tilt(pose: RestPose) -> bool:
    """Whether a lean about the origin, and not a shift, displaces the lowest markers sideways."""
    aside_m, shift_m = (float(np.hypot(*v[:2])) for v in (pose.offset_m, pose.crossing_m))
    return shift_m < ORIGIN_M < min(aside_m, pose.tip_aside_m)


def _origin(pose: RestPose, mapping: RecordingMap) -> list[ImportFinding]:
    """Finding on the origin of an upright link."""
    if pose.tilt_rad > LYING_RAD:
        return []
    offset_m = pose.offset_m * [0.0, 0.0, 1.0] if _is_tilt(pose) else pose.offset_m
    upright = msgspec.structs.replace(mapping.frame, up="z", mirror=None)
    return causes.ORIGIN.beyond(
        float(np.linalg.norm(offset_m)),
        height_m=abs(offset_m[2]), way="low" if offset_m[2] > 0 else "high",
        aside_m=np.hypot(*offset_m[:2]), off_m=-offset_m,
        new_m=np.array(mapping.frame.origin_m) + world_rotation(upright, "z").T @ offset_m,
    )  # fmt: skip


def judge_base(pose: RestPose) -> list[ImportFinding]:
    """Findings on the pose of the link's markers after the alignment by the base's."""
    off_m = float(np.linalg.norm(pose.offset_m))
    wrong = (
        causes.TILT.level(pose.tilt_rad), causes.CORNERS_TURNED.level(pose.yaw_rad),
        causes.ORIGIN.level(off_m),
    )  # fmt: skip
    if "refused" not in wrong:
        return []
    return causes.BASE_ORDER.raised(tilt_rad=pose.tilt_rad, yaw_rad=pose.yaw_rad, off_m=off_m)


# --- lean ----------------------------------------------------------------------------------------


def judge_removed_lean(pose: RestPose, mapping: RecordingMap) -> list[ImportFinding]:
    """Finding on a lean that an alignment by the link itself takes away."""
    lean = _removed_lean(pose, mapping)
    return causes.REMOVED_LEAN.beyond(lean[1], lean=_lean_words(*lean)) if lean else []


def lean_facts(
    pose: RestPose | None, mapping: RecordingMap, findings: Sequence[ImportFinding]
) -> dict[str, Any]:
    """Lean of the link at rest, if it was removed, or if it is large and no finding names it."""
    if pose is None:
        return {}
    if lean := _removed_lean(pose, mapping):
        text = f'align = "rest" took away a lean of {_lean_words(*lean)}'
        return {"removed_lean_rad": lean[0], "removed_lean_tip_m": lean[1], "lean": text}
    is_named = any(finding.cause == "tilt" for finding in findings)
    if mapping.frame.align != "none" or is_named or not pose.tip_aside_m > ORIGIN_M:
        return {}
    words = _lean_words(pose.tilt_rad, pose.tip_aside_m)
    return {"lean": f"at rest the link leans by {words} (a prebend, or a tilted frame)"}


def _removed_lean(pose: RestPose, mapping: RecordingMap) -> tuple[float, float] | None:
    """Lean in rad, and in m at the tip, that an alignment by the link itself takes away.

    Beyond 30° the file's upward axis is another, and no lean is known.
    """
    if mapping.frame.align != "rest" or pose.tilt_rad > LYING_RAD:
        return None
    reach_m = pose.meta.base_offset_m + pose.meta.link_length_m
    return pose.tilt_rad, float(reach_m * np.sin(pose.tilt_rad))


def _lean_words(angle_rad: float, tip_m: float) -> str:
    return f"{ANGLE.text(angle_rad)}, {LENGTH.text(tip_m, 0)} at the tip"
