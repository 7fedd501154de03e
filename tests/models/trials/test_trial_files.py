"""Trial files: written and read bit for bit, and refused where a part is wrong."""

import errno
import os
import re
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
import tomli_w
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from firmware_py.errors import InputError
from firmware_py.signals import trial_signals
from models.trials.files import read_trial, read_trials, write_trial
from models.trials.trial import SignalRole, Trial, TrialMeta, TrialSet

finite = st.floats(-6, 6, allow_nan=False)


def edit(path, change):
    """Rewrite a text file through `change`, and say that it did change."""
    before = path.read_text()
    after = change(before)
    assert after != before
    path.write_text(after)


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
def test_a_trial_comes_back_bit_for_bit(make_trial, tmp_path, data):
    dof = data.draw(st.sampled_from([1, 2]))
    angle_rad = data.draw(arrays(float, (7, dof), elements=finite))
    markers_m = data.draw(arrays(float, (7, 16, 3), elements=finite | st.just(np.nan)))
    trial = make_trial(
        angle_rad,
        markers_m,
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


def test_columns_stand_in_the_order_of_the_contract(written):
    header = written.read_text().splitlines()[0].split(",")
    assert header == [s.name for s in trial_signals(2)]
    assert header[:8] == [
        "time_s", "goal_1_rad", "angle_1_rad", "current_1_a",
        "goal_2_rad", "angle_2_rad", "current_2_a", "tip_x_m",
    ]  # fmt: skip
    assert header[-1] == "m16_z_m"


def test_views_of_a_trial_have_the_shapes_they_promise(written):
    trial = read_trial(written)
    n = len(trial)
    assert trial.angle_rad.shape == trial.goal_rad.shape == trial.current_a.shape == (n, 2)
    assert trial.tip_m.shape == (n, 3)
    assert trial.markers_m.shape == (n, 16, 3)
    assert trial.markers_m[5, 6, 2] == trial.columns["m07_z_m"][5]
    assert trial.step_s == pytest.approx(0.017)
    assert len(trial.time_s[trial.moving]) == n - 3


def test_an_occluded_marker_is_nan_and_everything_else_is_kept(written):
    set_cell(written, 9, "m07_y_m", "")
    markers_m = read_trial(written).markers_m
    assert np.argwhere(np.isnan(markers_m)).tolist() == [[7, 6, 1]]


@pytest.mark.parametrize("text", ["", "nan", "inf", "1,5e", "abc", "--"])
def test_a_bad_cell_is_named_by_row_and_column(written, text):
    set_cell(written, 12, "angle_2_rad", text.replace(",", ";"))
    sentence = refusal(written)
    assert "row 12" in sentence and "angle_2_rad" in sentence


def test_a_marker_cell_with_rubbish_is_no_occlusion(written):
    set_cell(written, 5, "m01_x_m", "n/a")
    assert re.search(r"row 5, column 'm01_x_m': 'n/a'", refusal(written))


@pytest.mark.parametrize("column", ["time_s", "current_2_a", "tip_z_m", "m16_z_m"])
def test_a_missing_column_is_named(written, column):
    edit(written, lambda text: text.replace(column, "spare_v", 1))
    assert f"column {column} is missing" in refusal(written)


def test_a_wrong_unit_gets_the_conversion_as_remedy(written):
    edit(written, lambda text: text.replace("angle_1_rad", "angle_1_deg", 1))
    sentence = refusal(written)
    assert "convert column 'angle_1_deg'" in sentence and "angle_1_rad" in sentence


@pytest.mark.parametrize(
    ("column", "value", "unit"),
    [("angle_1_rad", "-30.0", "degrees"), ("current_1_a", "1250", "mA"), ("m03_z_m", "980", "mm")],
)
def test_a_value_in_the_wrong_unit_under_the_right_name_is_noticed(written, column, value, unit):
    set_cell(written, 20, column, value)
    sentence = refusal(written)
    assert "row 20" in sentence and column in sentence and unit in sentence


def test_an_unknown_column_needs_a_unit_but_ours_do_not(written):
    lines = written.read_text().splitlines()
    written.write_text("\n".join([lines[0] + ",di"] + [row + ",0.01" for row in lines[1:]]))
    assert read_trial(written).columns["di"][4] == 0.01
    edit(written, lambda text: text.replace(",di\n", ",speed\n", 1))
    assert "'speed' has no unit suffix" in refusal(written)


def test_a_doubled_column_is_refused(written):
    edit(written, lambda text: text.replace("goal_2_rad", "goal_1_rad", 1))
    assert "'goal_1_rad' stands twice" in refusal(written)


def test_a_truncated_row_is_named(written):
    edit(written, lambda text: text[: len(text) * 2 // 3].rsplit(",", 1)[0])
    last = len(written.read_text().splitlines())
    assert re.search(rf"row {last} has \d+ cells, the header 58", refusal(written))


def test_a_file_without_samples_is_refused(written):
    written.write_text(written.read_text().splitlines()[0] + "\n")
    assert "has 0 rows" in refusal(written)


def test_a_binary_file_is_refused(written):
    written.write_bytes(bytes(range(256)) * 4)
    assert "is not UTF-8 text" in refusal(written)


@pytest.mark.parametrize("time", ["0.0925", "0.051", "-1.0"])
def test_a_step_that_is_not_uniform_is_named(written, time):
    set_cell(written, 7, "time_s", time)
    assert re.search(r"row [78], column time_s: step .* s, mean", refusal(written))


def test_a_spreadsheet_byte_order_mark_and_blank_last_lines_do_no_harm(written):
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
        ("payload_kg = 1.0", "payload_kg = -1.0", "payload_kg is -1.0"),
        ("payload_kg = 1.0", "payload_kg = nan", "payload_kg is nan"),
        ("payload_kg", "payload_g", "payload_g"),
        ("period_s = 4.352\n", "", "period_s"),
        ("amplitude_rad = 0.5", "amplitude_rad = 30", "amplitude_rad is 30"),
        ("rest_samples = 3", "rest_samples = 64", "rest_samples is 64"),
        ("rest_samples = 3", "rest_samples = -1", "rest_samples is -1"),
        ("rest_samples = 3", "rest_samples == 3", "is not TOML"),
    ],
)
def test_wrong_conditions_are_refused_by_key(written, old, new, what):
    edit(written.with_suffix(".toml"), lambda text: text.replace(old, new))
    sentence = refusal(written)
    assert what in sentence and ".toml" in sentence


def test_missing_files_are_named(written, tmp_path):
    assert "is missing" in refusal(tmp_path / "none.csv")
    written.with_suffix(".toml").unlink()
    assert "run.toml: is missing" in refusal(written)
    with pytest.raises(InputError, match="is not a directory"):
        read_trials(tmp_path / "none")
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="holds no trial"):
        read_trials(tmp_path / "empty")


