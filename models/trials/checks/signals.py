"""Times and signals of the files of a recording: steps, gaps, units, doubled signals, samples.

Most findings are on series, before they become a trial, because a file keeps its own sample times.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Final

import numpy as np
from numpy.typing import NDArray

from firmware_py.display_units import SMALL_CURRENT
from models.trials.checks import causes
from models.trials.checks.causes import ImportFinding
from models.trials.checks.motion import LARGEST_RAD, LEAST_MOTION_RAD
from models.trials.files import STEP_RANGE_S, STEP_TOLERANCE
from models.trials.recordings.mapping import RecordingMap
from models.trials.recordings.series import Series
from models.trials.trial import Array

EVEN_STEP: Final = 0.05
"""Largest relative deviation from the median step of nine steps in ten, in an even file."""
FINE_STEP: Final = 0.1
"""Largest step, relative to the trial's, at which a held goal is accurate enough."""
SAME_SIGNAL: Final = 0.01
"""Difference of a signal between two files, relative to its range, in one sample of twenty."""


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
        found += causes.GAP.beyond(bridged_s, file=gap.file, start_s=gap.start_s)
    return found


def judge_times(series: Sequence[Series]) -> list[ImportFinding]:
    """Findings on the unit of the times of one file."""
    for s in series:
        steps = np.diff(s.time_s)
        step_s = float(np.median(steps))
        if np.all(s.time_s == np.round(s.time_s)) and np.median(np.abs(steps)) == 1.0:
            return causes.FRAME_NUMBERS.raised(file=s.path.name)
        if not STEP_RANGE_S[0] <= step_s <= STEP_RANGE_S[1]:
            unit = "ms" if step_s > 1 else "s"
            return causes.TIME_UNIT.raised(file=s.path.name, step_s=step_s, unit=unit)
    return []


def judge_steps(series: Sequence[Series], mapping: RecordingMap) -> list[ImportFinding]:
    """Findings on goals with an even step other than the trial's, if the map names no step."""
    if mapping.step_named:
        return []
    for s in (s for s in series if any(mapping.is_goal(name) for name in s.columns)):
        steps = np.diff(s.time_s)
        usual_s = float(np.median(steps))
        own_s = float(np.mean(steps[steps < 1.5 * usual_s]))  # without gaps
        even = np.percentile(np.abs(steps / usual_s - 1), 90) <= EVEN_STEP
        other = abs(own_s - mapping.step_s) > STEP_TOLERANCE * mapping.step_s
        if even and other and own_s > FINE_STEP * mapping.step_s:
            return causes.STEP.raised(file=s.path.name, own_s=own_s, step_s=mapping.step_s)
    return []


def judge_shared_signals(servo: Sequence[Series], mocap: Sequence[Series]) -> list[ImportFinding]:
    """Findings on signals in both files that differ; those of the servo are used."""
    differing: dict[str, tuple[Series, Series, float]] = {}
    columns = {name: s for s in mocap for name in s.columns}
    for own, name in ((s, n) for s in servo for n in s.columns if n in columns):
        other = columns[name]
        inside = (own.time_s >= other.time_s[0]) & (own.time_s <= other.time_s[-1])
        used = own.columns[name][inside]
        differ = np.abs(np.interp(own.time_s[inside], other.time_s, other.columns[name]) - used)
        seen = np.isfinite(differ)
        if seen.any() and np.percentile(differ[seen], 95) > SAME_SIGNAL * np.ptp(used[seen]):
            differing[name] = own, other, float(np.max(differ[seen]))
    if not differing:
        return []
    name, (own, other, most) = next(iter(differing.items()))
    more = f", and so do {len(differing) - 1} others" if len(differing) > 1 else ""
    return causes.SHARED_SIGNAL.raised(
        name=name, own=own.path.name, other=other.path.name, most=most, more=more
    )


def judge_goal_sources(mapping: RecordingMap) -> list[ImportFinding]:
    """Findings on goals and angles that the map takes from one column without a note."""
    if mapping.trial.get("notes"):
        return []
    for columns in (mapping.columns, mapping.servo_columns):
        for j in (1, 2):
            goal, angle = (columns.get(f"{kind}_{j}_rad") for kind in ("goal", "angle"))
            if goal and angle and goal.source == angle.source:
                return causes.GOAL_FROM_ANGLE.raised(joint=j, source=goal.source)
    return []


