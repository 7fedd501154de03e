"""Findings on the signals of a file: times and step, duplicated signals, stuck angles, clock.

Findings on single samples of a servo: an angle that wraps, a wrong angle or current.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import Final

import numpy as np
from numpy.typing import NDArray

from firmware_py.display_units import ANGLE, DURATION
from firmware_py.errors import InputError
from models.trials.checks.finding import COMMON_CLOCK_S, STUCK_RAD, ImportFinding, level_of
from models.trials.checks.motion import LARGEST_RAD, LEAST_MOTION_RAD
from models.trials.checks.verdict import ImportVerdict
from models.trials.clock import synchronise
from models.trials.files import STEP_RANGE_S, STEP_TOLERANCE
from models.trials.recordings.mapping import RecordingMap
from models.trials.recordings.series import Series
from models.trials.trial import Array, TrialMeta

EVEN_STEP: Final = 0.05
"""Largest relative deviation from the median step of nine steps in ten, in an even file."""
FINE_STEP: Final = 0.1
"""Largest step, relative to the trial's, at which a held goal is accurate enough."""
SAME_SIGNAL: Final = 0.01
"""Difference of a signal between two files, relative to its range, in one sample of twenty."""


def judge_times(series: Sequence[Series]) -> list[ImportFinding]:
    """Findings on the unit of the times of one file."""
    for s in series:
        step_s = float(np.median(np.diff(s.time_s)))
        if not STEP_RANGE_S[0] <= step_s <= STEP_RANGE_S[1]:
            unit = '"ms"' if step_s > 1 else '"s"'
            return [
                ImportFinding(
                    "refused", "time",
                    f"the samples of {s.path.name} are {step_s:.3g} s apart: its times have "
                    "another unit",
                    f"set unit = {unit} for time_s in MAP.toml",
                )
            ]  # fmt: skip
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
            return [
                ImportFinding(
                    "warning", "step",
                    f"the samples of {s.path.name} are {DURATION.text(own_s)} apart and the "
                    f"trial's rows {DURATION.text(mapping.step_s)}: its goals are held from sample "
                    "to sample and come late or early",
                    f"set step_s = {own_s:.4g} in MAP.toml",
                )
            ]  # fmt: skip
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
        if not seen.any():
            continue
        if np.percentile(differ[seen], 95) > SAME_SIGNAL * np.ptp(used[seen]):
            differing[name] = own, other, float(np.max(differ[seen]))
    if not differing:
        return []
    name, (own, other, most) = next(iter(differing.items()))
    more = f", and so do {len(differing) - 1} others" if len(differing) > 1 else ""
    return [
        ImportFinding(
            "warning", "twice",
            f"{name} in {own.path.name} and in {other.path.name} differ by up to {most:.3g}{more}: "
            f"what {own.path.name} holds is used",
            "leave it out of the file that is wrong",
        )
    ]  # fmt: skip


def judge_signals(series: Sequence[Series], dof: int) -> list[ImportFinding]:
    """Findings on signals with identical values, and on angles that jump or do not move."""
    encoders, wrapped = judge_encoders(series, dof)
    return [*_doubled(series, dof), *encoders, *_stuck(series, dof, wrapped)]


def _doubled(series: Sequence[Series], dof: int) -> list[ImportFinding]:
    joints = range(1, dof + 1)
    kinds = ("angle_{}_rad", "current_{}_a")
    names = [kind.format(j) for kind in kinds for j in joints]
    found = []
    for s in series:
        moving = {n: s.columns[n] for n in names if n in s.columns and np.nanstd(s.columns[n]) > 0}
        for (one, x), (other, y) in combinations(moving.items(), 2):
            if np.array_equal(x, y, equal_nan=True):
                found.append(
                    ImportFinding(
                        "refused", "doubled", f"{one} and {other} hold the same values",
                        "map each to its own column",
                    )
                )  # fmt: skip
    return found


