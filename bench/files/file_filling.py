"""Blocks and lines that fill a file up to its size, and the motion that its samples show."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

from firmware_py.files.input_files import MOST_BYTES

STEP_S: Final = 0.017
MARKERS: Final = tuple(f"m{i:02d}" for i in range(1, 17))


def filled(path: Path, head: bytes, block: bytes, size: int = MOST_BYTES) -> None:
    """Write a file of a head and as many whole blocks as fit."""
    many = block * max(1, (1 << 20) // len(block))
    left = size - len(head)
    with path.open("wb") as file:
        file.write(head)
        while left >= len(many):
            left -= file.write(many)
        file.write(many[: left // len(block) * len(block)])


def filled_by_lines(
    path: Path, head: str, line: Callable[[int], str], size: int = MOST_BYTES
) -> None:
    """Write a file of a head and as many lines as fit."""
    with path.open("w", encoding="utf-8") as file:
        left, k = size - file.write(head), 0
        while left > 0 and len(text := line(k)) <= left:
            left -= file.write(text)
            k += 1


def angle_rad(k: int) -> float:
    """Angle of the joint in a row: rest, then a slow sinusoid."""
    return 0.3 * math.sin(0.01 * max(k - 30, 0))


def marker_m(number: int, turn_rad: float) -> Iterator[float]:
    """Yield the position of a marker of the straight nominal link."""
    row, corner = divmod(number, 4)
    x, y, z = (0.075, -0.075)[corner % 2], (0.075, -0.075)[corner // 2], 0.06 + 0.95 * (row + 1) / 4
    c, s = math.cos(turn_rad), math.sin(turn_rad)
    yield from (c * x + s * z, y, c * z - s * x)
