"""`dropstitch calibrate`: what it refuses, keeps and writes."""

import json

import numpy as np
import pytest

from dropstitch.__main__ import main
from firmware_py.core.motion import Motion
from models.gap.calibration.files import (
    begin_work,
    calibration_directory,
    patterns_beside,
    patterns_file,
)
from models.gap.calibration.measurement import PatternWork
from models.gap.estimation.own_error import write_patterns
from models.gap.estimation.transfer import motion_of
from models.plant.plant import read_plant
from models.rig.protocol import TrialCase
from models.trials.files import write_trial


def refusal(capsys, *options, command="calibrate"):
    code = main([command, *map(str, options)])
    words = capsys.readouterr().err
    assert code == 2 and words.count("\n") == 1
    return words


def work(directory, amplitude_rad=0.2, links=1, plant=None):
    cases = (TrialCase(Motion(amplitude_rad=amplitude_rad, period_s=1.0), 0.0, 1),)
    return PatternWork(cases, cases, links, directory, None, plant)


@pytest.fixture
def plant_file(tmp_path):
    path = tmp_path / "plant.json"
    read_plant().write(path)
    return path


@pytest.mark.parametrize("option", ["--rigs", "--links", "--workers"])
def test_counts_that_are_too_small_are_refused(option, plant_file, tmp_path, capsys):
    said = refusal(capsys, tmp_path, "--plant", plant_file, option, 0)
    assert option in said


def test_trials_of_a_link_of_another_size_need_its_description(
    plant_file, tmp_path, capsys, make_trial
):
    (tmp_path / "trials").mkdir()
    write_trial(make_trial(np.zeros((80, 1)), link_length_m=0.8), tmp_path / "trials")
    said = refusal(capsys, tmp_path / "trials", "--plant", plant_file)
    assert "--link" in said and "0.8" in said
    assert not calibration_directory(plant_file).exists()


def test_a_plant_without_a_calibration_has_no_patterns_of_its_own(plant_file):
    assert patterns_beside(plant_file, read_plant(plant_file).sha256()) == ()


def test_what_was_measured_for_other_trials_is_not_used(tmp_path):
    marked = tmp_path / "calibration" / "own_error_0.npz"
    begin_work(work(tmp_path).fingerprint(), "a plant", marked.parent)
    foreign = [marked.parent / name for name in ("trials/run.csv", "plants/mine.json", "notes.md")]
    for path in (marked, marked.parent / "plants" / "drawn_0.json", *foreign):
        path.parent.mkdir(exist_ok=True)
        path.touch()
    begin_work(work(tmp_path).fingerprint(), "a plant", marked.parent)
    assert marked.exists()
    begin_work(work(tmp_path, amplitude_rad=0.21).fingerprint(), "a plant", marked.parent)
    left = {p for p in marked.parent.rglob("*") if p.is_file()}
    assert left == {marked.parent / "fingerprint.txt", *foreign}


def test_everything_that_changes_the_files_changes_the_fingerprint(tmp_path):
    plant = read_plant()
    prints = {
        w.fingerprint()
        for w in (
            work(tmp_path), work(tmp_path, links=2), work(tmp_path, amplitude_rad=0.3),
            work(tmp_path, plant=plant),
        )
    }  # fmt: skip
    assert len(prints) == 4
    assert work(tmp_path / "elsewhere").fingerprint() in prints


def test_patterns_are_measured_once_and_kept_beside_the_plant(tmp_path, capsys):
    trials, plant = tmp_path / "trials", tmp_path / "plant.json"
    motion = ["--amplitude-deg", "15", "--period", "2", "--payloads", "1", "--workers", "1"]
    assert main(["simulate", "--out", str(trials), *motion]) == 0
    read_plant().write(plant)
    capsys.readouterr()
    command = ["calibrate", str(trials), "--plant", str(plant), "--rigs", "2", "--links", "1"]
    assert main([*command, "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    (patterns,) = patterns_beside(plant, read_plant(plant).sha256())
    assert list(result["motions"]) == [motion_of(patterns.key)]
    assert "sinusoid 0.2618rad 2s" in patterns.key
    assert np.isfinite(patterns.table).all() and patterns.table.any()
    assert patterns.payload_kg.tolist() == [1.0]
    files = sorted(calibration_directory(plant).glob("own_error_*.npz"))
    times = [f.stat().st_mtime_ns for f in files]
    patterns_file(plant).unlink()
    assert main(command) == 0
    assert "sinusoid of ±15°, period 2 s, one joint: " in capsys.readouterr().out
    assert [f.stat().st_mtime_ns for f in files] == times
    assert patterns_file(plant).exists()


def test_patterns_of_another_plant_are_refused(plant_file, tmp_path, capsys, make_trial):
    plant = read_plant(plant_file)
    directory = calibration_directory(plant_file)
    begin_work("of the trials", "of a plant that was here before", directory)
    write_patterns((), patterns_file(plant_file))
    (tmp_path / "trials").mkdir()
    write_trial(make_trial(np.zeros((80, 1))), tmp_path / "trials")
    said = refusal(
        capsys, tmp_path / "trials", "--plant", plant_file, "--out", tmp_path / "gap", command="gap"
    )
    assert directory.name in said and "calibrate again" in said
    begin_work("of the trials", plant.sha256(), directory)
    write_patterns((), patterns_file(plant_file))
    assert patterns_beside(plant_file, plant.sha256()) == ()
