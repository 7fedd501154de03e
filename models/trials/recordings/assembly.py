"""Assembly of series, each on its own sample times, into a trial with one uniform step.

The rows are the servo's own samples if they have the trial's step: a goal belongs to the sample
after which it was sent, and a row between two samples would combine an angle and a goal from times
up to half a step apart. Markers move smoothly and may be interpolated, goals may not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from firmware_py.errors import InputError
from firmware_py.files.input_files import MOST_CELLS
from firmware_py.link.marker_layout import MarkerLayout
from firmware_py.signals import TIME, joint_signals, tip_names
from models.trials.files import STEP_TOLERANCE, columns_of
from models.trials.recordings.mapping import RecordingMap
from models.trials.recordings.series import Series, marker_columns, row_centre_m
from models.trials.trial import Array, Trial, motion_start, rows_at_rest

LONGEST_TIP_GAP_S: Final = 0.1
"""Longest gap over which an occluded tip is interpolated; the motion is below 4 Hz."""


def assemble_trial(series: list[Series], mapping: RecordingMap, name: str) -> Trial:
    """Resample all series over their common time, and make a trial of them.

    Angles, currents and positions are interpolated linearly, goals are held. Without motion
    capture, tip and markers stay empty.
    """
    where = series[0].path
    series = _goals_at_samples(series, mapping)
    layout = mapping.layout
    source = {column: s for own in series for s in [_with_tip(own, layout)] for column in s.columns}
    whole = columns_of(mapping.dof, mapping.signals, layout.count)[1:]
    needed = whole if mapping.signals else joint_signals(mapping.dof)
    _check_complete(where, source, [signal.name for signal in needed])
    used = list({id(s): s for s in source.values()}.values())
    names = list(dict.fromkeys([*(signal.name for signal in whole), *source]))
    goals = [n for n in names if mapping.is_goal(n)]
    grid = _rows_of(source, used, goals, mapping.step_s, MOST_CELLS // (1 + len(names)))
    grid_s = grid.time_s
    columns: dict[str, Array] = {TIME.name: grid_s - grid_s[0]}
    for column in names:
        if column not in source:
            columns[column] = np.full(len(grid_s), np.nan)
            continue
        owner, hold = source[column], column in goals
        # A goal stamped up to half a step after a row's time was sent just after it.
        after = hold and (grid.in_phase or len(used) > 1)
        at_s = grid_s + 0.5 * mapping.step_s if after else grid_s
        columns[column] = resample(owner.time_s, owner.columns[column], at_s, hold=hold)
    for tip in (n for n in tip_names() if n in columns):
        columns[tip] = _fill_short_gaps(where, columns[tip], mapping.step_s)
    for signal in needed:
        if np.isnan(columns[signal.name]).any():
            at_s = columns[TIME.name][np.isnan(columns[signal.name])][0]
            raise InputError(
                where, f"{signal.name} was not measured at {at_s:.3f} s", "cut the gap out"
            )
    rest = rows_at_rest(np.column_stack([columns[n] for n in goals])) if goals else 0
    duration_s = float(grid_s[-1] - grid_s[0])
    trial = Trial(name, mapping.meta(min(rest, len(grid_s) - 1), duration_s), columns)
    if mapping.signals or "rest_samples" in mapping.trial:
        return trial
    return replace(trial, meta=mapping.meta(motion_start(trial), duration_s))


def _goals_at_samples(series: list[Series], mapping: RecordingMap) -> list[Series]:
    """Give goals from another log the times of the samples after which they were sent.

    A goal stamped within a period after a sample belongs to the row of that sample.
    """
    sampled = next((s.time_s for s in series if "angle_1_rad" in s.columns), None)
    if sampled is None or mapping.signals:
        return series
    return [
        replace(s, time_s=_sent_after(s.time_s, sampled, mapping.step_s))
        if s.columns and all(name.startswith("goal") for name in s.columns)
        else s
        for s in series
    ]


def _sent_after(goal_s: Array, sampled_s: Array, step_s: float) -> Array:
    """Times of the samples before goals, if exactly one goal follows a sample within a period."""
    before = np.searchsorted(sampled_s, goal_s, side="right") - 1
    sample_s = sampled_s[np.maximum(before, 0)]
    close = (before >= 0) & (goal_s - sample_s < (1 - STEP_TOLERANCE) * step_s)
    alone = np.bincount(np.maximum(before, 0), minlength=len(sampled_s))[np.maximum(before, 0)] == 1
    moved_s = np.where(close & alone, sample_s, goal_s)
    return moved_s if np.all(np.diff(moved_s) > 0) else goal_s


def _with_tip(series: Series, layout: MarkerLayout) -> Series:
    """Series with the centre of the last marker row as tip, if it has no tip."""
    names = layout.row(-1)
    if "tip_x_m" in series.columns or not all(map(series.has, names)):
        return series
    tip_m = row_centre_m(np.array([series.position_m(n) for n in names]), layout.corners_m)
    return replace(series, columns=series.columns | marker_columns({"tip": tip_m}))


def _check_complete(where: Path, present: dict[str, Series], needed: list[str]) -> None:
    for name in needed:
        if name not in present:
            extra = ", the angle's column if goals were not logged" if "goal" in name else ""
            raise InputError(
                where,
                f"nothing holds {name}",
                f"map it under [columns] or [topics] in MAP.toml{extra}, or merge it with --servo",
            )


# --- times of the rows ---------------------------------------------------------------------------

_IN_PHASE: Final = 0.7
"""Mean resultant length of the samples' phases (0 for uniform, 1 for equal phases) above which
samples have the step [assumed]. It is 0.76 for phases spread evenly over a fifth of a step to both
sides."""
_LEAST_CHANGES: Final = 20
"""Fewest changes of a goal that determine in which steps it was sent."""
_SAME: Final = 1e-6
"""Fraction of a step within which two times are equal."""


class TimeGrid(NamedTuple):
    """Times of the rows."""

    time_s: Array  # Times on the clock of the samples, (rows,)
    in_phase: bool  # Whether goals were sampled or sent at these times, apart from jitter


def _rows_of(
    source: dict[str, Series], used: list[Series], goals: list[str], step_s: float, most_rows: int
) -> TimeGrid:
    """Times of the rows, aligned with the samples of goals and angles, or of the only series."""
    start_s = max(s.time_s[0] for s in used)
    end_s = min(s.time_s[-1] for s in used)
    if (end_s - start_s) / step_s > most_rows:
        raise InputError(
            used[0].path,
            f"lasts {end_s - start_s:.3g} s, more than {most_rows} steps of {step_s} s",
            "check the times and their units, set step_s, or divide the recording",
        )  # fmt: skip
    names = [n for n in (*goals, "angle_1_rad") if n in source]
    signals = [(source[n].time_s, source[n].columns[n]) for n in names]
    if len(used) == 1:
        signals.append((used[0].time_s, used[0].time_s))
    grid = time_grid(start_s, end_s, step_s, signals)
    if len(grid.time_s) < 3:
        raise InputError(
            used[0].path,
            f"shares no time with {used[-1].path}"
            if len(used) > 1
            else f"lasts {end_s - start_s:.3g} s, less than three steps of {step_s} s",
            "check the times, their units and --offset",
        )
    return grid


def time_grid(
    start_s: float, end_s: float, step_s: float, signals: Sequence[tuple[Array, Array]]
) -> TimeGrid:
    """Rows from a first to a last time, on the samples of the first signal that has the step.

    Samples with exactly that step become the rows. Otherwise the grid is even. Its phase comes from
    samples with about that step (jitter or lost samples), or from goals that were logged finely
    and sent in that step; else the grid passes through a sample of the last signal.

    `signals` are times and values of goals, then angles; without any, the grid begins at `start_s`.
    """
    slack_s = _SAME * step_s

    def shared(time_s: Array) -> Array:
        return time_s[(time_s >= start_s - slack_s) & (time_s <= end_s + slack_s)]

    sampled = [shared(time_s) for time_s, _ in signals]
    changed = [shared(time_s[1:][np.abs(np.diff(values)) > 0]) for time_s, values in signals]
    for own_s in sampled:
        if len(own_s) > 2 and np.all(np.abs(np.diff(own_s) - step_s) <= STEP_TOLERANCE * step_s):
            return TimeGrid(own_s, in_phase=True)
    for times_s in (t for t in [*sampled, *changed] if len(t) >= _LEAST_CHANGES):
        phases = np.exp(2j * np.pi * ((times_s - start_s) % step_s) / step_s)
        if abs(phases.mean()) >= _IN_PHASE:
            apart = np.abs(np.angle(phases / phases.mean()))
            nearest = int(np.argmax(apart <= apart.min() + _SAME))
            return TimeGrid(_even(times_s[nearest], start_s, end_s, step_s), in_phase=True)
    through_s = float(sampled[-1][0]) if sampled and len(sampled[-1]) else start_s
    return TimeGrid(_even(through_s, start_s, end_s, step_s), in_phase=False)


def _even(through_s: float, start_s: float, end_s: float, step_s: float) -> Array:
    """Even grid through a time, between the first and the last time."""
    first_s = through_s - step_s * np.floor((through_s - start_s) / step_s + _SAME)
    count = int(np.floor((end_s - first_s) / step_s + _SAME)) + 1
    return np.asarray(np.clip(first_s + step_s * np.arange(count), start_s, end_s))


# --- values in the rows --------------------------------------------------------------------------


def resample(time_s: Array, values: Array, grid_s: Array, *, hold: bool = False) -> Array:
    """Values (n,) at the times of a grid (m,), interpolated linearly or held; NaN next to NaN.

    A grid time that coincides with a sample gets exactly that sample.
    """
    before = np.clip(np.searchsorted(time_s, grid_s, side="right") - 1, 0, len(time_s) - 2)
    fraction = (grid_s - time_s[before]) / (time_s[before + 1] - time_s[before])
    if hold:
        return np.asarray(np.where(fraction < 1, values[before], values[before + 1]))
    mixed = values[before] + fraction * (values[before + 1] - values[before])
    return np.select([fraction == 0, fraction == 1], [values[before], values[before + 1]], mixed)


def _fill_short_gaps(where: Path, values: Array, step_s: float) -> Array:
    """Fill short gaps linearly and refuse long ones; an empty column stays empty."""
    seen = np.isfinite(values)
    if seen.all() or not seen.any():
        return values
    rows = np.arange(len(values))
    known = np.flatnonzero(seen)
    gaps = np.diff(np.concatenate([[-1], known, [len(values)]])) - 1
    if gaps.max() * step_s > LONGEST_TIP_GAP_S:
        at_s = np.concatenate([[0], known])[int(np.argmax(gaps))] * step_s
        raise InputError(
            where,
            f"the tip is unseen for {gaps.max() * step_s:.2f} s from {at_s:.2f} s on",
            "cut the recording there or map a marker at the tip as 'tip'",
        )
    return np.asarray(np.interp(rows, known, values[known]))
