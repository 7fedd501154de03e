"""A run in software as a trial: measured angles and currents together with the true tip."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np

from firmware_py.core.signals import joint_signals, marker_signals, tip_names
from firmware_py.link.marker_layout import MarkerLayout
from firmware_py.log.recording import OUTSIDE
from hil.sil.prediction_error import true_tip_m
from hil.sil.sil_loop import SilResult
from hil.sil.sil_options import SilOptions
from models.trials.trial import Trial, TrialMeta, rows_at_rest


def as_trial(result: SilResult, options: SilOptions) -> Trial:
    """Return the run as a trial: the servos' measurements and the true tip.

    The emulator has no markers, so their cells stay empty. A trial has a uniform time step, so
    skipped slots and ticks without fresh data are interpolated; the notes count them.
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
    filled, rest_s = len(grid) - int(fresh.sum()), options.motion.rest_s
    link, conditions = result.link or {}, dict[str, Any]()
    if options.plan is not None:
        conditions, rest_s = options.plan.conditions(), options.plan.rest_s
    elif options.goals is not None:
        goals = np.column_stack([columns[f"goal_{j}_rad"] for j in range(1, options.dof + 1)])
        rest_s = rows_at_rest(goals) * options.period_s
        conditions = {
            "motion": OUTSIDE,
            "period_s": max(len(goals) * options.period_s - rest_s, options.period_s),
            "amplitude_rad": float(np.abs(goals).max()),
        }
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
        trial=1,
        source="sil",
        **conditions,
        rest_samples=min(max(round(rest_s / options.period_s), 1), len(grid) - 1),
        notes=f"{filled} of {len(grid)} rows interpolated" if filled else "",
        **{key: value for key, value in link.items() if key != "markers"},
        markers=msgspec.convert(link["markers"], MarkerLayout) if "markers" in link else None,
    )
    for signal in marker_signals(meta.layout.count):
        columns[signal.name] = np.full(len(grid), np.nan)
    return Trial("sil", meta, columns)
