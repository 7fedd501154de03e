"""Markers over a run: absent, occluded, moving at rest, held, exchanged or out of place.

Distances between markers of a section, and to the next one, are compared with those at rest: a
section keeps its shape, and the bend to its neighbours is small. On every rig, with each effect and
a load that nearly folds the link, distances change by less than 3 % (7 % on a link with another
payload). Two exchanged markers of a square section change them by 29 % and more.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import combinations
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_py.display_units import LENGTH
from firmware_py.link.marker_layout import MarkerLayout
from models.shared.kinematics import base_rotation
from models.trials.checks import causes
from models.trials.checks.causes import Cause, ImportFinding
from models.trials.recordings.mapping import RecordingMap
from models.trials.recordings.series import Series
from models.trials.trial import Array, Trial

Rows = NDArray[np.intp]


def judge_markers(series: Sequence[Series], mapping: RecordingMap) -> list[ImportFinding]:
    """Findings on markers that are mapped but absent, or occluded most of the time."""
    columns = {name: values for s in series for name, values in s.columns.items()}
    markers = mapping.layout.names
    given = [n for n in (*markers, "tip") if f"{n}_x_m" in columns]
    if not given:
        return []
    found: list[ImportFinding] = []
    for name, source in mapping.markers.items():
        if f"{name}_x_m" not in columns:
            found += causes.ABSENT_MARKER.raised(name=name, source=source)
    missing = [n for n in markers if n not in given and n not in mapping.markers]
    if missing and given != ["tip"]:
        found += causes.NOT_MAPPED.raised(names=", ".join(missing))
    for name in given:
        unseen = float(np.mean(~np.isfinite(columns[f"{name}_x_m"])))
        found += causes.OCCLUDED.beyond(unseen, name=name)
    return found


def judge_rest(trial: Trial) -> list[ImportFinding]:
    """Findings on the rest rows of a trial with markers."""
    markers_m, rest = trial.markers_m, trial.meta.rest_samples
    if not np.isfinite(markers_m).any():
        return []
    if rest < causes.REST_ROWS[0]:
        level: causes.Level = "refused" if rest < causes.REST_ROWS[1] else "warning"
        return [causes.SHORT_REST.at(level, rows=f"{rest} row{'' if rest == 1 else 's'}")]
    third = max(rest // 3, 1)
    first_m, last_m = seen_mean(markers_m[:third]), seen_mean(markers_m[rest - third : rest])
    moved_m = np.linalg.norm(last_m - first_m, axis=-1)
    most_m = float(np.nanmax(moved_m)) if np.isfinite(moved_m).any() else 0.0
    return causes.REST_MOVES.beyond(most_m, rest=rest)


def seen_mean(rows_m: Array) -> Array:
    """Mean over rows (n, …) without those that were not seen; NaN if none was."""
    seen = np.isfinite(rows_m)
    count = seen.sum(axis=0)
    total = np.where(seen, rows_m, 0.0).sum(axis=0)
    return np.asarray(np.where(count > 0, total / np.maximum(count, 1), np.nan))


def without_zeros(
    series: list[Series], names: Iterable[str], zero_m: Array, remedy: str
) -> tuple[list[Series], list[ImportFinding]]:
    """Set markers at exactly zero (`zero_m`, shape (3,)) to NaN, with a finding that counts them.

    A marker that is never elsewhere is unchanged.
    """
    counts: dict[str, int] = {}
    times_s: list[Array] = []
    result = []
    for s in series:
        columns = dict(s.columns)
        for name in names:
            axes = [f"{name}_{axis}_m" for axis in "xyz"]
            if not all(axis in columns for axis in axes):
                continue
            zero = np.logical_and.reduce(
                [columns[axis] == at for axis, at in zip(axes, zero_m, strict=True)]
            )
            if zero.any() and np.isfinite(columns[axes[0]][~zero]).any():
                columns |= {axis: np.where(zero, np.nan, columns[axis]) for axis in axes}
                counts[name] = int(zero.sum())
                times_s.append(s.time_s[zero])
        result.append(replace(s, columns=columns) if counts else s)
    if not counts:
        return series, []
    seen_s = np.concatenate(times_s)
    return result, causes.ZEROS.raised(
        first_s=seen_s.min(), last_s=seen_s.max(), remedy=remedy,
        listed=", ".join(f"{name} in {n}" for name, n in counts.items()),
    )  # fmt: skip


MOST_NAMED: Final = 4
"""Most findings of one kind that are listed one by one."""


def judge_marker_run(trial: Trial) -> list[ImportFinding]:
    """Findings on markers that hold, exchange or leave their positions during a trial."""
    markers_m, names, time_s = trial.markers_m, trial.meta.layout.names, trial.time_s
    if not np.isfinite(markers_m).any():
        return []
    texts: dict[Cause, list[str]] = {
        causes.HELD: [], causes.EXCHANGED: [], causes.OUT_OF_PLACE: []
    }  # fmt: skip
    for held in held_markers(trial):
        markers_m[held.first : held.last + 1, list(held.places)] = np.nan
        verb = "holds its position" if len(held.places) == 1 else "hold their positions"
        meanwhile = "the link moves" if len(held.places) == len(names) else "the neighbours move"
        where = _rows(np.arange(held.first, held.last + 1), time_s)
        texts[causes.HELD].append(
            f"{_listed(names, held.places)} {verb} {where}, while {meanwhile} by "
            f"{LENGTH.text(held.moved_m, 0)}"
        )
    for wrong in misplaced_markers(markers_m, trial.meta.layout, trial.meta.rest_samples):
        which, where = _listed(names, wrong.places), _rows(wrong.rows, time_s)
        if wrong.exchanged:
            texts[causes.EXCHANGED].append(f"{which} are exchanged {where}")
            continue
        texts[causes.OUT_OF_PLACE].append(
            f"{which} {'is' if len(wrong.places) == 1 else 'are'} out of place {where}: distances "
            f"to the neighbours are wrong by up to {LENGTH.text(wrong.off_m, 0)}"
        )
    found: list[ImportFinding] = []
    for cause, of_cause in texts.items():
        listed = of_cause[:MOST_NAMED]
        if len(of_cause) > MOST_NAMED:
            listed[-1] += f"; and {len(of_cause) - MOST_NAMED} times more in this trial"
        found += [finding for text in listed for finding in cause.raised(text=text)]
    return found


def _listed(names: Sequence[str], places: Iterable[int]) -> str:
    """Names of markers in words."""
    listed = [names[k] for k in places]
    if len(listed) == len(names) > 1:
        return "all markers"
    return " and ".join(filter(None, [", ".join(listed[:-1]), listed[-1]]))


def _rows(rows: Rows, time_s: Array) -> str:
    """Rows in words, counted as in the trial's file: its header is row 1."""
    first, last = int(rows[0]), int(rows[-1])
    if first == last:
        return f"in row {first + 2} ({time_s[first]:.2f} s)"
    of = "" if len(rows) == last - first + 1 else f"{len(rows)} of the "
    return f"in {of}rows {first + 2} to {last + 2} ({time_s[first]:.2f} s to {time_s[last]:.2f} s)"


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
    markers_m = trial.markers_m
    same = np.all(np.abs(np.diff(markers_m, axis=0)) <= SAME_M, axis=2)
    found: dict[tuple[int, int], dict[int, float]] = {}
    for place in range(markers_m.shape[1]):
        for run in _runs(same[:, place], trial.time_s):
            way_m = _way_m(trial, markers_m, same, place, run)
            if way_m > 0:
                found.setdefault(run, {})[place] = way_m
    return [
        HeldMarkers(tuple(ways_m), *run, max(ways_m.values()))
        for run, ways_m in sorted(found.items())
    ]


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
ROWS_AT_ONCE: Final = 2000
"""Most rows whose distances are in memory, and most of a stretch that name its markers."""


