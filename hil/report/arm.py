"""The arm of a run in 3-D, moving: the link, the robot's prediction of it, and a rigid link.

The picture is a list of strokes on the picture plane. The report shows them as an SVG that moves
without a script, so a server that blocks scripts shows it too.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from firmware_py.core.units import LENGTH
from firmware_py.log.scene import LinkPose, LinkShape, pose_link
from hil.report.build_inputs import LoopRun
from models.shared.pages import LegendEntry, Panel
from models.shared.palette import BLUE, GRID, MUTED, ORANGE, PAGE_COLOURS

Array = NDArray[np.float64]

FRAMES: Final = 64
"""Frames of one cycle; the browser interpolates between them."""
MOST_CYCLE_S: Final = 8.0
"""Longest time that is shown of a run without a period."""
REPEATS: Final = 3
VIEW_RAD: Final = (0.49, 0.28)
"""Azimuth and elevation of the viewer."""
FLOOR: Final = 0.35
"""Depth of the floor below the joints, in lengths of the link."""
QUIET: Final = PAGE_COLOURS["quiet"]
LINK, PREDICTED, RIGID = BLUE, ORANGE, MUTED
LEGEND: Final = (
    LegendEntry(LINK, "link with its true tip"),
    LegendEntry(PREDICTED, "prediction of the robot", "dashed"),
    LegendEntry(RIGID, "rigid kinematics"),
)


@dataclass(frozen=True)
class Stroke:
    """Line with round ends through `points` (frames, n, 2) in m; a single frame does not move."""

    points: Array
    colour: str
    width_m: float
    opacity: float = 1.0
    dashed: bool = False


@dataclass(frozen=True)
class ArmMotion:
    """Poses of a run over one cycle of its motion."""

    shape: LinkShape
    duration_s: float
    true: list[LinkPose]
    predicted: list[LinkPose]
    true_tip_m: Array  # (n, 3), every tick of the cycle
    still: int  # Frame with the largest bend, which a page shows when nothing moves
    rigid_off_m: float  # Mean distance of a rigid link's tip from the true one
    predicted_off_m: float  # Mean distance of the predicted tip from the true one


def arm_motion(loop: LoopRun) -> ArmMotion | None:
    """Motion of a run's arm; None if the run lacks the ticks, the true tip or the link's shape."""
    if loop.ticks is None or loop.true_tip_m is None or loop.shape is None:
        return None
    shape, angle_rad, predicted_m = loop.shape, loop.angle_rad(), loop.predicted_tip_m()
    known = np.isfinite(np.hstack([angle_rad, predicted_m, loop.true_tip_m])).all(axis=1)
    rows = np.flatnonzero(_cycle(loop) & known)
    if len(rows) < FRAMES:
        return None
    frames = rows[np.linspace(0, len(rows) - 1, FRAMES).astype(int)]
    true = [pose_link(shape, angle_rad[k], loop.true_tip_m[k]) for k in frames]
    rigid_m = np.array([pose.rigid_tip for pose in true])
    return ArmMotion(
        shape=shape,
        duration_s=float(np.ptp(loop.time_s()[rows])),
        true=true,
        predicted=[pose_link(shape, angle_rad[k], predicted_m[k]) for k in frames],
        true_tip_m=loop.true_tip_m[rows],
        still=int(np.linalg.norm(rigid_m - loop.true_tip_m[frames], axis=1).argmax()),
        rigid_off_m=_mean_distance(rigid_m, loop.true_tip_m[frames]),
        predicted_off_m=_mean_distance(predicted_m[rows], loop.true_tip_m[rows]),
    )


def _cycle(loop: LoopRun) -> NDArray[np.bool_]:
    """Ticks of the last period of the first motion, or the first seconds of a run without one."""
    time_s, programme_s = loop.time_s(), loop.timing.run.programme_s
    end_s = programme_s.get("rest", 0.0) + programme_s.get("motion", MOST_CYCLE_S)
    end_s = min(end_s, float(time_s[-1]))
    period_s = min(loop.period_s or MOST_CYCLE_S, MOST_CYCLE_S)
    return (time_s >= end_s - period_s) & (time_s <= end_s)


def _mean_distance(one_m: Array, other_m: Array) -> float:
    return float(np.linalg.norm(one_m - other_m, axis=1).mean())


# --- strokes ------------------------------------------------------------------------------------


def arm_strokes(motion: ArmMotion) -> list[Stroke]:
    """Strokes from the back to the front: floor, shadow, path, rigid link, link, prediction."""
    shape, length_m = motion.shape, motion.shape.length_m
    floor_m = -FLOOR * length_m
    width_m = 2.0 * float(np.abs(np.array(shape.corners_m)).min(axis=0).min()) or 0.1 * length_m
    centre = np.array([pose.centre for pose in motion.true])
    predicted = np.array([pose.centre for pose in motion.predicted])
    rigid = np.array([[np.zeros(3), pose.rigid_tip] for pose in motion.true])
    fine = 0.006 * length_m
    floor = [Stroke(_onto_picture(line), GRID, fine) for line in _floor_lines(length_m, floor_m)]
    post = np.array([[[0.0, 0.0, floor_m], [0.0, 0.0, 0.0]]])
    path = motion.true_tip_m[None]
    return [
        *floor,
        Stroke(_onto_picture(_at_height(path, floor_m)), MUTED, fine, 0.35),
        Stroke(_onto_picture(path), LINK, fine, 0.35),
        Stroke(_onto_picture(post), QUIET, 0.09 * length_m),
        Stroke(_onto_picture(_at_height(centre, floor_m)), MUTED, width_m, 0.22),
        Stroke(_onto_picture(rigid), RIGID, width_m, 0.35),
        Stroke(_onto_picture(rigid), RIGID, 1.5 * fine),
        Stroke(_onto_picture(centre), LINK, width_m, 0.45),
        Stroke(_onto_picture(centre), LINK, 1.5 * fine),
        Stroke(_onto_picture(predicted), PREDICTED, 1.5 * fine, dashed=True),
        Stroke(_onto_picture(rigid[:, -1:]), RIGID, 5 * fine),
        Stroke(_onto_picture(centre[:, -1:]), LINK, 7 * fine),
        Stroke(_onto_picture(predicted[:, -1:]), PREDICTED, 4 * fine),
    ]


def _floor_lines(length_m: float, height_m: float) -> list[Array]:
    side_m = np.linspace(-2.0, 2.0, 7) * FLOOR * length_m
    ends = side_m[[0, -1]]
    along = [[(a, b, height_m) for b in ends] for a in side_m]
    across = [[(b, a, height_m) for b in ends] for a in side_m]
    return [np.array([line]) for line in [*along, *across]]


def _at_height(points_m: Array, height_m: float) -> Array:
    return np.concatenate([points_m[..., :2], np.full_like(points_m[..., :1], height_m)], axis=-1)


def _onto_picture(points_m: Array) -> Array:
    """Parallel projection of points (…, 3): to the right, and up."""
    a, e = VIEW_RAD
    right = np.array([np.cos(a), np.sin(a), 0.0])
    up = np.array([-np.sin(a) * np.sin(e), np.cos(a) * np.sin(e), np.cos(e)])
    return np.asarray(points_m @ np.column_stack([right, up]))


def frame_of(strokes: list[Stroke]) -> tuple[Array, Array]:
    """Lower left and upper right corner of the picture, in m."""
    points = np.concatenate([stroke.points.reshape(-1, 2) for stroke in strokes])
    margin = max(stroke.width_m for stroke in strokes)
    return points.min(axis=0) - margin, points.max(axis=0) + margin


# --- SVG ----------------------------------------------------------------------------------------


def arm_panel(motion: ArmMotion, loop: LoopRun) -> Panel:
    """Moving picture of a run's arm; a click plays it again."""
    rigid, predicted = LENGTH.text(motion.rigid_off_m), LENGTH.text(motion.predicted_off_m)
    alt = (
        f"Link of a run ({loop.title}) over {motion.duration_s:.1f} s. Its tip is {rigid} from "
        f"that of a rigid link on average, and {predicted} from the predicted one."
    )
    return Panel(loop.title, alt, _svg(motion, f"arm-{loop.name}"))


