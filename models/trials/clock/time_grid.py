"""Times of a trial's rows: the servo's own samples if they have the trial's step.

A goal belongs to the sample after which it was sent. A row between two samples would combine an
angle and a goal from times up to half a step apart. Markers move smoothly and may be interpolated,
goals may not.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from models.trials.trial import Array
from models.trials.trial_files import STEP_TOLERANCE

IN_PHASE: Final = 0.7
"""Mean resultant length of the samples' phases (0 for uniform, 1 for equal phases) above which
samples have the step [assumed]. It is 0.76 for phases spread evenly over a fifth of a step to both
sides."""
LEAST_CHANGES: Final = 20
"""Fewest changes of a goal that determine in which steps it was sent."""
SAME: Final = 1e-6
"""Fraction of a step within which two times are equal."""


class Sampled(NamedTuple):
    """Sample times of a servo's signal, and those at which it changed."""

    time_s: Array  # Sample times, (n,)
    changed_s: Array  # Times of the samples that differ from the one before, (k,)


class TimeGrid(NamedTuple):
    """Times of the rows."""

    time_s: Array  # Times on the clock of the samples, (rows,)
    in_phase: bool  # Whether goals were sampled or sent at these times, apart from jitter


def sampled(time_s: Array, values: Array) -> Sampled:
    """Sample times of a signal and those at which it changed, from arrays (n,)."""
    return Sampled(time_s, time_s[1:][np.abs(np.diff(values)) > 0])


def time_grid(start_s: float, end_s: float, step_s: float, signals: Sequence[Sampled]) -> TimeGrid:
    """Rows from a first to a last time, on the samples of the first signal that has the step.

    Samples with exactly that step become the rows. Otherwise the grid is even. Its phase comes from
    samples with about that step (jitter or lost samples), or from goals that were logged finely
    and sent in that step; else the grid passes through a sample of the last signal.

    `signals` are goals, then angles; without any, the grid begins at `start_s`.
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
    """Even grid through a time, between the first and the last time."""
    first_s = through_s - step_s * np.floor((through_s - start_s) / step_s + SAME)
    count = int(np.floor((end_s - first_s) / step_s + SAME)) + 1
    return np.asarray(np.clip(first_s + step_s * np.arange(count), start_s, end_s))
