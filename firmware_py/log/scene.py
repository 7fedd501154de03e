"""Scene of a run for a 3-D viewer: link, markers and predicted tip as `foxglove.SceneUpdate`.

A tick determines the pose of the base plate and the position of the tip. Between them the link has
the slope of the plant's link under a tip force (`models.plant.components.link`): root bend φ at the
plate, and (2σ − σ²) of the span's bend ψ at the fraction σ of the length, with ψ/φ from the plant's
stiffnesses. φ is chosen so that the lateral distance of the tip is the predicted one. The residual
along the link, a few millimetres, is distributed over its length.

Each message is complete, so a viewer may begin anywhere in a log. It is protobuf, encoded here
field by field, so that the robot's recorder needs no further package. `scene_update.binpb` is the
descriptor for readers, as foxglove-sdk defines it.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from firmware_py.core.signals import tick_dtype, tip_names
from firmware_py.link.marker_layout import MarkerLayout, square_layout

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
    local_m = turn.T @ tip_m - (0.0, 0.0, shape.base_offset_m)
    sideways_m = float(np.hypot(local_m[0], local_m[1]))
    towards = local_m[:2] / sideways_m if sideways_m > 0 else np.array([1.0, 0.0])
    root_rad = _root_bend(shape, sideways_m)
    stations = np.linspace(0.0, 1.0, STATIONS)
    rows = np.array(shape.rows_m) / shape.rows_m[-1]
    centre, sections = _sections(
        shape, root_rad, towards, local_m, np.concatenate([stations, rows])
    )
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


_NEEDED: Final = ("base_offset_m", "link_length_m", "link_width_m", "span_position")


def shape_of_plant(plant: Mapping[str, Any]) -> LinkShape | None:
    """Return the shape of a plant's link; None if the plant describes no link."""
    try:
        value = {name: float(entry["value"]) for name, entry in plant["parameters"].items()}
        described = (plant.get("link") or {}).get("markers")
        offset_m, length_m, width_m, position = (value[name] for name in _NEEDED)
        ratio = value["root_stiffness_1_nm_rad"] / value["span_stiffness_1_nm_rad"]
        layout = (
            msgspec.convert(described, MarkerLayout)
            if described
            else square_layout(length_m, width_m)
        )
    except (AttributeError, KeyError, TypeError, ValueError, ZeroDivisionError):
        return None
    return LinkShape(offset_m, length_m, layout.rows_m, layout.corners_m, (1.0 - position) * ratio)


Colour = tuple[float, float, float, float]

SCENE_TOPIC: Final = "/scene"
SCENE_SCHEMA: Final = "foxglove.SceneUpdate"
FRAME: Final = "world"
SHAPE_KEY: Final = "link_shape"
"""Key of the link's shape in the metadata of a log."""
EVERY: Final = 6
"""Ticks per scene: ten scenes a second at 17 ms, which looks smooth."""

MARKER_SIZE_M: Final = 0.02
LINE_SIZE_M: Final = 0.004
SKIN: Final[Colour] = (0.11, 0.42, 0.59, 0.45)
AXIS: Final[Colour] = (0.11, 0.42, 0.59, 1.0)
MARKER: Final[Colour] = (0.78, 0.47, 0.0, 1.0)
RIGID: Final[Colour] = (0.54, 0.58, 0.63, 0.8)
IN_RANGE: Final[Colour] = (0.18, 0.62, 0.42, 0.6)
OUT_OF_RANGE: Final[Colour] = (0.61, 0.11, 0.09, 0.6)
_STEP_M: Final = 2.0**-13
"""Resolution of positions, 0.12 mm; rounding halves the size of the log."""


@cache
def scene_schema() -> bytes:
    """Return the descriptor of the messages, a protobuf FileDescriptorSet."""
    return Path(__file__).with_name("scene_update.binpb").read_bytes()


def shape_in(metadata: dict[str, str]) -> LinkShape | None:
    """Return the link's shape from the metadata of a log; None if they have none."""
    text = metadata.get(SHAPE_KEY)
    return msgspec.json.decode(text, type=LinkShape) if text else None


