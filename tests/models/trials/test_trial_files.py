"""Trial files: written and read bit for bit, and refused where a part is wrong."""

import errno
import os
import re
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from firmware_py.core.errors import InputError
from firmware_py.core.signals import trial_signals
from models.trials.files import read_trial, read_trials, write_trial
from models.trials.trial import SignalRole, Trial, TrialMeta, TrialSet

finite = st.floats(-6, 6, allow_nan=False)


def edit(path, old, new):
    """Replace a text where it stands first."""
    before = path.read_text()
    assert old in before
    path.write_text(before.replace(old, new, 1))


def set_cell(path, row, column, text):
    """Put `text` into a cell; `row` counts lines of the file from 1, as a refusal does."""
    lines = path.read_text().splitlines()
    cells = lines[row - 1].split(",")
    cells[lines[0].split(",").index(column)] = text
    lines[row - 1] = ",".join(cells)
    path.write_text("\n".join(lines) + "\n")


def refusal(path):
    with pytest.raises(InputError) as caught:
        read_trial(path)
    sentence = str(caught.value)
    assert str(path.with_suffix("")) in sentence
    assert "\n" not in sentence and sentence.endswith(".")
    return sentence


@pytest.fixture
def written(make_trial, swing_rad, tmp_path):
    return write_trial(make_trial(swing_rad), tmp_path)


@settings(
    max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(data=st.data())
def test_a_trial_is_read_as_it_was_written_bit_for_bit(make_trial, tmp_path, data):
    dof = data.draw(st.sampled_from([1, 2]))
    trial = make_trial(
        data.draw(arrays(float, (7, dof), elements=finite)),
        data.draw(arrays(float, (7, 16, 3), elements=finite | st.just(np.nan))),
        step_s=data.draw(st.floats(1e-4, 0.5)),
        payload_kg=data.draw(st.floats(0, 2)),
        notes=data.draw(st.text(st.characters(codec="utf-8", exclude_characters="\r"))),
    )
    for k, axis in enumerate("xyz"):
        trial.columns[f"tip_{axis}_m"] = data.draw(arrays(float, 7, elements=finite)) + k
    trial.columns["temperature_1_degc"] = data.draw(
        arrays(float, 7, elements=st.floats(allow_infinity=False))
    )
    back = read_trial(write_trial(trial, tmp_path))
    assert back.meta == trial.meta
    assert list(back.columns) == list(trial.columns)
    for name, column in trial.columns.items():
        assert np.array_equal(back.columns[name], column, equal_nan=True), name
    assert back.sha256() == trial.sha256()


def test_columns_have_the_order_of_the_contract_and_views_their_shapes(written):
    header = written.read_text().splitlines()[0].split(",")
    assert header == [s.name for s in trial_signals(2)]
    assert header[:4] == ["time_s", "goal_1_rad", "angle_1_rad", "current_1_a"]
    assert header[7] == "tip_x_m" and header[-1] == "m16_z_m"
    trial = read_trial(written)
    n = len(trial)
    assert trial.angle_rad.shape == trial.goal_rad.shape == trial.current_a.shape == (n, 2)
    assert (trial.tip_m.shape, trial.markers_m.shape) == ((n, 3), (n, 16, 3))
    assert trial.markers_m[5, 6, 2] == trial.columns["m07_z_m"][5]
    assert trial.step_s == pytest.approx(0.017)
    assert len(trial.time_s[trial.moving]) == n - 3


@pytest.mark.parametrize(
    ("row", "column", "text", "words"),
    [
        (12, "angle_2_rad", "", "angle_2_rad"),
        (12, "angle_2_rad", "inf", "angle_2_rad"),
        (12, "angle_2_rad", "abc", "angle_2_rad"),
        (5, "m01_x_m", "n/a", "'m01_x_m': 'n/a'"),
        (3, "time_s", "0.0_17", "'time_s': '0.0_17'"),
        (
            20,
            "angle_1_rad",
            "-30.0",
            "angle_1_rad: -30 is not plausible; convert it if it is in deg",
        ),
        (
            20,
            "current_1_a",
            "1250",
            "current_1_a: 1250 is not plausible; convert it if it is in mA",
        ),
        (20, "m03_z_m", "980", "m03_z_m: 980 is not plausible; convert it if it is in mm"),
        (7, "time_s", "0.0925", "column time_s: step"),
        (7, "time_s", "-1.0", "column time_s: step"),
    ],
)
def test_a_wrong_cell_is_refused_by_row_and_column(written, row, column, text, words):
    set_cell(written, row, column, text)
    sentence = refusal(written)
    assert words in sentence
    assert f"row {row}" in sentence or f"row {row + 1}, column time_s" in sentence


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("m16_z_m", "spare_v", "column m16_z_m is missing"),
        ("tip_z_m", "spare_v", "column tip_z_m is missing"),
        ("angle_1_rad", "angle_1_deg", "'angle_1_deg' to the SI unit and call it angle_1_rad"),
        ("goal_2_rad", "goal_1_rad", "'goal_1_rad' stands twice"),
    ],
)
def test_a_wrong_column_is_refused_by_name(written, old, new, words):
    edit(written, old, new)
    assert words in refusal(written)


