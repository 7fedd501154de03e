"""Offset between the servo's clock and the motion capture's.

A hardware signal that both files recorded (`sync_v`) determines it directly. Otherwise both
recorded the same motion: the servo as its angle, the markers as the direction of the link. All
offsets and signs are searched (`models.trials.clock.offset_search`). Then the offset is fitted, and
the lag of the link's bend is removed (`models.trials.clock.offset_fit`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np

from firmware_py.errors import InputError
from models.shared.kinematics import pointing_angles_rad
from models.trials.clock.bending_lag import BendRatio, nominal_bend_ratio
from models.trials.clock.offset_fit import ClockDrift, OffsetFit, fit_offset
from models.trials.clock.offset_search import SEPARATION_S, ClockSignal, Peak, find_peaks
from models.trials.clock.sync_channel import EdgeOffset, edge_offsets, rising_edges_s
from models.trials.importers.mapping import BASE_MARKERS
from models.trials.importers.series import Series, row_centre_m
from models.trials.trial import Array, TrialMeta

LONGEST_S: Final = 10_000.0
"""Longest recording whose offset is searched: a million coarse steps."""
MIN_CORRELATION: Final = 0.9
"""Smallest correlation of two files with the same motion."""
SYNC: Final = "sync_v"
"""Name of a hardware synchronisation signal in a map's `[columns]` and `[servo_columns]`."""
FINE_S: Final = 0.001
"""Half width of the signal's offset above which the motion refines it: the clock's target."""
NEAR_FACTOR: Final = 3.0
NEAR_FLOOR: Final = 0.001
"""A second offset competes if its lack of correlation is below this multiple of the best one's plus
the floor [assumed: the study's motion, with its rest, has 0.07 to 0.09 at the second offset, ten
minutes of a nearly periodic motion 0.003]."""


@dataclass(frozen=True)
class Synchronisation:
    """Offset between servo and motion capture, with its error."""

    offset_s: float  # Add it to the servo's times to get times of the motion capture
    # Correlation of servo angle and direction of the link at that offset, at most 1. NaN if the
    # motion did not determine the offset.
    correlation: float
    error_s: float = 0.0  # Half width of the 95 % interval of the offset
    lag_s: float = 0.0  # Lag of the link's bend, removed from the offset
    second_offset_s: float = np.nan  # Best offset apart from the first; NaN if there is none
    second_correlation: float = np.nan
    # Source of the offset: the motion, a hardware signal, or the user's option
    by: Literal["motion", "sync", "option"] = "motion"
    fit: OffsetFit | None = None  # Fit to the motion, for the picture of its residuals
    # Change of the offset over the edges of a hardware signal
    edges_drift: ClockDrift | None = None

    @property
    def drifts(self) -> list[ClockDrift]:
        """Drifts of the offset, measured by edges and by motion."""
        told = (self.edges_drift, self.fit.drift if self.fit is not None else None)
        return [drift for drift in told if drift is not None]


def synchronise(servo: list[Series], mocap: list[Series], meta: TrialMeta) -> Synchronisation:
    """Estimate the offset between the clocks of two files, with its error.

    The motion capture needs the first marker row or the tip; its second row measures the bend.
    """
    by_edges = _by_edges(servo, mocap)
    if len(by_edges) == 1 and by_edges[0].error_s <= FINE_S:
        return _of_edges(by_edges[0])
    if by_edges:
        return _edge_with_motion(by_edges, servo, mocap, meta)
    return _by_motion(servo, mocap, meta)


def _by_motion(servo: list[Series], mocap: list[Series], meta: TrialMeta) -> Synchronisation:
    angle = _angle(servo, meta.dof)
    seen, bend, ratio = _direction(mocap, meta)
    for own, time_s in ((servo, angle.time_s), (mocap, seen.time_s)):
        if time_s[-1] - time_s[0] > LONGEST_S:
            what = f"lasts {time_s[-1] - time_s[0]:.3g} s, more than {LONGEST_S:g} s"
            raise InputError(own[0].path, what, "check the unit of its times, or give --offset")
    peaks = find_peaks(angle, seen)
    mapped = [peak for peak in peaks if peak.reading.as_mapped]
    _check_reading(servo, mocap, mapped, peaks)
    fit = fit_offset(angle, seen, bend, ratio, mapped[0].offset_s)
    if not fit.correlation >= MIN_CORRELATION:
        raise _unlike(servo, mocap, fit.correlation, fit.offset_s)
    second = _second(mapped, peaks)
    if second is not None and _is_near(second.correlation, mapped[0].correlation):
        raise InputError(
            servo[0].path,
            f"its angle and the motion in {mocap[0].path} agree at {fit.offset_s:.3f} s and nearly "
            f"as well at {second.offset_s:.3f} s (correlations {mapped[0].correlation:.4f} and "
            f"{second.correlation:.4f}): the motion repeats itself, with too little rest to tell",
            "record the rest before the motion in both files, or give --offset SECONDS",
        )
    return Synchronisation(
        fit.offset_s, fit.correlation, fit.error_s, fit.lag_s,
        second.offset_s if second else np.nan, second.correlation if second else np.nan, fit=fit,
    )  # fmt: skip


