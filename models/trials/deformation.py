"""Deformation Index: mean relative change of lengths on the link (paper, equation 1).

    DI = 1/N sum_i |L_i - L'_i| / L_i

over N lengths: the segments of each long edge, from its corner on the base plate through its marker
in every row. The study's link has N = 16: four segments on each of four edges.
"""

from __future__ import annotations

import warnings
from typing import Final

import numpy as np

from firmware_py.core.errors import InputError
from models.shared.kinematics import Array, base_corners_m
from models.trials.trial import Trial

MAX_OCCLUDED_FRACTION: Final = 0.2
"""Fraction of occluded lengths in a trial above which the user is warned."""


def marker_lengths_m(trial: Trial) -> Array:
    """Lengths in m along the edges, one per marker, shape (n, N); NaN where an end is occluded."""
    rows_m, places_m = trial.marker_rows_m, trial.meta.layout.corners_m
    corners_m = base_corners_m(trial.angle_rad, trial.meta.base_offset_m, places_m)
    path_m = np.concatenate([corners_m[:, None], rows_m], axis=1)
    lengths_m = np.linalg.norm(np.diff(path_m, axis=1), axis=-1)
    return np.asarray(lengths_m.reshape(len(trial), -1), dtype=np.float64)


def deformation_index(trial: Trial) -> Array:
    """Return the Deformation Index of every row of a trial.

    The reference lengths are the means over the trial's rest rows. Where lengths are occluded,
    each segment of the edges counts as the mean of its visible lengths, and a row is NaN if a
    segment has none. The segments at the base strain most and need one marker, the others need two,
    so a mean over all visible lengths would rise with occlusion.

    Parameters
    ----------
    trial : Trial
        Trial of the link; NaN marks an occluded marker.

    Returns
    -------
    ndarray, shape (n,)
        Deformation Index, dimensionless.

    Raises
    ------
    InputError
        If the trial declares no rest rows, or all lengths of a segment are occluded in them.

    Examples
    --------
    A straight link whose height grows by one per cent in its last row:

    >>> from models.trials.trial import TrialMeta
    >>> z_m = np.outer([1, 1, 1.01], np.repeat([0.25, 0.5, 0.75, 1.0], 4))
    >>> x_m, y_m = np.tile([0.1, -0.1, 0.1, -0.1], 4), np.tile([0.1, 0.1, -0.1, -0.1], 4)
    >>> columns = {"time_s": np.arange(3) * 0.017, "angle_1_rad": np.zeros(3)}
    >>> for k in range(16):
    ...     for axis, values in (("x", x_m[k]), ("y", y_m[k]), ("z", z_m[:, k])):
    ...         columns[f"m{k + 1:02d}_{axis}_m"] = np.broadcast_to(values, 3)
    >>> meta = TrialMeta(dof=1, payload_kg=0.0, trial=1, motion="stretch", source="measured",
    ...                  period_s=1.0, link_length_m=1.0, link_width_m=0.2, rest_samples=2)
    >>> deformation_index(Trial("stretched", meta, columns)).round(9)
    array([0.  , 0.  , 0.01])
    """
    rest = trial.meta.rest_samples
    if rest < 1:
        raise InputError(
            trial.path, "rest_samples is 0, so the index has no reference",
            "record the link at rest before it moves and set rest_samples",
        )  # fmt: skip
    lengths, layout = marker_lengths_m(trial), trial.meta.layout
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", category=RuntimeWarning)  # an all-NaN mean is NaN
        reference = np.nanmean(lengths[:rest], axis=0)
        unseen = np.isnan(reference).reshape(layout.rows, layout.corners).all(axis=1)
        if unseen.any():
            raise InputError(
                trial.path,
                f"the lengths to marker row {np.argmax(unseen) + 1} of {layout.rows} are occluded "
                f"in all {rest} rest rows",
                "use a trial whose markers are visible at rest",
            )
        strain = np.abs(lengths - reference) / reference
        index = strain.mean(axis=1)
        hidden = np.isnan(index)
        by_segment = strain[hidden].reshape(-1, layout.rows, layout.corners)
        index[hidden] = np.nanmean(by_segment, axis=2).mean(axis=1)
    occluded = float(np.mean(np.isnan(lengths)))
    if occluded > MAX_OCCLUDED_FRACTION:
        warnings.warn(
            f"{trial.path}: {occluded:.0%} of the lengths are occluded; the index is less certain",
            stacklevel=2,
        )
    return np.asarray(index, dtype=np.float64)
