"""The command `dropstitch linearise`: what it writes is what python-control reads."""

import json

import control
import numpy as np
import pytest

from dropstitch.__main__ import main
from models.plant.plant import NOMINAL


def test_the_file_is_a_system_of_python_control(tmp_path, capsys):
    out = tmp_path / "linear.json"
    assert main(["linearise", "--plant", str(NOMINAL), "--payload-kg", "2", "--out", str(out)]) == 0
    m = json.loads(out.read_text())
    system = control.ss(m["A"], m["B"], m["C"], m["D"], m["dt"])
    assert (system.ninputs, system.noutputs) == (1, len(m["outputs"]))
    assert len(m["states"]) == system.nstates
    tip = m["outputs"].index("tip_x_m")
    low = abs(system(np.exp(0.01j * m["dt"]))[tip, 0])
    assert 0.9 < low < 1.5, "1 rad moves a link of 1 m by about 1 m, and it leans further by itself"
    assert m["margins"][0]["gain_db"] >= 6.0
    text = capsys.readouterr().out
    assert "damping" in text and "gain margin" in text


@pytest.mark.parametrize(
    ("options", "sentence"),
    [(["--payload-kg", "9"], "give 0 to 3 kg"), (["--angle-deg", "1", "2"], "give 1"),
     (["--period", "0"], "0.001 to 1 s"), (["--angle-deg", "nan"], "give 90° at most"),
     (["--angle-deg", "400"], "give 90° at most"), (["--payload-kg", "nan"], "give 0 to 3 kg")],
)  # fmt: skip
def test_wrong_options_are_refused(tmp_path, capsys, options, sentence):
    assert main(["linearise", "--plant", str(NOMINAL), "--out", str(tmp_path / "x"), *options]) == 2
    assert sentence in capsys.readouterr().err


def test_the_plant_that_is_read_is_not_overwritten(tmp_path, capsys):
    plant = tmp_path / "plant.json"
    plant.write_bytes(NOMINAL.read_bytes())
    assert main(["linearise", "--plant", str(plant), "--out", str(plant)]) == 2
    assert "is a file that is read" in capsys.readouterr().err
    assert plant.read_bytes() == NOMINAL.read_bytes()
