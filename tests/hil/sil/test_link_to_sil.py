"""Worked example of docs/plant/link.md: from a link's size to a run in software."""

import json

import numpy as np
import pytest

from dropstitch.__main__ import main as dropstitch
from firmware_py.inference.bundle import ModelBundle
from firmware_py.log.recording import read_recording
from hil.sil.sil_options import SilOptions, sil_config
from hil.sil.timing_document import read_timing
from models.plant.plant import read_plant
from models.predictor.document import read_predictors
from models.rig.drawn import rig_named
from models.shared.c_compiler import OPTIONS_VARIABLE
from models.shared.kinematics import rigid_tip_m
from models.trials.files import read_trial

pytestmark = pytest.mark.slow

LINK = (
    "--length 0.6 --width 0.1 --rows 3 --servo XM430-W350 --mounting hanging --dof 1 "
    "--pressure-pa 20700 --largest-payload-kg 0.4"
)
MOTION = "--period 2.2 --amplitude-deg 20"
"""Brief, and within the robot's default limit of acceleration."""


@pytest.fixture
def brief(monkeypatch):
    """Leave out what costs most: long rests, optimised C, second fits."""
    monkeypatch.setenv(OPTIONS_VARIABLE, "-O1")
    monkeypatch.setattr(
        "models.commands.simulate.rig_named",
        lambda name: rig_named(name).changed(**{"world.pause_s": 0.3, "world.settle_s": 0.1}),
    )
    monkeypatch.setattr("models.plant.identification.identify.starts_with_option", lambda plant: [])
    monkeypatch.setattr(
        "models.plant.identification.identify.with_noise_floor", lambda plant, trials: plant
    )


@pytest.mark.usefixtures("brief")
def test_five_commands_lead_from_another_link_to_a_run_of_its_robot(tmp_path, capsys):
    link, trials, plant, bundle, sil = (
        tmp_path / name for name in ("link.toml", "trials", "plant.json", "bundle", "sil")
    )

    def passes(arguments):
        assert dropstitch(arguments.split()) == 0, arguments
        return capsys.readouterr().out

    passes(f"new {link} {LINK}")
    passes(f"simulate --rig {link} --out {trials} --payloads 0.4 {MOTION} --workers 1 --seed 1")
    text = passes(f"identify {trials} --plant {link} --out {plant} --json")
    held_out = json.loads(text)["held_out"]
    assert held_out["tip_rms_m"] < held_out["rigid_tip_rms_m"] / 4

    text = passes(f"train {trials} --dof 1 --plant {plant} --out {bundle}")
    assert "no unseen motion" in text and "--amplitude-deg 20" in text
    assert "--study" in text and not (bundle / "study.json").exists()
    assert list(read_predictors(bundle / "predictors.json").candidates) == ["observer"]
    link_of_bundle = read_plant(bundle / "plant.json").link
    options = SilOptions(bundle=ModelBundle.load(bundle), out=sil)
    assert (options.model.name, options.payload_kg) == ("XM430-W350", 0.2)
    limits = sil_config(options, "virtual").limits
    assert limits.current_a == link_of_bundle.preset.current_limit_a
    assert limits.tip_max_m == pytest.approx(3 * (1.2 * 0.66,), abs=1e-3)
    assert link_of_bundle.layout.count == 12 and link_of_bundle.servo.model == "XM430-W350"
    assert link_of_bundle.gravity.mounting == "hanging"

    text = passes(
        f"sil --bundle {bundle} --rig {link} --line virtual --out {sil} --payload-kg 0.4 "
        f"--seconds 2.2 {MOTION}",
    )
    timing = read_timing(sil / "timing.json")
    assert timing.run.ended == "finished" and timing.own_misses == 0
    assert timing.environment.servo == "XM430-W350"
    log, trial = read_recording(sil / "ticks.mcap"), read_trial(sil / "trial" / "sil.csv")
    assert log.complete and len(log.columns["tick"]) == timing.ticks
    assert trial.markers_m.shape[1] == 12 and trial.meta.gravity == (0.0, 0.0, 9.81)
    rigid_m = rigid_tip_m(trial.angle_rad, link_of_bundle.base_offset_m, link_of_bundle.length_m)
    rigid_rms_m = np.sqrt(np.mean(np.sum((trial.tip_m - rigid_m) ** 2, axis=1)))
    assert timing.prediction_error.rms_m < rigid_rms_m / 2
