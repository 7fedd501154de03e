"""Trials of another link are refused: of several links, or of another one than the plant's."""

from dataclasses import replace

import msgspec
import pytest

from dropstitch.__main__ import main
from firmware_py.errors import InputError
from models.plant.identification.doubts import refuse_other_links
from models.plant.plant import read_plant
from models.predictor.fallback import doubts_of_di
from models.trials.checks.trials import check_trials
from models.trials.files import write_trial
from models.trials.trial import TrialSet

UPSIDE_DOWN = (0.0, 0.0, 9.81)


@pytest.fixture
def trials(toy_trials):
    """Two trials of the nominal link."""
    size = {"link_length_m": 0.95, "link_width_m": 0.15, "base_offset_m": 0.06}
    return [changed(t, **size) for t in toy_trials(1)[:2]]


def changed(trial, **conditions):
    return replace(trial, meta=msgspec.structs.replace(trial.meta, **conditions))


CHANGES = [
    {"link_length_m": 0.475}, {"link_width_m": 0.1}, {"base_offset_m": 0.3},
    {"gravity_m_s2": UPSIDE_DOWN},
]  # fmt: skip


@pytest.mark.parametrize("change", CHANGES)
def test_trials_of_two_links_are_refused_as_validate_refuses_them(trials, change):
    refuse_other_links(read_plant(), "plant.json", trials)
    mixed = [trials[0], changed(trials[1], **change)]
    with pytest.raises(InputError) as refusal:
        refuse_other_links(read_plant(), "plant.json", mixed)
    shared = check_trials(TrialSet(tuple(mixed)))
    found = next(f for f in shared if f.cause == "size")
    assert found.level == "refused"
    assert found.text in str(refusal.value)
    assert str(mixed[1].path) in str(refusal.value)


@pytest.mark.parametrize("change", CHANGES)
def test_trials_of_another_link_than_the_plants_are_refused(trials, change):
    others = [changed(t, **change) for t in trials]
    with pytest.raises(InputError, match=next(iter(change)).removesuffix("_m_s2")):
        refuse_other_links(read_plant(), "plant.json", others)


def test_a_length_by_the_tape_is_that_of_the_plant(trials):
    measured = [changed(t, link_length_m=0.946) for t in trials]
    refuse_other_links(read_plant(), "plant.json", measured)


@pytest.mark.parametrize(
    "command",
    [
        ["train", "--dof", "1", "--out", "bundle"],
        ["identify", "--out", "plant.json"],
        ["evaluate"],
        ["gap", "--out", "gap"],
        ["calibrate"],
    ],
)
def test_every_command_that_compares_trials_with_a_plant_refuses(
    trials, tmp_path, capsys, monkeypatch, command
):
    name, *options = command
    for trial in trials:
        write_trial(changed(trial, base_offset_m=0.3), tmp_path / "trials")
    monkeypatch.chdir(tmp_path)
    read_plant().write(tmp_path / "nominal.json")
    assert main([name, "trials", "--plant", "nominal.json", *options]) == 2
    told = capsys.readouterr().err.strip().splitlines()[-1]
    assert all(word in told for word in ("base_offset_m is 0.3 m", "nominal.json", "0.06 m"))
    assert not (tmp_path / "bundle").exists()


def test_an_estimate_of_the_di_that_is_worse_than_its_mean_is_told():
    assert doubts_of_di({"trial_2": 0.9, "unseen": 0.0}) == []
    assert doubts_of_di({}) == []
    (said,) = doubts_of_di({"trial_2": -0.1, "unseen": -1.035})
    assert said.startswith("R² of the estimated DI is -1.035 on unseen")
    assert "dropstitch validate" in said
