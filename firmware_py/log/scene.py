"""Scene of a run for a 3-D viewer: link, markers and predicted tip as `foxglove.SceneUpdate`.

Each message is complete, so a viewer may begin anywhere in a log. It is protobuf, encoded here
field by field, so that the robot's recorder needs no further package. `scene_update.binpb` is the
descriptor for readers, as foxglove-sdk defines it.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from firmware_py.core.signals import tick_dtype, tip_names
from firmware_py.log.link_shape import LinkPose, LinkShape, pose_link

__all__ = ["SCENE_SCHEMA", "SCENE_TOPIC", "SHAPE_KEY", "SceneEncoder", "scene_schema", "shape_in"]

Array = NDArray[np.float64]
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
    """Encoder of tick records as scenes."""

    def __init__(self, dof: int, shape: LinkShape) -> None:
        self._dtype, self._shape = tick_dtype(dof), shape
        self._angles = [f"angle_{j}_rad" for j in range(1, dof + 1)]
        self._records = 0
        self._templates = {
            True: _Template(shape, IN_RANGE), False: _Template(shape, OUT_OF_RANGE)
        }  # fmt: skip

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
        template = self._templates[bool(tick["in_range"])]
        return template.filled(pose_link(self._shape, angle, tip), size_m, time_ns)


class _Template:
    """Encoded scene without coordinates and times; filling them in takes microseconds.

    The offsets of the coordinates follow from encoding a scene of unique numbers.
    """

    def __init__(self, shape: LinkShape, tip_colour: Colour) -> None:
        like = pose_link(shape, np.zeros(1), np.array([0.0, 0.0, 1.0]))
        parts = (like.edges, like.centre, like.rigid_tip, like.markers, np.zeros(3))
        unique = 1.0 + 2.0**-40 * np.arange(1, sum(part.size for part in parts) + 1)
        cuts = np.cumsum([part.size for part in parts])[:-1]
        edges, centre, rigid, markers, size = (
            v.reshape(p.shape) for v, p in zip(np.split(unique, cuts), parts, strict=True)
        )
        own = LinkPose(centre=centre, edges=edges, markers=markers, rigid_tip=rigid)
        self._text = _scene(own, size, shape, tip_colour)
        places = [self._text.index(struct.pack("<d", value)) for value in unique.tolist()]
        # The tip's sphere is at the end of the centre line, so this position occurs twice.
        tips = [self._text.rindex(struct.pack("<d", value)) for value in centre[-1].tolist()]
        self._places = (np.array(places + tips)[:, None] + np.arange(8)).ravel()

    def filled(self, pose: LinkPose, tip_size_m: Array, time_ns: int) -> bytes:
        seconds, nanos = divmod(time_ns, 1_000_000_000)
        text = bytearray(
            self._text.replace(_SECONDS, _varint5(seconds)).replace(_NANOS, _varint5(nanos))
        )
        values = np.concatenate([
            pose.edges.ravel(), pose.centre.ravel(), pose.rigid_tip, pose.markers.ravel(),
            tip_size_m, pose.centre[-1],
        ])  # fmt: skip
        rounded = np.round(values / _STEP_M) * _STEP_M
        np.frombuffer(text, np.uint8)[self._places] = rounded.astype("<f8").view(np.uint8)
        return bytes(text)


def _scene(pose: LinkPose, tip_size_m: Array, shape: LinkShape, tip_colour: Colour) -> bytes:
    """Encode a scene with placeholder times, which `_Template.filled` replaces."""
    link = [
        (12, _surface(pose.edges, shape)),
        (11, _line(pose.centre, AXIS)),
        (11, _line(np.stack([np.zeros(3), pose.rigid_tip]), RIGID)),
    ]
    size_m = np.full(3, MARKER_SIZE_M)
    markers = [(9, _sphere(place, size_m, MARKER)) for place in pose.markers]
    tip = [(9, _sphere(pose.centre[-1], tip_size_m, tip_colour))]
    entities = (("link", link), ("markers", markers), ("tip", tip))
    return b"".join(_entity(name, parts) for name, parts in entities)


def _entity(name: str, parts: Iterable[tuple[int, bytes]]) -> bytes:
    """Encode an entity of a scene, which replaces the previous one of the same name."""
    stamp = bytes([1 << 3]) + _SECONDS + bytes([2 << 3]) + _NANOS  # wire type 0
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


def _vector(values: Array) -> bytes:
    return b"".join(_double(k, value) for k, value in enumerate(values.tolist(), start=1))


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


def _varint5(value: int) -> bytes:
    """Encode an integer below 2³⁵ in exactly five bytes."""
    digits = [value >> shift & 0x7F for shift in (0, 7, 14, 21, 28)]
    return bytes([*(digit | 0x80 for digit in digits[:4]), digits[4]])


_SECONDS: Final = _varint5(2**35 - 1)
_NANOS: Final = _varint5(2**35 - 2)
"""Placeholder times of a template, which no time of a run equals."""
