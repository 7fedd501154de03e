"""Signals of the files of a recording: doubled, in a wrong unit, wrapped, stuck, single samples.

The findings are on series, before they become a trial, because a file keeps its sample times.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import Final

import numpy as np
from numpy.typing import NDArray

from models.trials.checks import causes
from models.trials.checks.causes import ImportFinding, at_rows
from models.trials.checks.motion import LEAST_MOTION_RAD
from models.trials.recordings.mapping import RecordingMap
from models.trials.recordings.series import Series
from models.trials.trial import Array

# --- signals that are in two places --------------------------------------------------------------


def judge_shared_signals(servo: Sequence[Series], mocap: Sequence[Series]) -> list[ImportFinding]:
    """Findings on signals in both files that differ; those of the servo are used.

    They differ if one sample in twenty is off by 1 % of the signal's range.
    """
    names = []
    in_mocap = {name: s for s in mocap for name in s.columns}
    for s, name in ((file, n) for file in servo for n in file.columns if n in in_mocap):
        other = in_mocap[name]
        inside = (s.time_s >= other.time_s[0]) & (s.time_s <= other.time_s[-1])
        used = s.columns[name][inside]
        differ = np.abs(np.interp(s.time_s[inside], other.time_s, other.columns[name]) - used)
        visible = np.isfinite(differ)
        if visible.any() and np.percentile(differ[visible], 95) > 0.01 * np.ptp(used[visible]):
            names.append(name)
    if not names:
        return []
    files = {"servo": servo[0].path.name, "mocap": mocap[0].path.name}
    return causes.SHARED_SIGNAL.raised(names=names, **files)


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


# --- values --------------------------------------------------------------------------------------


def judge_signals(series: Sequence[Series], dof: int) -> list[ImportFinding]:
    """Findings on the signals of the joints, each file for itself."""
    findings: list[ImportFinding] = []
    for s in series:
        findings += _doubled(s, dof)
        for j in range(1, dof + 1):
            names = [n for n in (f"goal_{j}_rad", f"angle_{j}_rad") if n in s.columns]
            units = [unit for n in names for unit in _angle_unit(s, n)]
            wraps = [wrap for n in names for wrap in _wraps(s, n)]
            findings += units or wraps
            if not units and not wraps and f"angle_{j}_rad" in names:
                findings += _angle_spikes(s, f"angle_{j}_rad")
                if len(names) == 2:
                    findings += _stuck(s, j)
            findings += _current(s, j, series)
    return findings


def _doubled(series: Series, dof: int) -> list[ImportFinding]:
    names = [kind.format(j) for kind in ("angle_{}_rad", "current_{}_a") for j in range(1, dof + 1)]
    moving = {n: v for n in names if (v := series.columns.get(n)) is not None and np.nanstd(v) > 0}
    return [
        finding
        for (one, x), (other, y) in combinations(moving.items(), 2)
        if np.array_equal(x, y, equal_nan=True)
        for finding in causes.DOUBLED_SIGNAL.raised(one=one, other=other)
    ]


def _largest(values: Array) -> float:
    return float(np.abs(values[np.isfinite(values)]).max(initial=0.0))


def _angle_unit(series: Series, name: str) -> list[ImportFinding]:
    """Finding on an angle in degrees, or beyond a turn (below zero, half of one) in counts."""
    reached, low = _largest(series.columns[name]), np.nanmin(series.columns[name], initial=0.0)
    if reached <= LARGEST_RAD:
        return []
    cause = causes.COUNTS if reached > 360.0 or low < -180.0 else causes.DEGREES
    return cause.raised(name=name, reached=reached)


LARGEST_RAD: Final = 6.3
"""Angle above which its unit is not rad."""
LARGEST_A: Final = 100.0
"""Current above which its unit is not A."""
LEAST_A: Final = 0.01
"""Peak current of a motion below which its unit is not A: friction of the smallest servo needs 0.02
to 0.04 A (docs/sources.md, "The servo")."""


def _current(series: Series, joint: int, others: Sequence[Series]) -> list[ImportFinding]:
    """Findings on a current in another unit, and on spikes of it."""
    name = f"current_{joint}_a"
    if name not in series.columns:
        return []
    reached, angle = _largest(series.columns[name]), series.columns.get(f"angle_{joint}_rad")
    findings = _current_spikes(series, joint, others)
    if reached > LARGEST_A:
        findings += causes.MILLIAMPERES.raised(name=name, reached=reached)
    if angle is not None and np.nanstd(angle) > LEAST_MOTION_RAD and 0 < reached < LEAST_A:
        findings += causes.SMALL_CURRENT.raised(joint=joint, reached_a=reached)
    return findings


def _stuck(series: Series, joint: int) -> list[ImportFinding]:
    """Finding on an angle that does not move while its goal, sampled with it, moves."""
    angle, goal = (series.columns[f"{kind}_{joint}_rad"] for kind in ("angle", "goal"))
    starts = np.flatnonzero(np.concatenate([[True], np.diff(angle) != 0]))
    ends = np.append(starts[1:], len(angle)) - 1
    low, high = np.minimum.reduceat(goal, starts), np.maximum.reduceat(goal, starts)
    moved = np.nan_to_num(np.where(ends > starts, high - low, 0.0))
    k = int(np.argmax(moved))
    first_s, last_s = series.time_s[starts[k]], series.time_s[ends[k]]
    return causes.STUCK.beyond(moved[k], joint=joint, still_s=last_s - first_s, first_s=first_s)


def _wraps(series: Series, name: str) -> list[ImportFinding]:
    """Finding if a column jumps by a turn between two samples."""
    jumps = np.diff(series.columns[name])
    at = np.flatnonzero(np.abs(np.abs(jumps) - 2 * np.pi) < 0.5)
    if not len(at):
        return []
    where = at_rows(at, series.time_s, "sample")
    return causes.WRAP.raised(name=name, jump=jumps[at[0]], where=where)


# --- single samples ------------------------------------------------------------------------------


def single_samples(values: Array, least: float) -> NDArray[np.intp]:
    """Samples of a signal, (n,) or (n, k), that jump away and back.

    They are by `least`, and by twenty times the median, from the middle of the adjacent samples,
    and farther than these are from each other.
    """
    values = values.reshape(len(values), -1)
    if len(values) < 3:
        return np.empty(0, dtype=np.intp)
    bent = np.linalg.norm(values[1:-1] - 0.5 * (values[:-2] + values[2:]), axis=1)
    around = np.linalg.norm(values[2:] - values[:-2], axis=1)
    usual = float(np.median(bent[np.isfinite(bent)])) if np.isfinite(bent).any() else 0.0
    return np.flatnonzero((bent > max(least, 20 * usual)) & (bent > around)) + 1


SPIKE_RAD: Final = 0.02
"""Smallest jump of an angle there and back: thirteen steps of a coarse encoder."""
SPIKE_RAD_S2: Final = 300.0
"""Acceleration that no joint with the link reaches: five times the goals' limit."""