def _svg(motion: ArmMotion, name: str) -> str:
    """SVG in which the points of the strokes move; the scale is 400 units per metre."""
    strokes, scale = arm_strokes(motion), 400.0
    low, high = frame_of(strokes)
    width, height = scale * (high - low)
    begin = f"0s;{name}.click"
    rows = []
    for stroke in strokes:
        frames = [
            " ".join(f"{x:.1f},{y:.1f}" for x, y in scale * np.abs(frame - (low[0], high[1])))
            for frame in (stroke.points if stroke.points.shape[1] > 1 else _twice(stroke.points))
        ]
        width_px = scale * stroke.width_m
        moving = (
            f'<animate attributeName="points" begin="{begin}" dur="{motion.duration_s:.2f}s" '
            f'repeatCount="{REPEATS}" values="{";".join(frames)}"/>'
            if len(frames) > 1
            else ""
        )
        look = f'stroke="{stroke.colour}" stroke-width="{width_px:.1f}"'
        if stroke.opacity < 1.0:
            look += f' stroke-opacity="{stroke.opacity:g}"'
        if stroke.dashed:
            look += f' stroke-dasharray="{3 * width_px:.0f} {2.5 * width_px:.0f}"'
        still = frames[motion.still if moving else 0]
        rows.append(f'<polyline points="{still}" {look}>{moving}</polyline>')
    return (
        f'<svg id="{name}" viewBox="0 0 {width:.0f} {height:.0f}" fill="none" '
        f'stroke-linecap="round" style="cursor: pointer">{"".join(rows)}</svg>'
    )


def _twice(points: Array) -> Array:
    """A point as a line of no length, which is drawn as a dot."""
    return np.repeat(points, 2, axis=1)
