"""Times of a trial's rows: the servo's own samples if they have the trial's step.

A goal belongs to the sample after which it was sent. A row between two samples would combine an
angle and a goal from times up to half a step apart. Markers move smoothly and may be interpolated,
goals may not.

Assembly of series, each on its own sample times, into a trial with one uniform step.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from firmware_py.errors import InputError
from firmware_py.files.input_files import MOST_CELLS
from firmware_py.link.marker_layout import MarkerLayout, square_corners_m
from firmware_py.signals import TIME, joint_signals, tip_names
from models.shared.kinematics import base_rotation
from models.trials.files import STEP_TOLERANCE, columns_of
from models.trials.recordings.frame import fit_rigid_motion, nominal_markers_m
from models.trials.recordings.mapping import BASE_MARKERS, RecordingMap
from models.trials.recordings.series import Series, marker_columns, row_centre_m
from models.trials.trial import Array, Trial, motion_start, rows_at_rest

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


LONGEST_TIP_GAP_S: Final = 0.1
"""Longest gap over which an occluded tip is interpolated; the motion is below 4 Hz."""

REST_RANGE_M: Final = 3e-3
"""Largest displacement of a marker at rest."""


def assemble_trial(series: list[Series], mapping: RecordingMap, name: str) -> Trial:
    """Resample all series over their common time, and make a trial of them.

    Angles, currents and positions are interpolated linearly, goals are held. Goals and angles that
    already have the step keep their samples (`models.trials.recordings.assembly`). Without motion
    capture, tip and markers stay empty.
    """
    where = series[0].path
    series = _goals_at_samples(series, mapping)
    layout = mapping.layout
    source = {column: s for own in series for s in [_with_tip(own, layout)] for column in s.columns}
    whole = columns_of(mapping.dof, mapping.signals, layout.count)[1:]
    needed = whole if mapping.signals else joint_signals(mapping.dof)
    _check_complete(where, list(source), [signal.name for signal in needed])
    used = list({id(s): s for s in source.values()}.values())
    contract = [signal.name for signal in whole]
    width = 1 + len({*contract, *source})  # columns of the trial, with those not measured
    goals = [n for n in (*contract, *source) if mapping.is_goal(n)]
    grid = _grid(source, used, goals, mapping.step_s, MOST_CELLS // width)
    grid_s = grid.time_s
    columns: dict[str, Array] = {TIME.name: grid_s - grid_s[0]}
    for column in dict.fromkeys([*contract, *source]):
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


def align_markers(
    series: list[Series], mapping: RecordingMap, rest_rad: Array | None = None
) -> list[Series]:
    """Move the markers onto the nominal robot, by rest pose or base as the map says.

    `rest_rad` (dof,) are the joint angles at rest.
    """
    if mapping.frame.align == "none":
        return series
    turn = np.eye(3) if rest_rad is None else base_rotation(np.atleast_2d(rest_rad))[0]
    return [_align_series(s, mapping, turn) if "m01_x_m" in s.columns else s for s in series]


def rest_count(series: Series, names: Sequence[str]) -> int:
    """Number of leading samples in which no marker has moved, at least one."""
    rest = len(series.time_s)
    for column in (series.columns[f"{name}_{axis}_m"][:rest] for name in names for axis in "xyz"):
        seen = np.isfinite(column)
        first_m = column[int(np.argmax(seen))]
        moved = np.flatnonzero(np.abs(column - first_m) > REST_RANGE_M)  # NaN does not count
        rest = int(moved[0]) if len(moved) else rest
    return max(rest, 1)


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


def _check_complete(where: Path, present: list[str], needed: list[str]) -> None:
    for name in needed:
        if name not in present:
            extra = ", the angle's column if goals were not logged" if "goal" in name else ""
            raise InputError(
                where,
                f"nothing holds {name}",
                f"map it under [columns] or [topics] in MAP.toml{extra}, or merge it with --servo",
            )


def _with_tip(series: Series, layout: MarkerLayout) -> Series:
    """Series with the centre of the last marker row as tip, if it has no tip."""
    names = layout.row(-1)
    if "tip_x_m" in series.columns or not all(f"{n}_x_m" in series.columns for n in names):
        return series
    tip_m = row_centre_m(np.array([series.position_m(n) for n in names]), layout.corners_m)
    return replace(series, columns=series.columns | marker_columns({"tip": tip_m}))


def _grid(
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
    signals = [sampled(source[n].time_s, source[n].columns[n]) for n in names]
    if len(used) == 1:
        signals.append(sampled(used[0].time_s, used[0].time_s))
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


def _align_series(series: Series, mapping: RecordingMap, turn: Array) -> Series:
    meta = mapping.meta(0)
    by_base = mapping.frame.align == "base"
    wanted = BASE_MARKERS if by_base else meta.layout.names
    plate_m = [(x, y, meta.base_offset_m) for x, y in square_corners_m(meta.link_width_m)]
    places_m = np.array(plate_m) if by_base else nominal_markers_m(meta)
    nominal = dict(zip(wanted, places_m @ turn.T, strict=True))
    names = [n for n in mapping.known_markers if f"{n}_x_m" in series.columns]
    rest = rest_count(series, names)
    markers_m = {n: series.position_m(n) for n in names}
    pairs = [
        (np.nanmean(markers_m[n][:rest], axis=0), nominal[n])
        for n in names
        if n in nominal and np.isfinite(markers_m[n][:rest]).any()
    ]
    least = 3 if by_base else 4
    if len(pairs) < least:
        raise InputError(
            series.path,
            f"shows {len(pairs)} markers {'of the base ' if by_base else ''}at rest",
            f"align needs at least {least}" + (": map b01 … b04" if by_base else ""),
        )
    rotation, shift_m = fit_rigid_motion(*(np.array(side) for side in zip(*pairs, strict=True)))
    moved = {n: position @ rotation.T + shift_m for n, position in markers_m.items()}
    return replace(series, columns=series.columns | marker_columns(moved))
