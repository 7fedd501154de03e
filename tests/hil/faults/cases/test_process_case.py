"""Faults with real processes: a loop that is killed, and a port that comes back as another one."""

import signal

import pytest

from firmware_py.inference.bundle import ModelBundle
from hil.emulator.physics import build_twin
from hil.faults.cases.case_robot import CaseRobot
from hil.faults.cases.process_case import run_process
from hil.faults.fault_table import PROCESS
from hil.faults.fault_verdict import FaultCase, judge_case
from models.plant.plant import NOMINAL

PERIOD_S = 0.017
CASES = {
    "killed": "SIGKILL in motion, once",
    "replugged": "unplug and replug, another name, configured to go on",
    "hung up": "SIGHUP in motion, once",
}


@pytest.fixture(scope="session")
def robot(toy_bundle, tmp_path_factory):
    twin = build_twin(NOMINAL, 1, tmp_path_factory.mktemp("twin"))
    return CaseRobot(ModelBundle.load(toy_bundle), twin)


TRIES = 3
"""What the host does to the course of a run in real time is no fault of ours; safety is."""


@pytest.mark.parametrize("name", CASES)
def test_a_fault_of_the_process_is_survived(robot, name, request):
    if name == "hung up":  # as under nohup
        before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
        request.addfinalizer(lambda: signal.signal(signal.SIGHUP, before))
    row = next(row for row in PROCESS if f"{row.fault}, {row.how}" == CASES[name])
    deviations = []
    for _ in range(TRIES):
        seen = run_process(robot, row, row.models[0], 1)
        judged = judge_case(FaultCase(row, "process", row.models[0], 1), seen, PERIOD_S)
        assert not judged.safety_violations
        assert not seen.live
        if name == "killed":
            assert (seen.ended, seen.unheard_ns) == ("killed", 60_000_000)
            assert "watchdog stopped it" in seen.told
        if judged.verdict in ("pass", "inconclusive"):
            return
        deviations.append(judged.deviations)
    pytest.fail(f"{TRIES} times with deviations: {deviations}")
