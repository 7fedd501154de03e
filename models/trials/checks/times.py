"""Times of a recording: their unit, steps and gaps, and the clocks of two files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from firmware_py.core.errors import InputError
from models.trials.checks import causes
from models.trials.checks.causes import ImportFinding
from models.trials.checks.motion import LEAST_MOTION_RAD
from models.trials.clock import Synchronisation, synchronise
from models.trials.files import STEP_RANGE_S, STEP_TOLERANCE
from models.trials.recordings.mapping import RecordingMap
from models.trials.recordings.series import Series, with_angles, with_markers
from models.trials.trial import TrialMeta

# --- samples of a file ----------------------------------------------------------------------------


class Gap(NamedTuple):
    """Longest time without a sample in a series."""

    file: str  # Name of the file
    start_s: float  # Last sample before the gap, on the trial's clock
    length_s: float  # Time to the next sample
    step_s: float  # Usual step of the series


def longest_gaps(series: Sequence[Series], start_s: float, end_s: float) -> list[Gap]:
    """Longest gap of every series between the first and the last time of a trial."""
    gaps = []
    for s in series:
        inside_s = s.time_s[(s.time_s >= start_s - 1.0) & (s.time_s <= end_s + 1.0)]
        if len(inside_s) < 2:
            continue
        steps_s = np.diff(inside_s)
        k = int(np.argmax(steps_s))
        usual_s = float(np.median(steps_s))
        gaps.append(Gap(s.path.name, float(inside_s[k] - start_s), float(steps_s[k]), usual_s))
    return gaps


def judge_gaps(gaps: Sequence[Gap]) -> list[ImportFinding]:
    """Findings on gaps that would be bridged by interpolation."""
    return [
        finding
        for gap in gaps
        if gap.length_s > 1.5 * gap.step_s
        for finding in causes.GAP.beyond(gap.length_s, file=gap.file, start_s=gap.start_s)
    ]


def judge_times(series: Sequence[Series]) -> list[ImportFinding]:
    """Findings on the unit of the times of one file."""
    for s in series:
        steps_s = np.diff(s.time_s)
        step_s = float(np.median(steps_s))
        if step_s == 1.0 and np.all(s.time_s == np.round(s.time_s)):
            return causes.FRAME_NUMBERS.raised(file=s.path.name)
        if not STEP_RANGE_S[0] <= step_s <= STEP_RANGE_S[1]:
            unit = "ms" if step_s > 1 else "s"
            return causes.TIME_UNIT.raised(file=s.path.name, step_s=step_s, unit=unit)
    return []


def judge_steps(series: Sequence[Series], mapping: RecordingMap) -> list[ImportFinding]:
    """Findings on goals with an even step other than the trial's, if the map names no step.

    A step is even if nine in ten are within 5 % of the median. A held goal is accurate enough below
    a tenth of the trial's step.
    """
    if mapping.step_named:
        return []
    for s in (s for s in series if any(mapping.is_goal(name) for name in s.columns)):
        steps_s = np.diff(s.time_s)
        usual_s = float(np.median(steps_s))
        file_s = float(np.mean(steps_s[steps_s < 1.5 * usual_s]))  # without gaps
        even = np.percentile(np.abs(steps_s / usual_s - 1), 90) <= 0.05
        other = abs(file_s - mapping.step_s) > STEP_TOLERANCE * mapping.step_s
        if even and other and file_s > 0.1 * mapping.step_s:
            return causes.STEP.raised(file=s.path.name, file_s=file_s, step_s=mapping.step_s)
    return []


# --- clocks -------------------------------------------------------------------------------------


def judge_clock(clock: Synchronisation) -> list[ImportFinding]:
    """Findings if the clock's offset is uncertain, or drifts during the motion."""
    findings = causes.CLOCK_ERROR.beyond(clock.error_s)
    for drift in clock.drifts:
        change_s = abs(drift.change_s)
        drifting = causes.CLOCK_DRIFT.beyond(change_s, over_s=drift.over_s)
        if drifting and change_s > 3 * drift.deviation_s:
            return findings + drifting
    return findings


def judge_stated_offset(
    option_s: float, estimate: Synchronisation, apart_s: float
) -> list[ImportFinding]:
    """Finding if the user's offset differs from the estimate of signal or motion.

    `apart_s` is added to both in the message, because clocks may count from an epoch.
    """
    differs_s = abs(option_s - estimate.offset_s)
    return causes.CLOCK_OPTION.beyond(
        max(differs_s - 3 * estimate.error_s, 0.0), differs_s=differs_s,
        option_s=option_s + apart_s, estimate_s=estimate.offset_s + apart_s,
        error_s=estimate.error_s, by="sync signal" if estimate.by == "sync" else "motion",
    )  # fmt: skip


def judge_common_clock(
    series: list[Series], meta: TrialMeta
) -> tuple[Synchronisation | None, list[ImportFinding]]:
    """Clock of one file by its motion, and a finding if the markers lag or lead the angles."""
    angles = with_angles(series, meta.dof)
    if angles is None or not with_markers(series, "m01"):
        return None, []
    if not np.nanstd(angles[1][:, 0]) > LEAST_MOTION_RAD:
        return None, []
    try:
        clock = synchronise([angles[0]], series, meta)
    except InputError:
        return None, []  # the checks of the motion report signs and joints
    if abs(clock.offset_s) <= clock.error_s:
        return clock, []
    late = "late" if clock.offset_s > 0 else "early"
    return clock, causes.COMMON_CLOCK.beyond(abs(clock.offset_s), late=late)


def judge_frame_rate(
    servo: list[Series], mocap: list[Series], meta: TrialMeta
) -> list[ImportFinding]:
    """Finding if two files that do not fit do so once the motion capture has another rate.

    Rates are tried from a quarter to four times; with one 2 % off, the motion of ten seconds still
    fits by 0.99.
    """

    def fit(factor: float) -> float:
        stretched = [replace(s, time_s=factor * s.time_s) for s in mocap]
        try:
            return synchronise(servo, stretched, meta).correlation
        except InputError:
            return 0.0

    near = max((1.02**k for k in range(-70, 71)), key=fit)
    factor = max(near * (1 + 0.002 * np.arange(-10, 11)), key=fit)
    correlation = fit(factor)
    if correlation < 0.98 or abs(factor - 1) < 0.02:
        return []
    file = mocap[0].path.name
    return causes.FRAME_RATE.raised(file=file, factor=factor, correlation=correlation)
