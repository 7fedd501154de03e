"""Library: its names, what they show of themselves, and what they say without the workshop."""

import importlib
import math
from pathlib import Path

import numpy as np
import pytest

import dropstitch

BUNDLE = Path(__file__).parents[2] / "docs" / "notebooks" / "bundle_1dof"


def test_every_name_is_there():
    for name in dropstitch.__all__:
        assert hasattr(dropstitch, name), name
    assert set(dir(dropstitch)) == set(dropstitch.__all__)
    assert dropstitch.read_plant is importlib.import_module("models.plant.plant").read_plant


def test_a_name_that_is_not_listed_is_no_attribute():
    with pytest.raises(AttributeError, match="no_such_name"):
        _ = dropstitch.no_such_name
    assert not hasattr(dropstitch, "models")


def test_without_the_workshop_a_name_says_what_to_do(monkeypatch):
    def without(module):
        raise ModuleNotFoundError(f"No module named {module!r}", name="casadi")

    monkeypatch.delitem(vars(dropstitch), "diagnose", raising=False)
    monkeypatch.setattr(importlib, "import_module", without)
    with pytest.raises(ImportError, match=r"^dropstitch\.diagnose belongs .* casadi .*setup'\.$"):
        _ = dropstitch.diagnose


def test_bad_arguments_are_refused_in_one_sentence():
    nothing = dropstitch.TrialSet(())
    for use in (dropstitch.diagnose, dropstitch.identify):
        with pytest.raises(dropstitch.InputError, match=r"^trials: are none; give"):
            use(None, nothing)
    rig = dropstitch.rig_named("default")
    for payload_kg in (-1.0, math.nan):
        with pytest.raises(dropstitch.InputError, match=r"^payload_kg: is"):
            dropstitch.run_case(rig, dropstitch.TrialCase(dropstitch.Motion(), payload_kg, 1))


def test_results_show_themselves_in_a_line_a_table_and_a_figure(toy_trials):
    plant = dropstitch.read_plant(BUNDLE / "plant.json")
    bundle = dropstitch.ModelBundle.load(BUNDLE)
    trials = dropstitch.TrialSet(toy_trials(1, amplitudes_deg=(30,))[:1])
    evaluation = dropstitch.evaluate_plant(plant, trials)
    (comparison,) = dropstitch.compare_with_trials(plant, trials)
    predictions = bundle.predict_many(np.zeros(5), np.zeros(5))
    rig = dropstitch.rig_named("default")
    for result in (plant, bundle, trials, trials[0], evaluation, comparison, predictions, rig):
        assert len(repr(result)) < 200
        assert "\n" not in repr(result)
    for result in (plant, trials, evaluation):
        assert result._repr_html_().startswith("<table>")
    for result in (trials[0], comparison):
        labels = [axes.get_ylabel() for axes in result.plot().axes]
        assert any(label.endswith(", rad") for label in labels)


def test_a_plant_is_linearised_for_python_control():
    system = dropstitch.read_plant(BUNDLE / "plant.json").linearise(payload_kg=1.0)
    assert system.dt == 0.017
    assert (np.abs(system.poles()) < 1.0 + 1e-9).all()  # the hysteresis remembers: a pole at one
    with pytest.raises(dropstitch.InputError, match="90"):
        dropstitch.read_plant().linearise(angles_rad=[3.0])


def test_the_loop_runs_on_a_bundle_and_writes_what_the_command_writes(tmp_path):
    run = dropstitch.run_sil(BUNDLE, tmp_path, line="virtual", seconds=2.0)
    assert repr(run).startswith("<SilResult: pass")
    assert len(run.plot().axes) == 2
    run.write()
    assert {"timing.json", "timing.xml", "ticks.mcap", "summary.svg", "trial"} <= {
        path.name for path in tmp_path.iterdir()
    }
    assert dropstitch.read_recording(tmp_path / "ticks.mcap").dof == 1