class SceneEncoder:
    def __init__(self, dof: int, shape: LinkShape) -> None:
        self._dtype, self._shape = tick_dtype(dof), shape
        self._angles = [f"angle_{j}_rad" for j in range(1, dof + 1)]
        self._records = 0

    def __call__(self, record: bytes, time_ns: int) -> bytes | None:
        """Return the scene of every `EVERY`-th record; None for others and without a tip."""
        due = self._records % EVERY == 0
        self._records += 1
        if not due:
            return None
        tick = np.frombuffer(record, self._dtype)[0]
        angle = np.array([tick[name] for name in self._angles])
        tip = np.array([tick[name] for name in tip_names("predicted_")])
        if not np.isfinite([*angle, *tip]).all():
            return None
        half = np.array([tick[f"half_width_{axis}_m"] for axis in "xyz"])
        size_m = np.maximum(2.0 * np.nan_to_num(half), MARKER_SIZE_M)
        colour = IN_RANGE if tick["in_range"] else OUT_OF_RANGE
        return _scene(pose_link(self._shape, angle, tip), size_m, self._shape, colour, time_ns)


def _scene(
    pose: LinkPose, tip_size_m: Array, shape: LinkShape, tip_colour: Colour, time_ns: int
) -> bytes:
    link = [
        (12, _surface(pose.edges, shape)),
        (11, _line(pose.centre, AXIS)),
        (11, _line(np.stack([np.zeros(3), pose.rigid_tip]), RIGID)),
    ]
    size_m = np.full(3, MARKER_SIZE_M)
    markers = [(9, _sphere(place, size_m, MARKER)) for place in pose.markers]
    tip = [(9, _sphere(pose.centre[-1], tip_size_m, tip_colour))]
    entities = (("link", link), ("markers", markers), ("tip", tip))
    return b"".join(_entity(name, time_ns, parts) for name, parts in entities)


def _entity(name: str, time_ns: int, parts: Iterable[tuple[int, bytes]]) -> bytes:
    """Encode an entity of a scene, which replaces the previous one of the same name."""
    seconds, nanos = divmod(time_ns, 1_000_000_000)
    stamp = bytes([1 << 3]) + _varint(seconds) + bytes([2 << 3]) + _varint(nanos)  # wire type 0
    content = _part(1, stamp) + _part(2, FRAME.encode()) + _part(3, name.encode())
    return _part(2, content + b"".join(_part(number, part) for number, part in parts))


def _surface(edges_m: Array, shape: LinkShape) -> bytes:
    """Encode the skin between neighbouring sections; empty for fewer than three corners."""
    around = np.argsort([np.arctan2(y, x) for x, y in shape.corners_m], kind="stable")
    count, corners = len(edges_m), len(around)
    if corners < 3:
        return b""
    points = edges_m[:, around].reshape(-1, 3)
    low = corners * np.arange(count - 1)[:, None] + np.arange(corners)
    low_next = corners * np.arange(count - 1)[:, None] + (np.arange(corners) + 1) % corners
    quads = np.stack([low, low_next, low + corners, low_next, low_next + corners, low + corners], 2)
    indices = quads.astype("<u4").tobytes()
    return _points(2, points) + _part(3, _colour(SKIN)) + _part(5, indices)


def _line(points_m: Array, colour: Colour) -> bytes:
    """Encode a line through points, a strip by default."""
    return _double(3, LINE_SIZE_M) + _points(5, points_m) + _part(6, _colour(colour))


def _sphere(centre_m: Array, size_m: Array, colour: Colour) -> bytes:
    pose = _part(1, _vector(centre_m)) + _part(2, _double(4, 1.0))
    return _part(1, pose) + _part(2, _vector(size_m)) + _part(3, _colour(colour))


def _points(number: int, points_m: Array) -> bytes:
    return b"".join(_part(number, _vector(point)) for point in points_m)


def _vector(values_m: Array) -> bytes:
    rounded = np.round(values_m / _STEP_M) * _STEP_M
    return b"".join(_double(k, value) for k, value in enumerate(rounded.tolist(), start=1))


def _colour(colour: Colour) -> bytes:
    return b"".join(_double(k, value) for k, value in enumerate(colour, start=1))


def _double(number: int, value: float) -> bytes:
    """Encode a field of a double (wire type 1)."""
    return struct.pack("<Bd", number << 3 | 1, value)


def _part(number: int, content: bytes) -> bytes:
    """Encode a field of a message, a text or packed numbers (wire type 2)."""
    return bytes([number << 3 | 2]) + _varint(len(content)) + content


def _varint(value: int) -> bytes:
    digits = bytearray()
    while value > 0x7F:
        digits.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*digits, value])
