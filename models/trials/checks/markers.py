"""Markers over a run: absent, occluded, moving at rest, constant, exchanged or out of place.

Distances between markers of a section, and to the next one, are compared with those at rest: a
section keeps its shape, and the bend to its neighbours is small. On every rig, with each effect and
a load that nearly folds the link, distances change by less than 3 % (7 % on a link with another
payload). Two exchanged markers of a square section change them by 29 % and more.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from models.shared.kinematics import base_rotation
from models.trials.checks import causes
from models.trials.checks.causes import ImportFinding, at_rows
from models.trials.checks.pose import nearest_order, order_words, visible_mean
from models.trials.recordings.frames import fit_rigid_motion, nominal_markers_m
from models.trials.recordings.mapping import RecordingMap
from models.trials.recordings.series import Series
from models.trials.trial import Array, Trial, TrialMeta

Rows = NDArray[np.intp]


def judge_markers(series: Sequence[Series], mapping: RecordingMap) -> list[ImportFinding]:
    """Findings on markers that are mapped but absent, or occluded most of the time."""
    columns = {name: values for s in series for name, values in s.columns.items()}
    markers = mapping.layout.names
    present = [n for n in (*markers, "tip") if f"{n}_x_m" in columns]
    if not present:
        return []
    findings: list[ImportFinding] = []
    for name, source in mapping.markers.items():
        if f"{name}_x_m" not in columns:
            findings += causes.ABSENT_MARKER.raised(name=name, source=source)
    missing = [n for n in markers if n not in present and n not in mapping.markers]
    if missing and present != ["tip"]:
        findings += causes.NOT_MAPPED.raised(names=missing)
    for name in present:
        occluded = float(np.mean(~np.isfinite(columns[f"{name}_x_m"])))
        findings += causes.OCCLUDED.beyond(occluded, name=name)
    return findings


def judge_rest(trial: Trial) -> list[ImportFinding]:
    """Findings on the rest rows of a trial with markers."""
    markers_m, rest = trial.markers_m, trial.meta.rest_samples
    if not np.isfinite(markers_m).any():
        return []
    warned, refused = causes.REST_ROWS
    if rest < warned:
        return [causes.SHORT_REST.at("refused" if rest < refused else "warning", rest=rest)]
    third = max(rest // 3, 1)
    moved_m = visible_mean(markers_m[rest - third : rest]) - visible_mean(markers_m[:third])
    most_m = np.nan_to_num(np.linalg.norm(moved_m, axis=-1)).max()
    return causes.REST_MOVES.beyond(float(most_m), rest=rest)


def without_zeros(
    series: list[Series], names: Iterable[str], zero_m: Array
) -> tuple[list[Series], list[ImportFinding]]:
    """Set markers at exactly zero (`zero_m`, shape (3,)) to NaN, with a finding that counts them.

    A marker that is never elsewhere is unchanged.
    """
    counts: dict[str, int] = {}
    times_s: list[Array] = []
    result = []
    for s in series:
        columns = dict(s.columns)
        for name in filter(s.has, names):
            zero = (s.position_m(name) == zero_m).all(axis=1)
            if zero.any() and np.isfinite(columns[f"{name}_x_m"][~zero]).any():
                for column in (f"{name}_{axis}_m" for axis in "xyz"):
                    columns[column] = np.where(zero, np.nan, columns[column])
                counts[name] = int(zero.sum())
                times_s.append(s.time_s[zero])
        result.append(replace(s, columns=columns))
    if not counts:
        return series, []
    zeros_s = np.concatenate(times_s)
    return result, causes.ZEROS.raised(
        first_s=zeros_s.min(),
        last_s=zeros_s.max(),
        counts=[f"{n} in {k}" for n, k in counts.items()],
    )


MOST_NAMED: Final = 4
"""Most findings of one cause that are listed, the longest first."""


def judge_marker_run(trial: Trial) -> list[ImportFinding]:
    """Findings on markers that hold, exchange or leave their positions during a trial."""
    markers_m, names, time_s = trial.markers_m, trial.meta.layout.names, trial.time_s
    if not np.isfinite(markers_m).any():
        return []
    findings: list[ImportFinding] = []
    holds = constant_markers(trial)
    for (first, last), moved_m in sorted(holds.items(), key=lambda hold: hold[0][0] - hold[0][1]):
        places, whole = list(moved_m), len(moved_m) == len(names)
        markers_m[first : last + 1, places] = np.nan
        findings += causes.HELD.raised(
            names=["all markers"] if whole else [names[k] for k in places],
            rows=at_rows(np.arange(first, last + 1), time_s),
            meanwhile="the link moves" if whole else "the neighbours move",
            moved_m=max(moved_m.values()),
        )  # fmt: skip
    return findings[:MOST_NAMED] + _misplaced(trial, markers_m)


# --- constant positions --------------------------------------------------------------------------

LEAST_S: Final = 0.1
"""Shortest hold that is reported; a capture at 10 Hz, held to the trial's step, is shorter."""
MOVED_M: Final = 0.02
"""Travel of the neighbours, and of the marker on a rigid link, above which a hold is wrong; a clock
error of 20 ms moves the tip of the study's motion by 14 mm."""
ALL_MOVED_M: Final = 0.06
"""The same, from the joint angles alone, if every marker holds its position."""
MOST_HOLDS: Final = 100
"""Number of the longest holds of a marker that are checked."""


