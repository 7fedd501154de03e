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
    meta = read_trial(tmp_path / "out" / "take.csv").meta
    assert (meta.trial, meta.recording_sha256) == (2, recording_hash(file))


@pytest.mark.parametrize("capitals", [False, True])
def test_a_trial_of_another_recording_stays(capitals, tmp_path, importing):
    assert importing(record(tmp_path / "take.csv"))[0] == 0
    for path in (tmp_path / "out").glob("take.*" if capitals else "none"):
        path.rename(path.with_suffix(path.suffix.upper()))
    before = contents(tmp_path / "out")
    other = record(tmp_path / "other" / "take.csv", amplitude_rad=0.4)
    code, err = importing(other)
    assert code == 2
    assert f"take.{'CSV' if capitals else 'csv'}: is a trial of another recording" in err
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


@pytest.mark.parametrize("name", ["take.csv", "take.toml"])
def test_a_file_that_is_no_imported_trial_stays(tmp_path, importing, name):
    file = record(tmp_path / "take.csv")
    assert importing(file)[0] == 0
    for path in (tmp_path / "out").iterdir():
        if path.name == name:
            path.write_text(path.read_text().split("recording_sha256")[0])
        else:
            path.unlink()
    before = contents(tmp_path / "out")
    code, err = importing(file)
    assert code == 2 and f"{name}: would be replaced, and is no imported trial" in err
    assert contents(tmp_path / "out") == before


def test_a_file_that_is_read_stays(tmp_path, importing):
    file = record(tmp_path / "raw" / "run.csv")
    (file.parent / "take.csv").symlink_to(file)
    mapping = file.parent / "other.toml"
    mapping.write_text(MAP.format(trial=1))
    before = contents(tmp_path / "raw")
    for name, read in (("take", "take.csv"), ("run", "run.csv"), ("other", "other.toml")):
        code, err = importing(file, mapping=mapping, out="raw", options=["--name", name])
        assert code == 2 and "would replace" in err and f"{read}, which is read" in err
        assert contents(tmp_path / "raw") == before


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
