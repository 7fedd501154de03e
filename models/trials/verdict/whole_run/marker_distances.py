"""Distances between markers in a section and to the next one, compared with those at rest.

A section of the link keeps its shape, and the bend to its neighbours is small. On every rig, with
each effect and a load that nearly folds the link, distances change by less than 3 % (7 % on a link
with another payload). Two exchanged markers of a square section change them by 29 % and more.
"""

from __future__ import annotations

from itertools import combinations
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_py.link.marker_layout import MarkerLayout
from models.trials.trial import Array

Rows = NDArray[np.intp]

IN_SECTION: Final = 0.15
"""Relative change above which a distance within a section is wrong: ten times the rigs' largest."""
TO_NEXT: Final = 0.25
"""The same between neighbouring sections: a bend of half a radian in a quarter of the link."""
LEAST_M: Final = 0.01
"""Change of a distance that is never wrong."""
JOINED_ROWS: Final = 5
"""Most correct rows between wrong ones of one stretch."""
SAMPLED_ROWS: Final = 15
"""Rows of a stretch that are sampled to detect an exchange."""
MOST_CANDIDATES: Final = 20
"""Most markers of which every exchange is tried."""
MOST_EXCHANGES: Final = 4
RIGHT_AGAIN: Final = 0.9
"""Fraction of the sampled rows that an exchange must correct."""
PRESENT: Final = 0.2
"""Fraction of a stretch in which a marker must be wrong to be named."""
MOST_STRETCHES: Final = 50
"""Number of the longest stretches that are checked one by one; all others form one finding."""
_CELLS: Final = 200_000
"""Most distances in memory at once."""


class Misplaced(NamedTuple):
    """Markers at a wrong position over a stretch of rows."""

    places: tuple[int, ...]  # Indices of the markers in the layout; two for an exchange
    exchanged: bool  # Whether the two have each other's position
    rows: Rows  # Rows of the trial in which distances are wrong
    off_m: float  # Largest change of a distance


