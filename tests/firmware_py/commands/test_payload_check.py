"""The payload of the configuration is compared with the currents of the run."""

import functools
from dataclasses import replace

import numpy as np
import pytest

from firmware_py.commands.payload_check import contradicted_payload, unused_payload
from firmware_py.core.motion import Motion
from firmware_py.core.signals import PERIOD_S, tick_dtype
from firmware_py.inference.bundle import ModelBundle
from firmware_py.safety.states import SafetyState
from firmware_py.summary import Ended, RunSummary
from firmware_py.system.timing import Timing
from models.plant.plant import read_plant
from models.plant.simulation.runner import simulate_plant


@pytest.fixture(scope="module")
def bundle(observer_bundle):
    return ModelBundle.load(observer_bundle)


@functools.cache
def signals_of(payload_kg, kind, amplitude_rad):
    """Angles and currents of the nominal link with a payload."""
    goal_rad = Motion(kind=kind, amplitude_rad=amplitude_rad).table_rad()[:, 0]
    return simulate_plant(read_plant(), {"goal_1_rad": goal_rad, "payload_kg": payload_kg})


def run_of(payload_kg, kind="sinusoid", amplitude_rad=0.5):
    """Run of that link."""
    signals = signals_of(payload_kg, kind, amplitude_rad)
    records = np.zeros(len(signals["time_s"]), tick_dtype(1))
    for name in ("angle_1_rad", "current_1_a"):
        records[name] = signals[name]
    records["state"] = SafetyState.RUNNING
    records["deadline_ns"] = 10**9 + np.round(1e9 * PERIOD_S * np.arange(len(records)))
    return RunSummary(
        Ended.FINISHED, "the motion is over", len(records), {}, 0, Timing(), records, 0
    )


def note(bundle, payload_kg, summary):
    return contradicted_payload(bundle, payload_kg, PERIOD_S, summary)


@pytest.mark.parametrize("kind", ["sinusoid", "steps"])
def test_a_wrong_payload_is_reported_and_a_right_one_is_not(bundle, kind):
    for payload_kg in (0.0, 1.0):
        summary = run_of(payload_kg, kind)
        assert note(bundle, payload_kg, summary) == ""
        wrong = note(bundle, payload_kg + 0.5, summary)
        assert f"payload_kg is {payload_kg + 0.5:g} kg" in wrong
        assert f"fit a payload of {payload_kg:.1f}" in wrong
        assert "leave it out" in wrong


def test_a_payload_is_used_by_an_observer_alone(bundle, toy_bundle):
    assert unused_payload(bundle, 1.0) == "" == unused_payload(bundle, None)
    assert note(bundle, None, run_of(1.0)) == ""
    lagged = ModelBundle.load(toy_bundle)
    assert unused_payload(lagged, None) == ""
    assert note(lagged, 2.0, run_of(1.0)) == ""
    assert "payload_kg = 0 changes no prediction" in unused_payload(lagged, 0.0)


def test_currents_without_torque_or_of_stale_ticks_do_not_count(bundle):
    summary = run_of(1.0)
    for name, value in (("alert", 32), ("state", SafetyState.STOPPING)):
        records = summary.records.copy()
        records["current_1_a"][200:] = 0.0
        records[name][200:] = value
        assert note(bundle, 1.0, replace(summary, records=records)) == ""
        assert "payload of 1.0" in note(bundle, 2.0, replace(summary, records=records))
    summary.records["stale_ticks"][::7] = 1
    summary.records["current_1_a"][::7] = 9.0
    assert note(bundle, 1.0, summary) == ""


def test_the_begin_of_a_long_run_is_read_from_its_log(bundle, monkeypatch, tmp_path):
    summary = run_of(2.0)
    asked = []

    def read(path, first):
        asked.append((path, first))
        columns = {name: summary.records[name] for name in summary.records.dtype.names}
        return type("Log", (), {"columns": columns})

    monkeypatch.setattr("firmware_py.commands.payload_check.read_recording", read)
    cut = replace(summary, records=summary.records[100:])
    wrong = contradicted_payload(bundle, 1.0, PERIOD_S, cut, tmp_path / "run.mcap")
    assert float(wrong.split("payload of ")[1].split(" ")[0]) == pytest.approx(2.0, abs=0.1)
    assert asked == [(tmp_path / "run.mcap", 3530)]


def test_a_fault_of_the_comparison_is_a_sentence(bundle, tmp_path):
    gone = replace(bundle, directory=tmp_path)
    assert "could not be compared" in note(gone, 1.0, run_of(1.0))
    summary = run_of(1.0)
    summary.records["angle_1_rad"][50] = np.nan
    assert isinstance(note(bundle, 1.0, summary), str)
