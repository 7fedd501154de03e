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

from copy import copy
from dataclasses import dataclass, replace
from itertools import permutations, product
from typing import Final, Literal, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize_scalar
from scipy.signal import correlate
from scipy.signal import find_peaks as maxima

from firmware_py.errors import InputError
from firmware_py.link.link_description import STUDY_LINK
from models.shared.kinematics import pointing_angles_rad
from models.shared.link_scale import LinkScale
from models.trials.recordings.mapping import BASE_MARKERS
from models.trials.recordings.series import Series, row_centre_m
from models.trials.trial import Array, TrialMeta

SYNC: Final = "sync_v"
"""Name of a hardware synchronisation signal in a map's `[columns]` and `[servo_columns]`."""
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


class UnlikeMotionsError(InputError):
    """Two files whose motions do not agree at any offset, or not well at several."""


class ClockDrift(NamedTuple):
    """Change of the offset from the first half of the motion to the second, or over sync edges."""

    # Offset of the second half minus that of the first, or at the last edge minus at the first
    change_s: float
    deviation_s: float  # Standard deviation of the change
    over_s: float  # Time between the middles of the halves, or between those edges


class OffsetFit(NamedTuple):
    """Offset fitted to the motion."""

    offset_s: float  # Add it to the servo's times
    error_s: float  # Half width of the 95 % interval of the offset
    lag_s: float  # Lag of the bend, removed from the offset
    correlation: float  # Correlation of angle and direction at the offset
    # Direction without bend minus angle, about its mean, at every compared sample; (n, dof), rad
    residual: Array
    time_s: Array  # Times of these samples on the motion capture's clock, (n,)
    drift: ClockDrift | None = None  # None if half of the motion has too few samples


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
    fit: OffsetFit | None = None
    # Change of the offset over the edges of a hardware signal
    edges_drift: ClockDrift | None = None

    @property
    def drifts(self) -> list[ClockDrift]:
        """Drifts of the offset, measured by edges and by motion."""
        drifts = (self.edges_drift, self.fit.drift if self.fit is not None else None)
        return [drift for drift in drifts if drift is not None]


def synchronise(servo: list[Series], mocap: list[Series], meta: TrialMeta) -> Synchronisation:
    """Estimate the offset between the clocks of two files, with its error.

    The motion capture needs the first marker row or the tip; its second row measures the bend.
    """
    edges = _by_edges(servo, mocap)
    if not edges:
        return _by_motion(servo, mocap, meta)
    if len(edges) == 1 and edges[0].error_s <= FINE_S:
        return _of_edges(edges[0])
    return _edges_with_motion(edges, servo, mocap, meta)


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


# --- by the motion -------------------------------------------------------------------------------


def _by_motion(servo: list[Series], mocap: list[Series], meta: TrialMeta) -> Synchronisation:
    angle = _angle(servo, meta.dof)
    seen, bend, ratio = _direction(mocap, meta)
    for own, time_s in ((servo, angle.time_s), (mocap, seen.time_s)):
        if time_s[-1] - time_s[0] > LONGEST_S:
            what = f"lasts {time_s[-1] - time_s[0]:.3g} s, more than {LONGEST_S:g} s"
            raise InputError(own[0].path, what, "check the unit of its times, or give --offset")

    def unlike(correlation: float, offset_s: float) -> UnlikeMotionsError:
        return UnlikeMotionsError(
            servo[0].path,
            f"its angle and the motion in {mocap[0].path} correlate by {correlation:.2f} at best "
            f"(at {offset_s:.3f} s)",
            "check joint order, signs and [frame] in MAP.toml, or give --offset SECONDS",
        )

    def best(of: list[Peak], default: Peak | None = None) -> Peak | None:
        return max(of, key=lambda peak: peak.correlation, default=default)

    peaks = find_peaks(angle, seen)
    first = best([p for p in peaks if p.as_mapped]) or Peak(0.0, 0.0)
    other = best([p for p in peaks if not p.as_mapped])
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
    if not first.correlation >= MIN_CORRELATION:
        raise unlike(first.correlation, first.offset_s)
    fit = fit_offset(angle, seen, bend, ratio, first.offset_s)
    if not fit.correlation >= MIN_CORRELATION:
        raise unlike(fit.correlation, fit.offset_s)
    second = best([p for p in peaks if abs(p.offset_s - first.offset_s) > SEPARATION_S])
    second = second or Peak(np.nan, np.nan)
    if 1 - second.correlation < NEAR_FACTOR * (1 - first.correlation) + NEAR_FLOOR:
        kind = InputError if fit.correlation > SAME_MOTION else UnlikeMotionsError
        raise kind(
            servo[0].path,
            f"its angle and the motion in {mocap[0].path} agree at {fit.offset_s:.3f} s and nearly "
            f"as well at {second.offset_s:.3f} s (correlations {first.correlation:.4f} and "
            f"{second.correlation:.4f}): the motion repeats itself, with too little rest to tell",
            "record the rest before the motion in both files, or give --offset SECONDS",
        )
    return Synchronisation(
        fit.offset_s, fit.correlation, fit.error_s, fit.lag_s, second.offset_s, second.correlation,
        fit=fit,
    )  # fmt: skip