class _Distances:
    """Pairs of markers, their distances at rest and the limits of change."""

    def __init__(self, markers_m: Array, layout: MarkerLayout, rest: int) -> None:
        pairs = [
            (i, j)
            for i, j in combinations(range(layout.count), 2)
            if j // layout.corners - i // layout.corners <= 1
        ]
        self.first, self.second = np.array(pairs, dtype=np.intp).reshape(-1, 2).T
        nominal_m = np.array([(x, y, z) for z in layout.rows_m for x, y in layout.corners_m])
        self.rest_m = self.of(nominal_m[None])[0]
        self.chunk = max(_CELLS // max(len(pairs), 1), 1)
        at_rest_m = self.of(markers_m[: min(max(rest, 1), self.chunk)])
        seen = np.isfinite(at_rest_m).any(axis=0)
        self.rest_m[seen] = np.nanmedian(at_rest_m[:, seen], axis=0)
        same = self.first // layout.corners == self.second // layout.corners
        self.limit_m = np.maximum(np.where(same, IN_SECTION, TO_NEXT) * self.rest_m, LEAST_M)

    def of(self, markers_m: Array) -> Array:
        """Distances, shape (n, pairs); NaN if a marker is occluded."""
        apart_m = markers_m[:, self.first] - markers_m[:, self.second]
        return np.asarray(np.linalg.norm(apart_m, axis=2))

    def off_m(self, markers_m: Array) -> Array:
        """Changes of the distances, shape (n, pairs); 0 if a marker is occluded."""
        return np.asarray(np.nan_to_num(np.abs(self.of(markers_m) - self.rest_m)))

    def chunks(self, rows: Rows) -> list[Rows]:
        """Split rows into parts whose distances fit into memory."""
        return np.array_split(rows, len(rows) // self.chunk + 1)


def misplaced_markers(markers_m: Array, layout: MarkerLayout, rest: int) -> list[Misplaced]:
    """Markers, (n, markers, 3), whose distances to neighbours are wrong, by stretches of rows."""
    distances = _Distances(markers_m, layout, rest)
    wrong = np.concatenate(
        [
            (distances.off_m(markers_m[rows]) > distances.limit_m).any(axis=1)
            for rows in distances.chunks(np.arange(len(markers_m)))
        ]
    )
    rows = np.flatnonzero(wrong)
    if not len(rows):
        return []
    stretches = np.split(rows, np.flatnonzero(np.diff(rows) > JOINED_ROWS + 1) + 1)
    stretches.sort(key=len, reverse=True)
    found: list[Misplaced] = []
    for stretch in stretches[:MOST_STRETCHES]:
        before = markers_m[stretch[0] - 1] if stretch[0] else np.full(markers_m.shape[1:], np.nan)
        found += _exchanges(distances, markers_m, stretch, before) or [
            _out_of_place(distances, markers_m, stretch)
        ]
    if stretches[MOST_STRETCHES:]:
        rest_rows = np.sort(np.concatenate(stretches[MOST_STRETCHES:]))
        found.append(_out_of_place(distances, markers_m, rest_rows))
    return _merged(found)


def _exchanges(
    distances: _Distances, markers_m: Array, stretch: Rows, before_m: Array
) -> list[Misplaced]:
    """Exchanges of two markers that correct the distances of a stretch, or none."""
    sample = stretch[np.linspace(0, len(stretch) - 1, min(len(stretch), SAMPLED_ROWS)).astype(int)]
    sampled_m, start_m = markers_m[sample], markers_m[stretch[0]]
    off_m = distances.off_m(sampled_m)
    often = ((off_m > distances.limit_m).mean(axis=0) >= 0.5).astype(float)
    counts = np.bincount(distances.first, often, markers_m.shape[1])
    counts += np.bincount(distances.second, often, markers_m.shape[1])
    candidates = [k for k in np.argsort(-counts, kind="stable")[:MOST_CANDIDATES] if counts[k]]
    order, swaps = np.arange(markers_m.shape[1]), []

    def cost(trial_order: Rows) -> float:
        """Sum of distance changes; the jump at the start decides between mirrored exchanges."""
        jump_m = np.nansum(np.linalg.norm(start_m[trial_order] - before_m, axis=1))
        return float(distances.off_m(sampled_m[:, trial_order]).mean(axis=0).sum() + jump_m)

    now = cost(order)
    for _ in range(MOST_EXCHANGES):
        tried = []
        for i, j in combinations(sorted(candidates), 2):
            other = order.copy()
            other[[i, j]] = order[[j, i]]
            tried.append((cost(other), (int(i), int(j)), other))
        if not tried or min(tried, key=lambda t: t[0])[0] >= now:
            return []
        now, swap, order = min(tried, key=lambda t: t[0])
        swaps.append(swap)
        right = (distances.off_m(sampled_m[:, order]) <= distances.limit_m).all(axis=1)
        if right.mean() >= RIGHT_AGAIN:
            most_m = float(off_m.max())
            return [Misplaced(pair, True, stretch, most_m) for pair in swaps]
    return []


def _out_of_place(distances: _Distances, markers_m: Array, stretch: Rows) -> Misplaced:
    """Markers of a stretch without which no distance is wrong; both of two equal candidates."""
    named, most_m, count = np.zeros(markers_m.shape[1]), 0.0, markers_m.shape[1]
    for rows in distances.chunks(stretch):
        off_m = distances.off_m(markers_m[rows])
        most_m = max(most_m, float(off_m.max()))
        table = np.zeros((len(rows), count, count), dtype=bool)
        table[:, distances.first, distances.second] = off_m > distances.limit_m
        table |= table.transpose(0, 2, 1)
        while table.any():
            wrong = table.sum(axis=2)
            most = wrong.max(axis=1, keepdims=True)
            worst = (wrong == most) & (most > 0)
            named += worst.sum(axis=0)
            table &= ~(worst[:, :, None] | worst[:, None, :])
    least = min(PRESENT * len(stretch), named.max())
    return Misplaced(tuple(int(k) for k in np.flatnonzero(named >= least)), False, stretch, most_m)


def _merged(found: list[Misplaced]) -> list[Misplaced]:
    """One entry for the same markers in several stretches, the longest first."""
    merged: dict[tuple[tuple[int, ...], bool], Misplaced] = {}
    for one in found:
        key = (one.places, one.exchanged)
        if key in merged:
            rows = np.sort(np.concatenate([merged[key].rows, one.rows]))
            one = Misplaced(*key, rows, max(one.off_m, merged[key].off_m))
        merged[key] = one
    return sorted(merged.values(), key=lambda one: -len(one.rows))