class Misplaced(NamedTuple):
    """Markers at a wrong position over a stretch of rows."""

    places: tuple[int, ...]  # Indices of the markers in the layout; two for an exchange
    exchanged: bool  # Whether the two have each other's position
    rows: Rows  # Rows of the trial in which distances are wrong
    off_m: float  # Largest change of a distance


class _Distances:
    """Pairs of markers, their distances at rest and the limits of change."""

    def __init__(self, markers_m: Array, layout: MarkerLayout, rest: int) -> None:
        first, second = np.triu_indices(layout.count, 1)
        near = second // layout.corners - first // layout.corners <= 1
        self.first, self.second = first[near], second[near]
        nominal_m = np.array([(x, y, z) for z in layout.rows_m for x, y in layout.corners_m])
        self.rest_m = self.of(nominal_m[None])[0]
        at_rest_m = self.of(markers_m[: min(max(rest, 1), ROWS_AT_ONCE)])
        seen = np.isfinite(at_rest_m).any(axis=0)
        self.rest_m[seen] = np.nanmedian(at_rest_m[:, seen], axis=0)
        same = self.first // layout.corners == self.second // layout.corners
        self.limit_m = np.maximum(np.where(same, IN_SECTION, TO_NEXT) * self.rest_m, LEAST_M)

    def of(self, markers_m: Array) -> Array:
        """Distances, shape (n, pairs); NaN if a marker is occluded."""
        return np.asarray(
            np.linalg.norm(markers_m[:, self.first] - markers_m[:, self.second], axis=2)
        )

    def off_m(self, markers_m: Array) -> Array:
        """Changes of the distances, shape (n, pairs); 0 if a marker is occluded."""
        return np.asarray(np.nan_to_num(np.abs(self.of(markers_m) - self.rest_m)))


