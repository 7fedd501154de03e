"""Clocks of the files of a recording: uncertain, drifting, late, or at a wrong rate."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from firmware_py.errors import InputError
from models.trials.checks import causes
from models.trials.checks.causes import ImportFinding
from models.trials.checks.motion import LEAST_MOTION_RAD
from models.trials.clock import Synchronisation, synchronise
from models.trials.recordings.series import Series
from models.trials.trial import TrialMeta

FITS: Final = 0.98
"""Correlation at which another frame rate explains a motion that does not fit."""
RATE_STEP: Final = 1.02
"""Ratio of neighbouring rates in the search: over ten seconds the motion still fits by 0.99."""


def judge_clock(clock: Synchronisation) -> list[ImportFinding]:
    """Findings if the clock's offset is uncertain, or drifts during the motion."""
    found = causes.CLOCK_ERROR.beyond(clock.error_s)
    for drift in clock.drifts:
        least_s = max(causes.CLOCK_DRIFT_S, causes.DRIFT_DEVIATIONS * drift.deviation_s)
        if abs(drift.change_s) > least_s:
            change_s = abs(drift.change_s)
            return found + causes.CLOCK_DRIFT.raised(change_s=change_s, over_s=drift.over_s)
    return found


def judge_given_offset(
    given_s: float, found: Synchronisation | None, apart_s: float
) -> list[ImportFinding]:
    """Finding if the user's offset differs from the estimate of signal or motion, if there is one.

    `apart_s` is added to both in the message, because clocks may count from an epoch.
    """
    if found is None:
        return []
    differs_s = abs(given_s - found.offset_s)
    if differs_s <= 3 * found.error_s + causes.GIVEN_CLOCK_S:
        return []
    return causes.GIVEN_CLOCK.raised(
        given_s=given_s + apart_s, differs_s=differs_s, found_s=found.offset_s + apart_s,
        error_s=found.error_s, by="sync signal" if found.by == "sync" else "motion",
    )  # fmt: skip


def judge_common_clock(
    series: list[Series], meta: TrialMeta, remedy: str
) -> tuple[Synchronisation | None, list[ImportFinding]]:
    """Clock of one file by its motion, and a finding if the markers lag or lead the angles."""
    angles = [s for s in series if "angle_1_rad" in s.columns]
    if not angles or not any("m01_x_m" in s.columns for s in series):
        return None, []
    if not np.nanstd(angles[0].columns["angle_1_rad"]) > LEAST_MOTION_RAD:
        return None, []
    try:
        clock = synchronise(angles, series, meta)
    except InputError:
        return None, []  # the checks of the motion report signs and joints
    sure = abs(clock.offset_s) > clock.error_s
    late = "late" if clock.offset_s > 0 else "early"
    return clock, causes.COMMON_CLOCK.beyond(
        clock.offset_s if sure else 0.0, late_s=abs(clock.offset_s), late=late, remedy=remedy
    )


def judge_frame_rate(
    servo: list[Series], mocap: list[Series], meta: TrialMeta
) -> list[ImportFinding]:
    """Finding if two files that do not fit do so once the motion capture has another rate."""

    def fit(factor: float) -> float:
        stretched = [replace(s, time_s=factor * s.time_s) for s in mocap]
        try:
            return synchronise(servo, stretched, meta).correlation
        except InputError:
            return 0.0

    near = max((RATE_STEP**k for k in range(-70, 71)), key=fit)  # a quarter to four times
    factor = max(near * (1 + 0.002 * np.arange(-10, 11)), key=fit)
    correlation = fit(factor)
    if correlation < FITS or abs(factor - 1) < RATE_STEP - 1:
        return []
    file = mocap[0].path.name
    return causes.FRAME_RATE.raised(file=file, factor=factor, correlation=correlation)