def judge_signals(series: Sequence[Series], dof: int) -> list[ImportFinding]:
    """Findings on the signals of the joints, each file for itself."""
    found: list[ImportFinding] = []
    for s in series:
        found += [*_doubled(s, dof), *_units(s, dof)]
        for j in range(1, dof + 1):
            names = [n for n in (f"angle_{j}_rad", f"goal_{j}_rad") if n in s.columns]
            if f"current_{j}_a" in s.columns:
                found += _current_spikes(s, f"current_{j}_a", _step_times_s(series, j))
            if any(_largest(s.columns[n]) > LARGEST_RAD for n in names):
                continue  # in another unit
            wraps = [wrap for n in names for wrap in _wraps(s, n)]
            if wraps or f"angle_{j}_rad" not in names:
                found += wraps
                continue
            found += _angle_spikes(s, f"angle_{j}_rad")
            if len(names) == 2:
                found += _stuck(s, j)
    return found


def _largest(values: Array) -> float:
    seen = np.abs(values[np.isfinite(values)])
    return float(seen.max()) if len(seen) else 0.0


def _doubled(series: Series, dof: int) -> list[ImportFinding]:
    names = [kind.format(j) for kind in ("angle_{}_rad", "current_{}_a") for j in range(1, dof + 1)]
    moving = {n: v for n in names if (v := series.columns.get(n)) is not None and np.nanstd(v) > 0}
    return [
        finding
        for (one, x), (other, y) in combinations(moving.items(), 2)
        if np.array_equal(x, y, equal_nan=True)
        for finding in causes.DOUBLED_SIGNAL.raised(one=one, other=other)
    ]


LARGEST_A: Final = 100.0
"""Current above which its unit is not A."""
LEAST_A: Final = 0.01
"""Peak current of a motion below which its unit is not A: friction of the smallest servo needs 0.02
to 0.04 A (docs/sources.md, "The servo")."""
LARGEST_DEG: Final = 360.0
"""Angle above which it is not in degrees either; below zero, half of it."""


def _units(series: Series, dof: int) -> list[ImportFinding]:
    """Findings on angles in degrees or counts, currents in mA or counts, and the reverse."""
    found = []
    for j in range(1, dof + 1):
        angle, current = (series.columns.get(n) for n in (f"angle_{j}_rad", f"current_{j}_a"))
        for name in (f"goal_{j}_rad", f"angle_{j}_rad"):
            values = series.columns.get(name, np.zeros(1))
            reached, unit, remedy = _largest(values), "deg", 'unit = "deg"'
            if reached > LARGEST_DEG or np.nanmin(values) < -LARGEST_DEG / 2:
                unit = "counts of the encoder"
                remedy = "scale = 0.0015339 (4096 counts per turn) and offset"
            if reached > LARGEST_RAD:
                found += causes.UNIT.raised(name=name, reached=reached, unit=unit, remedy=remedy)
        if current is None:
            continue
        reached = _largest(current)
        if reached > LARGEST_A:
            found += causes.UNIT.raised(
                name=f"current_{j}_a", reached=reached, unit="mA, or in counts of the servo",
                remedy='unit = "mA", or the servo\'s A per count as scale,',
            )  # fmt: skip
        moves = angle is not None and np.nanstd(angle) > LEAST_MOTION_RAD
        if moves and 0 < reached < LEAST_A:
            found += causes.SMALL_CURRENT.raised(
                joint=j, reached=SMALL_CURRENT.significant(reached, 2)
            )
    return found


def _stuck(series: Series, joint: int) -> list[ImportFinding]:
    """Finding on an angle that does not move while its goal, sampled with it, moves."""
    angle, goal = (series.columns[f"{kind}_{joint}_rad"] for kind in ("angle", "goal"))
    starts = np.flatnonzero(np.concatenate([[True], np.diff(angle) != 0]))
    ends = np.append(starts[1:], len(angle)) - 1
    low, high = np.minimum.reduceat(goal, starts), np.maximum.reduceat(goal, starts)
    k = int(np.nanargmax(np.where(ends > starts, high - low, 0.0)))
    first_s, last_s = series.time_s[starts[k]], series.time_s[ends[k]]
    moved = float(high[k] - low[k]) if ends[k] > starts[k] else 0.0
    return causes.STUCK.beyond(moved, joint=joint, held_s=last_s - first_s, first_s=first_s)


WRAP_RAD: Final = 0.5
"""Largest difference of a jump between two samples from one turn that counts as a wrap."""
SPIKE_RAD: Final = 0.02
"""Smallest jump there and back of a spike: thirteen steps of a coarse encoder."""
SPIKE_RAD_S2: Final = 300.0
"""Acceleration that no joint with the link reaches: five times the goals' limit."""
SPIKE_NOISE: Final = 20.0
"""Smallest change of rate in a spike, relative to the median change."""
SPIKE_A: Final = 0.1
"""Smallest jump there and back of a spike of the current."""
SPIKE_PART: Final = 0.25
"""The same, relative to the range of all other samples: at most 0.02 on the recordings of three
machines (docs/sources.md), 0.7 where a rig's current is only noise."""
SPIKE_TIMES: Final = 5.0
"""Smallest jump of a spike, relative to the 95th percentile of jumps: 2.4 for noise only."""
SETTLED_S: Final = 0.1
"""Time after a step of the goal during which a current may jump too."""
MOST_NAMED: Final = 3


