"""Count of the ticks spent re-joining the motion after the port came back."""

from __future__ import annotations


class AwayTicks:
    """Ticks from the disconnect of a port until the goals have joined the motion again."""

    def __init__(self) -> None:
        self._ran_slot = self._followed_slot = -1
        self._left_slot: int | None = None
        self._count = 0

    @property
    def count(self) -> int:
        """Ticks so far, including slots in which none could run, excluding the last stop."""
        left = self._left_slot
        return self._count + (0 if left is None else max(self._ran_slot + 1 - left, 0))

    def leave(self) -> None:
        """Begin to count, since the robot starts again after a stop."""
        if self._left_slot is None:
            self._left_slot = self._followed_slot + 1

    def note(self, slot: int, *, running: bool, following: bool) -> None:
        """Record whether the loop ran, and whether its goals followed the motion, in a slot."""
        if running:
            self._ran_slot = slot
        if following:
            if self._left_slot is not None:
                self._count += max(slot - self._left_slot, 0)
            self._followed_slot, self._left_slot = slot, None
