"""Frozen feedback: a servo that repeats its measurement although its goal moves.

A sensor, a servo or an adapter may keep answering, well-formed and in time, with an old value. The
following error shows it only in large motions. But a driven joint whose goal has moved by more than
its encoder resolves changes its angle, or else its current, because the position loop pushes. So a
joint counts as frozen if angle and current are both identical for `ticks` fresh samples after its
goal has moved that far. A joint at rest, or in a motion too slow to show, never does.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from firmware_py.bus.servo_models import MODELS

LEAST_MOTION_RAD: Final = 8 * max(model.rad_per_pulse for model in MODELS.values())
"""Range of a goal that a servo must show: eight pulses of the coarsest encoder, 0.012 rad
[assumed]. The static friction of a gear holds an angle over some pulses, but not the current."""


class FrozenFeedback:
    """Detector for `dof` joints."""

    def __init__(self, dof: int, ticks: int) -> None:
        self._dof, self._ticks = dof, ticks
        self.reset()

    def reset(self) -> None:
        """Forget all samples, for a new start."""
        self._sample = [(float("nan"), float("nan"))] * self._dof
        self._low, self._high = [0.0] * self._dof, [0.0] * self._dof
        self._repeats = [0] * self._dof

    def joint(
        self, angle_rad: Sequence[float], current_a: Sequence[float], goal_rad: Sequence[float]
    ) -> int | None:
        """Note a fresh sample; return the first frozen joint, from 0, or None.

        `goal_rad`: goals sent before the sample.
        """
        frozen = None
        for j, sample in enumerate(zip(angle_rad, current_a, strict=True)):
            goal = goal_rad[j]
            if sample != self._sample[j]:
                self._sample[j] = sample
                self._low[j] = self._high[j] = goal
                self._repeats[j] = 0
                continue
            self._low[j], self._high[j] = min(self._low[j], goal), max(self._high[j], goal)
            if self._high[j] - self._low[j] > LEAST_MOTION_RAD:
                self._repeats[j] += 1
                if self._repeats[j] >= self._ticks and frozen is None:
                    frozen = j
        return frozen
