"""Feedback of a plan in its document: filters, bounds, margins, sensitivities to stiffness."""

from __future__ import annotations

from typing import Final

import msgspec
import numpy as np

__all__ = ["FeedbackDesign", "LoopMargins", "RateFilter", "StiffnessSlopes", "wrong_in_feedback"]

Columns = tuple[tuple[float, ...], ...]
MOST_STATES: Final = 20
"""Most states of a filter that is read [assumed]."""


class RateFilter(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Discrete filter from the error of the tip in m to the rate of the correction in rad/s."""

    a: Columns  # State matrix of the discrete filter at the period of the plan, shape (n, n)
    b: Columns  # Input matrix, shape (n, 1)
    c: Columns  # Output matrix, shape (1, n)
    d: Columns  # Feedthrough, shape (1, 1)


class LoopMargins(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Smallest stability margins of a loop over the linearised twins at one payload."""

    payload_kg: float
    gain_db: float  # Gain margin, with the delay of loop and bus
    phase_rad: float  # Phase margin, with the delay of loop and bus
    crossover_rad_s: float  # Frequency at which the gain of the loop is 1


class FeedbackDesign(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Feedback of the estimated tip, with a filter for each payload of the plan and each joint."""

    filters: tuple[tuple[RateFilter, ...], ...]  # Filters by payload, then by joint
    margins: tuple[tuple[LoopMargins, ...], ...]  # Stability margins by joint, then by payload
    size_rad: float  # Largest correction of a goal
    rate_rad_s: float  # Largest rate of the correction
    # Root mean square innovation of a current above which the estimate is rejected
    innovation_a: float


class StiffnessSlopes(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Sensitivities to the relative stiffness of the link, at every row of a plan."""

    goals_rad: Columns  # Sensitivity of the goals that keep the tip on the path
    current_a: Columns  # Sensitivity of the currents if link and goals change together
    unmatched_a: Columns  # Sensitivity of the currents if the link changes alone
    friction_a: Columns  # Sensitivity of the current of each joint to its relative friction
    # Weight of a sample of each joint: 0 at rest, where dry friction can take any value
    weight: Columns
    # Sensitivity of the true tip minus the estimate of an observer with the plant's stiffness
    unseen_m: Columns


def wrong_in_feedback(
    design: FeedbackDesign | None, slopes: tuple[StiffnessSlopes | None, ...], dof: int, rows: int
) -> str:
    """Return the first error in the feedback of a plan, as a sentence; empty for none."""
    if design is None:
        return ""
    if len(design.filters) != len(slopes) or any(len(own) != dof for own in design.filters):
        return f"needs a filter for each of {len(slopes)} payloads and {dof} joints"
    for own in (f for filters in design.filters for f in filters):
        n = len(own.a)
        shapes = ((own.a, n, n), (own.b, n, 1), (own.c, 1, n), (own.d, 1, 1))
        if not 1 <= n <= MOST_STATES or any(
            len(m) != rows_ or any(len(row) != columns for row in m) or not np.isfinite(m).all()
            for m, rows_, columns in shapes
        ):
            return "has a filter whose matrices do not fit together"
        if np.max(np.abs(np.linalg.eigvals(np.array(own.a)))) >= 1.0:
            return "has a filter that is not stable"
    bounds = design.size_rad, design.rate_rad_s, design.innovation_a
    if not (0 <= bounds[0] <= 0.2 and 0 < bounds[1] <= 10 and bounds[2] > 0):
        return f"has feedback with the bounds {bounds}"
    for one in slopes:
        for name in StiffnessSlopes.__struct_fields__ if one is not None else ():
            columns_: Columns = getattr(one, name)
            if len(columns_) != dof or any(len(c) != rows for c in columns_):
                return f"needs {dof} columns of {rows} rows in {name}"
            if not np.isfinite(columns_).all():
                return f"has a value in {name} that is not finite"
    return ""
