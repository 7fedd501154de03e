"""Trials are validated before a fit: each against the link, and all together."""

import json
from dataclasses import replace

import msgspec
import numpy as np
import pytest

from dropstitch.__main__ import main
from models.plant.plant import read_plant
from models.trials.checks.payloads import judge_payload_unit, payload_unit_cause
from models.trials.checks.trials import check_trials
from models.trials.files import write_trial
from models.trials.trial import TrialSet


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


def declared(trials, factor):
    """The trials with payloads in another unit."""
    return [
        replace(t, meta=msgspec.structs.replace(t.meta, payload_kg=factor * t.meta.payload_kg))
        for t in trials
    ]


PLANT_VALUES = {name: q.value for name, q in read_plant().parameters.items()}


@pytest.mark.parametrize(
    ("factor", "unit"),
    [
        (1.0, ""), (2.2046, "in pounds"), (9.81, "in newtons"), (35.27, "in ounces"),
        (1e3, "in grams"), (1 / 2.2046, "divided by 2.2"),
    ],
)  # fmt: skip
def test_the_unit_of_the_payloads_is_told_by_the_current_and_the_plant(toy_trials, factor, unit):
    found = judge_payload_unit(declared(toy_trials(1), factor), PLANT_VALUES)
    assert [f.cause for f in found] == ["payload unit"] * bool(unit)
    assert all(unit in f.text for f in found)


def test_a_wrong_torque_constant_is_not_taken_for_a_unit(toy_trials):
    wrong = PLANT_VALUES | {"torque_constant_1_nm_a": 2.2 * 6.83}
    (found,) = judge_payload_unit(list(toy_trials(1)), wrong)
    assert found.cause == "torque constant"


@pytest.mark.parametrize(
    ("factor", "error", "unit"),
    [
        (0.48, 0.02, "in pounds"), (1.05, 0.01, None), (0.7, 0.02, None), (0.5, 0.3, None),
        (0.11, 0.01, "in newtons"),
    ],
)  # fmt: skip
def test_a_factor_names_a_unit_only_where_one_fits_and_one_does_not(factor, error, unit):
    assert payload_unit_cause(factor, error) == unit


def test_payloads_in_pounds_are_told_with_a_plant(toy_trials, tmp_path, capsys):
    for trial in declared(toy_trials(1), 2.2046):
        meta = msgspec.structs.replace(trial.meta, source="measured")
        write_trial(replace(trial, meta=meta), tmp_path)
    code, said = validate(capsys, tmp_path, "--plant", "models/plant/nominal.toml")
    assert code == 0 and "payload unit" in [f["cause"] for f in said["findings"]]


def test_servo_logs_of_other_takes_are_told_by_the_bend(toy_trials):
    """Angles of one motion are alike; the currents of two payloads are exchanged."""
    light, middle, heavy = (
        t for t in toy_trials(1) if t.meta.trial == 1 and t.meta.amplitude_rad > 0.5
    )
    names = ("time_s", "goal_1_rad", "angle_1_rad", "current_1_a")
    swapped = [
        replace(t, columns=t.columns | {n: other.columns[n] for n in names})
        for t, other in ((light, heavy), (heavy, light))
    ]
    found = check_trials(TrialSet((swapped[0], middle, swapped[1])))
    assert "servo log" in [f.cause for f in found]
    right = check_trials(TrialSet((light, middle, heavy)))
    assert not {"servo log", "payload"} & {f.cause for f in right}
