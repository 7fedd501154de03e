"""Trial made of a run in software: measured angles and currents beside the true tip."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from firmware_py.goals.outside.for_robot import NAME as OUTSIDE
from firmware_py.signals import joint_signals, tip_names
from hil.sil.prediction_error import true_tip_m
from hil.sil.sil_loop import SilResult
from hil.sil.sil_options import SilOptions
from models.trials.trial import Trial, TrialMeta

PRESSURE_PA: Final = 41_300.0
"""Pressure that the plant's parameters stand for (docs/sources.md, "The link")."""
_MARKERS = tuple(f"m{i:02d}_{axis}_m" for i in range(1, 17) for axis in "xyz")


def as_trial(result: SilResult, options: SilOptions) -> Trial:
    """Return the run as a trial: what the servos measured beside the true tip.

    The emulator has no markers: their cells stay empty. Slots that were skipped and ticks without
    fresh data are interpolated, and the notes count them, since a trial has a uniform time step.

    Parameters
    ----------
    result : SilResult
        The run.
    options : SilOptions
        Its options; its plant must be a link.
    """
    records = result.records
    tip = true_tip_m(records, result.outcome.truth)
    fresh = np.isfinite(tip[:, 0])
    grid = np.arange(records["tick"][0], records["tick"][-1] + 1)
    columns = {"time_s": (grid - grid[0]) * options.period_s}
    known = {s.name: records[s.name] for s in joint_signals(options.dof)}
    known |= {name: tip[:, k] for k, name in enumerate(tip_names())}
    for name, values in known.items():
        columns[name] = np.interp(grid, records["tick"][fresh], values[fresh])
    columns |= {name: np.full(len(grid), np.nan) for name in _MARKERS}
    geometry = result.geometry or {}
    filled, rest_s = len(grid) - int(fresh.sum()), options.motion.rest_s
    conditions: dict[str, Any]
    if options.plan is not None:
        conditions, rest_s = options.plan.conditions(), options.plan.rest_s
    elif options.goals is not None:
        conditions, rest_s = {"motion": OUTSIDE, "period_s": options.seconds}, 0.0
    else:
        motion = options.motion.motion(options.dof)
        conditions = {
            "motion": motion.name,
            "period_s": motion.period_s,
            "amplitude_rad": motion.amplitude_rad,
            "phase_2_rad": motion.phase_2_rad if options.dof == 2 else 0.0,
        }
    meta = TrialMeta(
        dof=options.dof,
        payload_kg=options.payload_kg,
        pressure_pa=PRESSURE_PA,
        trial=1,
        source="sil",
        **conditions,
        rest_samples=min(max(round(rest_s / options.period_s), 1), len(grid) - 1),
        notes=f"{filled} of {len(grid)} rows interpolated" if filled else "",
        base_offset_m=geometry["base_offset_m"],
        link_length_m=geometry["link_length_m"],
        link_width_m=geometry["link_width_m"],
    )
    return Trial("sil", meta, columns)
