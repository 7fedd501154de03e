"""Built-in paths of the tip: their shape over one turn, and their timing.

Every path starts and ends at rest. A closed curve is passed at constant speed between an eased
start and an eased end; a polygon and a text stop at their corners, because the tip cannot turn at
speed. `size_m` is half of the largest extent.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from firmware_py.errors import InputError
from models.plan.stroke_font import text_strokes

Array = NDArray[np.float64]
EASE_FRACTION: Final = 0.25
"""Part of the first and of the last turn in which the speed rises and falls [assumed]."""
CORNER_RAD: Final = 0.9
"""Turn of a stroke above which the tip stops at the corner [assumed]."""
TIME_EXPONENT: Final = 0.6
"""Exponent of the length of a piece of a stroke in its share of the time: between equal speeds (1)
and equal accelerations (1/2) [assumed]."""
DEFAULT_SIZE_M: Final = 0.3

SHAPES: Final = ("circle", "figure_eight", "line", "square", "star", "hold", "point_to_point")
"""Names of the built-in paths, beside `text:…`."""
FOR_ONE_JOINT: Final = ("line", "hold", "point_to_point")


@dataclass(frozen=True)
class DesiredPath:
    """Path of the tip, sampled with the control period."""

    name: str
    tip_m: Array  # (n, dof), desired tip: x, and y with two joints
    drawn: tuple[tuple[int, int], ...]  # Rows that are drawn: first row, and first row after
    # Moves from rest to rest: first row, and first row after the rest that follows
    moves: tuple[tuple[int, int], ...] = ()


@dataclass(frozen=True)
class PathOptions:
    """Size, place and time of a built-in path."""

    size_m: float = DEFAULT_SIZE_M  # Half of the largest extent
    centre_m: tuple[float, ...] = ()
    seconds: float = 8.0  # Duration of one turn, or of a whole text
    turns: int = 1  # Number of turns
    angle_rad: float = 0.0  # Direction of a line in the plane, from x towards y
    move_s: float = 0.0  # Duration of a move of `point_to_point`; 0 means a quarter of a turn


def quintic(x: Array) -> Array:
    """Quintic from 0 to 1, at rest at both ends (Flash and Hogan, J. Neuroscience 5, 1985)."""
    x = np.clip(x, 0.0, 1.0)
    return np.asarray(x * x * x * (10.0 + x * (6.0 * x - 15.0)))


def built_in_path(name: str, dof: int, period_s: float, options: PathOptions) -> DesiredPath:
    _check_options(options, dof)
    file = Path(name)
    if name not in SHAPES and file.is_file():
        raise InputError(name, f"ends in {file.suffix!r}", "name a CSV file, which ends in .csv")
    if name not in SHAPES and not name.startswith("text:"):
        raise InputError(
            f"path {name}", "is no built-in path and no file",
            f"choose {', '.join(SHAPES)}, text:… or a CSV file",
        )  # fmt: skip
    if dof == 1 and name not in FOR_ONE_JOINT:
        raise InputError(
            f"path {name}", "lies in the plane, the arm has one joint",
            f"choose {', '.join(FOR_ONE_JOINT)}, or a bundle for two joints",
        )  # fmt: skip
    _check_use(options, name, dof)
    centre = np.zeros(2)
    centre[: len(options.centre_m)] = options.centre_m
    way = np.array([np.cos(options.angle_rad), np.sin(options.angle_rad)])
    rows = max(2, round(options.seconds * options.turns / period_s)) + 1
    fraction = np.linspace(0.0, 1.0, rows)
    drawn: tuple[tuple[int, int], ...] = ((0, rows),)
    moves: tuple[tuple[int, int], ...] = ()
    if name in _CURVES:
        turn = options.turns * _eased(fraction, EASE_FRACTION / options.turns)
        tip = options.size_m * _CURVES[name](2.0 * np.pi * turn, way)
    elif name in ("hold", "point_to_point"):
        part = options.move_s / options.seconds or 0.25
        tip = options.size_m * _points(name, fraction, options.turns, part)[:, None] * way
        if name == "point_to_point":
            ends = np.linspace(0, rows - 1, 2 * options.turns + 1).round().astype(int).tolist()
            moves = tuple(pairwise(ends))
    else:
        strokes = text_strokes(name[5:]) if name.startswith("text:") else [_polygon(name)]
        turns = 1 if name.startswith("text:") else options.turns
        tip, drawn = _along(strokes * turns, fraction, joined=not name.startswith("text:"))
        tip = options.size_m * tip
    return DesiredPath(name, np.asarray((tip + centre)[:, :dof]), drawn, moves)


def _check_options(options: PathOptions, dof: int) -> None:
    centre = options.centre_m
    for name, value, low, high in (
        ("--size", options.size_m, 1e-3, 2.0),
        ("--seconds", options.seconds, 0.5, 600.0),
        ("--turns", options.turns, 1, 100),
        *(("--centre", value, -2.0, 2.0) for value in centre),
        ("--angle-deg", math.degrees(options.angle_rad), -360.0, 360.0),
        ("--move", options.move_s, 0.0, 0.45 * options.seconds),
    ):
        if not low <= value <= high:
            raise InputError(name, f"is {value:g}", f"choose {low:g} to {high:g}")
    if len(centre) > dof:
        raise InputError("--centre", f"has {len(centre)} coordinates", f"give {dof}")


def _check_use(options: PathOptions, name: str, dof: int) -> None:
    """Refuse options that would have no effect."""
    text = name.startswith("text:")
    for option, given, used, what in (
        ("--turns", options.turns != 1, not text, "a text is written once"),
        ("--move", options.move_s != 0.0, name == "point_to_point", "is for point_to_point"),
        ("--angle-deg", options.angle_rad != 0.0, name in FOR_ONE_JOINT and dof == 2,
         f"is for {', '.join(FOR_ONE_JOINT)} of an arm with two joints"),
    ):  # fmt: skip
        if given and not used:
            raise InputError(option, what, "leave it out")


def _eased(fraction: Array, ease: float) -> Array:
    """Distance over time, from 0 to 1, with a rise and a fall of the speed that take a part `ease`
    each.
    """
    ease = min(ease, 0.5)
    fine = np.linspace(0.0, 1.0, 4001)
    speed = quintic(np.minimum(fine, 1.0 - fine) / ease)
    way = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]))])
    return np.asarray(np.interp(fraction, fine, way / way[-1]))


def _circle(phase: Array, way: Array) -> Array:
    return np.column_stack([np.cos(phase), np.sin(phase)])


def _figure_eight(phase: Array, way: Array) -> Array:
    return np.column_stack([np.sin(phase), np.sin(phase) * np.cos(phase)])


def _line(phase: Array, way: Array) -> Array:
    return np.sin(phase)[:, None] * way


_CURVES: Final[dict[str, Callable[[Array, Array], Array]]] = {
    "circle": _circle, "figure_eight": _figure_eight, "line": _line,
}  # fmt: skip
"""Shapes of size 1 over the phase; the line is a sinusoid of the time."""


def _points(name: str, fraction: Array, turns: int, part: float) -> Array:
    """Position over time: held, or moved to the other side and back, each in a part of a turn."""
    if name == "hold":
        return np.ones_like(fraction)
    at = fraction * turns % 1.0
    there = quintic(at / part) - quintic((at - 0.5) / part)
    return np.asarray(2.0 * np.where(fraction < 1.0, there, 0.0) - 1.0)


def _polygon(name: str) -> Array:
    """Corners of size 1, the first repeated at the end."""
    count, skip, first = {"square": (4, 1, 0.25 * np.pi), "star": (5, 2, 0.5 * np.pi)}[name]
    turn = first + 2.0 * np.pi * skip / count * np.arange(count + 1)
    corners = np.column_stack([np.cos(turn), np.sin(turn)])
    return np.asarray(corners / np.max(np.abs(corners)))


def _along(
    strokes: Sequence[Array], fraction: Array, *, joined: bool
) -> tuple[Array, tuple[tuple[int, int], ...]]:
    """Points along strokes and the connections between them, and the rows of each stroke."""
    pieces: list[tuple[Array, int]] = []  # points, number of the stroke or -1
    for number, stroke in enumerate(strokes):
        if number and not np.allclose(strokes[number - 1][-1], stroke[0]):
            pieces.append((np.array([strokes[number - 1][-1], stroke[0]]), -1))
        pieces += [(piece, number) for piece in _split(stroke)]
    steps = [np.append(0.0, np.cumsum(np.hypot(*np.diff(p, axis=0).T))) for p, _ in pieces]
    share = np.array([s[-1] ** TIME_EXPONENT for s in steps])
    limits = np.concatenate([[0.0], np.cumsum(share / share.sum())])
    tip = np.empty((len(fraction), 2))
    rows: dict[int, list[int]] = {}
    for k, ((points, number), step) in enumerate(zip(pieces, steps, strict=True)):
        inside = np.flatnonzero((fraction >= limits[k]) & (fraction <= limits[k + 1] + 1e-12))
        at = quintic((fraction[inside] - limits[k]) / (limits[k + 1] - limits[k])) * step[-1]
        tip[inside] = np.column_stack([np.interp(at, step, points[:, i]) for i in (0, 1)])
        if number >= 0 and len(inside):
            rows.setdefault(0 if joined else number, []).extend(inside.tolist())
    return tip, tuple((min(own), max(own) + 1) for own in rows.values())


def _split(stroke: Array) -> list[Array]:
    """Pieces of a stroke between its corners."""
    way = np.diff(stroke, axis=0)
    heading = np.arctan2(way[:, 1], way[:, 0])
    turn = np.abs((np.diff(heading) + np.pi) % (2.0 * np.pi) - np.pi)
    corners = [0, *(np.flatnonzero(turn > CORNER_RAD) + 1).tolist(), len(stroke) - 1]
    return [stroke[a : b + 1] for a, b in pairwise(corners)]
