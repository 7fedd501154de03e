"""Findings on single values of an encoder: its count starts again, or one sample is wrong."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from firmware_py.display_units import ANGLE
from models.trials.importers.series import Series
from models.trials.trial import Array
from models.trials.verdict.finding import ImportFinding
from models.trials.verdict.motion_findings import LARGEST_RAD

WRAP_RAD: Final = 0.5
"""How far a jump between two samples may be from a turn to be the start of a new count."""
SPIKE_RAD: Final = 0.02
"""Least jump there and back that is a spike: thirteen steps of a coarse encoder."""
SPIKE_RAD_S2: Final = 300.0
"""Acceleration that no joint with the link reaches: five times the limit of the goals."""
SPIKE_NOISE: Final = 20.0
"""How many times its usual change of rate an angle must change its rate in a spike."""
MOST_NAMED: Final = 3


def judge_encoders(series: Sequence[Series], dof: int) -> tuple[list[ImportFinding], set[int]]:
    """Findings on angles and goals that start a new count, and on spikes of angles.

    Parameters
    ----------
    series : sequence of Series
        Of one file.
    dof : int
        Joints.

    Returns
    -------
    list of ImportFinding
        What was found.
    set of int
        Joints whose angle or goal starts a new count: nothing else can be said of them.
    """
    found: list[ImportFinding] = []
    wrapped: set[int] = set()
    for s in series:
        for j in range(1, dof + 1):
            names = [n for n in (f"angle_{j}_rad", f"goal_{j}_rad") if n in s.columns]
            if any(np.nanmax(np.abs(s.columns[n])) > LARGEST_RAD for n in names):
                continue  # in another unit
            wraps = [wrap for n in names if (wrap := _wrap(s, n))]
            found += wraps
            if wraps:
                wrapped.add(j)
            elif f"angle_{j}_rad" in names:
                found += _spikes(s, f"angle_{j}_rad")
    return found, wrapped


def _wrap(series: Series, name: str) -> ImportFinding | None:
    """Finding where a column jumps by a turn from one sample to the next."""
    jumps = np.diff(series.columns[name])
    at = np.flatnonzero(np.abs(np.abs(jumps) - 2 * np.pi) < WRAP_RAD)
    if not len(at):
        return None
    k = int(at[0])
    times = f", and {len(at) - 1} times more" if len(at) > 1 else ""
    return ImportFinding(
        "refused", "wrap",
        f"{name} jumps by {ANGLE.text(jumps[k])} from sample {k + 1} to {k + 2} "
        f"({series.time_s[k]:.2f} s){times}: its count starts again after a turn",
        "write it without jumps: where it counts from 0 to 360 deg, subtract 360 deg above 180 deg",
    )  # fmt: skip


def _spikes(series: Series, name: str) -> list[ImportFinding]:
    """Finding on samples that an angle leaves and comes back from faster than a joint can turn."""
    angle, time_s = series.columns[name], series.time_s
    there, back = np.diff(angle)[:-1], np.diff(angle)[1:]
    step_s = 0.5 * (time_s[2:] - time_s[:-2])
    size = np.where(there * back < 0, np.minimum(np.abs(there), np.abs(back)), 0.0)
    turn = np.abs(back - there)
    limit = np.maximum(SPIKE_RAD_S2 * step_s**2, SPIKE_NOISE * _usual(turn))
    alike = size > 0.5 * np.maximum(np.abs(there), np.abs(back))  # else the sample beside it
    at = np.flatnonzero((size > SPIKE_RAD) & (turn > limit) & alike) + 1
    if not len(at):
        return []
    first = at[:MOST_NAMED]
    listed = ", ".join(f"{k + 1} ({time_s[k]:.2f} s)" for k in first)
    more = f" and {len(at) - len(first)} more" if len(at) > len(first) else ""
    many = "s" if len(at) > 1 else ""
    return [
        ImportFinding(
            "warning", "spike",
            f"{name} jumps by {ANGLE.text(size[at - 1].max())} and back in sample{many} "
            f"{listed}{more}: no joint moves like that",
            "correct the sample by its neighbours, or cut the recording there",
        )
    ]  # fmt: skip


def _usual(change: Array) -> float:
    seen = change[np.isfinite(change)]
    return float(np.median(seen)) if len(seen) else 0.0
