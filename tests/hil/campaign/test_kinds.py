"""Kinds of cases: the same result every time, and the same as the command's."""

import json
import signal
from pathlib import Path

import msgspec
import pytest

from firmware_py.core.errors import InputError
from firmware_py.log.telemetry import Telemetry
from hil.campaign.cases import canonical_json
from hil.campaign.kinds.case_kind import load_kind


def result_of(kind, tmp_path, **values):
    return kind.run(msgspec.convert(values, kind.options), tmp_path)


def test_a_trial_of_the_rig_leaves_figures_of_its_size(tmp_path):
    kind, _ = load_kind("rig")
    short = {"period_s": 1.0, "amplitude_rad": 0.1, "effects": {"backlash": 0.004}, "seed": 1}
    figures = json.loads(canonical_json(result_of(kind, tmp_path, **short)))
    assert 0 < figures["rigid_tip_rms_m"] < 0.1
    assert 0.09 < figures["largest"]["goal_1_rad"] < 0.11
    assert figures["largest"]["di"] > 0


def test_a_run_in_software_does_not_depend_on_the_runs_before_it(tmp_path, toy_bundle):
    kind, _ = load_kind("sil")
    values = {"bundle": str(toy_bundle), "seconds": 1.0, "payload_kg": 1.0, "seed": 3}
    shared = {"fmu": kind.prepare(msgspec.convert(values, kind.options), tmp_path).fmu}
    known = values | shared | {"payload_known": True, "faults": {"lost": 0.2}}
    first, between = (
        canonical_json(result_of(kind, tmp_path, **v)) for v in (values | shared, known)
    )
    mapped = Path("/proc/self/maps").read_text().count("dropstitch-fmu-")
    again = canonical_json(result_of(kind, tmp_path, **values | shared))
    # A worker runs thousands of cases: none may leave another copy of a library in its memory.
    assert Path("/proc/self/maps").read_text().count("dropstitch-fmu-") == mapped
    assert first == again != between
    figures = json.loads(first)
    assert figures["ended"] == "finished"
    assert figures["prediction_error"]["max_m"] > 0
    assert json.loads(between)["faults_injected"]["lost"] > 0
    assert not list(tmp_path.glob("*.mcap"))


class StopRequest(Telemetry):
    """Sends this process SIGTERM after the first tick."""

    def put(self, record):
        signal.raise_signal(signal.SIGTERM)


def test_a_part_of_a_run_in_software_is_no_result(tmp_path, toy_bundle, monkeypatch):
    monkeypatch.setattr("firmware_py.loop.Telemetry", StopRequest)
    kind, _ = load_kind("sil")
    with pytest.raises(InputError, match=r"SIGTERM ended the run after \d of 59 slots"):
        result_of(kind, tmp_path, bundle=str(toy_bundle), seconds=1.0)


@pytest.mark.parametrize("module", [".os", "os", "a.b\0c", "no_such.module", "json.decoder"])
def test_what_is_no_kind_is_refused(module):
    with pytest.raises(InputError, match=r"is not known|cannot be imported"):
        load_kind(module)
