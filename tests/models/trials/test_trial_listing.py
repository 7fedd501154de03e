"""Trials of a directory: every file of a trial counts, and other files may lie beside them."""

import pytest

from firmware_py.errors import InputError
from models.trials.files import read_trials, write_trial


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
