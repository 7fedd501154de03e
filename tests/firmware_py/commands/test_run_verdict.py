"""What `dropstitch run` says of its log and its payload, and its exit code."""

import json
import resource

import pytest

from firmware_py.core.documents import write_document
from firmware_py.log.recording import read_recording
from tests.firmware_py import test_robot_commands as robot
from tests.firmware_py.goals.small_plan import small_plan

servos, config, call = robot.servos, robot.config, robot.call


@pytest.fixture
def file_limit():
    """Files may get no larger than the called size: as on a full disk, a write fails."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    yield lambda size: resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.slow
def test_a_log_that_lacks_ticks_is_no_success(servos, config, capsys, file_limit):
    file_limit(20_000)
    code, output = call(capsys, "run", "--config", config, "--seconds", "1", "--json")
    result = json.loads(output.out)
    logged, ran = result["logged_ticks"], result["ticks"]
    assert result["ended"] == "finished" and 0 < logged < ran
    assert len(read_recording(result["log"]).columns["tick"]) == logged
    assert code == 1
    assert f"warning: the log {result['log']} holds {logged} of {ran} ticks" in output.err
    assert "full disk" in output.err


@pytest.mark.slow
def test_a_recorder_that_says_no_number_is_no_success(servos, config, capsys, monkeypatch):
    monkeypatch.setattr("firmware_py.log.recorder._await_end", lambda _: None)
    code, output = call(capsys, "run", "--config", config, "--json")
    assert (code, json.loads(output.out)["logged_ticks"]) == (1, None)
    assert "holds an unknown number of" in output.err


@pytest.mark.slow
def test_a_payload_that_the_bundle_does_not_use_is_told(servos, config, toy_bundle, capsys):
    config.write_text("payload_kg = 9.0\n" + config.read_text())
    code, output = call(capsys, "run", "--config", config, "--json")
    assert code == 0, output.err
    assert f"payload_kg = 9 changes no prediction and is not checked: the bundle {toy_bundle}" in (
        output.err
    )
    log = read_recording(json.loads(output.out)["log"])
    assert log.metadata["payload_kg"] == "9.0"
    assert len([line for line in output.err.splitlines() if "payload_kg" in line]) == 1


def test_a_payload_beyond_those_of_a_plan_is_refused(servos, config, toy_bundle, tmp_path, capsys):
    plan = tmp_path / "plan.json"
    write_document(plan, small_plan(toy_bundle))
    code, output = call(capsys, "run", "--config", config, "--plan", plan, "--payload-kg", "2.5")
    assert code == 2
    assert "payload_kg: is 2.5 kg, the plan circle holds 0 to 1 kg; plan again" in output.err
