"""Imports over what is there: the same recording again, and nothing else, replaces a trial."""

import numpy as np
import pytest

from dropstitch.__main__ import main
from models.trials.files import read_trial
from models.trials.pipeline import recording_hash

MAP = """step_s = 0.01
[trial]
dof = 1
payload_kg = 0.5
pressure_pa = 41300.0
trial = {trial}
motion = "sinusoid"
period_s = 4.0
amplitude_rad = 0.5
base_offset_m = 0.06
link_length_m = 0.95
link_width_m = 0.15
notes = "no goals"
[columns]
time_s = {{ from = "t" }}
angle_1_rad = {{ from = "q" }}
goal_1_rad = {{ from = "q" }}
current_1_a = {{ from = "i" }}
"""


def record(path, amplitude_rad=0.5):
    """Recording of a servo, at rest and then swinging."""
    time_s = 0.01 * np.arange(500)
    swing = np.where(time_s < 1, 0, np.sin(2 * np.pi * (time_s - 1) / 4))
    rows = np.column_stack([time_s, amplitude_rad * swing, 0.2 * swing])
    path.parent.mkdir(exist_ok=True)
    np.savetxt(path, rows, "%.6f", ",", header="t,q,i", comments="")
    return path


@pytest.fixture
def importing(tmp_path, capsys):
    """Function (files, map, directory, options) -> exit code and standard error."""

    def call(*files, trial=1, mapping=None, out="out", options=()):
        if mapping is None:
            mapping = tmp_path / "map.toml"
            mapping.write_text(MAP.format(trial=trial))
        arguments = ["--as", "table", "--map", str(mapping), "--out", str(tmp_path / out)]
        code = main(["import", *map(str, files), *arguments, *options])
        return code, capsys.readouterr().err

    return call


def contents(directory):
    return {path.name: path.read_bytes() for path in directory.iterdir()}


def test_a_recording_is_imported_again_with_another_map_and_from_another_place(tmp_path, importing):
    file = record(tmp_path / "take.csv")
    assert importing(file)[0] == 0
    (tmp_path / "moved").mkdir()
    file = file.rename(tmp_path / "moved" / "take.csv")
    assert importing(file, trial=2)[0] == 0
    trial = read_trial(tmp_path / "out" / "take.csv")
    assert trial.meta.trial == 2
    assert trial.meta.recording_sha256 == recording_hash(file)


def test_a_trial_of_another_recording_stays(tmp_path, importing):
    assert importing(record(tmp_path / "take.csv"))[0] == 0
    before = contents(tmp_path / "out")
    other = record(tmp_path / "other" / "take.csv", amplitude_rad=0.4)
    code, err = importing(other)
    assert code == 2
    assert f"{tmp_path / 'out' / 'take.csv'}: is a trial of another recording" in err
    assert contents(tmp_path / "out") == before
    assert importing(other, options=["--name", "second"])[0] == 0


def test_of_several_takes_the_others_are_imported(tmp_path, importing):
    first = record(tmp_path / "takes" / "a.csv")
    assert importing(first)[0] == 0
    record(first, amplitude_rad=0.4)
    record(tmp_path / "takes" / "b.csv", amplitude_rad=0.3)
    before = contents(tmp_path / "out")
    assert importing(tmp_path / "takes")[0] == 2
    after = contents(tmp_path / "out")
    assert "b.csv" in after and {name: after[name] for name in before} == before


def test_a_trial_that_was_not_imported_is_not_replaced(tmp_path, importing):
    file = record(tmp_path / "take.csv")
    assert importing(file)[0] == 0
    conditions = tmp_path / "out" / "take.toml"
    conditions.write_text(conditions.read_text().split("recording_sha256")[0])
    before = contents(tmp_path / "out")
    code, err = importing(file)
    assert code == 2 and "take.csv: would be replaced, and is no imported trial" in err
    assert contents(tmp_path / "out") == before


def test_a_trial_whose_suffixes_are_in_capitals_is_one(tmp_path, importing):
    assert importing(record(tmp_path / "take.csv"))[0] == 0
    for path in (tmp_path / "out").glob("take.*"):
        path.rename(path.with_suffix(path.suffix.upper()))
    before = contents(tmp_path / "out")
    code, err = importing(record(tmp_path / "other" / "take.csv", amplitude_rad=0.4))
    assert code == 2 and "take.CSV: is a trial of another recording" in err
    assert contents(tmp_path / "out") == before


@pytest.mark.parametrize("name", ["take.csv", "take.toml"])
def test_a_file_that_is_no_trial_stays(tmp_path, importing, name):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / name).write_text("a = 1\n")
    code, err = importing(record(tmp_path / "take.csv"))
    assert code == 2 and f"{name}: would be replaced, and is no imported trial" in err
    assert contents(tmp_path / "out") == {name: b"a = 1\n"}


@pytest.mark.parametrize("linked", [False, True])
def test_a_recording_is_not_replaced_by_its_own_trial(tmp_path, importing, linked):
    file = record(tmp_path / "raw" / ("run.csv" if linked else "take.csv"))
    if linked:
        (file.parent / "take.csv").symlink_to(file)
    before = contents(tmp_path / "raw")
    code, err = importing(file, out="raw", options=["--name", "take"])
    assert code == 2 and "would replace" in err and "take.csv, which is read" in err
    assert contents(tmp_path / "raw") == before


def test_a_map_is_not_replaced_by_the_conditions_of_a_trial(tmp_path, importing):
    mapping = tmp_path / "raw" / "take.toml"
    mapping.parent.mkdir()
    mapping.write_text(MAP.format(trial=1))
    code, err = importing(record(tmp_path / "take.csv"), mapping=mapping, out="raw")
    assert code == 2 and "take.toml" in err
    assert contents(tmp_path / "raw") == {"take.toml": MAP.format(trial=1).encode()}


def test_two_takes_of_one_name_are_refused_before_any_work(tmp_path, importing):
    one, other = record(tmp_path / "a" / "take.csv"), record(tmp_path / "b" / "take.csv", 0.4)
    code, err = importing(one, other)
    assert code == 2 and "same name" in err
    assert not (tmp_path / "out").exists()


def test_the_hash_of_a_bag_follows_its_files(tmp_path):
    bag = tmp_path / "bag"
    bag.mkdir()
    (bag / "metadata.yaml").write_text("a")
    (bag / "bag_0.db3").write_text("b")
    first = recording_hash(bag)
    moved = bag.rename(tmp_path / "moved")
    assert recording_hash(moved) == first
    (moved / "bag_0.db3").write_text("c")
    assert recording_hash(moved) != first