def test_a_directory_is_read_in_order_of_name(make_trial, swing_rad, tmp_path):
    for name in ("b", "a", "c"):
        write_trial(make_trial(swing_rad, name=name), tmp_path)
    trials = read_trials(tmp_path)
    assert [t.name for t in trials] == ["a", "b", "c"]
    assert trials.where(lambda t: t.name != "b")[1].name == "c"


def test_hashes_follow_content(make_trial, swing_rad):
    trial = make_trial(swing_rad)
    assert trial.sha256() == make_trial(swing_rad).sha256()
    heavier = replace(trial, meta=msgspec.structs.replace(trial.meta, payload_kg=1.5))
    nudged = make_trial(swing_rad)
    nudged.columns["tip_x_m"][0] += 1e-15
    assert len({t.sha256() for t in (trial, heavier, nudged)}) == 3


def test_split_holds_out_repetitions_and_smaller_amplitudes(make_trial, swing_rad):
    def trial(name, **conditions):
        return make_trial(swing_rad, name=name, **conditions)

    trials = TrialSet((
        trial("one", trial=1, payload_kg=0.0),
        trial("one_heavy", trial=1, payload_kg=2.0),
        trial("two", trial=2, payload_kg=0.0),
        trial("small", trial=1, amplitude_rad=0.3),
        trial("other_motion", trial=2, motion="triangle"),
    ))  # fmt: skip
    fitted, held_out = trials.split()
    assert [t.name for t in fitted] == ["one", "one_heavy", "other_motion"]
    assert [t.name for t in held_out] == ["two", "small"]


