"""Count of the ticks in which the goals were not those of the motion, after the port had gone."""

from __future__ import annotations


class AwayTicks:
    """Ticks from the loss of a port until the goals have joined the motion again."""

    def __init__(self) -> None:
        self._ran_slot = self._followed_slot = -1
        self._left_slot: int | None = None
        self._count = 0

    @property
    def count(self) -> int:
        """Ticks so far, those in which no tick could run included; the last stop is left out."""
        left = self._left_slot
        return self._count + (0 if left is None else max(self._ran_slot + 1 - left, 0))

    def leave(self) -> None:
        """Begin to count: the robot starts again after a stop."""
        if self._left_slot is None:
            self._left_slot = self._followed_slot + 1

    def note(self, slot: int, *, running: bool, following: bool) -> None:
        """Take a tick."""
        if running:
            self._ran_slot = slot
        if following:
            if self._left_slot is not None:
                self._count += max(slot - self._left_slot, 0)
            self._followed_slot, self._left_slot = slot, None