def _wraps(series: Series, name: str) -> list[ImportFinding]:
    """Finding if a column jumps by a turn between two samples."""
    jumps = np.diff(series.columns[name])
    at = np.flatnonzero(np.abs(np.abs(jumps) - 2 * np.pi) < WRAP_RAD)
    if not len(at):
        return []
    k = int(at[0])
    return causes.WRAP.raised(
        name=name, jump=jumps[k], sample=k + 1, next=k + 2, at_s=series.time_s[k],
        times=f", and {len(at) - 1} times more" if len(at) > 1 else "",
    )  # fmt: skip


def _there_and_back(values: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Size of the jump there and back at each inner sample, and whether both ways are alike.

    A sample beside the one that jumps has unlike ways.
    """
    there, back = np.diff(values)[:-1], np.diff(values)[1:]
    size = np.where(there * back < 0, np.minimum(np.abs(there), np.abs(back)), 0.0)
    return size, np.asarray(size > 0.5 * np.maximum(np.abs(there), np.abs(back)))


def _angle_spikes(series: Series, name: str) -> list[ImportFinding]:
    """Finding on samples with an angle that jumps and returns faster than a joint can turn."""
    angle, time_s = series.columns[name], series.time_s
    size, alike = _there_and_back(angle)
    turn = np.abs(np.diff(angle, 2))
    seen = turn[np.isfinite(turn)]
    usual = float(np.median(seen)) if len(seen) else 0.0
    step_s = 0.5 * (time_s[2:] - time_s[:-2])
    limit = np.maximum(SPIKE_RAD_S2 * step_s**2, SPIKE_NOISE * usual)
    at = np.flatnonzero((size > SPIKE_RAD) & (turn > limit) & alike) + 1
    if not len(at):
        return []
    return causes.ANGLE_SPIKE.raised(
        name=name, jump=size[at - 1].max(), where=_listed(at, time_s)
    )  # fmt: skip


def _step_times_s(series: Iterable[Series], joint: int) -> Array:
    """Times at which a goal steps: the servo's current responds for one or two samples."""
    name, times = f"goal_{joint}_rad", [np.zeros(0)]
    for s in (s for s in series if name in s.columns):
        changes = np.diff(s.columns[name])
        at = np.flatnonzero(np.abs(changes) > 0)
        size, time_s = np.abs(changes[at]), s.time_s[at + 1]
        beside = np.zeros(len(at))  # changes just before and after, as in a moving goal
        close = np.diff(time_s) < SETTLED_S
        beside[1:] = np.where(close, size[:-1], 0.0)
        beside[:-1] = np.maximum(beside[:-1], np.where(close, size[1:], 0.0))
        times.append(time_s[(size > SPIKE_RAD) & (size > 3 * beside)])
    return np.sort(np.concatenate(times))


def _current_spikes(series: Series, name: str, steps_s: Array) -> list[ImportFinding]:
    """Finding on samples with a current that jumps and returns, far beyond all others.

    Reversing friction is a step without return, and held goals cause small jumps repeatedly.
    """
    current, time_s = series.columns[name], series.time_s
    if not np.isfinite(current).all() or len(current) < 8:
        return []
    size, alike = _there_and_back(current)
    beyond = (size > max(SPIKE_TIMES * np.percentile(size, 95), SPIKE_A)) & alike
    others = np.delete(current, np.flatnonzero(beyond) + 1)
    at = np.flatnonzero(beyond & (size > SPIKE_PART * np.ptp(others))) + 1
    apart_s = np.abs(time_s[at, None] - steps_s).min(axis=1, initial=np.inf)
    at = at[apart_s > SETTLED_S]
    if not len(at):
        return []
    k = int(at[np.argmax(size[at - 1])])
    return causes.CURRENT_SPIKE.raised(
        name=name, jump=current[k], where=_listed(at, time_s), low=others.min(), high=others.max()
    )


def _listed(at: NDArray[np.intp], time_s: Array) -> str:
    """Samples in words."""
    first = at[:MOST_NAMED]
    listed = ", ".join(f"{k + 1} ({time_s[k]:.2f} s)" for k in first)
    more = f" and {len(at) - len(first)} more" if len(at) > len(first) else ""
    return f"sample{'s' if len(at) > 1 else ''} {listed}{more}"
