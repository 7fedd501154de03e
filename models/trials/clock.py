"""Offset between the clocks of servo and motion capture.

A hardware signal that both files recorded (`sync_v`) gives it directly: every rising edge lies
between two samples, and the offset is what all edges leave. Otherwise both recorded the same
motion, the servo as its angle q and the markers as the direction c of the first marker row. First
all offsets, signs and orders of the joints are searched, so that a wrong sign is not mistaken for a
shift by half a period; then the offset is fitted in continuous time.

The link bends between the joint and the first row, and the bend lags the motion (hysteresis,
creep), so the direction seems to lag as well. With the bend s between the first two rows,

    c(t) - κ s(t) = a + g q(t - offset),

where κ is estimated from the recording, with the nominal link as prior. a and g absorb what is in
phase with the motion: offsets of the encoder and of the frame.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import permutations, product
from pathlib import Path
from typing import Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize_scalar
from scipy.signal import fftconvolve, find_peaks

from firmware_py.core.errors import InputError
from models.shared.kinematics import pointing_angles_rad
from models.trials.recordings.mapping import BASE_MARKERS
from models.trials.recordings.series import (
    Series,
    nominal_scale,
    row_centre_m,
    with_angles,
    with_markers,
)
from models.trials.trial import Array, TrialMeta

SYNC: Final = "sync_v"
"""Name of a hardware synchronisation signal in a map's `[columns]` and `[servo_columns]`."""


class UnlikeMotionsError(InputError):
    """Two files whose motions do not agree at any offset, or not well at several."""


class ClockDrift(NamedTuple):
    """Change of the offset from the first half of the motion to the second, or over sync edges."""

    change_s: float
    deviation_s: float  # Standard deviation of the change
    over_s: float  # Time between the middles of the halves, or between first and last edge


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
    drifts: tuple[ClockDrift, ...] = ()  # By edges and by motion, where they determine it
    # Direction without bend minus angle, about its mean, at the compared samples, (n, dof) in rad,
    # and their times on the motion capture's clock, (n,)
    residual: Array | None = None
    time_s: Array | None = None


def synchronise(
    servo: list[Series], mocap: list[Series], meta: TrialMeta, near_s: float | None = None
) -> Synchronisation:
    """Estimate the offset between the clocks of two files, with its error.

    The motion capture needs the first marker row or the tip; its second row measures the bend.
    Of a motion that agrees at several offsets, the one at `near_s` is fitted.
    """
    edges = _by_edges(servo, mocap)
    if len(edges) == 1 and edges[0].error_s <= FINE_S:
        return edges[0]
    try:
        motion = _by_motion(servo, mocap, meta, near_s)
    except InputError as error:
        if len(edges) == 1:
            return edges[0]
        if not edges:
            raise
        raise InputError(
            servo[0].path,
            f"its {SYNC} repeats itself and fits at {edges[0].offset_s:.3f} s and at "
            f"{edges[1].offset_s:.3f} s, and the motion does not decide: {error.what}",
            "send pulses at uneven times, or give --offset SECONDS",
        ) from None
    if not edges:
        return motion
    nearest = min(edges, key=lambda edge: abs(edge.offset_s - motion.offset_s))
    low_s, high_s = nearest.offset_s - nearest.error_s, nearest.offset_s + nearest.error_s
    inside_s = float(np.clip(motion.offset_s, low_s, high_s))
    if abs(inside_s - motion.offset_s) > motion.error_s:  # the signal is trusted, not the motion
        return nearest
    return replace(
        motion, offset_s=inside_s, error_s=min(nearest.error_s, motion.error_s), by="sync",
        drifts=nearest.drifts + motion.drifts,
    )  # fmt: skip


# --- by a synchronisation signal -----------------------------------------------------------------

FINE_S: Final = 0.001
"""Half width of the signal's offset above which the motion refines it: the clock's target."""
JITTER_S: Final = 2e-4
"""Error of a time stamp [assumed]."""
RATE_DIFFERENCE: Final = 3e-5
"""Relative difference of two clocks' rates: a crystal's tolerance of 30 ppm [assumed]."""