def test_each_payload_and_phase_is_fitted_by_its_own_lowest_trial(make_trial, swing_rad):
    kinds = [("a", 0.0, 0.0), ("b", 1.0, 0.0), ("c", 1.0, 1.57), ("d", 2.0, 0.0)]
    takes = TrialSet(tuple(
        make_trial(swing_rad, name=f"{name}{n}", trial=2 * k + n, payload_kg=kg, phase_2_rad=lead)
        for k, (name, kg, lead) in enumerate(kinds) for n in (1, 2)
    ))  # fmt: skip
    fitted, held_out = takes.split()
    assert [t.name for t in fitted] == ["a1", "b1", "c1", "d1"]
    assert [t.name for t in held_out] == ["a2", "b2", "c2", "d2"]


def test_an_amplitude_that_was_rounded_is_the_same_amplitude(make_trial, swing_rad):
    amplitudes = {"rounded": 0.5236, "whole": 0.5235987755982988, "small": 0.5136}
    trials = TrialSet(tuple(
        make_trial(swing_rad, name=name, payload_kg=float(k), amplitude_rad=a)
        for k, (name, a) in enumerate(amplitudes.items())
    ))  # fmt: skip
    assert [t.name for t in trials.split()[0]] == ["rounded", "whole"]


def test_a_run_without_motion_capture_has_no_tip_but_a_tip_with_holes_is_refused(
    make_trial, swing_rad, tmp_path
):
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


@pytest.mark.parametrize(
    ("key", "value", "told"),
    [
        ("period_s", 0.0, "period_s is 0.0, outside 0.001 to 10000"),
        ("motion", "Sinusoid", 'write motion = "sinusoid"'),
        ("motion", " ", "motion is empty"),
    ],
)
def test_a_period_and_a_name_that_no_motion_has_are_refused(written, key, value, told):
    document = tomli_w.dumps({key: value})
    edit(written.with_suffix(".toml"), lambda t: re.sub(rf"{key} = .*\n", lambda _: document, t))
    assert told in refusal(written)


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


def test_a_file_that_ends_within_a_number_is_refused(make_trial, swing_rad, tmp_path):
    noise_rad = 1e-3 * np.random.default_rng(0).standard_normal(swing_rad.shape)
    written = write_trial(make_trial(swing_rad + noise_rad), tmp_path)
    text = written.read_text()
    written.write_text(text[:-1])  # a program that writes no last line break
    assert len(read_trial(written)) == 64
    written.write_text(text[:-12])
    assert "column 'm16_z_m': the file ends within" in refusal(written)


def test_an_underscore_is_no_part_of_a_number(written):
    set_cell(written, 3, "time_s", "0.0_17")
    assert "row 3, column 'time_s': '0.0_17'" in refusal(written)


@pytest.fixture
def directory(make_trial, swing_rad, tmp_path):
    for name in ("first", "second"):
        write_trial(make_trial(swing_rad, name=name), tmp_path)
    return tmp_path


@pytest.mark.parametrize("suffix", [".CSV", ".Csv"])
def test_a_suffix_in_capitals_is_a_trial_too(directory, suffix):
    before = read_trials(directory)
    (directory / "first.csv").rename(directory / f"first{suffix}")
    after = read_trials(directory)
    assert [t.name for t in after] == ["first", "second"]
    assert after.sha256() == before.sha256()


@pytest.mark.parametrize("suffix", [".TOML", ".Toml"])
def test_conditions_with_a_suffix_in_capitals_are_those_of_the_trial(directory, suffix):
    before = read_trials(directory)
    (directory / "first.toml").rename(directory / f"first{suffix}")
    assert read_trials(directory).sha256() == before.sha256()


@pytest.mark.parametrize("left", [("second",), ()])
def test_conditions_without_samples_are_refused(directory, left):
    for name in {"first", "second"} - set(left):
        (directory / f"{name}.csv").unlink()
    with pytest.raises(InputError, match=r"first\.toml: is a trial without samples: first\.csv is"):
        read_trials(directory)


def test_other_documents_lie_beside_trials(directory):
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
