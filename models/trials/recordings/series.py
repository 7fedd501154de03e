"""Series: channels sampled together, under the column names of a trial, in SI units.

Readers give the positions of markers in the frame of the motion capture; `frames.in_world` turns
them into the world frame of docs/trials.md.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from firmware_py.core.errors import InputError
from firmware_py.link.link_description import STUDY_LINK
from firmware_py.link.marker_layout import MarkerLayout
from models.shared.link_scale import LinkScale
from models.trials.trial import Array, TrialMeta


@dataclass(frozen=True)
class Series:
    """Channels with common sample times; `InputError` if they are no samples of a recording.

    Attributes
    ----------
    time_s : ndarray, shape (n,)
        Sample times in s, strictly increasing, on the clock of the file; steps may vary.
    columns : dict of str to ndarray, shape (n,)
        Samples by column name of a trial, in SI units; NaN where nothing was measured.
    path : Path
        File that they were read from, for messages.
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
                k = infinite[0]
                what = f"sample {k + 1}: {name} is {values[k]}, not a finite number"
                raise InputError(self.path, what, "correct it or leave it out")

    def has(self, *markers: str) -> bool:
        """Whether all coordinates of markers, or of the tip, are among the columns."""
        return all(f"{marker}_{axis}_m" in self.columns for marker in markers for axis in "xyz")

    def position_m(self, marker: str) -> Array:
        """Position of a marker or the tip in m, shape (n, 3)."""
        return np.column_stack([self.columns[f"{marker}_{axis}_m"] for axis in "xyz"])

    def positions_m(self, markers: Sequence[str]) -> Array:
        """Positions of several markers in m, shape (n, markers, 3)."""
        return np.stack([self.position_m(marker) for marker in markers], axis=1)


def with_markers(series: Iterable[Series], *markers: str) -> Series | None:
    """First series that has all of some markers."""
    return next((s for s in series if s.has(*markers)), None)


def with_angles(series: Iterable[Series], dof: int) -> tuple[Series, Array] | None:
    """First series that has the angles of all joints, and these, shape (n, dof)."""
    names = [f"angle_{j}_rad" for j in range(1, dof + 1)]
    for s in series:
        if s.columns.keys() >= set(names):
            return s, np.column_stack([s.columns[name] for name in names])
    return None


def marker_columns(markers_m: dict[str, Array]) -> dict[str, Array]:
    """Columns `m01_x_m` … of positions by marker name (`m01` … `m16`, `tip`), each (n, 3)."""
    return {
        f"{name}_{axis}_m": np.ascontiguousarray(position[:, k])
        for name, position in markers_m.items()
        for k, axis in enumerate("xyz")
    }


def row_centre_m(row_m: Array, layout: MarkerLayout) -> Array:
    """Centre of a marker row, shape (n, 3), from its markers (n, corners, 3).

    The centre is the midpoint of any two opposite markers, so two of them suffice. Without opposite
    markers all are needed. It is NaN where too many are occluded.
    """
    places = np.asarray(layout.corners_m)
    apart = np.abs(places[:, None] + places[None]).max(axis=2)
    pairs = [(int(i), int(j)) for i, j in np.argwhere(apart < 1e-3) if i <= j]
    if not pairs:
        return np.asarray(row_m.mean(axis=1))
    diagonals_m = np.array([row_m[:, i] + row_m[:, j] for i, j in pairs]) / 2
    visible = np.isfinite(diagonals_m)
    total_m = np.where(visible, diagonals_m, 0.0).sum(axis=0)
    count = visible.sum(axis=0)
    return np.asarray(np.where(count > 0, total_m / np.maximum(count, 1), np.nan))


def nominal_scale(meta: TrialMeta) -> LinkScale:
    """Stiffness, mass and limits of a nominal link of a trial's size and pressure."""
    return LinkScale(msgspec.structs.replace(
        STUDY_LINK, length_m=meta.link_length_m, width_m=meta.link_width_m,
        pressure_pa=meta.pressure_pa or STUDY_LINK.pressure_pa,
    ))  # fmt: skip