def constant_markers(trial: Trial) -> dict[tuple[int, int], dict[int, float]]:
    """Holds of markers that contradict the link's motion.

    By the first and last row of a hold, the markers with the travel that was due in m: that of
    their neighbours, or by the joint angles.
    """
    markers_m, time_s = trial.markers_m, trial.time_s
    same = np.all(np.abs(np.diff(markers_m, axis=0)) <= 1e-9, axis=2)  # a rotated frame rounds
    due_m: dict[tuple[int, int], dict[int, float]] = {}
    for place in range(markers_m.shape[1]):
        edges = np.diff(np.concatenate([[0], same[:, place].astype(int), [0]]))
        holds = np.column_stack([np.flatnonzero(edges > 0), np.flatnonzero(edges < 0)])
        holds = holds[(np.ptp(holds, axis=1) > 3) & (np.ptp(time_s[holds], axis=1) >= LEAST_S)]
        longest = np.argsort(-np.ptp(holds, axis=1), kind="stable")[:MOST_HOLDS]
        for first, last in holds[longest].tolist():
            moved_m = _due_travel_m(trial, markers_m, same, place, slice(first, last + 1))
            if moved_m > MOVED_M:
                due_m.setdefault((first, last), {})[place] = moved_m
    return due_m


def _due_travel_m(trial: Trial, markers_m: Array, same: Array, place: int, rows: slice) -> float:
    """Travel of a marker that is expected while it holds; 0 if it may have been at rest."""
    turn, start_m = base_rotation(trial.angle_rad[rows]), markers_m[rows.start, place]
    carried_m = turn @ (turn[0].T @ start_m) - start_m
    rigid_m = float(np.linalg.norm(carried_m, axis=1).max())
    moving = ~same[rows.start : rows.stop - 1].all(axis=0)
    free = np.flatnonzero(moving & np.isfinite(markers_m[rows.start, :, 0]))
    if rigid_m < MOVED_M or not len(free):
        return rigid_m if rigid_m > ALL_MOVED_M else 0.0
    distance_m = np.linalg.norm(markers_m[rows.start, free] - start_m, axis=1)
    near = free[np.argsort(distance_m, kind="stable")[:3]]
    apart_m = np.linalg.norm(markers_m[rows, near] - markers_m[rows.start, near], axis=2)
    return float(np.median(np.fmax.reduce(apart_m, axis=0)))


# --- wrong distances -----------------------------------------------------------------------------

IN_SECTION: Final = 0.15
"""Relative change above which a distance within a section is wrong: ten times the rigs' largest."""
TO_NEXT: Final = 0.25
"""The same between neighbouring sections: a bend of half a radian in a quarter of the link."""
MOST_STRETCHES: Final = 50
"""Number of the longest stretches that are checked one by one; all others are checked as one."""
ROWS_AT_ONCE: Final = 2000
"""Most rows whose distances are in memory, and most of a stretch that name its markers."""