def _angle_spikes(series: Series, name: str) -> list[ImportFinding]:
    """Finding on samples with an angle that jumps and returns faster than a joint can turn."""
    angle, step_s = series.columns[name], float(np.median(np.diff(series.time_s)))
    at = single_samples(angle, max(SPIKE_RAD, 0.5 * SPIKE_RAD_S2 * step_s**2))
    if not len(at):
        return []
    jump = np.abs(angle[at] - angle[at - 1]).max()
    where = at_rows(at, series.time_s, "sample")
    return causes.ANGLE_SPIKE.raised(name=name, jump=jump, where=where)


SPIKE_A: Final = 0.1
"""Smallest jump of a current there and back."""
SPIKE_PART: Final = 0.25
"""The same, relative to the range of all other samples: at most 0.02 on the recordings of three
machines (docs/sources.md), 0.7 where a rig's current is only noise."""
SPIKE_TIMES: Final = 5.0
"""The same, relative to the 95th percentile of jumps: 2.4 for noise only."""
SETTLED_S: Final = 0.1
"""Time around a step of the goal in which a current may jump too."""


def _current_spikes(series: Series, joint: int, others: Sequence[Series]) -> list[ImportFinding]:
    """Finding on samples with a current that jumps and returns, far beyond all others.

    Reversing friction is a step without return, held goals cause small jumps repeatedly, and after
    a step of its goal the current responds for one or two samples.
    """
    name, time_s = f"current_{joint}_a", series.time_s
    current = series.columns[name]
    if not np.isfinite(current).all() or len(current) < 8:
        return []
    there, back = np.diff(current)[:-1], np.diff(current)[1:]
    ways = np.sort(np.abs([there, back]), axis=0)
    size = np.where(there * back < 0, ways[0], 0.0)
    limit_a = max(SPIKE_TIMES * np.percentile(size, 95), SPIKE_A)
    beyond = (size > limit_a) & (size > 0.5 * ways[1])  # beside a spike, the ways are unlike
    usual = np.delete(current, np.flatnonzero(beyond) + 1)
    at = np.flatnonzero(beyond & (size > SPIKE_PART * np.ptp(usual))) + 1
    at = at[[not any(_goal_steps(s, joint, time_s[k]) for s in others) for k in at]]
    if not len(at):
        return []
    return causes.CURRENT_SPIKE.raised(
        name=name, jump=current[at[np.argmax(size[at - 1])]],
        where=at_rows(at, time_s, "sample"), low=usual.min(), high=usual.max(),
    )  # fmt: skip


def _goal_steps(series: Series, joint: int, at_s: float) -> bool:
    """Whether a goal makes most of its way around a time in one step."""
    goal = series.columns.get(f"goal_{joint}_rad", np.zeros(0))
    first, last = np.searchsorted(series.time_s, [at_s - SETTLED_S, at_s + SETTLED_S])
    near = goal[max(first - 1, 0) : last]
    step = np.abs(np.diff(near)).max(initial=0.0)
    return bool(step > max(SPIKE_RAD, 0.6 * np.ptp(near))) if len(near) else False