def offset_near(
    servo: list[Series], mocap: list[Series], meta: TrialMeta, given_s: float
) -> Synchronisation | None:
    """Offset from signal or motion, to be compared with one that the user gave.

    If the motion is periodic, the offset is fitted near the user's. None if it cannot be estimated.
    """
    try:
        return synchronise(servo, mocap, meta)
    except InputError:
        pass
    try:
        angle = _angle(servo, meta.dof)
        fit = fit_offset(angle, *_direction(mocap, meta), given_s)
    except (InputError, ValueError, IndexError):  # too little of the motion is in both
        return None
    if not fit.correlation >= MIN_CORRELATION:
        return None
    return Synchronisation(fit.offset_s, fit.correlation, fit.error_s, fit.lag_s, fit=fit)


def shift_clock(series: list[Series], offset_s: float) -> list[Series]:
    """Add `offset_s` to the times of series."""
    return [replace(s, time_s=s.time_s + offset_s) for s in series]


def without_sync(series: list[Series]) -> list[Series]:
    """Remove the synchronisation signal, which is not a signal of the trial."""
    return [
        replace(s, columns={n: v for n, v in s.columns.items() if n != SYNC}) if SYNC in s.columns
        else s
        for s in series
    ]  # fmt: skip


def _by_edges(servo: list[Series], mocap: list[Series]) -> list[EdgeOffset]:
    owners = [s for side in (servo, mocap) for s in side if SYNC in s.columns]
    if not all(any(SYNC in s.columns for s in side) for side in (servo, mocap)):
        return []
    edges = [rising_edges_s(s.time_s, s.columns[SYNC]) for s in (owners[0], owners[-1])]
    found = edge_offsets(*edges)
    if not found:
        raise InputError(
            owners[0].path,
            f"its {SYNC} has {len(edges[0])} rising edges, that of {owners[-1].path} "
            f"{len(edges[1])}, and they do not fit together",
            "map the same signal in both files, correct the unit and rate of their times, or leave "
            f"{SYNC} out",
        )
    return found


def _edge_with_motion(
    edges: list[EdgeOffset], servo: list[Series], mocap: list[Series], meta: TrialMeta
) -> Synchronisation:
    """Offset from a periodic or coarsely sampled signal, refined by the motion."""
    try:
        motion = _by_motion(servo, mocap, meta)
    except InputError as error:
        if len(edges) == 1:
            return _of_edges(edges[0])
        raise InputError(
            servo[0].path,
            f"its {SYNC} repeats itself and fits at {edges[0].offset_s:.3f} s and at "
            f"{edges[1].offset_s:.3f} s, and the motion does not decide: {error.what}",
            "send pulses at uneven times, or give --offset SECONDS",
        ) from None  # fmt: skip
    nearest = min(edges, key=lambda edge: abs(edge.offset_s - motion.offset_s))
    inside_s = float(np.clip(motion.offset_s, nearest.low_s, nearest.high_s))
    if abs(inside_s - motion.offset_s) > motion.error_s:  # the signal is trusted, not the motion
        return _of_edges(nearest)
    error_s = min(nearest.error_s, motion.error_s)
    return replace(motion, offset_s=inside_s, error_s=error_s, by="sync", edges_drift=nearest.drift)


def _of_edges(edge: EdgeOffset) -> Synchronisation:
    return Synchronisation(edge.offset_s, np.nan, edge.error_s, by="sync", edges_drift=edge.drift)


def _angle(servo: list[Series], dof: int) -> ClockSignal:
    names = [f"angle_{j}_rad" for j in range(1, dof + 1)]
    for series in servo:
        if all(name in series.columns for name in names):
            values = np.column_stack([series.columns[n] for n in names])
            whole = _complete(series, values)
            return ClockSignal(series.time_s[whole], values[whole])
    raise InputError(servo[0].path, f"has no {' and '.join(names)}", "map them under [columns]")