class _Distances:
    """Pairs of markers, their distances at rest and the limits of change."""

    def __init__(self, meta: TrialMeta, markers_m: Array) -> None:
        first, second = np.triu_indices(meta.layout.count, 1)
        sections_apart = second // meta.layout.corners - first // meta.layout.corners
        near = sections_apart <= 1
        self.first, self.second = first[near], second[near]
        at_rest_m = visible_mean(self.of(markers_m[: min(max(meta.rest_samples, 1), ROWS_AT_ONCE)]))
        nominal_m = self.of(nominal_markers_m(meta)[None])[0]
        self.rest_m = np.where(np.isfinite(at_rest_m), at_rest_m, nominal_m)
        part = np.where(sections_apart[near] == 0, IN_SECTION, TO_NEXT)
        self.limit_m = np.maximum(part * self.rest_m, 0.01)  # a centimetre is never wrong

    def of(self, markers_m: Array) -> Array:
        """Distances, shape (n, pairs); NaN if a marker is occluded."""
        apart_m = markers_m[:, self.first] - markers_m[:, self.second]
        return np.asarray(np.linalg.norm(apart_m, axis=2))

    def changes_m(self, markers_m: Array) -> Array:
        """Changes of the distances, shape (n, pairs); 0 if a marker is occluded."""
        return np.asarray(np.nan_to_num(np.abs(self.of(markers_m) - self.rest_m)))

    def are_right(self, markers_m: Array) -> NDArray[np.bool_]:
        """Whether no distance is wrong, by row."""
        parts = np.array_split(markers_m, len(markers_m) // ROWS_AT_ONCE + 1)
        right = [(self.changes_m(part) <= self.limit_m).all(axis=1) for part in parts]
        return np.concatenate(right)


def _misplaced(trial: Trial, markers_m: Array) -> list[ImportFinding]:
    """Findings on markers, (n, markers, 3), whose distances to neighbours are wrong.

    The same markers in several stretches of rows are one finding.
    """
    layout, names = trial.meta.layout, trial.meta.layout.names
    distances = _Distances(trial.meta, markers_m)
    right = distances.are_right(markers_m)
    wrong = np.flatnonzero(~right)
    if not len(wrong):
        return []
    stretches = np.split(wrong, np.flatnonzero(np.diff(wrong) > 6) + 1)
    stretches.sort(key=len, reverse=True)
    if rest := stretches[MOST_STRETCHES:]:
        stretches[MOST_STRETCHES:] = [np.sort(np.concatenate(rest))]
    faults: dict[causes.Cause, dict[str, tuple[Rows, float]]] = {
        causes.EXCHANGED: {}, causes.OUT_OF_PLACE: {},
    }  # fmt: skip
    for rows in stretches:
        order = _exchange(distances, markers_m, right, rows)
        if order is not None:
            cause, what, off_m = causes.EXCHANGED, order_words(names, order, layout), 0.0
        else:
            worst, off_m = _worst(distances, markers_m, rows)
            cause, what = causes.OUT_OF_PLACE, causes.listed([names[k] for k in worst])
        known, known_m = faults[cause].get(what, (rows, 0.0))
        faults[cause][what] = np.union1d(known, rows), max(known_m, off_m)
    findings: list[ImportFinding] = []
    for cause, by_markers in faults.items():
        longest = sorted(by_markers.items(), key=lambda fault: -len(fault[1][0]))
        for what, (rows, off_m) in longest[:MOST_NAMED]:
            where = at_rows(rows, trial.time_s)
            findings += cause.raised(what=what, rows=where, off_m=off_m)
    return findings


def _sample(rows: Rows, count: int) -> Rows:
    every = np.linspace(0, len(rows) - 1, min(len(rows), count)).astype(int)
    return np.asarray(rows[every])


def _exchange(
    distances: _Distances, markers_m: Array, right: NDArray[np.bool_], rows: Rows
) -> Rows | None:
    """Order of the markers, by the nearest right row, that corrects nine rows in ten of a stretch.

    None if there is none.
    """
    first_m = markers_m[rows[0]]
    visible = np.flatnonzero(np.isfinite(first_m).all(axis=1))
    complete = np.isfinite(markers_m[:, visible]).all(axis=(1, 2))
    comparable = np.flatnonzero(right & complete)
    if not len(comparable) or len(visible) < 4:
        return None
    before_m = markers_m[comparable[np.argmin(np.abs(comparable - rows[0]))], visible]
    start, _ = fit_rigid_motion(before_m, first_m[visible])
    order = np.arange(len(first_m))
    order[visible] = visible[nearest_order(first_m[visible], before_m, start)]
    corrected_m = markers_m[_sample(rows, 15)][:, np.argsort(order)]
    return order if distances.are_right(corrected_m).mean() >= 0.9 else None


def _worst(distances: _Distances, markers_m: Array, rows: Rows) -> tuple[list[int], float]:
    """Markers without which no distance of a stretch is wrong, and the largest change in m.

    Distances count that are wrong in a fifth of the rows. Of markers with as many of them, all are
    named.
    """
    changes_m = distances.changes_m(markers_m[_sample(rows, ROWS_AT_ONCE)])
    part = (changes_m > distances.limit_m).mean(axis=0)
    wrong = np.zeros((markers_m.shape[1],) * 2, dtype=bool)
    wrong[distances.first, distances.second] = part >= min(0.2, part.max())
    wrong |= wrong.T
    named = np.zeros(len(wrong), dtype=bool)
    while wrong.any():
        count = wrong.sum(axis=1)
        worst = count == count.max()
        named |= worst
        wrong[worst], wrong[:, worst] = False, False
    return np.flatnonzero(named).tolist(), float(changes_m.max())
