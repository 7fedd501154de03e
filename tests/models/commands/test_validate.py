"""Trials are validated before a fit: each against the link, and all together."""

import json

import numpy as np

from dropstitch.__main__ import main
from models.trials.files import write_trial


def validate(capsys, directory, *options):
    code = main(["validate", str(directory), "--json", *map(str, options)])
    return code, json.loads(capsys.readouterr().out)


def swinging():
    t = np.concatenate([np.zeros(30), 0.05 * np.arange(100)])
    return np.column_stack([0.5 * np.sin(t), 0.4 * np.sin(1.4 * t)])


def write(make_trial, directory, trial=1, **changes):
    angle_rad = (1 + 1e-4 * trial) * swinging()  # no two recordings are alike
    made = make_trial(angle_rad, rest_samples=30, amplitude_rad=0.5, trial=trial)
    made.columns.update(changes)
    object.__setattr__(made, "name", f"take{trial}")
    write_trial(made, directory)
    return made


def test_right_trials_pass_with_a_page_each(make_trial, tmp_path, capsys):
    for trial in (1, 2):
        write(make_trial, tmp_path, trial)
    code, said = validate(capsys, tmp_path, "--out", tmp_path / "pages")
    assert (code, said["verdict"]) == (0, "passed"), said
    assert (tmp_path / "pages" / "take2.html").read_text().count("<svg") >= 4


def test_a_wrong_trial_is_refused_by_its_cause(make_trial, tmp_path, capsys):
    made = write(make_trial, tmp_path)
    write(make_trial, tmp_path, 2, angle_2_rad=-made.columns["angle_2_rad"])
    code, said = validate(capsys, tmp_path)
    assert (code, said["verdict"]) == (1, "refused")
    assert said["trials"]["take1"]["verdict"] == "passed"
    assert said["trials"]["take2"]["findings"][0]["cause"] == "sign"


def test_a_single_trial_leaves_nothing_to_test_on(make_trial, tmp_path, capsys):
    write(make_trial, tmp_path)
    code, said = validate(capsys, tmp_path)
    assert (code, said["verdict"]) == (0, "warned")
    assert said["findings"][0]["cause"] == "held out"