def judge_goal_sources(mapping: RecordingMap) -> list[ImportFinding]:
    """Findings on goals and angles that the map takes from one column without a note."""
    if mapping.trial.get("notes"):
        return []
    for columns in (mapping.columns, mapping.servo_columns):
        for j in (1, 2):
            goal, angle = (columns.get(f"{kind}_{j}_rad") for kind in ("goal", "angle"))
            if goal and angle and goal.source == angle.source:
                return [
                    ImportFinding(
                        "warning", "goal",
                        f"goal and angle of joint {j} are both taken from {goal.source!r}: the "
                        "servo's own error is lost",
                        "map the goals, or say in 'notes' under [trial] that they were not logged",
                    )
                ]  # fmt: skip
    return []


def _stuck(series: Sequence[Series], dof: int, wrapped: set[int]) -> list[ImportFinding]:
    """Findings on angles that do not move while their goal, sampled with them, moves."""
    found = []
    for s in series:
        for j in (j for j in range(1, dof + 1) if j not in wrapped):
            angle, goal = (s.columns.get(f"{kind}_{j}_rad") for kind in ("angle", "goal"))
            if angle is None or goal is None or np.nanmax(np.abs(goal)) > LARGEST_RAD:
                continue
            moved, first, last = _longest_hold(angle, goal)
            level = level_of(moved, STUCK_RAD)
            if level:
                found.append(
                    ImportFinding(
                        level, "stuck",
                        f"angle_{j}_rad does not change for "
                        f"{DURATION.text(s.time_s[last] - s.time_s[first])} from "
                        f"{s.time_s[first]:.2f} s on, while its goal moves by {ANGLE.text(moved)}",
                        "check torque and current limit of the servo, or cut the recording there",
                    )
                )  # fmt: skip
    return found


def _longest_hold(angle: Array, goal: Array) -> tuple[float, int, int]:
    """Largest change of the goal over rows of constant angle, with first and last row."""
    starts = np.flatnonzero(np.concatenate([[True], np.diff(angle) != 0]))
    ends = np.append(starts[1:], len(angle)) - 1
    low, high = np.minimum.reduceat(goal, starts), np.maximum.reduceat(goal, starts)
    k = int(np.nanargmax(np.where(ends > starts, high - low, 0.0)))
    return float(high[k] - low[k]) if ends[k] > starts[k] else 0.0, int(starts[k]), int(ends[k])


def check_common_clock(
    series: list[Series], meta: TrialMeta, verdict: ImportVerdict, remedy: str
) -> None:
    """Add the clock to a verdict, and a finding if the markers lag or lead the angles."""
    angles = [s for s in series if "angle_1_rad" in s.columns]
    if not angles or not any("m01_x_m" in s.columns for s in series):
        return
    if not np.nanstd(angles[0].columns["angle_1_rad"]) > LEAST_MOTION_RAD:
        return
    try:
        clock = synchronise(angles, series, meta)
    except InputError:
        return  # the checks of the motion report signs and joints
    verdict.clock = clock
    level = level_of(clock.offset_s, COMMON_CLOCK_S)
    if level and abs(clock.offset_s) > clock.error_s:
        late = "late" if clock.offset_s > 0 else "early"
        verdict.findings.append(
            ImportFinding(
                level, "clock",
                f"the markers are {abs(clock.offset_s):.3f} s {late} against the angles", remedy,
            )
        )  # fmt: skip


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


def judge_encoders(series: Sequence[Series], dof: int) -> tuple[list[ImportFinding], set[int]]:
    """Findings on angles and goals that wrap, and on spikes; with the joints that wrap."""
    found: list[ImportFinding] = []
    wrapped: set[int] = set()
    for s in series:
        for j in range(1, dof + 1):
            if f"current_{j}_a" in s.columns:
                found += _current_spikes(s, f"current_{j}_a", _step_times_s(series, j))
            names = [n for n in (f"angle_{j}_rad", f"goal_{j}_rad") if n in s.columns]
            if any(np.nanmax(np.abs(s.columns[n])) > LARGEST_RAD for n in names):
                continue  # in another unit
            wraps = [wrap for n in names if (wrap := _wrap(s, n))]
            found += wraps
            if wraps:
                wrapped.add(j)
            elif f"angle_{j}_rad" in names:
                found += _spikes(s, f"angle_{j}_rad")
    return found, wrapped


