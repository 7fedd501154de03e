"""Zero-vibration shaper of goals whose future is unknown.

Each goal is sent in two parts, the second half a period of the first mode later and smaller by its
decay, so that the two vibrations cancel (Singer and Seering, *ASME J. Dynamic Systems* 112, 1990).
The mode may change in every tick, with the estimated payload.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

__all__ = ["ZeroVibration"]


class ZeroVibration:
    """Shaper with a history of the latest goals."""

    def __init__(self, start_rad: Sequence[float], longest_s: float, period_s: float) -> None:
        self._period_s = period_s
        self._size = math.ceil(longest_s / period_s) + 2
        self._past = [[value] * self._size for value in start_rad]
        self._latest = 0

    def next(
        self, goal_rad: Sequence[float], half_period_s: Sequence[float], decay: Sequence[float]
    ) -> list[float]:
        """Return the shaped goals of the next tick, one per joint."""
        size = self._size
        now = self._latest = (self._latest + 1) % size
        result = []
        for past, goal, seconds, left in zip(
            self._past, goal_rad, half_period_s, decay, strict=True
        ):
            past[now] = goal
            rows = min(seconds / self._period_s, size - 2.0)
            whole = int(rows)
            near, far = past[(now - whole) % size], past[(now - whole - 1) % size]
            late = near + (rows - whole) * (far - near)
            result.append((goal + left * late) / (1.0 + left))
        return result
