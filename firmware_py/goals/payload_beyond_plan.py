"""Comparison of the payload of a run with the payloads of its plan.

A known payload beyond them is refused before the run. An estimated one is known only during the
run, whose goals are then those of the nearest payload. The same holds for a recorded run.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from firmware_py.goals.tip_plan import TipPlan
from firmware_py.safety.states import SafetyState
from firmware_py.summary import RunSummary

__all__ = ["payload_beyond_plan", "recording_beyond_plan"]

TOLERANCE: Final = 0.05
"""Excess that is reported, relative to the largest payload of the plan, or in kg if that is zero
[assumed: the estimate of a payload at the end of the grid may exceed it by as much]."""


def payload_beyond_plan(plan: TipPlan, told_kg: float | None, summary: RunSummary) -> str:
    """Return a sentence if the estimated payload was outside the range of the plan, or "".

    The estimate is the median over the second half of the motion, when it has settled.

    `told_kg`: known payload of the run; None if it was estimated.
    """
    if told_kg is not None:
        return ""
    records = summary.records
    moving = (records["tick"] >= 0) & (records["state"] < SafetyState.STOPPING)
    estimated_kg = records["payload_kg"][moving & np.isfinite(records["payload_kg"])]
    settled_kg = estimated_kg[len(estimated_kg) // 2 :]
    if not len(settled_kg):
        return ""
    payload_kg = float(np.median(settled_kg))
    nearest_kg = _nearest_kg(plan, payload_kg)
    if nearest_kg is None:
        return ""
    return (
        f"the payload is estimated at {payload_kg:.2f} kg, the plan holds "
        f"{plan.payloads_in_words}: its goals were those for {nearest_kg:g} kg, and the tip is "
        "further off its path than the plan expects; plan again with --payloads that enclose it"
    )


def recording_beyond_plan(plan: TipPlan, payload_kg: float) -> str:
    """Return a sentence if a recorded payload is outside the range of the run's plan, or ""."""
    nearest_kg = _nearest_kg(plan, payload_kg)
    if nearest_kg is None:
        return ""
    return (
        f"the payload of the recording is {payload_kg:g} kg, the plan holds "
        f"{plan.payloads_in_words}: what it learns is for {nearest_kg:g} kg, and it stays without "
        f"goals for {payload_kg:g} kg; plan again with --payloads that enclose it, and run that"
    )


def _nearest_kg(plan: TipPlan, payload_kg: float) -> float | None:
    """Return the end of the grid that a payload lies beyond; None if it lies inside."""
    low, high = float(plan.grid_kg[0]), float(plan.grid_kg[-1])
    nearest_kg = min(max(payload_kg, low), high)
    return nearest_kg if abs(payload_kg - nearest_kg) > TOLERANCE * (high or 1.0) else None
