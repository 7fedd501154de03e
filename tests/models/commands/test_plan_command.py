"""The command `models plan`: options that contradict each other or would change nothing."""

import pytest

from models.__main__ import main
from models.plant.plant import NOMINAL


@pytest.mark.parametrize(
    ("path", "options", "sentence"),
    [
        ("line", ["--zvd"], "--zvd: is for point_to_point; leave it out"),
        ("point_to_point", ["--rigid", "--zvd"], "--zvd: is given beside --rigid; leave one out"),
        ("line", ["--fastest"], "--fastest: is for the inverse of point_to_point"),
        ("point_to_point", ["--fastest", "--move", "1"], "without --move; leave it out"),
        ("own.CSV", ["--size", "0.1"], "has its own size, place and time; leave --size"),
        ("line", ["--probe", "--open-loop"], "--probe: is for plans with feedback of the tip"),
        ("line", ["--probe", "--rigid"], "--probe: is for plans with feedback of the tip"),
        ("point_to_point", ["--probe"], "--probe: is for plans with feedback of the tip"),
        ("own.CSV", ["--out", "own.svg"], "is the name of the picture"),
    ],
)
def test_unfit_options_are_refused(bare_bundle, tmp_path, capsys, path, options, sentence):
    out = tmp_path / "plan.json"
    words = ["plan", path, "--plant", NOMINAL, "--bundle", bare_bundle, "--out", out, *options]
    assert main([str(word) for word in words]) == 2
    assert sentence in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("words", [["plan", "line"], ["goalmap"]])
def test_the_plant_that_is_read_is_not_overwritten(bare_bundle, tmp_path, capsys, words):
    plant = tmp_path / "plant.json"
    plant.write_bytes(NOMINAL.read_bytes())
    words = [*words, "--plant", plant, "--bundle", bare_bundle, "--out", plant]
    assert main([str(word) for word in words]) == 2
    assert "is a file that is read" in capsys.readouterr().err
    assert plant.read_bytes() == NOMINAL.read_bytes()