def _wrap(series: Series, name: str) -> ImportFinding | None:
    """Finding if a column jumps by a turn between two samples."""
    jumps = np.diff(series.columns[name])
    at = np.flatnonzero(np.abs(np.abs(jumps) - 2 * np.pi) < WRAP_RAD)
    if not len(at):
        return None
    k = int(at[0])
    times = f", and {len(at) - 1} times more" if len(at) > 1 else ""
    return ImportFinding(
        "refused", "wrap",
        f"{name} jumps by {ANGLE.text(jumps[k])} from sample {k + 1} to {k + 2} "
        f"({series.time_s[k]:.2f} s){times}: its count starts again after a turn",
        "write it without jumps: where it counts from 0 to 360 deg, subtract 360 deg above 180 deg",
    )  # fmt: skip


def _spikes(series: Series, name: str) -> list[ImportFinding]:
    """Finding on samples with an angle that jumps and returns faster than a joint can turn."""
    angle, time_s = series.columns[name], series.time_s
    there, back = np.diff(angle)[:-1], np.diff(angle)[1:]
    step_s = 0.5 * (time_s[2:] - time_s[:-2])
    size = np.where(there * back < 0, np.minimum(np.abs(there), np.abs(back)), 0.0)
    turn = np.abs(back - there)
    limit = np.maximum(SPIKE_RAD_S2 * step_s**2, SPIKE_NOISE * _usual(turn))
    alike = size > 0.5 * np.maximum(np.abs(there), np.abs(back))  # else it is an adjacent sample
    at = np.flatnonzero((size > SPIKE_RAD) & (turn > limit) & alike) + 1
    if not len(at):
        return []
    return [
        ImportFinding(
            "warning", "spike",
            f"{name} jumps by {ANGLE.text(size[at - 1].max())} and back in {_listed(at, time_s)}: "
            "no joint moves like that",
            "correct the sample by its neighbours, or cut the recording there",
        )
    ]  # fmt: skip


def _step_times_s(series: Sequence[Series], joint: int) -> Array:
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
    there, back = np.diff(current)[:-1], np.diff(current)[1:]
    size = np.where(there * back < 0, np.minimum(np.abs(there), np.abs(back)), 0.0)
    alike = size > 0.5 * np.maximum(np.abs(there), np.abs(back))  # else it is an adjacent sample
    beyond = (size > SPIKE_TIMES * np.percentile(size, 95)) & alike & (size > SPIKE_A)
    others = np.delete(current, np.flatnonzero(beyond) + 1)
    at = np.flatnonzero(beyond & (size > SPIKE_PART * np.ptp(others))) + 1
    apart_s = np.abs(time_s[at, None] - steps_s).min(axis=1, initial=np.inf)
    at = at[apart_s > SETTLED_S]
    if not len(at):
        return []
    k = int(at[np.argmax(size[at - 1])])
    return [
        ImportFinding(
            "warning", "spike",
            f"{name} jumps to {current[k]:.3g} A and back in {_listed(at, time_s)}, the others lie "
            f"between {others.min():.3g} and {others.max():.3g} A",
            "correct the sample by its neighbours: one such sample changes a fit",
        )
    ]  # fmt: skip


def _listed(at: NDArray[np.intp], time_s: Array) -> str:
    """Samples in words."""
    first = at[:MOST_NAMED]
    listed = ", ".join(f"{k + 1} ({time_s[k]:.2f} s)" for k in first)
    more = f" and {len(at) - len(first)} more" if len(at) > len(first) else ""
    return f"sample{'s' if len(at) > 1 else ''} {listed}{more}"


def _usual(change: Array) -> float:
    seen = change[np.isfinite(change)]
    return float(np.median(seen)) if len(seen) else 0.0
