"""Findings on single samples of a servo: an angle that wraps, a wrong angle or current."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from firmware_py.display_units import ANGLE
from models.trials.importers.series import Series
from models.trials.trial import Array
from models.trials.verdict.finding import ImportFinding
from models.trials.verdict.motion_findings import LARGEST_RAD

WRAP_RAD: Final = 0.5
"""Largest difference of a jump between two samples from one turn that counts as a wrap."""
SPIKE_RAD: Final = 0.02
"""Smallest jump there and back of a spike: thirteen steps of a coarse encoder."""
SPIKE_RAD_S2: Final = 300.0
"""Acceleration that no joint with the link reaches: five times the goals' limit."""
SPIKE_NOISE: Final = 20.0
"""Smallest change of rate in a spike, relative to the median change."""
SPIKE_A: Final = 0.1
"""Smallest jump there and back of a spike of the current."""
SPIKE_PART: Final = 0.25
"""The same, relative to the range of all other samples: at most 0.02 on the recordings of three
machines (docs/sources.md), 0.7 where a rig's current is only noise."""
SPIKE_TIMES: Final = 5.0
"""Smallest jump of a spike, relative to the 95th percentile of jumps: 2.4 for noise only."""
SETTLED_S: Final = 0.1
"""Time after a step of the goal during which a current may jump too."""
MOST_NAMED: Final = 3


def judge_encoders(series: Sequence[Series], dof: int) -> tuple[list[ImportFinding], set[int]]:
    """Findings on angles and goals that wrap, and on spikes; with the joints that wrap."""
    found: list[ImportFinding] = []
    wrapped: set[int] = set()
    for s in series:
        for j in range(1, dof + 1):
            if f"current_{j}_a" in s.columns:
                found += _current_spikes(s, f"current_{j}_a", _step_times_s(series, j))
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
    """Finding if a column jumps by a turn between two samples."""
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
    """Finding on samples with an angle that jumps and returns faster than a joint can turn."""
    angle, time_s = series.columns[name], series.time_s
    there, back = np.diff(angle)[:-1], np.diff(angle)[1:]
    step_s = 0.5 * (time_s[2:] - time_s[:-2])
    size = np.where(there * back < 0, np.minimum(np.abs(there), np.abs(back)), 0.0)
    turn = np.abs(back - there)
    limit = np.maximum(SPIKE_RAD_S2 * step_s**2, SPIKE_NOISE * _usual(turn))
    alike = size > 0.5 * np.maximum(np.abs(there), np.abs(back))  # else it is an adjacent sample
    at = np.flatnonzero((size > SPIKE_RAD) & (turn > limit) & alike) + 1
    if not len(at):
        return []
    return [
        ImportFinding(
            "warning", "spike",
            f"{name} jumps by {ANGLE.text(size[at - 1].max())} and back in {_listed(at, time_s)}: "
            "no joint moves like that",
            "correct the sample by its neighbours, or cut the recording there",
        )
    ]  # fmt: skip


def _step_times_s(series: Sequence[Series], joint: int) -> Array:
    """Times at which a goal steps: the servo's current responds for one or two samples."""
    name, times = f"goal_{joint}_rad", [np.zeros(0)]
    for s in (s for s in series if name in s.columns):
        changes = np.diff(s.columns[name])
        at = np.flatnonzero(np.abs(changes) > 0)
        size, time_s = np.abs(changes[at]), s.time_s[at + 1]
        beside = np.zeros(len(at))  # changes just before and after, as in a moving goal
        close = np.diff(time_s) < SETTLED_S
        beside[1:] = np.where(close, size[:-1], 0.0)
        beside[:-1] = np.maximum(beside[:-1], np.where(close, size[1:], 0.0))
        times.append(time_s[(size > SPIKE_RAD) & (size > 3 * beside)])
    return np.sort(np.concatenate(times))


def _current_spikes(series: Series, name: str, steps_s: Array) -> list[ImportFinding]:
    """Finding on samples with a current that jumps and returns, far beyond all others.

    Reversing friction is a step without return, and held goals cause small jumps repeatedly.
    """
    current, time_s = series.columns[name], series.time_s
    if not np.isfinite(current).all() or len(current) < 8:
        return []
    there, back = np.diff(current)[:-1], np.diff(current)[1:]
    size = np.where(there * back < 0, np.minimum(np.abs(there), np.abs(back)), 0.0)
    alike = size > 0.5 * np.maximum(np.abs(there), np.abs(back))  # else it is an adjacent sample
    beyond = (size > SPIKE_TIMES * np.percentile(size, 95)) & alike & (size > SPIKE_A)
    others = np.delete(current, np.flatnonzero(beyond) + 1)
    at = np.flatnonzero(beyond & (size > SPIKE_PART * np.ptp(others))) + 1
    apart_s = np.abs(time_s[at, None] - steps_s).min(axis=1, initial=np.inf)
    at = at[apart_s > SETTLED_S]
    if not len(at):
        return []
    k = int(at[np.argmax(size[at - 1])])
    return [
        ImportFinding(
            "warning", "spike",
            f"{name} jumps to {current[k]:.3g} A and back in {_listed(at, time_s)}, the others lie "
            f"between {others.min():.3g} and {others.max():.3g} A",
            "correct the sample by its neighbours: one such sample changes a fit",
        )
    ]  # fmt: skip


def _listed(at: NDArray[np.intp], time_s: Array) -> str:
    """Samples in words."""
    first = at[:MOST_NAMED]
    listed = ", ".join(f"{k + 1} ({time_s[k]:.2f} s)" for k in first)
    more = f" and {len(at) - len(first)} more" if len(at) > len(first) else ""
    return f"sample{'s' if len(at) > 1 else ''} {listed}{more}"


def _usual(change: Array) -> float:
    seen = change[np.isfinite(change)]
    return float(np.median(seen)) if len(seen) else 0.0
