"""The command `dropstitch identify`: names of its result, refused before the fit."""

import pytest

from dropstitch.__main__ import main
from models.plant.plant import NOMINAL, read_plant
from models.trials.files import write_trial


@pytest.fixture
def trials(toy_trials, tmp_path):
    """Directory with a trial."""
    write_trial(toy_trials(1, amplitudes_deg=(30,))[0], tmp_path / "trials")
    return tmp_path / "trials"


@pytest.fixture
def refused(capsys, monkeypatch):
    """Function that gives the command, which must end before the fit, and returns its sentence."""
    monkeypatch.setattr("models.commands.identify.identify", lambda *_: pytest.fail("fitted"))

    def run(*words):
        assert main(["identify", *map(str, words)]) == 2
        said = capsys.readouterr().err
        assert said.count("\n") == 1
        return said

    return run


@pytest.mark.parametrize("name", ["p.svg", "plain", "p.yaml"])
def test_a_name_that_could_not_be_read_is_refused(trials, refused, tmp_path, name):
    said = refused(trials, "--plant", NOMINAL, "--out", tmp_path / "id" / name)
    assert "let its name end with .json or .toml" in said
    assert not (tmp_path / "id").exists()


def test_the_picture_does_not_replace_the_given_plant(trials, refused, tmp_path):
    plant = tmp_path / "p.svg"
    read_plant().write(plant)
    before = plant.read_bytes()
    said = refused(trials, "--plant", plant, "--out", tmp_path / "new" / ".." / "p.json")
    assert "is a file that is read" in said
    assert plant.read_bytes() == before


def test_the_fit_may_replace_the_plant_that_it_starts_from(trials, tmp_path, monkeypatch):
    class Fitted(Exception):
        """The fit has begun."""

    def fit(*_):
        raise Fitted

    monkeypatch.setattr("models.commands.identify.identify", fit)
    plant = tmp_path / "p.json"
    read_plant().write(plant)
    with pytest.raises(Fitted):
        main(["identify", str(trials), "--plant", str(plant), "--out", str(plant)])


def test_the_given_configuration_is_not_replaced(trials, refused, tmp_path):
    config = tmp_path / "robot.toml"
    config.write_text("kept")
    said = refused(trials, "--plant", NOMINAL, "--gains", config, "--out", config)
    assert "is a file that is read" in said
    assert config.read_text() == "kept"


def test_the_conditions_of_a_trial_are_not_replaced(trials, refused):
    (conditions,) = trials.glob("*.toml")
    before = conditions.read_bytes()
    assert "is a file that is read" in refused(trials, "--plant", NOMINAL, "--out", conditions)
    assert conditions.read_bytes() == before


@pytest.mark.parametrize("name", ["P.JSON", "P.Toml", "plain"])
def test_a_plant_is_read_as_it_was_written(tmp_path, name):
    read_plant().write(tmp_path / name)
    assert (tmp_path / name).read_text().startswith("{") == name.endswith("JSON")
    assert read_plant(tmp_path / name) == read_plant()
