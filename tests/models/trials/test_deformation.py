"""Deformation Index: zero for rigid motions, the mean change of the lengths otherwise."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from firmware_py.core.errors import InputError
from firmware_py.link.marker_layout import square_corners_m
from models.shared.kinematics import base_corners_m
from models.trials.deformation import deformation_index, marker_lengths_m

pytestmark = pytest.mark.filterwarnings("error")


def occlude(trial, rows, *markers):
    for marker in markers:
        for axis in "xyz":
            trial.columns[f"m{marker:02d}_{axis}_m"][rows] = np.nan
    return trial


def test_a_rigid_motion_does_not_deform(make_trial):
    @settings(max_examples=30)
    @given(arrays(float, (6, 2), elements=st.floats(-1.2, 1.2)))
    def check(angle_rad):
        trial = make_trial(angle_rad)
        assert marker_lengths_m(trial).shape == (6, 16)
        assert deformation_index(trial) == pytest.approx(0, abs=1e-13)

    check()


def test_the_index_is_equation_1_written_out(make_trial, swing_rad):
    rng = np.random.default_rng(1)
    trial = make_trial(swing_rad)
    for name in trial.columns:
        if name[0] == "m":
            trial.columns[name] += 0.003 * rng.standard_normal(len(trial))
    corners = base_corners_m(trial.angle_rad, 0.06, square_corners_m(0.15))
    row, expected = 40, 0.0
    for corner in range(4):
        for k in range(4):

            def length(r, corner=corner, k=k):
                end = trial.markers_m[r, 4 * k + corner]
                start = trial.markers_m[r, 4 * (k - 1) + corner] if k else corners[r, corner]
                return np.sqrt(np.sum((end - start) ** 2))

            rest = (length(0) + length(1) + length(2)) / 3
            expected += abs(rest - length(row)) / rest / 16
    assert deformation_index(trial)[row] == pytest.approx(expected, rel=1e-12)


def test_the_mean_runs_over_the_visible_lengths(make_trial, swing_rad):
    stretch = np.ones(len(swing_rad))
    stretch[3:] = 1.01
    trial = occlude(make_trial(swing_rad, stretch=stretch), slice(20, 25), 6, 11)
    assert np.isnan(marker_lengths_m(trial)[20:25]).sum(axis=1).tolist() == [4] * 5  # two each
    assert deformation_index(trial)[3:] == pytest.approx(0.01)
    occlude(trial, slice(30, 31), *range(1, 17))
    assert np.flatnonzero(np.isnan(deformation_index(trial))).tolist() == [30]


def test_much_occlusion_is_warned_of_and_a_little_is_not(make_trial, swing_rad):
    deformation_index(occlude(make_trial(swing_rad), slice(40, 50), 5))
    trial = occlude(make_trial(swing_rad), slice(10, None), 5, 6)
    with pytest.warns(UserWarning, match=r"2\d% of the lengths are occluded"):
        deformation_index(trial)


def test_occlusion_does_not_shift_the_index(make_trial, swing_rad):
    """The first segment strains most, and the others are hidden twice as often."""

    def sheared():
        trial = make_trial(swing_rad)
        for marker in range(1, 17):
            trial.columns[f"m{marker:02d}_x_m"][3:] += 0.05
        return trial

    whole = deformation_index(sheared())
    assert whole[20] > 1e-3
    occluded = deformation_index(occlude(sheared(), slice(20, 25), 1, 6, 11, 16))
    assert occluded == pytest.approx(whole, rel=0.1)
    assert np.isnan(deformation_index(occlude(sheared(), slice(30, 31), 1, 2, 3, 4))[30])


def test_a_segment_that_is_not_visible_at_rest_has_no_reference(make_trial, swing_rad):
    trial = occlude(make_trial(swing_rad), slice(0, 3), 13, 14, 15, 16)
    with pytest.raises(InputError, match=r"row 4 of 4 are occluded in all 3 rest"):
        deformation_index(trial)
    for occluded in ((slice(0, 2), 13, 14, 15, 16), (slice(0, 3), 13)):  # one length is enough
        trial = occlude(make_trial(swing_rad), *occluded)
        assert deformation_index(trial)[2:] == pytest.approx(0, abs=1e-14)
    with pytest.raises(InputError, match="rest_samples is 0"):
        deformation_index(make_trial(swing_rad, rest_samples=0))
