"""The command `dropstitch goalmap`: it states the mode that goals are shaped by."""

import json

import numpy as np
import pytest

from dropstitch.__main__ import main
from firmware_py.signals import PERIOD_S
from models.commands import goalmap
from models.plant.linear_twin import linearise
from models.plant.plant import NOMINAL, read_plant


@pytest.fixture
def words(bare_bundle, tmp_path, monkeypatch):
    monkeypatch.setattr("models.commands.goalmap.compare_with_bundle", lambda *_: None)
    monkeypatch.setattr("models.plan.rest_map.PLACES", {1: 7})
    return ["goalmap", "--plant", str(NOMINAL), "--bundle", str(bare_bundle), "--payloads", "0",
            "--out", str(tmp_path / "map.json")]  # fmt: skip


def test_the_mode_is_that_of_the_link_beside_a_slow_servo(words, tmp_path, capsys):
    """The loop of the servo has 1.3 rad/s, damped by 0.4: half a period of 2.7 s."""
    plant = read_plant().with_values({"position_gain_1_per_s": 6.0, "velocity_gain_1_a_s_rad": 5.0})
    words[2] = str(tmp_path / "plant.json")
    plant.write(tmp_path / "plant.json")
    assert main(words) == 0
    (payload,) = json.loads((tmp_path / "map.json").read_text())["payloads"]
    twin = linearise(read_plant(), 0.0)  # with the stiff servo the link's mode is the slowest
    poles = np.log(np.linalg.eigvals(twin.A)) / PERIOD_S
    slowest = min(p.imag for p in poles if p.imag > 0 and -p.real < 0.5 * abs(p))
    assert payload["half_period_s"] == [pytest.approx(np.pi / slowest, rel=0.05)]
    shown = capsys.readouterr()
    assert f"half period {payload['half_period_s'][0]:.3f} s" in shown.out
    assert "stands out" not in shown.err


def test_a_mode_that_does_not_stand_out_is_warned_of(words, capsys, monkeypatch):
    monkeypatch.setattr(goalmap, "LEAST_SHARE", 0.99)
    assert main(words) == 0
    assert "with 0 kg no mode of joint 1 stands out" in capsys.readouterr().err