def misplaced_markers(markers_m: Array, layout: MarkerLayout, rest: int) -> list[Misplaced]:
    """Markers, (n, markers, 3), whose distances to neighbours are wrong, by stretches of rows.

    The same markers in several stretches are one entry; the longest comes first.
    """
    distances = _Distances(markers_m, layout, rest)
    parts = range(0, len(markers_m), ROWS_AT_ONCE)
    wrong = [distances.off_m(markers_m[k : k + ROWS_AT_ONCE]) > distances.limit_m for k in parts]
    rows = np.flatnonzero(np.concatenate([part.any(axis=1) for part in wrong]))
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
    merged: dict[tuple[tuple[int, ...], bool], Misplaced] = {}
    for one in found:
        other = merged.get(key := (one.places, one.exchanged))
        if other is not None:
            rows = np.sort(np.concatenate([other.rows, one.rows]))
            one = Misplaced(*key, rows, max(one.off_m, other.off_m))
        merged[key] = one
    return sorted(merged.values(), key=lambda one: -len(one.rows))


def _sample(stretch: Rows, count: int) -> Rows:
    every = np.linspace(0, len(stretch) - 1, min(len(stretch), count)).astype(int)
    return np.asarray(stretch[every])


def _exchanges(
    distances: _Distances, markers_m: Array, stretch: Rows, before_m: Array
) -> list[Misplaced]:
    """Exchanges of two markers that correct the distances of a stretch, or none."""
    sampled_m, start_m = markers_m[_sample(stretch, SAMPLED_ROWS)], markers_m[stretch[0]]
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
            return [Misplaced(pair, True, stretch, float(off_m.max())) for pair in swaps]
    return []


def _out_of_place(distances: _Distances, markers_m: Array, stretch: Rows) -> Misplaced:
    """Markers of a stretch without which no distance is wrong; both of two equal candidates."""
    count, sample = markers_m.shape[1], _sample(stretch, ROWS_AT_ONCE)
    off_m = distances.off_m(markers_m[sample])
    wrong = np.zeros((len(sample), count, count), dtype=bool)
    wrong[:, distances.first, distances.second] = off_m > distances.limit_m
    wrong |= wrong.transpose(0, 2, 1)
    named = np.zeros(count)
    while wrong.any():
        pairs = wrong.sum(axis=2)
        most = pairs.max(axis=1, keepdims=True)
        worst = (pairs == most) & (most > 0)
        named += worst.sum(axis=0)
        wrong &= ~(worst[:, :, None] | worst[:, None, :])
    least = min(PRESENT * len(sample), named.max())
    places = tuple(int(k) for k in np.flatnonzero(named >= least))
    return Misplaced(places, False, stretch, float(off_m.max()))
