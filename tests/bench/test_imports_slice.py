"""A seeded slice of the imports benchmark, on a rigid link."""

import numpy as np
import pytest

from bench.imports.__main__ import import_case, summarise
from bench.imports.import_cases import right_cases, wrong_cases
from firmware_py.signals import trial_signals
from models.shared.kinematics import base_rotation
from models.trials.importers.mocap_frame import nominal_markers_m
from models.trials.trial import Trial, TrialMeta

REST = 60


def rigid_trial(angle_rad):
    dof = angle_rad.shape[1]
    meta = TrialMeta(
        dof=dof, payload_kg=1.0, pressure_pa=41300.0, trial=1, motion="test", source="rig",
        period_s=2.0, amplitude_rad=0.5, base_offset_m=0.06, link_length_m=0.95,
        link_width_m=0.15, rest_samples=REST,
    )  # fmt: skip
    markers_m = np.einsum("nij,kj->nki", base_rotation(angle_rad), nominal_markers_m(meta))
    joints = np.stack([angle_rad, angle_rad, -2 * angle_rad], axis=2).reshape(len(angle_rad), -1)
    time_s = 0.017 * np.arange(len(angle_rad))
    tip_m = markers_m[:, 12:].mean(axis=1)
    samples = np.column_stack([time_s, joints, tip_m, markers_m.reshape(len(time_s), -1)])
    names = [s.name for s in trial_signals(dof)]
    return Trial("rigid", meta, dict(zip(names, samples.T, strict=True)))


@pytest.fixture(scope="module")
def moved():
    time_s = 0.017 * np.arange(REST + 360)
    t = np.clip(time_s - 0.017 * (REST - 1), 0, 5.0)
    smooth = np.clip(t, 0, 1) ** 2 * np.clip(5.0 - t, 0, 1) ** 2
    return np.column_stack([0.5 * np.sin(2.6 * t) * smooth, 0.4 * np.sin(3.3 * t + 0.8) * smooth])


@pytest.fixture
def one(moved):
    return rigid_trial(moved[:, :1])


@pytest.fixture
def two(moved):
    return rigid_trial(moved)


SLICE = (0, 2, 5, 15, 22, 26, 29, 34, 37)
"""A sign, another of two joints, swapped names, origin, upward axis, yaw, a marker that is absent,
a gap, decimal commas."""


def test_wrong_imports_are_told_by_their_cause(one, two, tmp_path):
    cases = wrong_cases(one, two, 3)
    assert len(cases) == 40
    for k in SLICE:
        row = import_case(cases[k], tmp_path / str(k), k)
        assert row["told"] and row["exit"] == 2, row


def test_right_imports_pass_and_their_clock_is_right(one, two, tmp_path):
    rows = [
        import_case(case, tmp_path / str(k), k) | {"delay_s": 0.0}
        for k, case in enumerate(right_cases([one, two], 3, 4))
    ]
    result = summarise(rows)
    assert (result["refused_right"], result["clock_within_1_ms"]) == (0, 3), rows
