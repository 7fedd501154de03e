"""Deformation Index: one number for how far the link is from its rest shape (paper, eq. 1).

    DI = 1/N sum_i |L_i - L'_i| / L_i

over N = 16 lengths: the four segments of each of the four long edges, every edge running from
its base-plate corner through its four markers. Other sets of lengths are selectable.
"""

from __future__ import annotations

import warnings
from typing import Final, Literal

import numpy as np

from firmware_py.errors import InputError
from models.shared.kinematics import Array, base_corners_m
from models.trials.trial_files import Trial

Definition = Literal["edges", "base_to_marker", "all_pairs"]
DEFINITIONS: Final[tuple[Definition, ...]] = ("edges", "base_to_marker", "all_pairs")
OCCLUSION_WARNING_SHARE: Final = 0.2
"""Above this share of unseen lengths the index of a trial deserves a warning."""


def edge_lengths_m(trial: Trial, definition: Definition = "edges") -> Array:
    """Lengths that the index compares.

    Parameters
    ----------
    trial : Trial
        Of the link, with 16 markers; NaN is an occluded marker.
    definition : {"edges", "base_to_marker", "all_pairs"}
        `edges`: 16 segments along the long edges; `base_to_marker`: from a base corner to each
        marker of its edge, 16; `all_pairs`: between any two markers, 120.

    Returns
    -------
    ndarray, shape (n, N)
        Lengths in m, NaN where an end is occluded.
    """
    markers_m = trial.markers_m
    corners_m = base_corners_m(trial.angle_rad, trial.meta.base_offset_m, trial.meta.link_width_m)
    rows_m = markers_m.reshape(len(markers_m), 4, 4, 3)
    if definition == "edges":
        path_m = np.concatenate([corners_m[:, None], rows_m], axis=1)
        return _norm(np.diff(path_m, axis=1)).reshape(len(markers_m), 16)
    if definition == "base_to_marker":
        return _norm(rows_m - corners_m[:, None]).reshape(len(markers_m), 16)
    first, second = np.triu_indices(markers_m.shape[1], k=1)
    return _norm(markers_m[:, first] - markers_m[:, second])


def _norm(vectors: Array) -> Array:
    return np.asarray(np.linalg.norm(vectors, axis=-1), dtype=np.float64)


def deformation_index(trial: Trial, definition: Definition = "edges") -> Array:
    """Deformation Index of every row of a trial, shape (n,), dimensionless.

    The reference lengths are the means over the trial's rest rows, never over moving ones. The
    mean runs over the lengths that are seen; NaN only where a row shows none.

    Raises
    ------
    InputError
        If a length is never seen at rest, or the trial declares no rest rows.
    """
    rest = trial.meta.rest_samples
    if rest < 1:
        raise InputError(
            trial.path, "rest_samples is 0, so the index has no reference",
            "record the link at rest before it moves and set rest_samples",
        )  # fmt: skip
    lengths = edge_lengths_m(trial, definition)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", category=RuntimeWarning)  # an all-NaN mean is NaN
        reference = np.nanmean(lengths[:rest], axis=0)
        unseen = np.flatnonzero(np.isnan(reference))
        if len(unseen):
            raise InputError(
                trial.path,
                f"length {unseen[0] + 1} of {lengths.shape[1]} ('{definition}') is occluded in "
                f"all {rest} rest rows",
                "use a trial whose markers are visible at rest",
            )
        index = np.nanmean(np.abs(lengths - reference) / reference, axis=1)
    share = float(np.mean(np.isnan(lengths)))
    if share > OCCLUSION_WARNING_SHARE:
        warnings.warn(
            f"{trial.path}: {share:.0%} of the lengths are occluded; the index is less certain",
            stacklevel=2,
        )
    return np.asarray(index, dtype=np.float64)