class ClockSignal(NamedTuple):
    """Samples `values` (n, dof) at times `time_s` (n,)."""

    time_s: Array
    values: Array


def _angle(servo: list[Series], dof: int) -> ClockSignal:
    names = [f"angle_{j}_rad" for j in range(1, dof + 1)]
    for series in servo:
        if all(name in series.columns for name in names):
            values = np.column_stack([series.columns[n] for n in names])
            whole = _complete(series, values)
            return ClockSignal(series.time_s[whole], values[whole])
    raise InputError(servo[0].path, f"has no {' and '.join(names)}", "map them under [columns]")


def _direction(mocap: list[Series], meta: TrialMeta) -> tuple[ClockSignal, Array | None, BendRatio]:
    """Direction of the link near its root, bend above, and nominal ratio of the bend below.

    The base plate does not bend, so its markers are preferred. Without them and the first row, the
    direction of the tip has to do.
    """

    def owner(*names: str) -> Series | None:
        return next((s for s in mocap if all(map(s.has, names))), None)

    layout, ratio, bend = meta.layout, nominal_bend_ratio(meta), None
    if series := owner(*BASE_MARKERS):
        b1, b2, b3, b4 = (series.position_m(name) for name in BASE_MARKERS)
        root = pointing_angles_rad(np.cross(b1 + b3 - b2 - b4, b1 + b2 - b3 - b4))
        ratio = BendRatio(0.0, 0.0)
    elif series := owner(*layout.row(0)):
        rows_m = [
            row_centre_m(np.array([series.position_m(n) for n in names]), layout.corners_m)
            for names in map(layout.row, range(min(layout.rows, 2)))
            if all(map(series.has, names))
        ]
        root = pointing_angles_rad(rows_m[0])
        bend = pointing_angles_rad(rows_m[1] - rows_m[0]) - root if len(rows_m) > 1 else None
    elif series := owner("tip"):
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
    return ClockSignal(series.time_s[whole], root[whole]), bend, ratio


def _complete(series: Series, values: Array) -> Array:
    """Rows in which every value was measured."""
    whole = np.asarray(np.all(np.isfinite(values), axis=1))
    if whole.sum() < 3:
        raise InputError(series.path, "shows too little to synchronise", "give --offset SECONDS")
    return whole


class BendRatio(NamedTuple):
    """Bend below the first row, relative to the bend between the first two rows."""

    whole: float  # Ratio of all bend, shear included
    late: float  # Ratio of the lagging bend: shear is elastic and does not lag


def nominal_bend_ratio(meta: TrialMeta) -> BendRatio:
    """Ratio for a nominal link of this size under a force at its tip; zero with a single row."""
    if meta.layout.rows < 2:
        return BendRatio(0.0, 0.0)
    size = {"length_m": meta.link_length_m, "width_m": meta.link_width_m}
    scale = LinkScale(msgspec.structs.replace(STUDY_LINK, pressure_pa=meta.pressure_pa, **size))
    first_m, second_m = meta.layout.rows_m[:2]

    rows_m = np.array([first_m, second_m])
    whole_m, _ = scale.deflection(rows_m, 1.0)

    def ratio(deflection_m: Array) -> float:
        first, second = deflection_m
        below = first / (meta.base_offset_m + first_m)
        return float(below / ((second - first) / (second_m - first_m) - below))

    return BendRatio(ratio(whole_m), ratio(whole_m - rows_m / scale.shear_n))


