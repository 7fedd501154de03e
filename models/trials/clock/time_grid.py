"""Times of a trial's rows: the servo's own samples wherever they have the trial's step.

A goal belongs to the sample that it was sent after. Rows between two samples would have the angle
of a moment and the goal of another, by up to half a step. Markers move smoothly and may be
interpolated, goals may not.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from models.trials.trial import Array
from models.trials.trial_files import STEP_TOLERANCE

IN_PHASE: Final = 0.7
"""Mean direction of the samples' phases, 0 for any phase and 1 for one, from which samples have the
step [assumed]: it is 0.76 where they lie evenly within a fifth of a step around their phase."""
LEAST_CHANGES: Final = 20
"""Changes of a goal that show in which steps it was sent."""
SAME: Final = 1e-6
"""Fraction of a step within which two times are one."""


class Sampled(NamedTuple):
    """Sample times of a signal that the servo gave, and those at which it changed."""

    time_s: Array  # (n,)
    changed_s: Array  # (k,), of those that differ from the one before


class TimeGrid(NamedTuple):
    """Times of the rows."""

    time_s: Array  # (rows,), on the clock of the samples
    in_phase: bool  # Whether the goals were sampled or sent at these times, but for a jitter


def sampled(time_s: Array, values: Array) -> Sampled:
    """Sample times of a signal, with those at which it changed.

    Shapes: `time_s`, `values` (n,).
    """
    return Sampled(time_s, time_s[1:][np.abs(np.diff(values)) > 0])


def time_grid(start_s: float, end_s: float, step_s: float, signals: Sequence[Sampled]) -> TimeGrid:
    """Rows from a first to a last time, on the samples of the first signal that has the step.

    Samples of exactly that step are the rows themselves. Samples around it, by jitter or with some
    lost, and goals that were logged finely and sent in that step, give an even grid its phase. Else
    the grid passes through a sample of the last signal.

    `signals`: goals, then angles; without any the grid begins at `start_s`.
    """
    slack_s = SAME * step_s
    shared = [
        [t[(t >= start_s - slack_s) & (t <= end_s + slack_s)] for t in signal] for signal in signals
    ]
    for own_s, _ in shared:
        if len(own_s) > 2 and np.all(np.abs(np.diff(own_s) - step_s) <= STEP_TOLERANCE * step_s):
            return TimeGrid(own_s, in_phase=True)
    candidates = [own_s for own_s, _ in shared] + [changed_s for _, changed_s in shared]
    for times_s in (t for t in candidates if len(t) >= LEAST_CHANGES):
        phases = np.exp(2j * np.pi * ((times_s - start_s) % step_s) / step_s)
        if abs(phases.mean()) >= IN_PHASE:
            apart = np.abs(np.angle(phases / phases.mean()))
            nearest = int(np.argmax(apart <= apart.min() + SAME))
            return TimeGrid(_even(times_s[nearest], start_s, end_s, step_s), in_phase=True)
    through = shared[-1][0] if shared else np.zeros(0)
    sample_s = float(through[0]) if len(through) else start_s
    return TimeGrid(_even(sample_s, start_s, end_s, step_s), in_phase=False)


def _even(through_s: float, start_s: float, end_s: float, step_s: float) -> Array:
    """Even grid through a time, within the first and the last one."""
    first_s = through_s - step_s * np.floor((through_s - start_s) / step_s + SAME)
    count = int(np.floor((end_s - first_s) / step_s + SAME)) + 1
    return np.asarray(np.clip(first_s + step_s * np.arange(count), start_s, end_s))
