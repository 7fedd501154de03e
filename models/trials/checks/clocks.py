"""Clocks of the files of a recording: uncertain, drifting, late, or at a wrong rate."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from firmware_py.core.errors import InputError
from models.trials.checks import causes
from models.trials.checks.causes import ImportFinding
from models.trials.checks.motion import LEAST_MOTION_RAD
from models.trials.clock import Synchronisation, synchronise
from models.trials.recordings.series import Series
from models.trials.trial import TrialMeta


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
    option_s: float, estimate: Synchronisation | None, apart_s: float
) -> list[ImportFinding]:
    """Finding if the user's offset differs from the estimate of signal or motion, if there is one.

    `apart_s` is added to both in the message, because clocks may count from an epoch.
    """
    if estimate is None:
        return []
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
    angles = [s for s in series if "angle_1_rad" in s.columns]
    if not angles or not any("m01_x_m" in s.columns for s in series):
        return None, []
    if not np.nanstd(angles[0].columns["angle_1_rad"]) > LEAST_MOTION_RAD:
        return None, []
    try:
        clock = synchronise(angles, series, meta)
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
