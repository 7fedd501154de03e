"""The exit code of `dropstitch run` and its warnings on its log and its payload."""

import json
import resource

import pytest

from firmware_py.log.recording import read_recording


@pytest.fixture
def file_limit():
    """Files may get no larger than the size: as on a full disk, a write fails."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    yield lambda size: resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.slow
def test_a_log_that_lacks_ticks_is_no_success(servos, config, call, file_limit):
    file_limit(20_000)
    code, output = call("run", "--config", config, "--seconds", "1", "--json")
    result = json.loads(output.out)
    logged, ran = result["logged_ticks"], result["ticks"]
    assert result["ended"] == "finished" and 0 < logged < ran
    assert len(read_recording(result["log"]).columns["tick"]) == logged
    assert code == 1
    assert f"warning: the log {result['log']} holds {logged} of {ran} ticks" in output.err
    assert "full disk" in output.err


@pytest.mark.slow
def test_a_log_of_unknown_length_is_no_success(servos, config, call, monkeypatch):
    monkeypatch.setattr("firmware_py.log.recorder._await_end", lambda _: None)
    code, output = call("run", "--config", config, "--json")
    assert (code, json.loads(output.out)["logged_ticks"]) == (1, None)
    assert "holds an unknown number of" in output.err
