"""Feedback of a plan in its document: filters, bounds, margins, slopes by stiffness."""

from __future__ import annotations

from typing import Final

import msgspec
import numpy as np

__all__ = ["FeedbackDesign", "LoopMargins", "RateFilter", "StiffnessSlopes", "wrong_in_feedback"]

Columns = tuple[tuple[float, ...], ...]
MOST_STATES: Final = 20
"""States of the largest filter that is read [assumed]."""


class RateFilter(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Discrete filter from the error of the tip in m to the rate of the correction in rad/s."""

    # State-space matrices with the period of the plan, shapes (n, n), (n, 1), (1, n) and (1, 1)
    a: Columns
    b: Columns
    c: Columns
    d: Columns


class LoopMargins(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Least margins of a loop over the linearised twins at one payload."""

    payload_kg: float
    gain_db: float  # Gain and phase margin, delay of loop and bus included
    phase_rad: float
    crossover_rad_s: float  # Frequency at which the gain of the loop is 1


class FeedbackDesign(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Feedback of the estimated tip, one filter for each payload of the plan and joint."""

    filters: tuple[tuple[RateFilter, ...], ...]  # By payload, then by joint
    margins: tuple[tuple[LoopMargins, ...], ...]  # By joint, then by payload
    size_rad: float  # Largest correction of a goal and its largest rate
    rate_rad_s: float
    # Root mean square innovation of a current above which the estimate is not trusted
    innovation_a: float


class StiffnessSlopes(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Differences that a stiffer link makes, per relative stiffness, at every row of a plan."""

    goals_rad: Columns  # Goals that follow the path with the stiffer link
    current_a: Columns  # Currents, link and goals changed together
    unmatched_a: Columns  # Currents, the link alone changed
    friction_a: Columns  # Current of each joint per relative friction
    # Weight of a sample of each joint: none at rest, where dry friction can take any value
    weight: Columns
    unseen_m: Columns  # True tip beyond that of an observer that does not know of the change


def wrong_in_feedback(
    design: FeedbackDesign | None, slopes: tuple[StiffnessSlopes | None, ...], dof: int, rows: int
) -> str:
    """First thing in the feedback of a plan that cannot be, as a sentence; empty for none."""
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
