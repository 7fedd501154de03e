"""Assembly of series with different sample times into a trial with one uniform step.

The rows are the samples of the servo if they have the trial's step: a goal belongs to the sample
after which it was sent, and a row between two samples would combine an angle and a goal from times
up to half a step apart. Markers move smoothly and may be interpolated, goals may not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from firmware_py.core.errors import InputError
from firmware_py.core.input_files import MOST_CELLS
from firmware_py.core.signals import TIME, joint_signals, tip_names
from firmware_py.link.marker_layout import MarkerLayout
from models.trials.files import STEP_TOLERANCE, columns_of
from models.trials.recordings.mapping import RecordingMap
from models.trials.recordings.series import Series, marker_columns, row_centre_m
from models.trials.trial import Array, Trial, motion_start, rows_at_rest

LONGEST_TIP_GAP_S: Final = 0.1
"""Longest gap over which an occluded tip is interpolated; the motion is below 4 Hz."""


def assemble_trial(series: list[Series], mapping: RecordingMap, name: str) -> Trial:
    """Resample all series over their common time, and make a trial of them.

    Angles, currents and positions are interpolated linearly, goals are constant until the next one.
    Without motion capture, tip and markers stay empty.
    """
    where, layout, step_s = series[0].path, mapping.layout, mapping.step_s
    if not mapping.signals:
        series = [_with_tip(s, layout) for s in _goals_at_samples(series, step_s)]
    source = {column: s for s in series for column in s.columns}
    whole = columns_of(mapping.dof, mapping.signals, layout.count)[1:]
    needed = [s.name for s in (whole if mapping.signals else joint_signals(mapping.dof))]
    for column in (n for n in needed if n not in source):
        extra = ", the angle's column if goals were not logged" if "goal" in column else ""
        remedy = f"map it under [columns] or [topics] in MAP.toml{extra}, or merge it with --servo"
        raise InputError(where, f"nothing holds {column}", remedy)
    used = list({id(s): s for s in source.values()}.values())
    names = list(dict.fromkeys([*(signal.name for signal in whole), *source]))
    goals = [n for n in names if mapping.is_goal(n)]
    grid_s, in_phase = _rows_of(source, used, goals, step_s, MOST_CELLS // (1 + len(names)))
    # A goal stamped up to half a step after a row's time was sent just after it.
    goals_s = grid_s + 0.5 * step_s if in_phase or len(used) > 1 else grid_s
    columns: dict[str, Array] = {TIME.name: grid_s - grid_s[0]}
    for column in names:
        columns[column] = np.full(len(grid_s), np.nan)
        if owner := source.get(column):
            hold = column in goals
            at_s = goals_s if hold else grid_s
            columns[column] = resample(owner.time_s, owner.columns[column], at_s, hold=hold)
    for tip in (n for n in tip_names() if n in columns):
        columns[tip] = _fill_short_gaps(where, columns[tip], step_s)
    for column in needed:
        empty = np.isnan(columns[column])
        if empty.any():
            at_s = columns[TIME.name][empty][0]
            what = f"{column} was not measured at {at_s:.3f} s"
            raise InputError(where, what, "cut the gap out")
    rest = rows_at_rest(np.column_stack([columns[n] for n in goals])) if goals else 0
    duration_s = float(grid_s[-1] - grid_s[0])
    trial = Trial(name, mapping.meta(min(rest, len(grid_s) - 1), duration_s), columns)
    if mapping.signals or "rest_samples" in mapping.trial:
        return trial
    return replace(trial, meta=mapping.meta(motion_start(trial), duration_s))


def _goals_at_samples(series: list[Series], step_s: float) -> list[Series]:
    """Set goals from another log to the times of the samples after which they were sent.

    A goal stamped within a period after a sample belongs to the row of that sample, if it is the
    only one.
    """
    sampled_s = next((s.time_s for s in series if "angle_1_rad" in s.columns), None)

    def at_samples(s: Series) -> Series:
        is_goals = s.columns and all(name.startswith("goal") for name in s.columns)
        if sampled_s is None or not is_goals:
            return s
        before = np.searchsorted(sampled_s, s.time_s, side="right") - 1
        row = np.maximum(before, 0)
        close = (before >= 0) & (s.time_s - sampled_s[row] < (1 - STEP_TOLERANCE) * step_s)
        alone = np.bincount(row, minlength=len(sampled_s))[row] == 1
        moved_s = np.where(close & alone, sampled_s[row], s.time_s)
        return replace(s, time_s=moved_s) if np.all(np.diff(moved_s) > 0) else s

    return [at_samples(s) for s in series]


def _with_tip(series: Series, layout: MarkerLayout) -> Series:
    """Series with the centre of the last marker row as tip, if it has no tip."""
    names = layout.row(-1)
    if "tip_x_m" in series.columns or not series.has(*names):
        return series
    tip_m = row_centre_m(series.positions_m(names), layout)
    return replace(series, columns=series.columns | marker_columns({"tip": tip_m}))


# --- times of the rows ---------------------------------------------------------------------------

_IN_PHASE: Final = 0.7
"""Mean resultant length of the samples' phases (0 for uniform, 1 for equal phases) above which
samples have the step [assumed]. It is 0.76 for phases spread evenly over a fifth of a step to both
sides."""
_LEAST_CHANGES: Final = 20
"""Fewest changes of a goal that determine in which steps it was sent."""
_SAME: Final = 1e-6
"""Fraction of a step within which two times are equal."""


def _rows_of(
    source: dict[str, Series], used: list[Series], goals: list[str], step_s: float, most_rows: int
) -> tuple[Array, bool]:
    """`time_grid` over the common time, by the samples of goals, angles, or the only series."""
    start_s = max(s.time_s[0] for s in used)
    end_s = min(s.time_s[-1] for s in used)
    if (end_s - start_s) / step_s > most_rows:
        raise InputError(
            used[0].path,
            f"lasts {end_s - start_s:.3g} s, more than {most_rows} steps of {step_s} s",
            "check the times and their units, set step_s, or divide the recording",
        )
    names = [n for n in (*goals, "angle_1_rad") if n in source]
    signals = [(source[n].time_s, source[n].columns[n]) for n in names]
    if len(used) == 1:
        signals.append((used[0].time_s, used[0].time_s))
    grid_s, in_phase = time_grid(start_s, end_s, step_s, signals)
    if len(grid_s) < 3:
        what = f"lasts {end_s - start_s:.3g} s, less than three steps of {step_s} s"
        if len(used) > 1:
            what = f"shares no time with {used[-1].path}"
        raise InputError(used[0].path, what, "check the times, their units and --offset")
    return grid_s, in_phase


def time_grid(
    start_s: float, end_s: float, step_s: float, signals: Sequence[tuple[Array, Array]]
) -> tuple[Array, bool]:
    """Times of the rows, and whether goals were sampled or sent at them, apart from jitter.

    Samples with exactly the step become the rows. Otherwise the grid is even. Its phase comes from
    samples with about that step (jitter or lost samples), or from goals that were logged finely
    and sent in that step; else the grid passes through a sample of the last signal.

    `signals` are times and values of goals, then angles; without any, the grid begins at `start_s`.
    """
    slack_s = _SAME * step_s

    def shared(time_s: Array) -> Array:
        return time_s[(time_s >= start_s - slack_s) & (time_s <= end_s + slack_s)]

    sampled = [shared(time_s) for time_s, _ in signals]
    changed = [shared(time_s[1:][np.abs(np.diff(values)) > 0]) for time_s, values in signals]
    for time_s in sampled:
        if len(time_s) > 2 and np.all(np.abs(np.diff(time_s) - step_s) <= STEP_TOLERANCE * step_s):
            return time_s, True
    for time_s in (t for t in [*sampled, *changed] if len(t) >= _LEAST_CHANGES):
        phases = np.exp(2j * np.pi * ((time_s - start_s) % step_s) / step_s)
        if abs(phases.mean()) >= _IN_PHASE:
            apart = np.abs(np.angle(phases / phases.mean()))
            nearest = int(np.argmax(apart <= apart.min() + _SAME))
            return _even(time_s[nearest], start_s, end_s, step_s), True
    through_s = float(sampled[-1][0]) if sampled and len(sampled[-1]) else start_s
    return _even(through_s, start_s, end_s, step_s), False


def _even(through_s: float, start_s: float, end_s: float, step_s: float) -> Array:
    """Even grid through a time, between the first and the last time."""
    first_s = through_s - step_s * np.floor((through_s - start_s) / step_s + _SAME)
    count = int(np.floor((end_s - first_s) / step_s + _SAME)) + 1
    return np.asarray(np.clip(first_s + step_s * np.arange(count), start_s, end_s))


# --- values in the rows --------------------------------------------------------------------------


def resample(time_s: Array, values: Array, grid_s: Array, *, hold: bool = False) -> Array:
    """Values (n,) at the times of a grid (m,), interpolated linearly; NaN next to NaN.

    With `hold` the last value applies. A grid time that coincides with a sample gets that sample.
    """
    before = np.clip(np.searchsorted(time_s, grid_s, side="right") - 1, 0, len(time_s) - 2)
    fraction = (grid_s - time_s[before]) / (time_s[before + 1] - time_s[before])
    if hold:
        return np.asarray(np.where(fraction < 1, values[before], values[before + 1]))
    mixed = values[before] + fraction * (values[before + 1] - values[before])
    return np.select([fraction == 0, fraction == 1], [values[before], values[before + 1]], mixed)


def _fill_short_gaps(where: Path, values: Array, step_s: float) -> Array:
    """Fill short gaps of the tip linearly and refuse long ones; an empty column stays empty."""
    known = np.flatnonzero(np.isfinite(values))
    if not len(known):
        return values
    gaps_s = step_s * (np.diff([-1, *known, len(values)]) - 1)
    longest = int(np.argmax(gaps_s))
    if gaps_s[longest] > LONGEST_TIP_GAP_S:
        at_s = [0, *known][longest] * step_s
        raise InputError(
            where,
            f"the tip is unseen for {gaps_s[longest]:.2f} s from {at_s:.2f} s on",
            "cut the recording there or map a marker at the tip as 'tip'",
        )
    return np.asarray(np.interp(np.arange(len(values)), known, values[known]))
