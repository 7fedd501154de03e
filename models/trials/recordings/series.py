"""Series: channels sampled together, under the column names of a trial, in SI units."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from firmware_py.errors import InputError
from firmware_py.signals import unit_of
from models.trials.trial import Array
from models.trials.units import TO_SI

OPPOSITE_M: Final = 1e-3
"""Largest distance from the axis at which the midpoint of two markers is the row's centre."""


@dataclass(frozen=True)
class Series:
    """Channels with common sample times.

    Attributes
    ----------
    time_s : ndarray, shape (n,)
        Sample times in s, strictly increasing, on the clock of the file; steps may vary.
    columns : dict of str to ndarray, shape (n,)
        Samples by column name of a trial, in SI units; NaN where nothing was measured.
    path : Path
        File that they were read from, for messages.

    Raises
    ------
    InputError
        If there are fewer than three samples, the times do not increase, or a value is infinite.
    """

    time_s: Array
    columns: dict[str, Array]
    path: Path

    def __post_init__(self) -> None:
        if len(self.time_s) < 3:
            raise InputError(self.path, f"has {len(self.time_s)} samples", "record at least three")
        if not np.all(np.isfinite(self.time_s)):
            row = int(np.argmin(np.isfinite(self.time_s)))
            raise InputError(self.path, f"sample {row + 1} has no time", "correct the time column")
        back = np.flatnonzero(np.diff(self.time_s) <= 0)
        if len(back):
            raise InputError(
                self.path,
                f"time does not increase after sample {back[0] + 1} "
                f"({self.time_s[back[0]]:.6g} s, then {self.time_s[back[0] + 1]:.6g} s)",
                "sort the samples and drop doubled ones",
            )
        for name, values in self.columns.items():
            infinite = np.flatnonzero(np.isinf(values))
            if len(infinite):
                raise InputError(
                    self.path,
                    f"sample {infinite[0] + 1}: {name} is {values[infinite[0]]}, "
                    "not a finite number",
                    "correct it or leave it out",
                )

    def position_m(self, name: str) -> Array:
        """Return the position of a marker or the tip in m, shape (n, 3)."""
        return np.column_stack([self.columns[f"{name}_{axis}_m"] for axis in "xyz"])


def marker_columns(markers_m: dict[str, Array]) -> dict[str, Array]:
    """Columns `m01_x_m` … of positions by marker name (`m01` … `m16`, `tip`), each (n, 3)."""
    return {
        f"{name}_{axis}_m": np.ascontiguousarray(position[:, k])
        for name, position in markers_m.items()
        for k, axis in enumerate("xyz")
    }


def row_centre_m(corners_m: Array, places_m: Sequence[tuple[float, float]]) -> Array:
    """Centre of a marker row, shape (n, 3), from its markers (corners, n, 3).

    The centre is the midpoint of any two opposite markers, so two of them suffice. Without opposite
    markers all are needed. It is NaN where too many are occluded.
    """
    places = np.asarray(places_m)
    apart = np.abs(places[:, None] + places[None]).max(axis=2)
    pairs = [(int(i), int(j)) for i, j in np.argwhere(apart < OPPOSITE_M) if i <= j]
    if not pairs:
        return np.asarray(corners_m.mean(axis=0))
    diagonals_m = np.array([corners_m[i] + corners_m[j] for i, j in pairs]) / 2
    seen = np.isfinite(diagonals_m)
    total_m = np.where(seen, diagonals_m, 0.0).sum(axis=0)
    count = seen.sum(axis=0)
    return np.asarray(np.where(count > 0, total_m / np.maximum(count, 1), np.nan))


def factor_to_si(where: Path, column: str, unit: str, declared: str | None = None) -> float:
    """Factor from `unit` to the SI unit of `column`, from its suffix or `declared` without one."""
    declared = declared or unit_of(column) or "1"
    if unit == declared:
        return 1.0
    if unit not in TO_SI:
        raise InputError(
            where, f"{column}: unit {unit!r} is unknown", "choose from " + ", ".join(TO_SI)
        )
    si, factor = TO_SI[unit]
    if si != declared:
        alike = ", ".join(name for name, (other, _) in TO_SI.items() if other == declared)
        raise InputError(
            where, f"{column}: unit {unit!r} does not measure {declared}", f"give one of {alike}"
        )
    return factor