def _by_edges(servo: list[Series], mocap: list[Series]) -> list[Synchronisation]:
    first, second = (next((s for s in side if SYNC in s.columns), None) for side in (servo, mocap))
    if first is None or second is None:
        return []
    edges = [rising_edges_s(s.time_s, s.columns[SYNC]) for s in (first, second)]
    offsets = edge_offsets(*edges)
    if not offsets:
        raise InputError(
            first.path,
            f"its {SYNC} has {len(edges[0])} rising edges, that of {second.path} "
            f"{len(edges[1])}, and they do not fit together",
            "map the same signal in both files, correct the unit and rate of their times, or leave "
            f"{SYNC} out",
        )
    return offsets


def rising_edges_s(time_s: Array, level_v: Array) -> Array:
    """Times of the samples before and after each rise through mid-range, shape (edges, 2)."""
    measured = np.isfinite(level_v)
    time_s, level_v = time_s[measured], level_v[measured]
    if len(level_v) < 2 or np.ptp(level_v) < 0.5:  # logic is at 1.8 V or more
        return np.zeros((0, 2))
    middle = 0.5 * (level_v.min() + level_v.max())
    at = np.flatnonzero((level_v[:-1] < middle) & (level_v[1:] >= middle))
    return np.column_stack([time_s[at], time_s[at + 1]])


def edge_offsets(servo_s: Array, mocap_s: Array) -> list[Synchronisation]:
    """Offsets at which the edges (edges, 2) of two files match, the one with the most pairs first.

    Either file may lack edges at its ends: half of the edges of the file with fewer need a partner.
    There are several offsets if the signal is periodic, and none if nothing matches.
    """
    least = max(0.5 * min(len(servo_s), len(mocap_s)), 1)
    offsets = []
    for shift in range(1 - len(servo_s), len(mocap_s)):
        servo, mocap = servo_s[max(-shift, 0) :], mocap_s[max(shift, 0) :]
        pairs = min(len(servo), len(mocap))
        if pairs < least:
            continue
        servo, mocap = servo[:pairs], mocap[:pairs]
        slack_s = JITTER_S + RATE_DIFFERENCE * float(servo[-1, 1] - servo[0, 0])
        low_s = float(np.max(mocap[:, 0] - servo[:, 1])) - slack_s
        high_s = float(np.min(mocap[:, 1] - servo[:, 0])) + slack_s
        if low_s <= high_s:
            offset = Synchronisation(
                0.5 * (low_s + high_s), np.nan, 0.5 * (high_s - low_s), by="sync",
                drifts=_drift_of_edges(servo, mocap),
            )  # fmt: skip
            offsets.append((pairs, offset))
    return [offset for _, offset in sorted(offsets, key=lambda entry: -entry[0])]


def _drift_of_edges(servo_s: Array, mocap_s: Array) -> tuple[ClockDrift, ...]:
    """Change of the offset over pairs of edges, by a line through the middles of their intervals.

    An edge is uniformly distributed between its two samples: its variance is a twelfth of the
    square of their distance.
    """
    if len(servo_s) < 4:
        return ()
    time_s = mocap_s.mean(axis=1)
    centred_s = time_s - time_s.mean()
    slope = float(centred_s @ (time_s - servo_s.mean(axis=1)) / (centred_s @ centred_s))
    widths_s = [np.median(edges[:, 1] - edges[:, 0]) for edges in (servo_s, mocap_s)]
    deviation_s = np.hypot(np.linalg.norm(widths_s) / np.sqrt(12.0), JITTER_S)
    over_s = float(time_s[-1] - time_s[0])
    slope_deviation = float(deviation_s / np.linalg.norm(centred_s))
    return (ClockDrift(slope * over_s, slope_deviation * over_s, over_s),)


# --- by the motion -------------------------------------------------------------------------------

LONGEST_S: Final = 10_000.0
"""Longest recording whose offset is searched: a million coarse steps."""
MIN_CORRELATION: Final = 0.9
"""Smallest correlation of two files with the same motion."""
SAME_MOTION: Final = 0.97
"""Correlation above which two files certainly hold one motion; bend leaves 0.99 and more."""
NEAR_FACTOR: Final = 3.0
NEAR_FLOOR: Final = 0.001
"""A second offset competes if its lack of correlation is below this multiple of the best one's plus
the floor [assumed: the study's motion, with its rest, has 0.07 to 0.09 at the second offset, ten
minutes of a nearly periodic motion 0.003]."""


