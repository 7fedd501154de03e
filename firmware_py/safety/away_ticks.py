"""Count of the ticks in which the goals were not those of the motion, after the port had gone."""

from __future__ import annotations


class AwayTicks:
    """Ticks from the loss of a port until the goals have joined the motion again.

    Examples
    --------
    >>> away = AwayTicks()
    >>> away.note(0, running=True, following=True)
    >>> away.note(1, running=False, following=False)  # the port has gone, the robot stops
    >>> away.leave()
    >>> away.note(40, running=True, following=False)  # it is back, the goals blend
    >>> away.note(41, running=True, following=False)
    >>> away.count
    41
    >>> away.note(42, running=True, following=True)
    >>> away.count
    41
    """

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
        """Take a tick.

        Parameters
        ----------
        slot : int
            Number of the slot.
        running : bool
            Whether no stop has begun.
        following : bool
            Whether the goals were those of the motion.
        """
        if running:
            self._ran_slot = slot
        if following:
            if self._left_slot is not None:
                self._count += max(slot - self._left_slot, 0)
            self._followed_slot, self._left_slot = slot, None
