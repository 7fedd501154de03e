"""Trials made by hand: a link that does not bend, moved by known angles."""

import numpy as np
import pytest

from models.shared.kinematics import base_rotation
from models.trials.trial import Trial, TrialMeta

BASE_OFFSET_M, LENGTH_M, WIDTH_M = 0.06, 0.95, 0.15


def rigid_markers_m(angle_rad, stretch=1.0):
    """Markers of a straight link, (n, 16, 3), built corner by corner from the contract."""
    markers_m = np.empty((len(angle_rad), 16, 3))
    rotation = base_rotation(angle_rad)
    for i in range(16):
        row, corner = divmod(i, 4)
        body = np.array(
            [
                (WIDTH_M / 2, -WIDTH_M / 2)[corner % 2],
                (WIDTH_M / 2, -WIDTH_M / 2)[corner // 2],
                BASE_OFFSET_M,
            ]
        )
        along = np.multiply.outer(np.broadcast_to(stretch, len(angle_rad)), [0, 0, 1.0])
        body = body + along * LENGTH_M * (row + 1) / 4
        markers_m[:, i] = np.einsum("nij,nj->ni", rotation, body)
    return markers_m


def _make_trial(angle_rad, markers_m=None, *, stretch=1.0, step_s=0.017, **conditions):
    angle_rad = np.atleast_2d(np.asarray(angle_rad, dtype=float).T).T
    if markers_m is None:
        markers_m = rigid_markers_m(angle_rad, stretch)
    count, dof = angle_rad.shape
    columns = {"time_s": step_s * np.arange(count)}
    for j in range(dof):
        columns[f"goal_{j + 1}_rad"] = angle_rad[:, j].copy()
        columns[f"angle_{j + 1}_rad"] = angle_rad[:, j].copy()
        columns[f"current_{j + 1}_a"] = 2.0 * np.sin(angle_rad[:, j])
    tip_m = markers_m[:, 12:].mean(axis=1)
    columns |= {f"tip_{axis}_m": tip_m[:, k].copy() for k, axis in enumerate("xyz")}
    columns |= {
        f"m{i + 1:02d}_{axis}_m": markers_m[:, i, k].copy()
        for i in range(16)
        for k, axis in enumerate("xyz")
    }
    meta = {
        "dof": dof, "payload_kg": 1.0, "pressure_pa": 41.3e3, "trial": 1, "motion": "sinusoid",
        "source": "measured", "period_s": 4.352, "amplitude_rad": 0.5, "rest_samples": 3,
        "base_offset_m": BASE_OFFSET_M, "link_length_m": LENGTH_M, "link_width_m": WIDTH_M,
    }  # fmt: skip
    name = conditions.pop("name", "run")
    return Trial(name, TrialMeta(**(meta | conditions)), columns)


@pytest.fixture
def make_trial():
    return _make_trial


@pytest.fixture
def rigid_markers():
    return rigid_markers_m


@pytest.fixture
def swing_rad():
    """Three rest rows, then one slow swing of both joints, out of phase, shape (64, 2)."""
    phase = 2 * np.pi * np.arange(61) / 60
    swing = np.column_stack([-0.5 * np.sin(phase), 0.4 * (1 - np.cos(phase))])
    return np.vstack([np.zeros((3, 2)), swing])