def _by_motion(
    servo: list[Series], mocap: list[Series], meta: TrialMeta, near_s: float | None
) -> Synchronisation:
    angle, direction = _angle(servo, meta.dof), _direction(mocap, meta)
    for side, time_s in ((servo, angle.time_s), (mocap, direction.root.time_s)):
        if time_s[-1] - time_s[0] > LONGEST_S:
            what = f"lasts {time_s[-1] - time_s[0]:.3g} s, more than {LONGEST_S:g} s"
            raise InputError(side[0].path, what, "check the unit of its times, or give --offset")
    files = f"its angle and the motion in {mocap[0].path}"

    def check_correlation(correlation: float, offset_s: float) -> None:
        if not correlation >= MIN_CORRELATION:
            raise UnlikeMotionsError(
                servo[0].path,
                f"{files} correlate by {correlation:.2f} at best (at {offset_s:.3f} s)",
                "check joint order, signs and [frame] in MAP.toml, or give --offset SECONDS",
            )

    peaks = correlation_peaks(angle, direction.root)
    mapped = [peak for peak in peaks if peak.as_mapped]
    first = mapped[0] if mapped else Peak(0.0, 0.0)
    other = max((p for p in peaks if not p.as_mapped), key=lambda p: p.correlation, default=None)
    if (
        other is not None
        and other.correlation >= MIN_CORRELATION
        and 1 - other.correlation < (1 - first.correlation) / NEAR_FACTOR
    ):
        raise InputError(
            servo[0].path,
            f"{other.words}: so read, it fits the motion in {mocap[0].path} with a "
            f"correlation of {other.correlation:.4f}, as mapped with {first.correlation:.4f}",
            "check joint order, signs (scale = -1.0) and [frame] in MAP.toml, with mirror for a "
            "left-handed file",
        )
    check_correlation(first.correlation, first.offset_s)
    motion = fit_offset(angle, direction, first.offset_s)
    check_correlation(motion.correlation, motion.offset_s)
    apart = (peak for peak in peaks if abs(peak.offset_s - first.offset_s) > SEPARATION_S)
    second = max(apart, key=lambda peak: peak.correlation, default=Peak(np.nan, np.nan))
    if 1 - second.correlation < NEAR_FACTOR * (1 - first.correlation) + NEAR_FLOOR:
        if near_s is not None:
            motion = fit_offset(angle, direction, near_s)
            check_correlation(motion.correlation, motion.offset_s)
            return motion
        kind = InputError if motion.correlation > SAME_MOTION else UnlikeMotionsError
        raise kind(
            servo[0].path,
            f"{files} agree at {motion.offset_s:.3f} s and nearly "
            f"as well at {second.offset_s:.3f} s (correlations {first.correlation:.4f} and "
            f"{second.correlation:.4f}): the motion repeats itself, with too little rest to tell",
            "record the rest before the motion in both files, or give --offset SECONDS",
        )
    return replace(motion, second_offset_s=second.offset_s, second_correlation=second.correlation)


class ClockSignal(NamedTuple):
    """Samples `values` (n, dof) of a file at times `time_s` (n,)."""

    time_s: Array
    values: Array
    path: Path


class Direction(NamedTuple):
    """Direction of the link near its root in rad, and what is known of its bend."""

    root: ClockSignal
    bend: Array | None = None  # Turn from the first row to the second, (n, dof), if measured
    # Nominal ratio κ of the bend below the first row to `bend`: of all bend, and of the lagging
    # bend, as shear is elastic and does not lag. Zero for the base plate, which does not bend.
    whole_ratio: float = 0.0
    late_ratio: float = 0.0


def _angle(servo: list[Series], dof: int) -> ClockSignal:
    angles = with_angles(servo, dof)
    if angles is None:
        names = " and ".join(f"angle_{j}_rad" for j in range(1, dof + 1))
        raise InputError(servo[0].path, f"has no {names}", "map them under [columns]")
    series, values = angles
    whole = _complete(series, values)
    return ClockSignal(series.time_s[whole], values[whole], series.path)