def test_an_occluded_marker_is_nan(written):
    set_cell(written, 9, "m07_y_m", "")
    assert np.argwhere(np.isnan(read_trial(written).markers_m)).tolist() == [[7, 6, 1]]


def test_an_unknown_column_needs_a_unit_unless_it_is_of_a_log(written):
    lines = written.read_text().splitlines()
    written.write_text("\n".join([lines[0] + ",di"] + [row + ",0.01" for row in lines[1:]]))
    assert read_trial(written).columns["di"][4] == 0.01
    edit(written, ",di\n", ",speed\n")
    assert "'speed' has no unit suffix" in refusal(written)


def test_a_damaged_file_is_refused(written):
    whole = written.read_text()
    written.write_text(whole[: len(whole) * 2 // 3].rsplit(",", 1)[0])
    last = len(written.read_text().splitlines())
    assert re.search(rf"row {last} has \d+ cells, the header 58", refusal(written))
    written.write_text(whole.splitlines()[0] + "\n")
    assert "has 0 rows" in refusal(written)
    written.write_bytes(bytes(range(256)) * 4)
    assert "is not UTF-8 text" in refusal(written)


def test_a_file_that_ends_within_a_number_is_refused(make_trial, swing_rad, tmp_path):
    noise_rad = 1e-3 * np.random.default_rng(0).standard_normal(swing_rad.shape)
    written = write_trial(make_trial(swing_rad + noise_rad), tmp_path)
    text = written.read_text()
    written.write_text(text[:-1])  # a program that writes no last line break
    assert len(read_trial(written)) == 64
    written.write_text(text[:-12])
    assert "column 'm16_z_m': the file ends within" in refusal(written)


def test_a_byte_order_mark_and_blank_last_lines_are_ignored(written):
    before = read_trial(written)
    written.write_bytes(b"\xef\xbb\xbf" + written.read_bytes() + b"\n\n")
    assert read_trial(written).sha256() == before.sha256()


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ("schema = 1", "schema = 2", "schema is 2"),
        ("schema = 1\n", "", "schema is None"),
        ("dof = 2", "dof = 3", "dof is 3"),
        ("dof = 2", 'dof = "2"', "dof"),
        ("payload_kg = 1.0", "payload_kg = nan", "payload_kg is nan"),
        ("payload_kg", "payload_g", "payload_g"),
        ("period_s = 4.352\n", "", "period_s"),
        ("period_s = 4.352", "period_s = 0.0", "period_s is 0.0, outside 0.001 to 10000"),
        ("amplitude_rad = 0.5", "amplitude_rad = 30", "amplitude_rad is 30"),
        ("rest_samples = 3", "rest_samples = 64", "rest_samples is 64"),
        ("rest_samples = 3", "rest_samples == 3", "is not TOML"),
        ('motion = "sinusoid"', 'motion = "Sinusoid"', 'write motion = "sinusoid"'),
        ('motion = "sinusoid"', 'motion = " "', "motion is empty"),
    ],
)
def test_wrong_conditions_are_refused_by_key(written, old, new, what):
    edit(written.with_suffix(".toml"), old, new)
    sentence = refusal(written)
    assert what in sentence and ".toml" in sentence


def test_times_in_milliseconds_are_refused(make_trial, swing_rad, tmp_path):
    path = write_trial(make_trial(swing_rad, step_s=17.0), tmp_path)
    assert "the rows are 17 s apart" in refusal(path)


def test_another_plant_may_be_slow_and_have_no_period(tmp_path):
    meta = TrialMeta(
        dof=1, payload_kg=0.0, trial=1, motion="Steps", source="measured", period_s=0.0,
        rest_samples=1,
    )  # fmt: skip
    columns = {"time_s": 60.0 * np.arange(4), "temperature_1_degc": np.zeros(4)}
    path = write_trial(Trial("oven", meta, columns), tmp_path)
    assert len(read_trial(path, {"temperature_1_degc": SignalRole("degC", "measured")})) == 4


