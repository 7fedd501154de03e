"""Desired path of the tip over time: built-in shapes, texts, CSV files, and the ways around them.

Every path starts and ends at rest. A closed curve is passed at constant speed between an eased
start and an eased end; a polygon and a text stop at their corners, because the tip cannot turn at
speed. `timeline` adds the rest before a path, the way to it, the way back, and the rest after it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from firmware_py.core.errors import InputError
from firmware_py.core.input_files import read_lines
from models.shared.numeric_text import read_header, read_numbers

Array = NDArray[np.float64]

SHAPES: Final = ("circle", "figure_eight", "line", "square", "star", "hold", "point_to_point")
"""Names of the built-in paths, beside `text:…`."""
FOR_ONE_JOINT: Final = ("line", "hold", "point_to_point")
FARTHEST_M: Final = 2.0
LONGEST_S: Final = 600.0
"""Largest coordinate and longest path [assumed]."""


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

    size_m: float = 0.3  # Half of the largest extent
    centre_m: tuple[float, ...] = ()
    seconds: float = 8.0  # Duration of one turn, or of a whole text
    turns: int = 1
    angle_rad: float = 0.0  # Direction of a line in the plane, from x towards y
    move_s: float = 0.0  # Duration of a move of `point_to_point`; 0 means a quarter of a turn


def built_in_path(name: str, dof: int, period_s: float, options: PathOptions) -> DesiredPath:
    _check(name, dof, options)
    centre = np.zeros(2)
    centre[: len(options.centre_m)] = options.centre_m
    direction = np.array([np.cos(options.angle_rad), np.sin(options.angle_rad)])
    rows = max(2, round(options.seconds * options.turns / period_s)) + 1
    fraction = np.linspace(0.0, 1.0, rows)
    drawn: tuple[tuple[int, int], ...] = ((0, rows),)
    moves: tuple[tuple[int, int], ...] = ()
    if name.startswith("text:"):
        tip, drawn = _along(text_strokes(name[5:]), fraction)
    elif name in _CORNERS:
        tip, _ = _along([_polygon(name)] * options.turns, fraction)
    elif name == "hold":
        tip = np.tile(direction, (rows, 1))
    elif name == "point_to_point":
        tip = _there_and_back(fraction, options)[:, None] * direction
        ends = np.linspace(0, rows - 1, 2 * options.turns + 1).round().astype(int).tolist()
        moves = tuple(pairwise(ends))
    else:
        # The speed rises and falls in a quarter of the first and of the last turn [assumed].
        turn = options.turns * _eased(fraction, 0.25 / options.turns)
        tip = _curve(name, 2.0 * np.pi * turn, direction)
    tip = options.size_m * tip + centre
    return DesiredPath(name, np.asarray(tip[:, :dof]), drawn, moves)


def _check(name: str, dof: int, options: PathOptions) -> None:
    """Refuse an unknown path, and options out of range or without effect."""
    is_text = name.startswith("text:")
    if name not in SHAPES and not is_text:
        remedy = f"choose {', '.join(SHAPES)}, text:… or a CSV file"
        raise InputError(f"path {name}", "is no built-in path and no CSV file", remedy)
    if dof == 1 and name not in FOR_ONE_JOINT:
        remedy = f"choose {', '.join(FOR_ONE_JOINT)}, or a bundle for two joints"
        raise InputError(f"path {name}", "lies in the plane, the arm has one joint", remedy)
    for option, value, low, high in (
        ("--size", options.size_m, 1e-3, FARTHEST_M),
        ("--seconds", options.seconds, 0.5, LONGEST_S),
        ("--turns", options.turns, 1, 100),
        *(("--centre", value, -FARTHEST_M, FARTHEST_M) for value in options.centre_m),
        ("--angle-deg", math.degrees(options.angle_rad), -360.0, 360.0),
        ("--move", options.move_s, 0.0, 0.45 * options.seconds),
    ):
        if not low <= value <= high:
            raise InputError(option, f"is {value:g}", f"choose {low:g} to {high:g}")
    if len(options.centre_m) > dof:
        raise InputError("--centre", f"has {len(options.centre_m)} coordinates", f"give {dof}")
    turned = f"is for {', '.join(FOR_ONE_JOINT)} of an arm with two joints"
    for option, is_set, has_effect, what in (
        ("--turns", options.turns != 1, not is_text, "a text is written once"),
        ("--move", options.move_s != 0.0, name == "point_to_point", "is for point_to_point"),
        ("--angle-deg", options.angle_rad != 0.0, name in FOR_ONE_JOINT and dof == 2, turned),
    ):
        if is_set and not has_effect:
            raise InputError(option, what, "leave it out")


def quintic(x: Array) -> Array:
    """Quintic from 0 to 1, at rest at both ends (Flash and Hogan, J. Neuroscience 5, 1985)."""
    x = np.clip(x, 0.0, 1.0)
    return np.asarray(x * x * x * (10.0 + x * (6.0 * x - 15.0)))


def _eased(fraction: Array, ease: float) -> Array:
    """Distance over time, from 0 to 1; the speed rises and falls in a part `ease` each."""
    ease = min(ease, 0.5)
    fine = np.linspace(0.0, 1.0, 4001)
    speed = quintic(np.minimum(fine, 1.0 - fine) / ease)
    distance = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]))])
    return np.asarray(np.interp(fraction, fine, distance / distance[-1]))


def _curve(name: str, phase: Array, direction: Array) -> Array:
    """Shape of size 1 over the phase; the line is a sinusoid of the time."""
    if name == "circle":
        return np.column_stack([np.cos(phase), np.sin(phase)])
    if name == "figure_eight":
        return np.column_stack([np.sin(phase), np.sin(phase) * np.cos(phase)])
    return np.asarray(np.sin(phase)[:, None] * direction)


def _there_and_back(fraction: Array, options: PathOptions) -> Array:
    """Position from −1 to 1 and back, once a turn."""
    part = options.move_s / options.seconds or 0.25
    at = fraction * options.turns % 1.0
    there = quintic(at / part) - quintic((at - 0.5) / part)
    return np.asarray(2.0 * np.where(fraction < 1.0, there, 0.0) - 1.0)


_CORNERS: Final = {"square": (4, 1, 0.25 * np.pi), "star": (5, 2, 0.5 * np.pi)}
"""Number of corners, corners from one to the next, and direction of the first."""


def _polygon(name: str) -> Array:
    """Corners of size 1, the first repeated at the end."""
    count, skip, first = _CORNERS[name]
    turn = first + 2.0 * np.pi * skip / count * np.arange(count + 1)
    corners = np.column_stack([np.cos(turn), np.sin(turn)])
    return np.asarray(corners / np.max(np.abs(corners)))


def _along(strokes: Sequence[Array], fraction: Array) -> tuple[Array, tuple[tuple[int, int], ...]]:
    """Points along strokes and the connections between them, and the rows of each stroke."""
    pieces: list[tuple[Array, int]] = []  # points, number of the stroke or -1
    for number, stroke in enumerate(strokes):
        if number and not np.allclose(strokes[number - 1][-1], stroke[0]):
            pieces.append((np.array([strokes[number - 1][-1], stroke[0]]), -1))
        pieces += [(piece, number) for piece in _split(stroke)]
    lengths = [np.append(0.0, np.cumsum(np.hypot(*np.diff(p, axis=0).T))) for p, _ in pieces]
    # Between equal speeds (exponent 1) and equal accelerations (1/2) [assumed]
    share = np.array([length[-1] ** 0.6 for length in lengths])
    limits = np.concatenate([[0.0], np.cumsum(share / share.sum())])
    tip = np.empty((len(fraction), 2))
    rows: dict[int, list[int]] = {}
    for k, ((points, number), length) in enumerate(zip(pieces, lengths, strict=True)):
        inside = np.flatnonzero((fraction >= limits[k]) & (fraction <= limits[k + 1] + 1e-12))
        at = quintic((fraction[inside] - limits[k]) / (limits[k + 1] - limits[k])) * length[-1]
        tip[inside] = np.column_stack([np.interp(at, length, points[:, i]) for i in (0, 1)])
        if number >= 0 and len(inside):
            rows.setdefault(number, []).extend(inside.tolist())
    return tip, tuple((min(drawn), max(drawn) + 1) for drawn in rows.values())


def _split(stroke: Array) -> list[Array]:
    """Pieces of a stroke between its corners, which turn by more than 0.9 rad [assumed]."""
    step = np.diff(stroke, axis=0)
    heading = np.arctan2(step[:, 1], step[:, 0])
    turn = np.abs((np.diff(heading) + np.pi) % (2.0 * np.pi) - np.pi)
    corners = [0, *(np.flatnonzero(turn > 0.9) + 1).tolist(), len(stroke) - 1]
    return [stroke[a : b + 1] for a, b in pairwise(corners)]


WIDTH: Final = 4.0
HEIGHT: Final = 6.0
"""Grid of a letter."""
GLYPHS: Final[dict[str, str]] = {
    " ": "",
    "A": "002640|1232", "B": "0006|~0646464303|~0343434000", "C": "~444626060000204042",
    "D": "0006|~06464640400000", "E": "46060040|0333", "F": "460600|0333",
    "G": "~44462606000020404043|4323", "H": "0006|4046|0343", "I": "2026", "J": "~464640200002",
    "K": "0006|460340", "L": "060040", "M": "0006234640", "N": "00064046",
    "O": "o", "P": "0006|~0646464303", "Q": "o|2240",
    "R": "0006|~0646464303|2340", "S": "~45462606040343424020000001", "T": "0646|2620",
    "U": "~06060000404046", "V": "062046", "W": "0610233046", "X": "0046|0640",
    "Y": "062346|2320", "Z": "06460040",
    "0": "o", "1": "052620", "2": "~0506264644230000|0040",
    "3": "~0506464643232343434000000001", "4": "30360242", "5": "46060333|~2343434000000001",
    "6": "~4526060000404043432303", "7": "064610", "8": "~2306064646230000404023",
    "9": "~4323030606464640200001", "-": "1333", ".": "2021", "+": "2125|0343", "/": "0046",
}  # fmt: skip
"""Single-stroke font, made for this project: the strokes of each character, separated by `|`. A
stroke is a row of points on the grid, two digits each: column, row from below. The corners of one
that begins with `~` are cut repeatedly (Chaikin 1974). The stroke `o` is an ellipse."""


def text_strokes(text: str) -> list[Array]:
    """Strokes of a text in the order of writing, centred, with a largest extent of 2."""
    unknown = sorted({c for c in text.upper() if c not in GLYPHS})
    if unknown or not text.strip():
        wrong = f"has {' '.join(unknown)!r}, which the font lacks" if unknown else "is empty"
        raise InputError(f"text {text!r}", wrong, "use " + "".join(sorted(GLYPHS)).strip())
    strokes = []
    for place, letter in enumerate(text.upper()):
        origin = np.array([place * (WIDTH + 1.6), 0.0])
        strokes += [origin + _stroke(code) for code in GLYPHS[letter].split("|") if code]
    points = np.concatenate(strokes)
    low, high = points.min(axis=0), points.max(axis=0)
    scale = 2.0 / max(*(high - low), 1e-9)
    return [scale * (stroke - 0.5 * (low + high)) for stroke in strokes]


def _stroke(code: str) -> Array:
    """Points of a stroke of the font, shape (points, 2)."""
    if code == "o":
        turn = 0.5 * np.pi + np.linspace(0.0, 2.0 * np.pi, 49)
        half = 0.5 * np.array([WIDTH, HEIGHT])
        return np.asarray(half + half * np.column_stack([np.cos(turn), np.sin(turn)]))
    points = np.array([float(c) for c in code.lstrip("~")]).reshape(-1, 2)
    return _rounded(points) if code.startswith("~") else points


def _rounded(points: Array) -> Array:
    """Polyline whose corners are cut repeatedly; its ends stay."""
    points = points[np.append(True, np.any(np.diff(points, axis=0) != 0, axis=1))]
    for _ in range(4):
        a, b = points[:-1], points[1:]
        cut = np.stack([0.75 * a + 0.25 * b, 0.25 * a + 0.75 * b], axis=1).reshape(-1, 2)
        points = np.concatenate([points[:1], cut, points[-1:]])
    return points


def read_path(path: Path, dof: int, period_s: float) -> DesiredPath:
    """Read a path from CSV: a line of names (time_s, x_m, and y_m with two joints), rising times.

    The path is interpolated to the control period. If it ends between two periods, the nearer one
    counts; past the end the tip continues at its last speed.
    """
    names = ["time_s", "x_m", "y_m"][: dof + 1]
    remedy = f"give the columns {','.join(names)} in s and m"
    lines = read_lines(path, remedy)
    header = read_header(path, next(lines, ""))
    if header != names:
        raise InputError(path, f"has the columns {','.join(header)[:80]!r}", remedy)
    table = read_numbers(path, lines, header, range(len(header)))
    time_s, place_m = table[:, 0], table[:, 1:]
    away_m = np.abs(place_m).max(axis=1, initial=0.0)
    for wrong, what, how in (
        (np.isnan(table).any(axis=1), "has an empty cell", f"write {len(names)} numbers"),
        (np.diff(time_s, prepend=-np.inf) <= 0.0, "time_s does not rise", "sort the rows by time"),
        (away_m > FARTHEST_M, "leads far away", f"give places in m, {FARTHEST_M:g} at most"),
    ):
        if wrong.any():
            row = int(wrong.argmax())
            values = ",".join(f"{value:g}" for value in table[row])
            raise InputError(path, f"row {row + 1} below the header, {values}: {what}", how)
    if len(table) < 2:
        raise InputError(path, f"has {len(table)} rows", "give 2 or more")
    if not 2 * period_s <= (lasts_s := time_s[-1] - time_s[0]) <= LONGEST_S:
        raise InputError(path, f"lasts {lasts_s:g} s", f"give {2 * period_s:g} to {LONGEST_S:g} s")

    def at(times_s: Array) -> Array:
        return np.column_stack([np.interp(times_s, time_s, column) for column in place_m.T])

    at_s = np.arange(time_s[0], time_s[-1] + 0.5 * period_s, period_s)
    tip = at(at_s)
    # The way back starts at the speed of the end: a last row at rest would halve it.
    end, before = at(np.array([time_s[-1], time_s[-1] - period_s]))
    tip[-1] += max(0.0, at_s[-1] - time_s[-1]) * (end - before) / period_s
    return DesiredPath(path.stem, tip, ((0, len(at_s)),))


REST_S: Final = 1.0
"""Rest before the motion: that of `[motion]`, the reference of the Deformation Index."""
LEAD_S: Final = 0.4
"""Time before the way in which the goals may already move, because the arm follows them late.
Measured on the twin of the demo, circle of 0.4 m in 8 s: without it 6.6 mm at the start."""
SETTLE_S: Final = 1.0
"""Rest after the way back, in which the goals return to zero [assumed]."""


@dataclass(frozen=True)
class Timeline:
    """Desired tip over a whole plan."""

    desired_m: Array  # (n, dof), one row per control period
    rest_rows: int
    start_row: int  # First row of the path
    end_row: int  # First row after the path
    drawn: tuple[tuple[int, int], ...]  # Rows that are drawn: first row, and first row after
    moves: tuple[tuple[int, int], ...] = ()  # Moves from rest to rest, the rest after them included


def timeline(path: DesiredPath, rest_tip_m: Array, period_s: float) -> Timeline:
    """Add rest and ways around a path.

    `rest_tip_m`, shape (dof,): tip at rest with all goals zero, since a link is not quite straight.
    """
    rest, lead, settle = (round(s / period_s) for s in (REST_S, LEAD_S, SETTLE_S))
    first_m_s = (path.tip_m[1] - path.tip_m[0]) / period_s
    last_m_s = (path.tip_m[-1] - path.tip_m[-2]) / period_s
    there = _way(rest_tip_m, path.tip_m[0], first_m_s, period_s)
    back = _way(rest_tip_m, path.tip_m[-1], -last_m_s, period_s)[::-1]
    still = np.tile(rest_tip_m, (rest + lead + settle, 1))
    start = rest + lead + len(there)
    end = start + len(path.tip_m)
    desired = np.concatenate([still[: rest + lead], there, path.tip_m, back, still[:settle]])
    drawn, moves = (tuple((start + a, start + b) for a, b in p) for p in (path.drawn, path.moves))
    return Timeline(desired, rest, start, end, drawn, moves)


def _way(start: Array, end: Array, speed: Array, period_s: float) -> Array:
    """Quintic from rest at a place to a speed at another, without acceleration and without its
    last row.

    Coefficients from the conditions at both ends, e.g. Spong, Hutchinson and Vidyasagar, *Robot
    Modeling and Control* (2006), section 5.5.2.
    """
    # At least 1.5 s, at a mean speed of 0.3 m/s at most [assumed]
    seconds = max(1.5, float(np.linalg.norm(end - start)) / 0.3)
    rows = round(seconds / period_s)
    x = (np.arange(rows) / rows)[:, None]
    distance, slope = end - start, speed * rows * period_s
    return np.asarray(
        start + distance * x**3 * (10 - 15 * x + 6 * x**2) - slope * x**3 * (4 - 7 * x + 3 * x**2)
    )