def _direction(mocap: list[Series], meta: TrialMeta) -> Direction:
    """Direction by the base plate, else by the first marker row, else by the tip."""
    layout, bend, ratios = meta.layout, None, nominal_bend_ratios(meta)
    if series := with_markers(mocap, *BASE_MARKERS):
        b1, b2, b3, b4 = (series.position_m(name) for name in BASE_MARKERS)
        root = pointing_angles_rad(np.cross(b1 + b3 - b2 - b4, b1 + b2 - b3 - b4))
        ratios = (0.0, 0.0)
    elif series := with_markers(mocap, *layout.row(0)):
        first_m = row_centre_m(series.positions_m(layout.row(0)), layout)
        root = pointing_angles_rad(first_m)
        if layout.rows > 1 and series.has(*layout.row(1)):
            second_m = row_centre_m(series.positions_m(layout.row(1)), layout)
            bend = pointing_angles_rad(second_m - first_m) - root
    elif series := with_markers(mocap, "tip"):
        root = pointing_angles_rad(series.position_m("tip"))
    else:
        row = f"{layout.row(0)[0]} … {layout.row(0)[-1]}"
        remedy = "map them under [markers]"
        raise InputError(mocap[0].path, f"has neither {row} nor the tip", remedy)
    root = root[:, : meta.dof]
    whole = _complete(series, root)
    if bend is not None:
        bend = bend[whole, : meta.dof]
        bend = bend if np.isfinite(bend).all(axis=1).sum() > LEAST_SAMPLES else None
    return Direction(ClockSignal(series.time_s[whole], root[whole], series.path), bend, *ratios)


def _complete(series: Series, values: Array) -> Array:
    """Rows in which every value was measured."""
    whole = np.asarray(np.all(np.isfinite(values), axis=1))
    if whole.sum() < 3:
        raise InputError(series.path, "shows too little to synchronise", "give --offset SECONDS")
    return whole


def nominal_bend_ratios(meta: TrialMeta) -> tuple[float, float]:
    """Bend below the first row over the bend between the first two: of all bend, without shear.

    They are those of a nominal link of this size under a force at its tip, and zero with one row.
    """
    if meta.layout.rows < 2:
        return 0.0, 0.0
    scale = nominal_scale(meta)
    rows_m = np.array(meta.layout.rows_m[:2])
    deflection_m, _ = scale.deflection(rows_m, 1.0)

    def ratio(first_m: float, second_m: float) -> float:
        below = first_m / (meta.base_offset_m + rows_m[0])
        return float(below / ((second_m - first_m) / (rows_m[1] - rows_m[0]) - below))

    return ratio(*deflection_m), ratio(*(deflection_m - rows_m / scale.shear_n))


# --- search over all offsets, signs and orders ---------------------------------------------------

COARSE_STEP_S: Final = 0.01
"""Step of the search in s."""
SEPARATION_S: Final = 0.25
"""Smallest distance of two peaks: the period of the fastest motion, 4 Hz."""


class Peak(NamedTuple):
    """Local maximum of the correlation over the offset, for one order and signs of the angles."""

    offset_s: float
    correlation: float
    # Which of the file's angles is compared with direction 1 and 2, counted from 0
    joints: tuple[int, ...] = (0,)
    signs: tuple[int, ...] = (1,)

    @property
    def as_mapped(self) -> bool:
        """Whether no sign is reversed and no joints are swapped."""
        return self.joints == tuple(sorted(self.joints)) and min(self.signs) > 0

    @property
    def words(self) -> str:
        """How the angles are read."""
        turned = [f"joint {j + 1}" for j, s in zip(self.joints, self.signs, strict=True) if s < 0]
        words = ["joints 1 and 2 are swapped"] if list(self.joints) != sorted(self.joints) else []
        if turned:
            verb = "counts" if len(turned) == 1 else "count"
            words.append(f"the servo of {' and '.join(turned)} {verb} the other way")
        return ", and ".join(words)


