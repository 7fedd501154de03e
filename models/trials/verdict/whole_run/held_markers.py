"""Markers whose position is constant for a while although the link moves."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from models.shared.kinematics import base_rotation
from models.trials.trial import Array, Trial

SAME_M: Final = 1e-9
"""Largest change of a constant position between rows: rounding of a rotated frame."""
LEAST_ROWS: Final = 5
LEAST_S: Final = 0.1
"""Shortest hold that is reported; a capture at 10 Hz, held to the trial's step, is shorter."""
MOVED_M: Final = 0.02
"""Travel of the neighbours, and of the marker on a rigid link, above which a hold is wrong; a clock
error of 20 ms moves the tip of the study's motion by 14 mm."""
ALL_MOVED_M: Final = 0.06
"""The same, from the joint angles alone, if every marker holds its position."""
NEIGHBOURS: Final = 3
MOST_RUNS: Final = 100
"""Number of the longest holds of a marker that are checked."""


class HeldMarkers(NamedTuple):
    """Markers that hold their positions over the same rows."""

    places: tuple[int, ...]  # Indices of the markers in the layout
    first: int  # First and last row in the trial
    last: int
    moved_m: float  # Travel of the neighbours meanwhile, or of the markers by the joint angles


def held_markers(trial: Trial) -> list[HeldMarkers]:
    """Holds of markers that contradict the link's motion, in the order of the rows."""
    markers_m, time_s = trial.markers_m, trial.time_s
    same = np.all(np.abs(np.diff(markers_m, axis=0)) <= SAME_M, axis=2)
    found: dict[tuple[int, int], list[int]] = {}
    ways_m: dict[tuple[int, int], float] = {}
    for place in range(markers_m.shape[1]):
        for run in _runs(same[:, place], time_s):
            if run not in ways_m:
                ways_m[run] = -1.0
            way_m = _way_m(trial, markers_m, same, place, run)
            if way_m > 0:
                found.setdefault(run, []).append(place)
                ways_m[run] = max(ways_m[run], way_m)
    return [HeldMarkers(tuple(found[run]), *run, ways_m[run]) for run in sorted(found)]


def _runs(same: Array, time_s: Array) -> list[tuple[int, int]]:
    """First and last rows of the longest holds."""
    edges = np.diff(np.concatenate([[0], same.astype(int), [0]]))
    first, last = np.flatnonzero(edges > 0), np.flatnonzero(edges < 0)
    long = (last - first + 1 >= LEAST_ROWS) & (time_s[last] - time_s[first] >= LEAST_S)
    runs = sorted(zip(first[long], last[long], strict=True), key=lambda run: run[0] - run[1])
    return [(int(a), int(b)) for a, b in runs[:MOST_RUNS]]


def _way_m(trial: Trial, markers_m: Array, same: Array, place: int, run: tuple[int, int]) -> float:
    """Travel of a marker that is expected during a hold; 0 if it may have been at rest."""
    first, last = run
    rows = slice(first, last + 1)
    turn = base_rotation(trial.angle_rad[rows])
    own_m = markers_m[first, place]
    carried_m = turn @ (turn[0].T @ own_m) - own_m
    rigid_m = float(np.linalg.norm(carried_m, axis=1).max())
    if rigid_m < MOVED_M:
        return 0.0
    free = np.flatnonzero(~same[first:last].all(axis=0) & np.isfinite(markers_m[first, :, 0]))
    if not len(free):
        return rigid_m if rigid_m > ALL_MOVED_M else 0.0
    distance_m = np.linalg.norm(markers_m[first, free] - own_m, axis=1)
    near = free[np.argsort(distance_m, kind="stable")[:NEIGHBOURS]]
    apart_m = np.linalg.norm(markers_m[rows, near] - markers_m[first, near], axis=2)
    way_m = float(np.median(np.fmax.reduce(apart_m, axis=0)))
    return way_m if way_m > MOVED_M else 0.0