def _direction(mocap: list[Series], meta: TrialMeta) -> tuple[ClockSignal, Array | None, BendRatio]:
    """Direction of the link near its root, bend above, and nominal ratio of the bend below."""
    dof, layout = meta.dof, meta.layout
    ratio = nominal_bend_ratio(meta)
    for series in mocap:
        if all(f"{name}_z_m" in series.columns for name in BASE_MARKERS):  # the base does not bend
            b1, b2, b3, b4 = (series.position_m(name) for name in BASE_MARKERS)
            normal = pointing_angles_rad(np.cross(b1 + b3 - b2 - b4, b1 + b2 - b3 - b4))[:, :dof]
            whole = _complete(series, normal)
            return ClockSignal(series.time_s[whole], normal[whole]), None, BendRatio(0.0, 0.0)
    for series in mocap:
        if all(f"{name}_z_m" in series.columns for name in layout.row(0)):
            rows_m = [
                row_centre_m(np.array([series.position_m(n) for n in names]), layout.corners_m)
                for names in map(layout.row, range(min(layout.rows, 2)))
                if all(f"{name}_z_m" in series.columns for name in names)
            ]
            root = pointing_angles_rad(rows_m[0])[:, :dof]
            whole = _complete(series, root)
            bend = None
            if len(rows_m) > 1:
                above = pointing_angles_rad(rows_m[1] - rows_m[0])[:, :dof] - root
                bend = above[whole] if np.isfinite(above).all(axis=1).sum() > 100 else None
            return ClockSignal(series.time_s[whole], root[whole]), bend, ratio
    for series in mocap:
        if "tip_z_m" in series.columns:
            tip = pointing_angles_rad(series.position_m("tip"))[:, :dof]
            whole = _complete(series, tip)
            return ClockSignal(series.time_s[whole], tip[whole]), None, ratio
    row = f"{layout.row(0)[0]} … {layout.row(0)[-1]}"
    raise InputError(mocap[0].path, f"has neither {row} nor the tip", "map them under [markers]")


def _complete(series: Series, values: Array) -> Array:
    """Rows in which every value was measured."""
    whole = np.asarray(np.all(np.isfinite(values), axis=1))
    if whole.sum() < 3:
        raise InputError(series.path, "shows too little to synchronise", "give --offset SECONDS")
    return whole


def _check_reading(
    servo: list[Series], mocap: list[Series], mapped: list[Peak], peaks: list[Peak]
) -> None:
    """Refuse angles that fit better with other signs or in another order, or do not fit at all."""
    best = max((p.correlation for p in mapped), default=0.0)
    other = max(
        (p for p in peaks if not p.reading.as_mapped), key=lambda p: p.correlation, default=None
    )
    at_s = mapped[0].offset_s if mapped else 0.0
    if (
        other is not None
        and other.correlation >= MIN_CORRELATION
        and 1 - other.correlation < (1 - best) / NEAR_FACTOR
    ):
        raise InputError(
            servo[0].path,
            f"{_other_reading(other)}: so read, it fits the motion in {mocap[0].path} with a "
            f"correlation of {other.correlation:.4f}, as mapped with {best:.4f}",
            "check joint order, signs (scale = -1.0) and [frame] in MAP.toml, with mirror for a "
            "left-handed file",
        )
    if not best >= MIN_CORRELATION:
        raise _unlike(servo, mocap, best, at_s)


def _other_reading(peak: Peak) -> str:
    joints, signs = peak.reading
    turned = [f"joint {j + 1}" for j, sign in zip(joints, signs, strict=True) if sign < 0]
    said = []
    if list(joints) != sorted(joints):
        said.append("joints 1 and 2 are swapped")
    if turned:
        verb = "counts" if len(turned) == 1 else "count"
        said.append(f"the servo of {' and '.join(turned)} {verb} the other way")
    return ", and ".join(said)


def _second(mapped: list[Peak], peaks: list[Peak]) -> Peak | None:
    """Best peak at another offset, for any signs and order."""
    first_s = mapped[0].offset_s
    apart = [p for p in peaks if abs(p.offset_s - first_s) > SEPARATION_S]
    return max(apart, key=lambda p: p.correlation, default=None)


def _is_near(second: float, first: float) -> bool:
    return 1 - second < NEAR_FACTOR * (1 - first) + NEAR_FLOOR


def _unlike(
    servo: list[Series], mocap: list[Series], correlation: float, offset_s: float
) -> InputError:
    return InputError(
        servo[0].path,
        f"its angle and the motion in {mocap[0].path} correlate by {correlation:.2f} at best "
        f"(at {offset_s:.3f} s)",
        "check joint order, signs and [frame] in MAP.toml, or give --offset SECONDS",
    )
