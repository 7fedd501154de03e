"""Series: channels sampled together, under the column names of a trial, in SI units.

Readers give the positions of markers in the frame of the motion capture; `in_world` turns them into
the world frame of docs/trials.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from firmware_py.core.errors import InputError
from models.trials.recordings.mapping import MocapFrame
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

    def has(self, marker: str) -> bool:
        """Whether all coordinates of a marker or the tip are among the columns."""
        return all(f"{marker}_{axis}_m" in self.columns for axis in "xyz")

    def position_m(self, marker: str) -> Array:
        """Position of a marker or the tip in m, shape (n, 3)."""
        return np.column_stack([self.columns[f"{marker}_{axis}_m"] for axis in "xyz"])


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
    pairs = [(int(i), int(j)) for i, j in np.argwhere(apart < 1e-3) if i <= j]
    if not pairs:
        return np.asarray(corners_m.mean(axis=0))
    diagonals_m = np.array([corners_m[i] + corners_m[j] for i, j in pairs]) / 2
    visible = np.isfinite(diagonals_m)
    total_m = np.where(visible, diagonals_m, 0.0).sum(axis=0)
    count = visible.sum(axis=0)
    return np.asarray(np.where(count > 0, total_m / np.maximum(count, 1), np.nan))


_TO_Z_UP: Final = {
    "x": np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]),
    "y": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
    "z": np.eye(3),
}
"""Rotation from the file's upward axis to z, by that axis."""
_OVER: Final = np.diag([1.0, -1.0, -1.0])
"""Half a turn about x, for a link that points down an axis."""


def in_world(series: Series, markers: Sequence[str], frame: MocapFrame, default_up: str) -> Series:
    """Series whose markers are turned from the frame of the file into the world frame."""
    columns = dict(series.columns)
    for name in filter(series.has, markers):  # one by one: one copy of a long capture, not four
        columns |= marker_columns({name: to_world(series.position_m(name), frame, default_up)})
    return replace(series, columns=columns)


def to_world(position_m: Array, frame: MocapFrame, default_up: str) -> Array:
    """Positions (…, 3) in the world frame; `default_up` is used if the map does not state `up`."""
    rotation = world_rotation(frame, default_up)
    origin_m = _about_z(frame.yaw_deg) @ np.array(frame.origin_m)
    if np.array_equal(rotation, np.eye(3)) and not origin_m.any():
        return position_m  # a marker of which one coordinate is missing keeps the others
    return np.asarray(position_m @ rotation.T - origin_m)


def world_rotation(frame: MocapFrame, default_up: str) -> Array:
    """Rotation from the file's axes to the world's, shape (3, 3); a reflection with `mirror`."""
    up = frame.up or default_up
    upward = _TO_Z_UP[up.removeprefix("-")]
    turned = _about_z(frame.yaw_deg) @ (_OVER @ upward if up != up[-1] else upward)
    signs = [-1.0 if axis == frame.mirror else 1.0 for axis in "xyz"]
    return np.asarray(turned * signs)  # signs belong to the file's axes


def _about_z(yaw_deg: float) -> Array:
    cos, sin = np.cos(np.radians(yaw_deg)), np.sin(np.radians(yaw_deg))
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])


def nominal_markers_m(meta: TrialMeta) -> Array:
    """Markers of the straight link at zero angle, shape (markers, 3)."""
    layout = meta.layout
    return np.array(
        [(x, y, meta.base_offset_m + z) for z in layout.rows_m for x, y in layout.corners_m]
    )


def fit_rigid_motion(measured_m: Array, nominal_m: Array) -> tuple[Array, Array]:
    """Rotation (3, 3) and shift (3,) that best map measured points to nominal ones, (k, 3) each.

    nominal ≈ rotation @ measured + shift, by least squares with the singular value decomposition
    (Kabsch 1976).
    """
    centre, target = measured_m.mean(axis=0), nominal_m.mean(axis=0)
    u, _, vt = np.linalg.svd((measured_m - centre).T @ (nominal_m - target))
    mirror = np.diag([1.0, 1.0, np.sign(np.linalg.det(vt.T @ u.T))])
    rotation = np.asarray(vt.T @ mirror @ u.T)
    return rotation, target - rotation @ centre