def test_the_tip_is_empty_only_without_motion_capture(make_trial, swing_rad, tmp_path):
    trial = make_trial(swing_rad)
    for name in trial.columns:
        if name.startswith(("tip", "m0", "m1")):
            trial.columns[name][:] = np.nan
    back = read_trial(write_trial(trial, tmp_path))
    assert np.isnan(back.tip_m).all() and np.isnan(back.markers_m).all()
    trial.columns["tip_x_m"][7:] = 0.1
    assert "row 2, column 'tip_x_m'" in refusal(write_trial(trial, tmp_path))


def test_a_full_disk_leaves_the_earlier_trial(make_trial, swing_rad, tmp_path, monkeypatch):
    trial = make_trial(swing_rad)
    write_trial(trial, tmp_path)
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}

    def refused(path, *_, **__):
        path.open("w").close()  # the old content is gone
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    for method in ("write_bytes", "write_text"):
        monkeypatch.setattr(Path, method, refused)
    other = replace(trial, meta=msgspec.structs.replace(trial.meta, trial=7))
    with pytest.raises(OSError, match="No space left"):
        write_trial(other, tmp_path)
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before


# --- directories ----------------------------------------------------------------------------------


@pytest.fixture
def directory(make_trial, swing_rad, tmp_path):
    for name in ("second", "first"):
        write_trial(make_trial(swing_rad, name=name), tmp_path)
    return tmp_path


def test_missing_files_and_directories_are_named(written, tmp_path):
    assert "is missing" in refusal(tmp_path / "none.csv")
    written.with_suffix(".toml").unlink()
    assert "run.toml: is missing" in refusal(written)
    (tmp_path / "empty").mkdir()
    for name, words in (("none", "is not a directory"), ("empty", "holds no trial")):
        with pytest.raises(InputError, match=words):
            read_trials(tmp_path / name)


@pytest.mark.parametrize("suffix", [".CSV", ".Toml"])
def test_a_suffix_may_be_in_capitals(directory, suffix):
    before = read_trials(directory)
    (directory / f"first{suffix.lower()}").rename(directory / f"first{suffix}")
    after = read_trials(directory)
    assert [t.name for t in after] == ["first", "second"]
    assert after.sha256() == before.sha256()


def test_conditions_without_samples_are_refused(directory):
    (directory / "first.csv").unlink()
    with pytest.raises(InputError, match=r"first\.toml: is a trial without samples: first\.csv is"):
        read_trials(directory)


def test_other_documents_may_lie_beside_trials(directory):
    for name, content in {
        "map": "[trial]\ntrial = 1\nrest_samples = 3\nmotion = 'step'\n[columns]\n",
        "link": "name = 'link'\nmotion = 'none'\n", "damaged": "trial = ", "empty": "",
    }.items():  # fmt: skip
        (directory / f"{name}.toml").write_text(content)
    assert [t.name for t in read_trials(directory)] == ["first", "second"]


def test_two_files_of_one_name_are_refused(directory):
    copy = directory / "first.CSV"
    if copy.exists():
        pytest.skip("the file system ignores the case")
    copy.write_bytes((directory / "first.csv").read_bytes())
    with pytest.raises(InputError, match="has the name of the trial first"):
        read_trials(directory)


# --- hashes and the split of a set ----------------------------------------------------------------


def test_hashes_follow_content(make_trial, swing_rad):
    trial, nudged = make_trial(swing_rad), make_trial(swing_rad)
    assert trial.sha256() == nudged.sha256()
    heavier = replace(trial, meta=msgspec.structs.replace(trial.meta, payload_kg=1.5))
    nudged.columns["tip_x_m"][0] += 1e-15
    assert len({t.sha256() for t in (trial, heavier, nudged)}) == 3


def test_repetitions_and_smaller_amplitudes_are_held_out(make_trial, swing_rad):
    conditions = {
        "one": {"payload_kg": 0.0, "trial": 2},
        "one_again": {"payload_kg": 0.0, "trial": 3},
        "small": {"payload_kg": 0.0, "amplitude_rad": 0.5136},
        "rounded": {"payload_kg": 1.0, "amplitude_rad": 0.5236},
        "ahead": {"payload_kg": 1.0, "phase_2_rad": 1.57, "trial": 4},
        "ahead_again": {"payload_kg": 1.0, "phase_2_rad": 1.57, "trial": 5},
        "other_motion": {"motion": "triangle", "amplitude_rad": 0.1},
    }
    trials = TrialSet(tuple(
        make_trial(swing_rad, name=name, **{"amplitude_rad": 0.5235987755982988} | changed)
        for name, changed in conditions.items()
    ))  # fmt: skip
    fitted, held_out = trials.split()
    assert [t.name for t in fitted] == ["one", "rounded", "ahead", "other_motion"]
    assert [t.name for t in held_out] == ["one_again", "small", "ahead_again"]
