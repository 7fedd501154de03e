"""Check of one file's clock: its markers against its angles, which it stamps together."""

from __future__ import annotations

import numpy as np

from firmware_py.errors import InputError
from models.trials.importers.series import Series
from models.trials.importers.synchronisation import synchronise
from models.trials.trial import TrialMeta
from models.trials.verdict.finding import COMMON_CLOCK_S, ImportFinding, level_of
from models.trials.verdict.import_verdict import ImportVerdict
from models.trials.verdict.motion_findings import LEAST_MOTION_RAD


def check_common_clock(series: list[Series], meta: TrialMeta, verdict: ImportVerdict) -> None:
    """Add the clock, and a finding where the markers are late or early, to a verdict.

    Parameters
    ----------
    series : list of Series
        Of one file.
    meta : TrialMeta
        Joints, size and markers of the link.
    verdict : ImportVerdict
        Filled in.
    """
    angles = [s for s in series if "angle_1_rad" in s.columns]
    if not angles or not any("m01_x_m" in s.columns for s in series):
        return
    if not np.nanstd(angles[0].columns["angle_1_rad"]) > LEAST_MOTION_RAD:
        return
    try:
        clock = synchronise(angles, series, meta)
    except InputError:
        return  # the checks of the motion tell signs and joints apart
    verdict.clock = clock
    level = level_of(clock.offset_s, COMMON_CLOCK_S)
    if level and abs(clock.offset_s) > clock.error_s:
        late = "late" if clock.offset_s > 0 else "early"
        verdict.findings.append(
            ImportFinding(
                level, "clock",
                f"the markers are {abs(clock.offset_s):.3f} s {late} against the angles",
                "give the angles as a second file with --servo",
            )
        )  # fmt: skip
