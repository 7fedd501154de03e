"""The commands `plan` and `goalmap`: contradictory options, warnings, places of output."""

import json

import numpy as np
import pytest

from dropstitch.__main__ import main
from firmware_py.core.documents import write_document
from firmware_py.core.errors import InputError
from models.commands import goalmap
from models.plan.learning import RecordedRun
from models.plant.linear_twin import linearise, modes
from models.plant.plant import NOMINAL, read_plant
from tests.firmware_py.goals.small_plan import small_plan


@pytest.mark.parametrize(
    ("path", "options", "sentence"),
    [
        ("line", ["--zvd"], "--zvd: is for point_to_point; leave it out"),
        ("point_to_point", ["--rigid", "--zvd"], "--zvd: is set beside --rigid; leave one out"),
        ("line", ["--fastest"], "--fastest: is for the inverse of point_to_point"),
        ("point_to_point", ["--fastest", "--move", "1"], "without --move; leave it out"),
        ("a.CSV", ["--size", "0.1"], "contains size, place and time; leave --size"),
        ("line", ["--probe", "--open-loop"], "--probe: is for plans with feedback of the tip"),
        ("point_to_point", ["--probe"], "--probe: is for plans with feedback of the tip"),
        ("a.CSV", ["--out", "a.svg"], "is the name of the picture"),
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


@pytest.mark.parametrize(("payload_kg", "warnings"), [(3.0, 1), (0.5, 0)])
def test_a_recorded_payload_beyond_the_plan_is_a_warning(
    bare_bundle, tmp_path, capsys, monkeypatch, payload_kg, warnings
):
    def recorded(path, plan):
        none = np.zeros((plan.rows, 1))
        return RecordedRun(none, none, none, payload_kg, 1.0, "mocap", "0" * 64)

    def stop(*_):
        raise InputError("the test", "ends here", "go on")

    monkeypatch.setattr("models.plan.learning.read_plan_run", recorded)
    monkeypatch.setattr("models.plan.learning.improve_plan", stop)
    plan = tmp_path / "plan.json"
    write_document(plan, small_plan(bare_bundle))
    words = ["plan", plan, "--improve", tmp_path / "run.csv", "--plant", NOMINAL,
             "--bundle", bare_bundle, "--out", tmp_path / "better.json"]  # fmt: skip
    assert main([str(word) for word in words]) == 2
    error = capsys.readouterr().err
    assert "the test: ends here" in error
    sentence = f"warning: {tmp_path}/run.csv: the payload of the recording is 3 kg, the plan holds"
    assert error.count(sentence) == warnings


def test_the_map_states_the_mode_of_the_link_beside_a_slow_servo(
    bare_bundle, tmp_path, capsys, monkeypatch
):
    """The loop of the servo has 1.3 rad/s, damped by 0.4: half a period of 2.7 s."""
    monkeypatch.setattr("models.plan.rest_map.PLACES", {1: 7})
    plant, out = tmp_path / "plant.json", tmp_path / "map.json"
    slow = {"position_gain_1_per_s": 6.0, "velocity_gain_1_a_s_rad": 5.0}
    read_plant().with_values(slow).write(plant)
    words = ["goalmap", "--plant", plant, "--bundle", bare_bundle, "--payloads", 0, "--out", out]
    assert main([str(word) for word in words]) == 0
    ((half_period_s,),) = (p["half_period_s"] for p in json.loads(out.read_text())["payloads"])
    # With the stiff servo the link's mode is the slowest vibration.
    slowest = next(m for m in modes(linearise(read_plant(), 0.0)) if m.damping < 0.5)
    assert half_period_s == pytest.approx(slowest.half_period_s, rel=0.05)
    shown = capsys.readouterr()
    assert f"half period {half_period_s:.3f} s" in shown.out
    assert "stands out" not in shown.err

    monkeypatch.setattr(goalmap, "LEAST_SHARE", 0.99)
    assert main([str(word) for word in words]) == 0
    assert "with 0 kg no mode of joint 1 stands out" in capsys.readouterr().err