def correlation_peaks(angle: ClockSignal, direction: ClockSignal) -> list[Peak]:
    """Peaks over the offset: the best two as mapped, then the best of each other reading.

    The correlation is computed on a coarse grid, at every offset at which the overlap contains half
    of the motion of one file. There may be fewer peaks, or none.
    """
    a, b = _on_grid(angle), _on_grid(direction)
    covariance, enough = _covariances(a, b)
    start_s = float(direction.time_s[0] - angle.time_s[0]) - (len(a) - 1) * COARSE_STEP_S
    peaks: list[Peak] = []
    dof = a.shape[1]
    for joints, signs in product(permutations(range(dof)), product((1, -1), repeat=dof)):
        shared = sum(
            sign * covariance[:, j, k]
            for k, (j, sign) in enumerate(zip(joints, signs, strict=True))
        )
        score = np.where(enough, shared, -1.0)
        at, _ = find_peaks(score, height=0.0, distance=round(SEPARATION_S / COARSE_STEP_S) + 1)
        best = at[np.argsort(-score[at], kind="stable")]
        as_mapped = Peak(0.0, 0.0, joints, signs).as_mapped
        peaks += [
            Peak(start_s + k * COARSE_STEP_S, float(score[k]), joints, signs)
            for k in best[: 2 if as_mapped else 1].tolist()
        ]
    return peaks


def _on_grid(signal: ClockSignal) -> Array:
    grid_s = np.arange(signal.time_s[0], signal.time_s[-1], COARSE_STEP_S)
    columns = [np.interp(grid_s, signal.time_s, column) for column in signal.values.T]
    return np.asarray(np.column_stack(columns) - signal.values[0])


