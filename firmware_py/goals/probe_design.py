"""Probing motion in the document of a plan: goals, and features of the currents along it.

The goals are the same for every payload. Planning has reduced the currents of the whole motion to
a few linear features, with their expected values over a grid of relative stiffness and payload.
The features are whitened: their noise, including friction and the other uncertain parameters of the
plant, is uncorrelated with standard deviation 1.
"""

from __future__ import annotations

from typing import Final

import msgspec
import numpy as np

__all__ = ["ProbeDesign", "wrong_in_probe"]

Columns = tuple[tuple[float, ...], ...]
MOST_ROWS: Final = 2_000
MOST_FEATURES: Final = 40
MOST_NODES: Final = 200
"""Largest probing motion that is read: rows, features, nodes of an axis [assumed]."""
MOST_VALUE: Final = 1e6


class ProbeDesign(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Probing motion that precedes the first run of a plan."""

    # Goals relative to the plan's first row, one column per joint, beginning and ending at zero
    goals_rad: Columns
    # Weights of the currents in 1/A: for each feature a column per joint, one value per row
    weights: tuple[Columns, ...]
    stiffness: tuple[
        float, ...
    ]  # Grid of relative stiffness, 0 for the plant's, in equal rising steps
    payloads_kg: tuple[float, ...]  # Grid of payloads, in equal rising steps
    expected: tuple[
        tuple[tuple[float, ...], ...], ...
    ]  # Expected features by stiffness and payload

    @property
    def rows(self) -> int:
        """Number of control periods."""
        return len(self.goals_rad[0])


def wrong_in_probe(probe: ProbeDesign | None, dof: int) -> str:
    """Return the first error in a probing motion, as a sentence; empty for none."""
    if probe is None:
        return ""
    rows = len(probe.goals_rad[0]) if probe.goals_rad else 0
    tables = probe.goals_rad, *probe.weights
    if not 2 <= rows <= MOST_ROWS or not 1 <= len(probe.weights) <= MOST_FEATURES:
        return f"has a probe of {rows} rows and {len(probe.weights)} features"
    if any(len(t) != dof or any(len(c) != rows for c in t) for t in tables):
        return f"needs {dof} columns of {rows} rows in its probe"
    sizes = len(probe.stiffness), len(probe.payloads_kg)
    if not all(3 <= size <= MOST_NODES for size in sizes):
        return f"has a probe with a grid of {sizes[0]} times {sizes[1]} nodes"
    for axis in (probe.stiffness, probe.payloads_kg):
        steps = np.diff(axis)
        if not (steps[0] > 1e-3 and np.allclose(steps, steps[0])):
            return "has a probe whose grid does not rise in equal steps"
    if probe.stiffness[0] <= -1.0 or probe.payloads_kg[0] < 0.0:
        return "has a probe with a link without stiffness or a negative payload"
    if len(probe.expected) != sizes[0] or any(
        len(own) != sizes[1] or any(len(f) != len(probe.weights) for f in own)
        for own in probe.expected
    ):
        return "has a probe whose expected features do not fit its grid"
    values = (*tables, probe.stiffness, probe.payloads_kg, probe.expected)
    if not all(np.all(np.abs(np.array(v)) <= MOST_VALUE) for v in values):
        return f"has a value in its probe that is not finite or beyond {MOST_VALUE:g}"
    if any(abs(column[k]) > 1e-9 for column in probe.goals_rad for k in (0, -1)):
        return "has a probe that does not begin and end at zero"
    return ""