# --- search over all offsets, signs and orders ---------------------------------------------------

COARSE_STEP_S: Final = 0.01
"""Step of the search in s."""
LEAST_OVERLAP: Final = 0.5
"""Smallest fraction of the motion of one file in the overlap."""
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
        turned = [f"joint {j + 1}" for j, sign in zip(*self[2:], strict=True) if sign < 0]
        swapped = ["joints 1 and 2 are swapped"] if list(self.joints) != sorted(self.joints) else []
        verb = "counts" if len(turned) == 1 else "count"
        other = [f"the servo of {' and '.join(turned)} {verb} the other way"] if turned else []
        return ", and ".join(swapped + other)


def find_peaks(angle: ClockSignal, seen: ClockSignal) -> list[Peak]:
    """Best offsets of the angles as mapped, then the best one of each other reading.

    On a coarse grid, the correlation of angles and directions is computed at every offset at which
    the overlap contains half of the motion of one file. There are two peaks of the mapped reading
    (one if no other is far enough) and one of each other reading; none if the files have too little
    in common.
    """
    a, b = _on_grid(angle), _on_grid(seen)
    covariance, enough = _covariances(a, b)
    start_s = float(seen.time_s[0] - angle.time_s[0]) - (len(a) - 1) * COARSE_STEP_S
    peaks: list[Peak] = []
    dof = angle.values.shape[1]
    for joints, signs in product(permutations(range(dof)), product((1, -1), repeat=dof)):
        shared = sum(
            sign * covariance[j, k] for k, (j, sign) in enumerate(zip(joints, signs, strict=True))
        )
        score = np.where(enough, shared, -1.0)
        at, _ = maxima(score, height=0.0, distance=round(SEPARATION_S / COARSE_STEP_S) + 1)
        for k in at[np.argsort(-score[at], kind="stable")][:2].tolist():
            peaks.append(Peak(start_s + k * COARSE_STEP_S, float(score[k]), joints, signs))
            if not peaks[-1].as_mapped:
                break
    return peaks


def _on_grid(signal: ClockSignal) -> Array:
    grid_s = np.arange(signal.time_s[0], signal.time_s[-1], COARSE_STEP_S)
    columns = [np.interp(grid_s, signal.time_s, column) for column in signal.values.T]
    return np.asarray(np.column_stack(columns) - signal.values[0])


