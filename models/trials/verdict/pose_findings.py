"""Findings on the rest pose: wrong names, scale, upward axis, origin, yaw, and their remedies."""

from __future__ import annotations

import msgspec
import numpy as np

from firmware_py.display_units import ANGLE, LENGTH
from models.trials.importers.mapping import RecordingMap
from models.trials.importers.mocap_frame import world_rotation
from models.trials.verdict.finding import (
    OFFSET_M,
    SCALE,
    SHAPE_M,
    TILT_RAD,
    YAW_RAD,
    ImportFinding,
    level_of,
)
from models.trials.verdict.rest_pose import RestPose

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
