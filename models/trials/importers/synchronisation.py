"""Offset between the servo's clock and the motion capture's.

Both recorded the same motion: the servo as its angle, the markers as the direction in which the
link points. The offset is the one at which the two correlate best. The link lags behind the joint
by its own dynamics, so the direction is that of its root (first marker row, if there is one),
which bends least.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.signal import correlate

from firmware_py.errors import InputError
from models.shared.kinematics import pointing_angles_rad
from models.trials.importers.mapping import MARKERS
from models.trials.importers.series import Series, row_centre_m
from models.trials.trial import Array

COARSE_STEP_S: Final = 0.01
"""Step of the first search over all offsets; the second one is continuous."""
LONGEST_S: Final = 10_000.0
"""Longest recording whose offset is searched: a million coarse steps."""
MIN_CORRELATION: Final = 0.9
"""Correlation below which two files do not show the same motion."""


@dataclass(frozen=True)
class Synchronisation:
    """Result of `synchronise`.

    Attributes
    ----------
    offset_s : float
        To be added to the servo's times to get those of the motion capture.
    correlation : float
        Of servo angle and direction of the link at that offset; 1 is perfect.
    """

    offset_s: float
    correlation: float


def synchronise(servo: list[Series], mocap: list[Series], dof: int) -> Synchronisation:
    """Offset between the clocks of two files, to a fraction of a sample.

    A coarse cross-correlation over all offsets gives the start; the maximum of the correlation
    coefficient around it is found in continuous time.

    Parameters
    ----------
    servo : list of Series
        With the joint angles.
    mocap : list of Series
        With the first marker row or the tip.
    dof : int
        Joints to compare.

    Raises
    ------
    InputError
        If a file lacks what is compared, or the correlation is below `MIN_CORRELATION`.
    """
    angle_s, angle_rad = _angle(servo, dof)
    seen_s, seen_rad = _direction(mocap, dof)
    for own, time_s in ((servo, angle_s), (mocap, seen_s)):
        if time_s[-1] - time_s[0] > LONGEST_S:
            what = f"lasts {time_s[-1] - time_s[0]:.3g} s, more than {LONGEST_S:g} s"
            raise InputError(own[0].path, what, "check the unit of its times, or give --offset")
    coarse_s = _coarse_offset_s(angle_s, angle_rad, seen_s, seen_rad)

    def disagreement(offset_s: float) -> float:
        return -_correlation(angle_s + offset_s, angle_rad, seen_s, seen_rad)

    best = minimize_scalar(
        disagreement,
        bounds=(coarse_s - 2 * COARSE_STEP_S, coarse_s + 2 * COARSE_STEP_S),
        method="bounded",
        options={"xatol": 1e-6},
    )
    found = Synchronisation(float(best.x), -float(best.fun))
    if not found.correlation >= MIN_CORRELATION:
        raise InputError(
            servo[0].path,
            f"its angle and the motion in {mocap[0].path} correlate by {found.correlation:.2f} at "
            f"best (at {found.offset_s:.3f} s)",
            "check joint order, signs and [frame] in MAP.toml, or give --offset SECONDS",
        )
    return found


def shift_clock(series: list[Series], offset_s: float) -> list[Series]:
    """Series whose times are larger by `offset_s`.

    Parameters
    ----------
    series : list of Series
        On one clock.
    offset_s : float
        Added to their times.
    """
    return [replace(s, time_s=s.time_s + offset_s) for s in series]


def _angle(servo: list[Series], dof: int) -> tuple[Array, Array]:
    names = [f"angle_{j}_rad" for j in range(1, dof + 1)]
    for series in servo:
        if all(name in series.columns for name in names):
            return _complete(series, np.column_stack([series.columns[n] for n in names]))
    raise InputError(servo[0].path, f"has no {' and '.join(names)}", "map them under [columns]")


def _direction(mocap: list[Series], dof: int) -> tuple[Array, Array]:
    for series in mocap:
        if all(f"{name}_z_m" in series.columns for name in MARKERS[:4]):
            root_m = row_centre_m(np.array([series.position_m(name) for name in MARKERS[:4]]))
            return _complete(series, pointing_angles_rad(root_m)[:, :dof])
    for series in mocap:
        if "tip_z_m" in series.columns:
            return _complete(series, pointing_angles_rad(series.position_m("tip"))[:, :dof])
    raise InputError(mocap[0].path, "has neither m01 … m04 nor the tip", "map them under [markers]")


def _complete(series: Series, values: Array) -> tuple[Array, Array]:
    """Times and values of the samples in which every value was measured."""
    whole = np.all(np.isfinite(values), axis=1)
    if whole.sum() < 3:
        raise InputError(series.path, "shows too little to synchronise", "give --offset SECONDS")
    return series.time_s[whole], values[whole]


def _coarse_offset_s(angle_s: Array, angle_rad: Array, seen_s: Array, seen_rad: Array) -> float:
    score: Array | float = 0.0
    for a, b in zip(angle_rad.T, seen_rad.T, strict=True):
        # Zero beyond the ends, where the link rests: a partial overlap must not win.
        score = score + correlate(_even(seen_s, b), _even(angle_s, a), mode="full")
    lag = int(np.argmax(score)) - (len(_even(angle_s, angle_rad[:, 0])) - 1)
    return float(seen_s[0] - angle_s[0] + lag * COARSE_STEP_S)


def _even(time_s: Array, values: Array) -> Array:
    grid_s = np.arange(time_s[0], time_s[-1], COARSE_STEP_S)
    return np.asarray(np.interp(grid_s, time_s, values) - values[0])


def _correlation(angle_s: Array, angle_rad: Array, seen_s: Array, seen_rad: Array) -> float:
    """Correlation coefficient of all joints together, each about its own mean."""
    after = np.clip(np.searchsorted(seen_s, angle_s), 1, len(seen_s) - 1)
    gap = seen_s[after] - seen_s[after - 1] > 3 * np.median(np.diff(seen_s))  # occluded
    inside = (angle_s >= seen_s[0]) & (angle_s <= seen_s[-1]) & ~gap
    if inside.sum() < 3:
        return 0.0
    angle = angle_rad[inside] - angle_rad[inside].mean(axis=0)
    direction = np.column_stack(
        [np.interp(angle_s[inside], seen_s, column) for column in seen_rad.T]
    )
    direction = direction - direction.mean(axis=0)
    size = np.sqrt(np.sum(angle**2) * np.sum(direction**2))
    return float(np.sum(angle * direction) / size) if size > 0 else 0.0
