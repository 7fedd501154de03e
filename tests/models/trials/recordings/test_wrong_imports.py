"""Forty wrong imports are refused with their cause, and right ones pass with the right clock."""

import json

import numpy as np
import pytest

from dropstitch.__main__ import main
from firmware_py.signals import trial_signals
from models.shared.kinematics import base_rotation
from models.trials.recordings.series import nominal_markers_m
from models.trials.trial import Trial, TrialMeta
from tests.models.trials.recordings.written_takes import right_cases, wrong_cases

REST = 60
QUICK = (0, 2, 5, 15, 22, 26, 29, 34, 37)
"""A sign, another of two joints, swapped names, origin, upward axis, yaw, a marker that is absent,
a gap, decimal commas."""


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
def trials():
    """A rigid link on one joint, and on two that move out of phase."""
    time_s = 0.017 * np.arange(REST + 360)
    t = np.clip(time_s - 0.017 * (REST - 1), 0, 5.0)
    smooth = np.clip(t, 0, 1) ** 2 * np.clip(5.0 - t, 0, 1) ** 2
    both = np.column_stack([0.5 * np.sin(2.6 * t) * smooth, 0.4 * np.sin(3.3 * t + 0.8) * smooth])
    return [rigid_trial(both[:, :1]), rigid_trial(both)]


def imported(case, directory, capsys, seed):
    """Exit code of the import, what it printed and what it said."""
    arguments = case.take.write(case.trial, directory, seed)
    code = main(["import", *arguments, "--out", str(directory / "trials"), "--json"])
    return code, *capsys.readouterr()


@pytest.mark.parametrize("k", QUICK)
def test_a_wrong_import_is_refused_with_its_cause(k, trials, tmp_path, capsys):
    case = wrong_cases(*trials, seed=3)[k]
    code, _, said = imported(case, tmp_path, capsys, k)
    assert code == 2 and case.cause in said, (case.name, said)


def test_every_other_one_is_refused_or_warned_of_with_its_cause(trials, tmp_path, capsys):
    for k, case in enumerate(wrong_cases(*trials, seed=3)):
        if k not in QUICK:
            _, _, said = imported(case, tmp_path / str(k), capsys, k)
            assert case.cause in said, (case.name, said)


def test_right_imports_pass_and_their_clock_is_right(trials, tmp_path, capsys):
    for k, case in enumerate(right_cases(trials, 3, 4)):
        code, document, said = imported(case, tmp_path / str(k), capsys, k)
        assert code == 0, said
        offset_s = json.loads(document)["offset_s"]
        assert offset_s == pytest.approx(case.take.offset_s - case.take.epoch_s, abs=1e-3)
