"""The command `dropstitch identify`: names of its result, refused before the fit."""

import pytest

from dropstitch.__main__ import main
from models.plant.plant import NOMINAL, read_plant
from models.trials.files import write_trial


class FitStarted(Exception):
    """The command has checked its arguments."""


@pytest.fixture
def directory(toy_trials, tmp_path, monkeypatch):
    """Directory with a trial, a plant and a configuration; nothing is fitted."""

    def fit(*_, **__):
        raise FitStarted

    monkeypatch.setattr("models.commands.identify.identify", fit)
    write_trial(toy_trials(1, amplitudes_deg=(30,))[0], tmp_path / "trials")
    for name in ("p.svg", "p.json"):
        read_plant().write(tmp_path / name)
    (tmp_path / "robot.toml").write_text("robot")
    return tmp_path


def identify(directory, plant, out, *options):
    return main(
        ["identify", f"{directory}/trials", "--plant", str(plant), "--out", str(out), *options]
    )


@pytest.mark.parametrize("name", ["p.svg", "plain", "p.yaml"])
def test_a_name_that_could_not_be_read_is_refused(directory, capsys, name):
    assert identify(directory, NOMINAL, directory / "id" / name) == 2
    assert "let its name end with .json or .toml" in capsys.readouterr().err
    assert not (directory / "id").exists()


@pytest.mark.parametrize("replaced", ["p.svg", "robot.toml", "trials/conditions"])
def test_the_result_does_not_replace_an_input(directory, capsys, replaced):
    path, plant, out, options = directory / replaced, NOMINAL, directory / replaced, []
    if replaced == "p.svg":  # the picture beside the plant
        plant, out = path, directory / "new" / ".." / "p.json"
    elif replaced == "robot.toml":
        options = ["--gains", str(path)]
    else:
        (path,) = (directory / "trials").glob("*.toml")
        out = path
    before = path.read_bytes()
    assert identify(directory, plant, out, *options) == 2
    assert "is a file that is read" in capsys.readouterr().err
    assert path.read_bytes() == before


def test_the_fit_may_replace_the_plant_that_it_starts_from(directory):
    with pytest.raises(FitStarted):
        identify(directory, directory / "p.json", directory / "p.json")
