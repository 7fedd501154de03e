"""Trials made by hand: a link that does not bend, moved by known angles, and changes of trials."""

from dataclasses import replace

import msgspec
import numpy as np

from models.shared.kinematics import base_rotation
from models.trials.recordings.series import marker_columns
from models.trials.trial import Trial, TrialMeta

BASE_OFFSET_M, LENGTH_M, WIDTH_M = 0.06, 0.95, 0.15


def rigid_markers_m(angle_rad, stretch=1.0):
    """Markers of a straight link, (n, 16, 3), built corner by corner from the contract."""
    rotation, half = base_rotation(angle_rad), WIDTH_M / 2
    markers_m = np.empty((len(angle_rad), 16, 3))
    for i in range(16):
        row, corner = divmod(i, 4)
        body = np.empty((len(angle_rad), 3))
        body[:, 0], body[:, 1] = (half, -half)[corner % 2], (half, -half)[corner // 2]
        body[:, 2] = BASE_OFFSET_M + stretch * LENGTH_M * (row + 1) / 4
        markers_m[:, i] = np.einsum("nij,nj->ni", rotation, body)
    return markers_m


def rigid_trial(angle_rad, markers_m=None, *, stretch=1.0, step_s=0.017, name="run", **conditions):
    """Trial whose goals are its angles, one column of them for each joint."""
    angle_rad = np.atleast_2d(np.asarray(angle_rad, dtype=float).T).T
    if markers_m is None:
        markers_m = rigid_markers_m(angle_rad, stretch)
    count, dof = angle_rad.shape
    columns = {"time_s": step_s * np.arange(count)}
    for j in range(dof):
        columns[f"goal_{j + 1}_rad"] = angle_rad[:, j].copy()
        columns[f"angle_{j + 1}_rad"] = angle_rad[:, j].copy()
        columns[f"current_{j + 1}_a"] = 2.0 * np.sin(angle_rad[:, j])
    places_m = {"tip": markers_m[:, 12:].mean(axis=1)}
    places_m |= {f"m{i + 1:02d}": markers_m[:, i] for i in range(16)}
    columns |= marker_columns(places_m)
    meta = {
        "dof": dof, "payload_kg": 1.0, "pressure_pa": 41.3e3, "trial": 1, "motion": "sinusoid",
        "source": "measured", "period_s": 4.352, "amplitude_rad": 0.5, "rest_samples": 3,
        "base_offset_m": BASE_OFFSET_M, "link_length_m": LENGTH_M, "link_width_m": WIDTH_M,
    }  # fmt: skip
    return Trial(name, TrialMeta(**(meta | conditions)), columns)


def with_columns(trial, /, **columns):
    return replace(trial, columns=trial.columns | columns)


def with_conditions(trial, /, **conditions):
    return replace(trial, meta=msgspec.structs.replace(trial.meta, **conditions))
