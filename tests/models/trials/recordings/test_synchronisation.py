import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from firmware_py.errors import InputError
from firmware_py.link.link_description import STUDY_LINK
from models.trials.clock import shift_clock, synchronise
from models.trials.files import read_trial
from models.trials.recordings.assembly import resample
from models.trials.recordings.series import Series, marker_columns
from models.trials.trial import TrialMeta


def servo_series(session, path):
    columns = {f"angle_{j}_rad": session.angle_rad[:, j - 1] for j in range(1, session.dof + 1)}
    return [Series(session.servo_s, columns, path)]


def meta_of(session):
    """Conditions of a trial of the study's link."""
    return TrialMeta(
        dof=session.dof, payload_kg=0.0, trial=1, motion="sinusoid", source="measured",
        period_s=4.0, rest_samples=1, **STUDY_LINK.conditions(),
    )  # fmt: skip


def mocap_series(session, path, markers_m=None):
    markers_m = session.markers_m if markers_m is None else markers_m
    named = {f"m{i + 1:02d}": markers_m[:, i] for i in range(16)}
    return [Series(session.mocap_s, marker_columns(named), path)]


def test_the_offset_is_found_to_a_fraction_of_a_sample(session, tmp_path):
    rng = np.random.default_rng(3)
    for late_s in (-40.0, 0.0, 0.0071, 1000.003):
        servo = shift_clock(servo_series(session, tmp_path), late_s)
        markers_m = session.markers_m + 2e-4 * rng.standard_normal(session.markers_m.shape)
        found = synchronise(servo, mocap_series(session, tmp_path, markers_m), meta_of(session))
        assert found.offset_s == pytest.approx(session.offset_s - late_s, abs=3e-4)
        assert found.correlation > 0.999


def test_a_recording_that_starts_late_or_has_holes_is_still_found(session, tmp_path):
    markers_m = session.markers_m.copy()
    markers_m[500:560, 1] = np.nan
    (mocap,) = mocap_series(session, tmp_path, markers_m)
    late = Series(mocap.time_s[200:], {k: v[200:] for k, v in mocap.columns.items()}, tmp_path)
    found = synchronise(servo_series(session, tmp_path), [late], meta_of(session))
    assert found.offset_s == pytest.approx(session.offset_s, abs=5e-4)


def test_a_link_that_overshoots_does_not_shift_the_clock(session, tmp_path, rigid_markers):
    """Bending in proportion to the angle scales the direction and must not move the offset."""
    true = np.column_stack(
        [np.interp(session.mocap_s, session.servo_true_s, a) for a in session.angle_rad.T]
    )
    bent_m = rigid_markers(1.2 * true)
    found = synchronise(
        servo_series(session, tmp_path), mocap_series(session, tmp_path, bent_m), meta_of(session)
    )
    assert found.offset_s == pytest.approx(session.offset_s, abs=1e-3)


def test_files_of_different_motions_are_refused(session, tmp_path):
    rng = np.random.default_rng(5)
    still_m = session.markers_m[:1] + 1e-3 * rng.standard_normal(session.markers_m.shape)
    with pytest.raises(InputError, match="correlate by"):
        synchronise(
            servo_series(session, tmp_path),
            mocap_series(session, tmp_path, still_m),
            meta_of(session),
        )
    mirrored_m = session.markers_m * [-1, -1, 1]
    with pytest.raises(InputError, match=r"check joint order, signs"):
        synchronise(
            servo_series(session, tmp_path),
            mocap_series(session, tmp_path, mirrored_m),
            meta_of(session),
        )


def write_table(path, columns):
    rows = zip(*columns.values(), strict=True)
    lines = [",".join(columns), *(",".join(repr(float(v)) for v in row) for row in rows)]
    path.write_text("\n".join(lines))
    return path


def test_an_explicit_offset_is_taken_as_it_is(session, write_map, run, check, tmp_path):
    (mocap,) = mocap_series(session, tmp_path)
    mocap_csv = write_table(tmp_path / "mocap.csv", {"time_s": mocap.time_s} | mocap.columns)
    columns = {"time_s": session.servo_s}
    for j in range(1, session.dof + 1):
        columns[f"goal_{j}_rad"] = columns[f"angle_{j}_rad"] = session.angle_rad[:, j - 1]
        columns[f"current_{j}_ma"] = 1e3 * session.current_a[:, j - 1]
    currents = {
        f"current_{j}_a": {"from": f"current_{j}_ma", "unit": "mA"}
        for j in range(1, session.dof + 1)
    }
    servo_csv = write_table(tmp_path / "servo.csv", columns)
    code, out, err = run(
        mocap_csv, "--as", "table", "--servo", servo_csv, "--offset", session.offset_s,
        "--map", write_map(session.dof, servo_columns=currents),
    )  # fmt: skip
    assert code == 0, err
    assert "correlation" not in out
    check(read_trial(tmp_path / "trials" / "mocap.csv"), session.servo_true_s[0], session.dof, 1e-4)


@settings(max_examples=50)
@given(
    arrays(float, 12, elements=st.floats(-5, 5)),
    st.lists(st.floats(0, 11), min_size=1, max_size=20).map(sorted),
)
def test_resampling_is_exact_at_samples_and_linear_between(values, grid):
    time_s = np.arange(12.0)
    grid_s = np.array(grid)
    assert resample(time_s, values, time_s).tolist() == values.tolist()
    assert resample(time_s, values, grid_s) == pytest.approx(np.interp(grid_s, time_s, values))
    held = resample(time_s, values, grid_s, hold=True)
    assert held.tolist() == [values[int(np.floor(t))] for t in grid]


def test_an_occlusion_spreads_to_no_sample_that_was_seen():
    time_s = np.arange(6.0)
    values = np.array([0.0, 1.0, np.nan, 3.0, 4.0, 5.0])
    out = resample(time_s, values, np.array([0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5]))
    assert np.isnan(out).tolist() == [False, False, True, True, True, False, False]
