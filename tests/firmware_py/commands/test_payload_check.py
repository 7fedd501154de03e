"""A payload that the robot was told is compared with the currents of the run."""

import functools
import shutil
from dataclasses import replace

import numpy as np
import pytest

from dropstitch.__main__ import main as dropstitch
from firmware_py.commands.payload_check import PayloadEstimate, contradicted_payload, unused_payload
from firmware_py.core.motion import Motion
from firmware_py.core.signals import PERIOD_S, tick_dtype
from firmware_py.inference.bundle import ModelBundle
from firmware_py.safety.states import SafetyState
from firmware_py.summary import Ended, RunSummary
from firmware_py.system.timing import Timing
from models.plant.plant import read_plant
from models.plant.simulation.runner import simulate_plant


@pytest.fixture(scope="module")
def bundle(toy_bundle, tmp_path_factory):
    """A bundle with the observer of the nominal plant."""
    directory = tmp_path_factory.mktemp("robot") / "bundle"
    shutil.copytree(toy_bundle, directory)
    plant = str(directory / "plant.json")
    assert dropstitch(["fmu", "build", str(directory), "--plant", plant, "--unit", "observer"]) == 0
    return ModelBundle.load(directory)


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


def said(bundle, told_kg, summary):
    return contradicted_payload(bundle, told_kg, PERIOD_S, summary)


@pytest.mark.parametrize("kind", ["sinusoid", "steps"])
def test_a_wrong_payload_is_told_and_a_right_one_is_not(bundle, kind):
    for payload_kg in (0.0, 1.0):
        summary = run_of(payload_kg, kind)
        assert said(bundle, payload_kg, summary) == ""
        told = said(bundle, payload_kg + 0.5, summary)
        assert f"told {payload_kg + 0.5:g} kg (payload_kg)" in told
        assert f"fit a payload of {payload_kg:.1f}" in told
        assert "leave it out" in told


def test_a_payload_is_used_by_an_observer_alone(bundle, toy_bundle):
    assert unused_payload(bundle, 1.0) == "" == unused_payload(bundle, None)
    lagged = ModelBundle.load(toy_bundle)
    assert unused_payload(lagged, None) == ""
    assert "payload_kg = 0 changes no prediction" in unused_payload(lagged, 0.0)


def test_an_estimate_is_held_against_its_own_deviation():
    assert PayloadEstimate(1.0, 0.02, 1.0).contradicts(1.5)
    assert not PayloadEstimate(1.0, 0.02, 1.0).contradicts(1.25)
    assert not PayloadEstimate(1.0, 0.2, 1.0).contradicts(1.5)


def test_currents_without_torque_are_not_weighed(bundle):
    summary = run_of(1.0)
    for name, value in (("alert", 32), ("state", SafetyState.STOPPING)):
        records = summary.records.copy()
        records["current_1_a"][200:] = 0.0
        records[name][200:] = value
        assert said(bundle, 1.0, replace(summary, records=records)) == ""
        assert "payload of 1.0" in said(bundle, 2.0, replace(summary, records=records))


def test_stale_ticks_are_left_out(bundle):
    summary = run_of(1.0)
    summary.records["stale_ticks"][::7] = 1
    summary.records["current_1_a"][::7] = 9.0
    assert said(bundle, 1.0, summary) == ""


def test_the_begin_of_a_long_run_is_read_from_its_log(bundle, monkeypatch, tmp_path):
    summary = run_of(2.0)
    asked = []

    def read(path, first):
        asked.append((path, first))
        columns = {name: summary.records[name] for name in summary.records.dtype.names}
        return type("Log", (), {"columns": columns})

    monkeypatch.setattr("firmware_py.commands.payload_check.read_recording", read)
    cut = replace(summary, records=summary.records[100:])
    told = contradicted_payload(bundle, 1.0, PERIOD_S, cut, tmp_path / "run.mcap")
    assert float(told.split("payload of ")[1].split(" ")[0]) == pytest.approx(2.0, abs=0.1)
    assert asked == [(tmp_path / "run.mcap", 3530)]


def test_a_fault_of_the_comparison_is_a_sentence(bundle, tmp_path):
    gone = replace(bundle, directory=tmp_path)
    assert "could not be compared" in said(gone, 1.0, run_of(1.0))
    summary = run_of(1.0)
    summary.records["angle_1_rad"][50] = np.nan
    assert isinstance(said(bundle, 1.0, summary), str)


def test_nothing_is_compared_without_an_observer_or_a_told_payload(bundle, toy_bundle):
    assert said(bundle, None, run_of(1.0)) == ""
    assert said(ModelBundle.load(toy_bundle), 2.0, run_of(1.0)) == ""


def test_the_observer_of_the_run_is_left_as_it_is(bundle):
    bundle.assume_payload(2.0)
    first = bundle.estimator.update(np.array([0.1]), np.array([0.5]), PERIOD_S)
    assert said(bundle, 2.0, run_of(1.0))
    again = bundle.estimator.update(np.array([0.1]), np.array([0.5]), PERIOD_S)
    assert (first.payload_kg, again.payload_kg) == (2.0, 2.0)