def _covariances(a: Array, b: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Covariance of each pair of columns at every lag, relative to all of both; enough overlap.

    Shape (lags, columns of a, columns of b), and (lags,).
    """

    def summed(x: Array, y: Array) -> Array:
        """Sum of x(t) y(t + lag) over the overlap at every lag, along axis 0."""
        return np.asarray(fftconvolve(y, x[::-1], axes=0))

    one_a, one_b = np.ones((len(a), 1)), np.ones((len(b), 1))
    count = np.maximum(np.round(summed(one_a, one_b)), 1.0)
    sum_a, sum_b = summed(a, one_b), summed(one_a, b)
    square_a = summed(np.sum(a**2, axis=1, keepdims=True), one_b)
    square_b = summed(one_a, np.sum(b**2, axis=1, keepdims=True))
    variance_a = square_a - np.sum(sum_a**2, axis=1, keepdims=True) / count
    variance_b = square_b - np.sum(sum_b**2, axis=1, keepdims=True) / count
    size = np.sqrt(np.maximum(variance_a * variance_b, 1e-30))
    shared = summed(a[:, :, None], b[:, None, :])
    covariance = shared - sum_a[:, :, None] * sum_b[:, None, :] / count[:, :, None]
    fraction = np.maximum(square_a / max(np.sum(a**2), 1e-30), square_b / max(np.sum(b**2), 1e-30))
    return covariance / size[:, :, None], ((fraction >= 0.5) & (count > 2))[:, 0]


# --- fit of the offset near the best peak --------------------------------------------------------

GAIN_DEVIATION: Final = 0.01
"""Standard deviation of g: the frame's origin is known to 3 mm at a row 0.3 m away [assumed]."""
RATIO_DEVIATION: Final = 0.5
"""Standard deviation of the ratio between links [assumed]. The ratio is 0.4 with a rigid root and 4
with a rigid span; the rig's links have 1.3 to 2.7."""
LAG_DEVIATION: Final = 0.05
"""Standard deviation of the lag of the bend relative to it, beyond that of the ratio: the bend
below the first row does not lag exactly like that above. On 13 rigs at 0 to 2 kg, with origins of
the frame known to 0 to 3 mm, it is 0.04 [measured]."""
UNCORRECTED_DEVIATION_S: Final = 0.004
"""The same without measured bend: the lag is 1 to 9 ms on the rig at 0 to 2 kg."""
FLOOR_S: Final = 3e-4
"""Standard deviation of what shifts the whole motion, whatever it is compared with: play and
wind-up of the gear behind the encoder. It is 0.2 to 0.4 ms on the same rigs [measured]."""
RANGE_S: Final = 0.03
"""Half width of the search around the coarse offset."""
MODEL_ERROR_S: Final = 0.25
"""Correlation time of model errors: the period of the fastest motion, 4 Hz."""
LEAST_SAMPLES: Final = 100
"""Fewest samples of half of the motion for its offset, or with a measured bend."""
FEWEST_COMPARED: Final = 10
"""Fewest samples of the motion capture that are compared with the angle [assumed]."""
DRIFT_FLOOR_S: Final = 1e-4
"""Standard deviation of the difference of two offsets, beyond that of their fits: encoder steps."""


def fit_offset(angle: ClockSignal, direction: Direction, start_s: float) -> Synchronisation:
    """Fit the offset near `start_s`, without the lag of the bend."""
    near = _Comparison.near(angle, direction, start_s)
    raw_s = offset_s = near.best(0.0)
    kappa, lag_deviation = np.zeros(angle.values.shape[1]), 0.0
    if direction.bend is not None:
        for _ in range(2):
            whole, deviation = near.bend_ratio(offset_s, direction.whole_ratio)
            kappa = whole * direction.late_ratio / direction.whole_ratio
            offset_s = near.best(kappa)
        lag_deviation = float(np.max(deviation / np.maximum(whole, deviation)))
    fit = near.at(offset_s, kappa)
    lag_s = raw_s - offset_s
    is_uncorrected = direction.bend is None and direction.whole_ratio > 0
    deviations_s = [
        fit.standard_error_s(),
        lag_deviation * lag_s,
        LAG_DEVIATION * lag_s,
        UNCORRECTED_DEVIATION_S if is_uncorrected else 0.0,
        FLOOR_S,
    ]
    return Synchronisation(
        offset_s,
        fit.correlation,
        float(1.96 * np.linalg.norm(deviations_s)),
        lag_s,
        drifts=_drift(near, fit, kappa),
        residual=fit.residual,
        time_s=fit.time_s,
    )


def _drift(near: _Comparison, fit: _Fit, kappa: Array) -> tuple[ClockDrift, ...]:
    """Drift between two halves of the motion with equal information on the offset."""
    weight, time_s = np.sum(fit.rate**2, axis=1), fit.time_s
    if len(time_s) < 2 * LEAST_SAMPLES:
        return ()
    information = np.cumsum(weight)
    split = int(np.searchsorted(information, information[-1] / 2))
    offsets, deviations, middles = [], [], []
    for half in (slice(None, split), slice(split, None)):
        if len(time_s[half]) < LEAST_SAMPLES:
            return ()
        part = near.within(time_s[half][0], time_s[half][-1])
        offsets.append(part.best(kappa))
        deviations.append(part.at(offsets[-1], kappa).standard_error_s())
        middles.append(float(np.average(time_s[half], weights=weight[half])))
    deviation_s = float(np.linalg.norm([*deviations, DRIFT_FLOOR_S]))
    return (ClockDrift(offsets[1] - offsets[0], deviation_s, middles[1] - middles[0]),)


class _Fit(NamedTuple):
    """Comparison of direction and angle at one offset, at n samples in which both are known."""

    time_s: Array  # On the motion capture's clock, (n,)
    residual: Array  # (n, dof)
    rate: Array  # Change of the direction per time by the angle, (n, dof)
    correlation: float

    def standard_error_s(self) -> float:
        """Standard error of the offset; residuals within one second count as dependent."""
        block = (self.time_s - self.time_s[0]).astype(int)
        moment = np.bincount(block, np.sum(self.residual * self.rate, axis=1))
        return float(np.sqrt(np.sum(moment**2)) / max(np.sum(self.rate**2), 1e-30))


@dataclass
class _Comparison:
    """Samples of the link's direction to compare with the angle at offsets near a first one."""

    angle: CubicSpline
    start_s: float
    time_s: Array  # On the motion capture's clock
    root: Array
    bend: Array

    @classmethod
    def near(cls, angle: ClockSignal, direction: Direction, start_s: float) -> _Comparison:
        """Comparison of the samples that no gap of the servo's log hides."""
        time_s, values, path = direction.root
        shifted, steps = time_s - start_s, np.diff(angle.time_s)
        inside = (shifted >= angle.time_s[0] + RANGE_S) & (shifted <= angle.time_s[-1] - RANGE_S)
        after = np.clip(np.searchsorted(angle.time_s, shifted), 1, len(angle.time_s) - 1)
        inside &= steps[after - 1] <= 3 * np.median(steps)
        bend = np.zeros_like(values) if direction.bend is None else direction.bend
        if np.isfinite(bend[inside]).all(axis=1).sum() < FEWEST_COMPARED:
            raise InputError(
                angle.path,
                f"nearly all samples of {path} lie in gaps of its times",
                "record the angle at a uniform step, or give --offset SECONDS",
            )
        spline = CubicSpline(angle.time_s, angle.values)
        return cls(spline, start_s, time_s[inside], values[inside], bend[inside])

    def within(self, first_s: float, last_s: float) -> _Comparison:
        rows = (self.time_s >= first_s) & (self.time_s <= last_s)
        return replace(self, time_s=self.time_s[rows], root=self.root[rows], bend=self.bend[rows])

    def best(self, kappa: Array | float) -> float:
        """Offset with the least sum of squares at these ratios."""
        least = minimize_scalar(
            lambda offset_s: float(np.sum(self.at(offset_s, kappa).residual ** 2)),
            bounds=(self.start_s - RANGE_S, self.start_s + RANGE_S),
            method="bounded",
            options={"xatol": 1e-6},
        )
        return float(least.x)

    def at(self, offset_s: float, kappa: Array | float) -> _Fit:
        y = self.root - kappa * self.bend
        known = np.all(np.isfinite(y), axis=1)
        time_s = self.time_s[known]
        q, y = self.angle(time_s - offset_s), y[known]
        q, y = q - q.mean(axis=0), y - y.mean(axis=0)
        power, shared = np.sum(q * q, axis=0), np.sum(q * y, axis=0)
        gain = shared / np.maximum(power, 1e-30)
        size = np.sqrt(power.sum() * np.sum(y * y))
        correlation = float(shared.sum() / size) if size > 0 else 0.0
        rate = gain * self.angle(time_s - offset_s, 1)
        return _Fit(time_s, y - gain * q, rate, correlation)

    def bend_ratio(self, offset_s: float, nominal: float) -> tuple[Array, Array]:
        """Ratio of all bend and its standard deviation, of each joint, (dof,) each.

        It is fitted to the bend in phase with the motion; a term in the rate absorbs what is out of
        phase: an error of the offset, and the lag itself. The noise of the markers, which would
        lower the ratio (errors in variables), is estimated from second differences.
        """
        known = np.all(np.isfinite(self.root + self.bend), axis=1)
        at_s, bend = self.time_s[known] - offset_s, self.bend[known]
        q, rates = self.angle(at_s), self.angle(at_s, 1)
        below = self.root[known] - q
        noise_bend = _noise_covariance(bend, bend)
        noise_shared = _noise_covariance(below, bend)
        # The model error, a tenth of the bend, is correlated over a quarter of a second.
        alike = max(MODEL_ERROR_S / float(np.median(np.diff(self.time_s))), 1.0)
        variance = alike * np.maximum(np.var(below, axis=0) * 1e-2, 1e-8)
        prior = RATIO_DEVIATION**-2
        ratios, deviations = [], []
        for j in range(q.shape[1]):
            x, s, r, y = (v[:, j] - v[:, j].mean() for v in (q, bend, rates, below))
            design = np.column_stack([x, s, r])
            matrix, right = design.T @ design, design.T @ y
            matrix[1, 1] -= len(x) * noise_bend[j]
            right[1] -= len(x) * noise_shared[j]
            matrix = matrix / variance[j] + np.diag([GAIN_DEVIATION**-2, prior, 1e-9])
            right = right / variance[j] + np.array([0.0, nominal * prior, 0.0])
            ratios.append(np.linalg.solve(matrix, right)[1])
            # The noise may exceed a bend that is hardly there; then only the prior is known.
            square = np.linalg.inv(matrix)[1, 1]
            deviations.append(np.sqrt(square) if 0.0 < square < 1 / prior else RATIO_DEVIATION)
        low, high = nominal - 3 * RATIO_DEVIATION, nominal + 3 * RATIO_DEVIATION
        return np.clip(ratios, max(low, 0.0), high), np.array(deviations)


def _noise_covariance(a: Array, b: Array) -> Array:
    """Covariance of the white noise of two signals, per column."""
    return np.asarray(np.mean(np.diff(a, 2, axis=0) * np.diff(b, 2, axis=0), axis=0) / 6.0)
