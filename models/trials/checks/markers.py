"""Findings on what is missing: mapped markers, gaps in time, occlusions, rest rows.

Occlusions that an export wrote as zeros: all three coordinates of a marker exactly zero.

Markers whose position is constant for a while although the link moves.

Distances between markers in a section and to the next one, compared with those at rest.

A section of the link keeps its shape, and the bend to its neighbours is small. On every rig, with
each effect and a load that nearly folds the link, distances change by less than 3 % (7 % on a link
with another payload). Two exchanged markers of a square section change them by 29 % and more.

Findings on the tip: its distance from the centre of the last marker row, and single jumps.

The tip is defined as the centre of the last marker row (docs/trials.md). A recording may use its
name for another point: in Motive the pivot of a rigid body may be anywhere, and an asset may be the
wrong one.

Findings on a whole run: markers held, exchanged or out of place; goals, phase of joint 2.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_py.display_units import ANGLE, LENGTH
from firmware_py.link.marker_layout import MarkerLayout
from models.shared.kinematics import base_rotation
from models.trials.checks.finding import (
    GAP_S,
    REST_MOVE_M,
    REST_ROWS,
    SHAPE_M,
    UNSEEN,
    ImportFinding,
    level_of,
)
from models.trials.checks.goals import judge_goals
from models.trials.checks.motion import LEAST_MOTION_RAD
from models.trials.recordings.mapping import RecordingMap
from models.trials.recordings.series import Series, row_centre_m
from models.trials.trial import Array, Trial


@dataclass(frozen=True)
class Gap:
    """Longest time without a sample in a series."""

    file: str  # Name of the file
    start_s: float  # Last sample before the gap, on the trial's clock
    length_s: float  # Time to the next sample
    step_s: float  # Usual step of the series


def longest_gaps(series: Sequence[Series], start_s: float, end_s: float) -> list[Gap]:
    """Longest gap of every series between the first and the last time of a trial."""
    gaps = []
    for s in series:
        inside = s.time_s[(s.time_s >= start_s - 1.0) & (s.time_s <= end_s + 1.0)]
        if len(inside) < 2:
            continue
        steps = np.diff(inside)
        k = int(np.argmax(steps))
        gaps.append(
            Gap(s.path.name, float(inside[k] - start_s), float(steps[k]), float(np.median(steps)))
        )
    return gaps


def judge_gaps(gaps: Sequence[Gap]) -> list[ImportFinding]:
    """Findings on gaps that would be bridged by interpolation."""
    found = []
    for gap in gaps:
        bridged_s = gap.length_s if gap.length_s > 1.5 * gap.step_s else 0.0
        level = level_of(bridged_s, GAP_S)
        if level:
            found.append(
                ImportFinding(
                    level, "gap",
                    f"{gap.file} has no samples for {gap.length_s:.3f} s from "
                    f"{gap.start_s:.2f} s on",
                    "cut the recording there, or record it again",
                )
            )  # fmt: skip
    return found


def judge_markers(series: Sequence[Series], mapping: RecordingMap) -> list[ImportFinding]:
    """Findings on markers that are mapped but absent, or occluded most of the time."""
    columns = {name: values for s in series for name, values in s.columns.items()}
    markers = mapping.layout.names
    given = [n for n in (*markers, "tip") if f"{n}_x_m" in columns]
    if not given:
        return []
    found = []
    for name, source in mapping.markers.items():
        if f"{name}_x_m" not in columns:
            found.append(
                ImportFinding(
                    "refused", "absent",
                    f"{name} is mapped to {source!r}, which the file does not hold",
                    "correct [markers] in MAP.toml",
                )
            )  # fmt: skip
    missing = [n for n in markers if n not in given and n not in mapping.markers]
    if missing and set(given) != {"tip"}:
        found.append(
            ImportFinding(
                "warning", "absent",
                f"the file holds no {', '.join(missing)}: there is no Deformation Index without",
                "map them under [markers], or use the plant without DI",
            )
        )  # fmt: skip
    for name in given:
        unseen = float(np.mean(~np.isfinite(columns[f"{name}_x_m"])))
        level = level_of(unseen, UNSEEN)
        if level:
            found.append(
                ImportFinding(
                    level, "occluded", f"{name} is unseen in {unseen:.0%} of the rows",
                    "check its name, or record it again with the marker in view",
                )
            )  # fmt: skip
    return found


def judge_rest(trial: Trial) -> list[ImportFinding]:
    """Findings on the rest rows of a trial with markers."""
    markers_m = trial.markers_m
    if not np.isfinite(markers_m).any():
        return []
    rest = trial.meta.rest_samples
    if rest < REST_ROWS[0]:
        return [
            ImportFinding(
                "refused" if rest < REST_ROWS[1] else "warning", "rest",
                f"{rest} row{'' if rest == 1 else 's'} at rest before the motion, the reference of "
                "the Deformation Index",
                f"start both recordings at least {REST_ROWS[0]} rows before the motion",
            )
        ]  # fmt: skip
    moved = _largest_move_m(markers_m[:rest])
    level = level_of(moved, REST_MOVE_M)
    if level:
        return [
            ImportFinding(
                level, "rest",
                f"a marker moves by {LENGTH.text(moved)} within the {rest} rest rows",
                "correct rest_samples, or let the link come to rest first",
            )
        ]  # fmt: skip
    return []


def _largest_move_m(markers_m: Array) -> float:
    """Largest distance between a marker's mean places in the first and the last third of rows."""
    third = max(len(markers_m) // 3, 1)
    ends = []
    for rows in (markers_m[:third], markers_m[-third:]):
        seen = np.isfinite(rows)
        count = seen.sum(axis=0)
        ends.append(
            np.where(
                count > 0, np.where(seen, rows, 0.0).sum(axis=0) / np.maximum(count, 1), np.nan
            )
        )
    moved = np.linalg.norm(ends[1] - ends[0], axis=-1)
    return float(np.nanmax(moved)) if np.isfinite(moved).any() else 0.0


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
    listed = ", ".join(f"{name} in {n}" for name, n in counts.items())
    seen_s = np.concatenate(times_s)
    text = (
        f"markers are at exactly 0, 0, 0 between {seen_s.min():.2f} s and {seen_s.max():.2f} s "
        f"({listed} samples), as some exports write an occlusion"
    )
    return result, [ImportFinding("warning", "zeros", text, remedy)]


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


REFUSED_ROWS: Final = 0.1
"""Fraction of rows above which a tip beyond the limit is more than outliers [assumed]."""
ROW_SHAPE_M: Final = 0.01
"""Change of a distance within the last row above which its centre is not used in a sample."""
FEWEST_SEEN: Final = 3
"""Fewest visible markers of a row, or all of a smaller row."""
REACH: Final = (0.5, 1.3)
"""Distance of the tip from the joint axes, relative to a straight link's: a link bent to a half
circle has 0.64; a larger distance means another unit or origin."""
UNITS: Final = (("mm", 1e3), ("cm", 1e2), ("inches", 39.37), ("feet", 3.281), ("km", 1e-3))
"""Units in which a tip may be, and how many of them are 1 m."""
SAME_UNIT: Final = 0.05
"""Largest relative error of the distance from the joint axes at which a unit is recognised."""
CONSTANT: Final = 0.1
"""Largest change of a constant offset, relative to its length."""
SAME_PLACE_M: Final = 1e-3
"""Largest distance between tip and marker at the same place."""
JUMP_M: Final = 0.02
"""Smallest distance from the midpoint of the adjacent samples at which the tip jumps."""
JUMP_NOISE: Final = 20.0
"""Smallest jump, relative to the median of that distance."""
_TURNED: Final = (
    ("x is negated", (0, 1, 2), (-1, 1, 1)),
    ("y is negated", (0, 1, 2), (1, -1, 1)),
    ("z is negated", (0, 1, 2), (1, 1, -1)),
    ("x and y are exchanged", (1, 0, 2), (1, 1, 1)),
    ("x and z are exchanged", (2, 1, 0), (1, 1, 1)),
    ("y and z are exchanged", (0, 2, 1), (1, 1, 1)),
)
"""Mistakes in the axes of the tip: order and signs that undo them."""


def judge_tip(trial: Trial) -> list[ImportFinding]:
    """Findings on the tip of a trial of the link.

    It is compared with the centre of the last marker row where that is visible, and with the reach
    of the link. A trial without a tip, or of another plant, has no findings.
    """
    if not trial.meta.link_length_m or "tip_x_m" not in trial.columns:
        return []
    tip_m = trial.tip_m
    seen = np.flatnonzero(np.isfinite(tip_m).all(axis=1))
    if not len(seen):
        return []
    rows, apart_m = _apart(trial)
    found = _reach(trial, tip_m[seen])
    if found and not _marker_at(trial, rows):
        return found
    off_m = np.linalg.norm(apart_m, axis=1)
    found = _beside_row(trial, rows, apart_m) if len(rows) else []
    if any(f.level == "refused" for f in found):
        return found
    usual_m = float(np.median(off_m)) if len(rows) else 0.0
    wrong = rows[off_m > usual_m + SHAPE_M[1]]
    others = np.setdiff1d(_jumps(trial, seen), rows)
    if len(wrong):
        off = LENGTH.text(off_m.max(), 0)
        found.append(_at_rows(trial, wrong, f"up to {off} from the centre of {_row_name(trial)}"))
    if len(others):
        found.append(_at_rows(trial, others, "off its course"))
    return found


def _reach(trial: Trial, tip_m: Array) -> list[ImportFinding]:
    """Finding on a tip far from the link."""
    reach_m = trial.meta.base_offset_m + trial.meta.link_length_m
    size_m = float(np.median(np.linalg.norm(tip_m, axis=1)))
    low, high = REACH
    if low * reach_m <= size_m <= high * reach_m:
        return []
    units = [
        unit for unit, per_m in UNITS if abs(size_m / (per_m * reach_m) - 1) < SAME_UNIT
    ]  # fmt: skip
    cause = f": it is in {units[0]}" if units else ""
    return [
        ImportFinding(
            "refused", "tip",
            f"the tip is {size_m:.3g} m from the joint axes, the end of the link "
            f"{reach_m:.3g} m{cause}",
            "correct the unit or place of tip (tip_x_m, tip_y_m, tip_z_m), or link_length_m",
        )
    ]  # fmt: skip


def _apart(trial: Trial) -> tuple[Rows, Array]:
    """Rows in which the last marker row is valid, and the tip's place from its centre."""
    none = np.empty(0, dtype=np.intp), np.empty((0, 3))
    layout = trial.meta.layout
    if f"{layout.names[-1]}_x_m" not in trial.columns:
        return none
    row_m = trial.marker_rows_m[:, -1]
    first, second = np.triu_indices(layout.corners, 1)
    distance_m = np.linalg.norm(row_m[:, first] - row_m[:, second], axis=2)
    seen = np.isfinite(row_m).all(axis=2)
    known = np.isfinite(distance_m).any(axis=0)
    usual_m = np.zeros(len(first))
    usual_m[known] = np.nanmedian(distance_m[:, known], axis=0)
    if len(first) and usual_m.max() < SAME_PLACE_M:
        return none  # all in one place, so these are no markers
    changed = np.nan_to_num(np.abs(distance_m - usual_m)).max(axis=1, initial=0.0)
    apart_m = trial.tip_m - row_centre_m(np.moveaxis(row_m, 1, 0), layout.corners_m)
    kept = (seen.sum(axis=1) >= min(FEWEST_SEEN, layout.corners)) & (changed < ROW_SHAPE_M)
    rows = np.flatnonzero(kept & np.isfinite(apart_m).all(axis=1))
    return rows, apart_m[rows]


def _beside_row(trial: Trial, rows: Rows, apart_m: Array) -> list[ImportFinding]:
    """Finding on a tip that is not the centre of the last marker row in the whole run."""
    off_m = np.linalg.norm(apart_m, axis=1)
    usual_m, most_m = float(np.median(off_m)), float(np.quantile(off_m, 1 - REFUSED_ROWS))
    level = "refused" if most_m > SHAPE_M[1] else level_of(usual_m, SHAPE_M)
    if level is None:
        return []
    where = f"from the centre of the last marker row ({_row_name(trial)})"
    if usual_m > SHAPE_M[0]:
        text = f"the tip is {LENGTH.text(usual_m)} {where}{_cause(trial, rows, apart_m)}"
    else:
        part = float(np.mean(off_m > SHAPE_M[1]))
        text = f"the tip is beyond {LENGTH.text(SHAPE_M[1], 0)} {where} in {part:.0%} of the rows"
    return [
        ImportFinding(
            level, "tip", text,
            "correct tip in [markers] of the map (the pivot of its rigid body), or leave it out to "
            "have it computed, and import again",
        )
    ]  # fmt: skip


def _cause(trial: Trial, rows: Rows, apart_m: Array) -> str:
    """Probable cause of the tip's distance, in words."""
    tip_m, off_m = trial.tip_m[rows], np.linalg.norm(apart_m, axis=1)
    marker = _marker_at(trial, rows)
    if marker:
        return f": it is marker {marker}"
    for words, order, signs in _TURNED:
        left_m = tip_m[:, order] * signs - (tip_m - apart_m)
        if np.median(np.linalg.norm(left_m, axis=1)) < min(SHAPE_M[0], CONSTANT * np.median(off_m)):
            return f": {words}"
    turn = base_rotation(trial.angle_rad[rows])
    for frame, offset_m in (
        ("link", np.einsum("nji,nj->ni", turn, apart_m)), ("world", apart_m),
    ):  # fmt: skip
        middle_m = np.median(offset_m, axis=0)
        change_m = float(np.median(np.linalg.norm(offset_m - middle_m, axis=1)))
        if change_m < max(CONSTANT * float(np.linalg.norm(middle_m)), SAME_PLACE_M):
            listed = ", ".join(f"{LENGTH.factor * v:+.0f}" for v in middle_m)
            return f", by dx, dy, dz = {listed} {LENGTH.name} in the frame of the {frame}"
    return ", by no constant offset: an axis, a unit or a point is wrong"


def _marker_at(trial: Trial, rows: Rows) -> str:
    """Name of the marker at the tip's place, empty for none."""
    if not len(rows):
        return ""
    distance_m = np.linalg.norm(trial.markers_m[rows] - trial.tip_m[rows, None], axis=2)
    for name, own_m in zip(trial.meta.layout.names, distance_m.T, strict=True):
        known_m = own_m[np.isfinite(own_m)]
        if len(known_m) and np.median(known_m) < SAME_PLACE_M:
            return name
    return ""


def _jumps(trial: Trial, seen: Rows) -> Rows:
    """Rows in which the tip jumps from the adjacent samples, or leaves the reach of the link."""
    tip_m = trial.tip_m[seen]
    reach_m = trial.meta.base_offset_m + trial.meta.link_length_m
    beyond = np.linalg.norm(tip_m, axis=1) > REACH[1] * reach_m
    if len(seen) >= 3:
        middle_m = 0.5 * (tip_m[:-2] + tip_m[2:])
        bent_m = np.linalg.norm(tip_m[1:-1] - middle_m, axis=1)
        limit_m = max(JUMP_M, JUMP_NOISE * float(np.median(bent_m)))
        around_m = np.linalg.norm(tip_m[2:] - tip_m[:-2], axis=1)
        beyond[1:-1] |= (bent_m > limit_m) & (bent_m > around_m)
    return np.asarray(seen[beyond])


def _row_name(trial: Trial) -> str:
    names: Sequence[str] = trial.meta.layout.row(-1)
    return names[0] if len(names) == 1 else f"{names[0]} to {names[-1]}"


def _at_rows(trial: Trial, rows: Rows, what: str) -> ImportFinding:
    """Warning on single rows, counted as in the trial's file: its header is row 1."""
    first = int(rows[0])
    where = f"row {first + 2} ({trial.time_s[first]:.2f} s)"
    if len(rows) > 1:
        where = f"{len(rows)} rows from {where} on"
    return ImportFinding(
        "warning", "tip", f"the tip is {what} in {where}",
        f"correct the tip there: the centre of {_row_name(trial)}, or interpolate it",
    )  # fmt: skip


MOST_NAMED: Final = 4
"""Most findings of one kind that are listed one by one."""
PHASE_RAD: Final = 0.3
"""Difference of the goals' phase from the declared one that causes a warning."""
SINUSOIDAL: Final = 0.9
"""Smallest fraction of a goal's variance in a sine of the period that defines its phase."""


def judge_run(trial: Trial) -> list[ImportFinding]:
    """Findings on the markers over a whole trial, and on its goals."""
    found = [*judge_goals(trial), *_phase(trial)]
    markers_m = trial.markers_m
    if not np.isfinite(markers_m).any():
        return found
    names, time_s = trial.meta.layout.names, trial.time_s
    held = held_markers(trial)
    texts = []
    for h in held:
        markers_m[h.first : h.last + 1, list(h.places)] = np.nan
        verb = "holds its position" if len(h.places) == 1 else "hold their positions"
        meanwhile = "the link moves" if len(h.places) == len(names) else "the neighbours move"
        texts.append(
            f"{_listed(names, h.places)} {verb} {_rows(np.arange(h.first, h.last + 1), time_s)}, "
            f"while {meanwhile} by {LENGTH.text(h.moved_m, 0)}"
        )
    found += _findings(texts, "held", "leave these cells empty where the marker was not seen")
    texts, swapped = [], []
    for m in misplaced_markers(markers_m, trial.meta.layout, trial.meta.rest_samples):
        where = _rows(m.rows, time_s)
        if m.exchanged:
            swapped.append(f"{_listed(names, m.places)} are exchanged {where}")
            continue
        verb = "is" if len(m.places) == 1 else "are"
        texts.append(
            f"{_listed(names, m.places)} {verb} out of place {where}: distances to the neighbours "
            f"are wrong by up to {LENGTH.text(m.off_m, 0)}"
        )
    found += _findings(swapped, "swapped", "exchange them in these rows and correct the tip")
    return found + _findings(
        texts, "place", "leave these cells empty, or label the markers again and export anew"
    )


def _findings(texts: Sequence[str], cause: str, remedy: str) -> list[ImportFinding]:
    """A warning for each text; many of one kind are counted."""
    told = list(texts[:MOST_NAMED])
    if len(texts) > MOST_NAMED:
        told[-1] += f"; and {len(texts) - MOST_NAMED} times more in this trial"
    return [ImportFinding("warning", cause, text, remedy) for text in told]


def _listed(names: Sequence[str], places: Iterable[int]) -> str:
    """Names of markers in words."""
    listed = [names[k] for k in places]
    if len(listed) == len(names) > 1:
        return "all markers"
    return " and ".join(filter(None, [", ".join(listed[:-1]), listed[-1]]))


def _rows(rows: NDArray[np.intp], time_s: Array) -> str:
    """Rows in words, counted as in the trial's file: its header is row 1."""
    first, last = int(rows[0]), int(rows[-1])
    if first == last:
        return f"in row {first + 2} ({time_s[first]:.2f} s)"
    of = "" if len(rows) == last - first + 1 else f"{len(rows)} of the "
    return f"in {of}rows {first + 2} to {last + 2} ({time_s[first]:.2f} s to {time_s[last]:.2f} s)"


def _phase(trial: Trial) -> list[ImportFinding]:
    """Finding if joint 2 leads joint 1 by another phase than the conditions state."""
    meta = trial.meta
    if meta.dof != 2 or meta.motion != "sinusoid":
        return []
    # The second half of the first cycle and the first half of the second: joint 2 is faded in.
    start_s = trial.time_s[min(meta.rest_samples, len(trial) - 1)] + 0.5 * meta.period_s
    cycle = (trial.time_s >= start_s) & (trial.time_s < start_s + meta.period_s)
    if trial.time_s[-1] < start_s + 0.9 * meta.period_s or cycle.sum() < 8:
        return []
    turn = 2 * np.pi * (trial.time_s[cycle] - start_s) / meta.period_s
    design = np.column_stack([np.ones_like(turn), np.sin(turn), np.cos(turn)])
    phases = []
    for goal in trial.goal_rad[cycle].T:
        terms, *_ = np.linalg.lstsq(design, goal, rcond=None)
        left = np.var(goal - design @ terms)
        if np.std(goal) < LEAST_MOTION_RAD or left > (1 - SINUSOIDAL) * np.var(goal):
            return []
        phases.append(np.arctan2(terms[2], terms[1]))
    lead = float(phases[1] - phases[0])
    off = float(np.angle(np.exp(1j * (lead - meta.phase_2_rad))))
    if abs(off) <= PHASE_RAD:
        return []
    shown = float(np.angle(np.exp(1j * (lead + 1e-9))))
    return [
        ImportFinding(
            "warning", "phase",
            f"goal 2 leads goal 1 by {ANGLE.text(shown, 0)}, phase_2_rad says "
            f"{ANGLE.text(meta.phase_2_rad, 0)}",
            f"set phase_2_rad = {shown:.4g} under [trial], or correct the sign of a goal",
        )
    ]  # fmt: skip
