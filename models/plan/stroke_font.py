"""Single-stroke font: capitals, digits and a few signs, made for this project.

A letter stands on a grid of 4 by 6. A stroke is a row of points, two digits each: column, row from
below. A stroke that begins with `~` is rounded by cutting its corners (Chaikin 1974).
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from firmware_py.errors import InputError

Array = NDArray[np.float64]
WIDTH: Final = 4.0
HEIGHT: Final = 6.0
GAP: Final = 1.6
"""Space between two letters, in units of the grid."""
ROUNDS: Final = 4
"""Times that the corners of a round stroke are cut."""

GLYPHS: Final[dict[str, str]] = {
    " ": "",
    "A": "002640|1232", "B": "0006|~0646464303|~0343434000", "C": "~444626060000204042",
    "D": "0006|~06464640400000", "E": "46060040|0333", "F": "460600|0333",
    "G": "~44462606000020404043|4323", "H": "0006|4046|0343", "I": "2026", "J": "~464640200002",
    "K": "0006|460340", "L": "060040", "M": "0006234640", "N": "00064046",
    "O": "~232606000020404046262606", "P": "0006|~0646464303", "Q": "~26060000404046462606|2240",
    "R": "0006|~0646464303|2340", "S": "~45462606040343424020000001", "T": "0646|2620",
    "U": "~06060000404046", "V": "062046", "W": "0610233046", "X": "0046|0640",
    "Y": "062346|2320", "Z": "06460040",
    "0": "~26060000404046462606", "1": "052620", "2": "~0506264644230000|0040",
    "3": "~0506464643232343434000000001", "4": "30360242", "5": "46060333|~2343434000000001",
    "6": "~4526060000404043432303", "7": "064610", "8": "~2306064646230000404023",
    "9": "~4323030606464640200001", "-": "1333", ".": "2021", "+": "2125|0343", "/": "0046",
}  # fmt: skip
"""Strokes of each character, separated by `|`."""

ROUND_LETTERS: Final = {"O": (2.0, 3.0), "0": (2.0, 3.0), "Q": (2.0, 3.0)}
"""Characters whose first stroke is an ellipse: its half axes."""


def text_strokes(text: str) -> list[Array]:
    """Strokes of a text in the order of writing, centred, with a largest extent of 2.

    Shapes: each (points, 2).
    """
    unknown = sorted({c for c in text.upper() if c not in GLYPHS})
    if unknown or not text.strip():
        raise InputError(
            f"text {text!r}", f"has {' '.join(unknown)!r}, which the font lacks" if unknown
            else "is empty", "use " + "".join(sorted(GLYPHS)).strip(),
        )  # fmt: skip
    strokes = []
    for place, letter in enumerate(text.upper()):
        origin = np.array([place * (WIDTH + GAP), 0.0])
        strokes += [origin + stroke for stroke in _strokes_of(letter)]
    every = np.concatenate(strokes)
    low, high = every.min(axis=0), every.max(axis=0)
    scale = 2.0 / max(*(high - low), 1e-9)
    return [scale * (stroke - 0.5 * (low + high)) for stroke in strokes]


def _strokes_of(letter: str) -> list[Array]:
    result = []
    for number, text in enumerate(filter(None, GLYPHS[letter].split("|"))):
        if letter in ROUND_LETTERS and number == 0:
            result.append(_ellipse(*ROUND_LETTERS[letter]))
            continue
        digits = np.array([int(c) for c in text.lstrip("~")], dtype=np.float64)
        points = digits.reshape(-1, 2)
        result.append(_rounded(points) if text.startswith("~") else points)
    return result


def _ellipse(half_width: float, half_height: float) -> Array:
    """Ellipse, counter-clockwise from the top, about the middle of the grid."""
    turn = 0.5 * np.pi + np.linspace(0.0, 2.0 * np.pi, 49)
    middle = np.array([0.5 * WIDTH, 0.5 * HEIGHT])
    return middle + np.column_stack([half_width * np.cos(turn), half_height * np.sin(turn)])


def _rounded(points: Array) -> Array:
    """Polyline whose corners are cut repeatedly; its ends stay."""
    points = points[np.append(True, np.any(np.diff(points, axis=0) != 0, axis=1))]
    for _ in range(ROUNDS):
        a, b = points[:-1], points[1:]
        cut = np.stack([0.75 * a + 0.25 * b, 0.25 * a + 0.75 * b], axis=1).reshape(-1, 2)
        points = np.concatenate([points[:1], cut, points[-1:]])
    return points