def _covariances(a: Array, b: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Covariance of each pair of columns at every lag, relative to all of both; enough overlap."""

    def over(x: Array, y: Array) -> Array:
        return np.asarray(correlate(y, x, mode="full", method="fft"))

    one_a, one_b = np.ones(len(a)), np.ones(len(b))
    count = np.maximum(np.round(over(one_a, one_b)), 1.0)
    sum_a, sum_b = [over(x, one_b) for x in a.T], [over(one_a, y) for y in b.T]
    square_a, square_b = over((a**2).sum(axis=1), one_b), over(one_a, (b**2).sum(axis=1))
    variance_a = square_a - np.square(sum_a).sum(axis=0) / count
    variance_b = square_b - np.square(sum_b).sum(axis=0) / count
    size = np.sqrt(np.maximum(variance_a * variance_b, 1e-30))
    covariance = np.array(
        [
            [
                (over(x, y) - sum_x * sum_y / count) / size
                for y, sum_y in zip(b.T, sum_b, strict=True)
            ]
            for x, sum_x in zip(a.T, sum_a, strict=True)
        ]
    )
    held = np.maximum(square_a / max(np.sum(a**2), 1e-30), square_b / max(np.sum(b**2), 1e-30))
    return covariance, (held >= LEAST_OVERLAP) & (count > 2)


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
BLOCK_S: Final = 1.0
"""Time over which residuals count as dependent."""
LEAST_SAMPLES: Final = 100
"""Fewest samples of half of the motion for an offset of its own, or with a measured bend."""
DRIFT_FLOOR_S: Final = 1e-4
"""Standard deviation of the difference of two offsets, beyond that of their fits: encoder steps."""


def fit_offset(
    angle: ClockSignal,
    seen: ClockSignal,
    bend: Array | None,
    ratio: BendRatio,
    start_s: float,
) -> OffsetFit:
    """Fit the offset near `start_s`.

    `seen` is the direction of the first row on the motion capture's clock. `bend` (n, dof) is the
    turn from the first row to the second at the same samples; None if it was not measured, or if
    the direction is that of the base. `ratio` is the nominal link's, zero for the base.
    """
    near = _Comparison(angle, seen, bend, start_s)
    raw_s = offset_s = near.best(0.0)
    kappa, lag_deviation = np.zeros(angle.values.shape[1]), 0.0
    if bend is not None:
        for _ in range(2):
            whole, deviation = near.bend_ratio(offset_s, ratio)
            kappa = whole * ratio.late / ratio.whole
            offset_s = near.best(kappa)
        lag_deviation = float(np.max(deviation / np.maximum(whole, deviation)))
    residual, rate, kept, correlation = near.at(offset_s, kappa)
    lag_s = raw_s - offset_s
    deviations_s = [
        _standard_error_s(near.seen_s[kept], residual, rate),
        lag_deviation * lag_s,
        LAG_DEVIATION * lag_s,
        UNCORRECTED_DEVIATION_S if bend is None and ratio.whole > 0 else 0.0,
        FLOOR_S,
    ]
    return OffsetFit(
        offset_s,
        float(1.96 * np.linalg.norm(deviations_s)),
        lag_s,
        correlation,
        residual,
        near.seen_s[kept],
        _drift(near, offset_s, kappa),
    )


def _drift(near: _Comparison, offset_s: float, kappa: Array | float) -> ClockDrift | None:
    """Drift between two halves of the motion with equal information on the offset."""
    _, rate, kept, _ = near.at(offset_s, kappa)
    weight, time_s = np.sum(rate**2, axis=1), near.seen_s[kept]
    if len(time_s) < 2 * LEAST_SAMPLES or not weight.sum() > 0:
        return None
    information = np.cumsum(weight)
    split = int(np.searchsorted(information, information[-1] / 2))
    offsets, deviations, middles = [], [], []
    for half in (slice(None, split), slice(split, None)):
        if len(time_s[half]) < LEAST_SAMPLES:
            return None
        part = near.within(time_s[half][0], time_s[half][-1])
        offsets.append(part.best(kappa))
        residual, rate, kept, _ = part.at(offsets[-1], kappa)
        deviations.append(_standard_error_s(part.seen_s[kept], residual, rate))
        middles.append(float(np.average(time_s[half], weights=weight[half])))
    deviation_s = float(np.linalg.norm([*deviations, DRIFT_FLOOR_S]))
    return ClockDrift(offsets[1] - offsets[0], deviation_s, middles[1] - middles[0])


class _Comparison:
    """Comparison of servo and link at offsets near a first one."""

    def __init__(
        self, angle: ClockSignal, seen: ClockSignal, bend: Array | None, start_s: float
    ) -> None:
        self.start_s, self._angle_s = start_s, angle.time_s
        self._spline = CubicSpline(angle.time_s, angle.values)
        self._gap_s = 3 * np.median(np.diff(angle.time_s))
        shifted = seen.time_s - start_s
        inside = (shifted >= angle.time_s[0] + RANGE_S) & (shifted <= angle.time_s[-1] - RANGE_S)
        after = np.clip(np.searchsorted(angle.time_s, shifted), 1, len(angle.time_s) - 1)
        inside &= angle.time_s[after] - angle.time_s[after - 1] <= self._gap_s
        self.seen_s, self._seen = seen.time_s[inside], seen.values[inside]
        self._bend = np.zeros_like(self._seen) if bend is None else bend[inside]

    def within(self, first_s: float, last_s: float) -> _Comparison:
        """Comparison restricted to the samples between two times."""
        part, inside = copy(self), (self.seen_s >= first_s) & (self.seen_s <= last_s)
        part.seen_s, part._seen, part._bend = (
            v[inside] for v in (self.seen_s, self._seen, self._bend)
        )
        return part

    def best(self, kappa: Array | float) -> float:
        """Offset with the least sum of squares, for given ratios."""
        found = minimize_scalar(
            lambda offset_s: float(np.sum(self.at(offset_s, kappa)[0] ** 2)),
            bounds=(self.start_s - RANGE_S, self.start_s + RANGE_S),
            method="bounded",
            options={"xatol": 1e-6},
        )
        return float(found.x)

    def at(self, offset_s: float, kappa: Array | float) -> tuple[Array, Array, Array, float]:
        """Residual, rate of the angle, kept samples and correlation at an offset."""
        q = self._spline(self.seen_s - offset_s)
        y = self._seen - kappa * self._bend
        kept = np.all(np.isfinite(y), axis=1)
        q, y = q[kept] - q[kept].mean(axis=0), y[kept] - y[kept].mean(axis=0)
        power, shared = np.sum(q * q, axis=0), np.sum(q * y, axis=0)
        gain = shared / np.maximum(power, 1e-30)
        size = np.sqrt(power.sum() * np.sum(y * y))
        rate = gain * self._spline(self.seen_s[kept] - offset_s, 1)
        return y - gain * q, rate, kept, float(shared.sum() / size) if size > 0 else 0.0

    def bend_ratio(self, offset_s: float, ratio: BendRatio) -> tuple[Array, Array]:
        """Ratio κ of each joint and its standard deviation, (dof,) each.

        It is fitted to the bend in phase with the motion; a term in the rate absorbs what is out of
        phase: an error of the offset, and the lag itself. The noise of the markers, which would
        lower κ (errors in variables), is estimated from second differences.
        """
        q = self._spline(self.seen_s - offset_s)
        kept = np.all(np.isfinite(self._seen + self._bend), axis=1)
        below, bend, q = (self._seen - q)[kept], self._bend[kept], q[kept]
        rates = self._spline(self.seen_s[kept] - offset_s, 1)
        noise_bend = _second_difference(bend, bend)
        noise_shared = _second_difference(below, bend)
        # The model error, a tenth of the bend, is correlated over a quarter of a second.
        alike = max(MODEL_ERROR_S / float(np.median(np.diff(self.seen_s))), 1.0)
        variance = alike * np.maximum(np.var(below, axis=0) * 1e-2, 1e-8)
        ratios, deviations = [], []
        for j in range(q.shape[1]):
            x, s, r, y = (v[:, j] - v[:, j].mean() for v in (q, bend, rates, below))
            design = np.column_stack([x, s, r])
            matrix, right = design.T @ design, design.T @ y
            matrix[1, 1] -= len(x) * noise_bend[j]
            right[1] -= len(x) * noise_shared[j]
            matrix = matrix / variance[j] + np.diag([GAIN_DEVIATION**-2, RATIO_DEVIATION**-2, 1e-9])
            right = right / variance[j] + np.array([0.0, ratio.whole * RATIO_DEVIATION**-2, 0.0])
            ratios.append(np.linalg.solve(matrix, right)[1])
            # The noise may exceed a bend that is hardly there; then only the prior is known.
            own = np.linalg.inv(matrix)[1, 1]
            deviations.append(np.sqrt(own) if 0.0 < own < RATIO_DEVIATION**2 else RATIO_DEVIATION)
        low, high = ratio.whole - 3 * RATIO_DEVIATION, ratio.whole + 3 * RATIO_DEVIATION
        return np.clip(ratios, max(low, 0.0), high), np.array(deviations)


def _second_difference(a: Array, b: Array) -> Array:
    """Covariance of the white noise of two signals, per column."""
    return np.asarray(np.mean(np.diff(a, 2, axis=0) * np.diff(b, 2, axis=0), axis=0) / 6.0)


def _standard_error_s(time_s: Array, residual: Array, rate: Array) -> float:
    """Standard error of the offset, allowing for correlated residuals within a block."""
    block = ((time_s - time_s[0]) / BLOCK_S).astype(int)
    moment = np.bincount(block, np.sum(residual * rate, axis=1))
    information = np.sum(rate**2)
    return float(np.sqrt(np.sum(moment**2)) / max(information, 1e-30))


# --- by a synchronisation signal -----------------------------------------------------------------

FINE_S: Final = 0.001
"""Half width of the signal's offset above which the motion refines it: the clock's target."""
LEAST_SWING_V: Final = 0.5
"""Smallest difference between the levels of the signal [assumed: logic is at 1.8 V or more]."""
JITTER_S: Final = 2e-4
"""Error of a time stamp [assumed]."""
DRIFT: Final = 3e-5
"""Relative difference of two clocks' rates: a crystal's tolerance of 30 ppm [assumed]."""
LEAST_PAIRS: Final = 4
"""Fewest pairs of edges for a fit of the drift [assumed]."""
LEAST_SHARED: Final = 0.5
"""Smallest fraction of edges with a partner, in the file with fewer edges."""


class EdgeOffset(NamedTuple):
    """Interval of offsets at which the edges of two files match."""

    low_s: float  # Lower and upper end of the interval; add the offset to the servo's times
    high_s: float
    shared: int  # Number of matching pairs of edges
    # Change of the offset from the first pair to the last; None for fewer than `LEAST_PAIRS`
    drift: ClockDrift | None = None

    @property
    def offset_s(self) -> float:
        """Middle of the interval in s."""
        return 0.5 * (self.low_s + self.high_s)

    @property
    def error_s(self) -> float:
        """Half of the interval's width in s."""
        return 0.5 * (self.high_s - self.low_s)


def rising_edges_s(time_s: Array, level_v: Array) -> Array:
    """Times of the samples before and after each rise through mid-range, shape (edges, 2)."""
    seen = np.isfinite(level_v)
    time_s, level_v = time_s[seen], level_v[seen]
    if len(level_v) < 2 or np.ptp(level_v) < LEAST_SWING_V:
        return np.zeros((0, 2))
    middle = 0.5 * (level_v.min() + level_v.max())
    at = np.flatnonzero((level_v[:-1] < middle) & (level_v[1:] >= middle))
    return np.column_stack([time_s[at], time_s[at + 1]])


def edge_offsets(servo_s: Array, mocap_s: Array) -> list[EdgeOffset]:
    """Offsets at which the edges (edges, 2) of two files match, the one with the most pairs first.

    Either file may lack edges at its ends. There are several offsets if the signal is periodic, and
    none if nothing matches.
    """
    least = max(LEAST_SHARED * min(len(servo_s), len(mocap_s)), 1)
    found = []
    for shift in range(1 - len(servo_s), len(mocap_s)):
        servo = servo_s[max(-shift, 0) :]
        mocap = mocap_s[max(shift, 0) :]
        shared = min(len(servo), len(mocap))
        if shared < least:
            continue
        servo, mocap = servo[:shared], mocap[:shared]
        slack_s = JITTER_S + DRIFT * float(servo[-1, 1] - servo[0, 0])
        low_s = float(np.max(mocap[:, 0] - servo[:, 1])) - slack_s
        high_s = float(np.min(mocap[:, 1] - servo[:, 0])) + slack_s
        if low_s <= high_s:
            found.append(EdgeOffset(low_s, high_s, shared, _drift_of_edges(servo, mocap)))
    return sorted(found, key=lambda fit: -fit.shared)


def _drift_of_edges(servo_s: Array, mocap_s: Array) -> ClockDrift | None:
    """Change of the offset over pairs of edges, by a line through the middles of their intervals.

    An edge is uniformly distributed between its two samples: its variance is a twelfth of the
    square of their distance.
    """
    if len(servo_s) < LEAST_PAIRS:
        return None
    time_s = mocap_s.mean(axis=1)
    offset_s = time_s - servo_s.mean(axis=1)
    centred_s = time_s - time_s.mean()
    slope = float(centred_s @ offset_s / (centred_s @ centred_s))
    widths_s = [np.median(edges[:, 1] - edges[:, 0]) for edges in (servo_s, mocap_s)]
    deviation_s = np.hypot(np.linalg.norm(widths_s) / np.sqrt(12.0), JITTER_S)
    over_s = float(time_s[-1] - time_s[0])
    slope_deviation = float(deviation_s / np.linalg.norm(centred_s))
    return ClockDrift(slope * over_s, slope_deviation * over_s, over_s)


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


def _edges_with_motion(
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
