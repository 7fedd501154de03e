"""The fault campaign: every fault ends as its row says, and a broken robot fails its case."""

import os
import signal
from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree as ET

import pytest

from dropstitch.__main__ import main
from firmware_py.bus import codec, exchange
from firmware_py.bus.dynamixel import DynamixelBus
from firmware_py.bus.port import RegisterAccess
from firmware_py.bus.registers import Register
from firmware_py.inference.bundle import ModelBundle
from firmware_py.system.stop_signals import signals_to
from hil.emulator.physics import build_twin
from hil.faults import campaign, virtual_case
from hil.faults.campaign import cases_of
from hil.faults.case_robot import CaseRobot
from hil.faults.fault_row import Expectation, FaultRow, Injection
from hil.faults.fault_table import RECOVERED, ROWS
from hil.faults.faults_document import FaultCase, judge_case, read_faults
from hil.faults.faulty_parts import FaultSchedule
from hil.faults.observation import CaseObservation
from hil.faults.real_time_cases import run_process
from models.plant.plant import NOMINAL
from tests.hil.faults.toy_robot import PERIOD_S, ToyPhysics, manifest, toy_robot

LEGACY, PRO_A = 54024, 54025
VIRTUAL = [row for row in ROWS if "virtual" in row.lines]


@pytest.fixture
def robot(monkeypatch, tmp_path):
    monkeypatch.setattr(virtual_case, "FmuPhysics", ToyPhysics)
    return toy_robot(tmp_path)


def row_named(fault, how):
    return next(row for row in ROWS if (row.fault, row.how) == (fault, how))


def run(robot, row, number=PRO_A, seed=5):
    case = FaultCase(row, "virtual", number, seed)
    return judge_case(case, virtual_case.run_virtual(robot, row, number, seed), PERIOD_S)


@pytest.mark.slow
@pytest.mark.parametrize("row", VIRTUAL, ids=lambda row: f"{row.fault}, {row.how}")
def test_every_fault_ends_as_its_row_says(robot, row):
    for number in row.models:
        judged = run(robot, row, number)
        assert judged.verdict == "pass", judged.complaints


def test_the_same_seed_gives_the_same_run_and_another_seed_another(robot):
    row = row_named("bit flip in payload", "both reads of two ticks")
    first, second = (run(robot, row, seed=1).observation for _ in range(2))
    assert first == second
    starts = {FaultSchedule(row.injections, seed).start for seed in range(20)}
    assert len(starts) > 10


def test_in_real_time_a_row_runs_once():
    cases = cases_of(2, ("virtual", "socket", "process"), range(3))
    assert len({(c.row, c.line) for c in cases}) < len(cases)
    real = [(c.row, c.line) for c in cases if c.line != "virtual"]
    assert len(set(real)) == len(real)
    assert all(c.row.joints == 1 for c in cases_of(1, ("virtual",), range(1)))


# --- a broken robot fails its case


def test_a_bus_that_takes_late_answers_for_fresh_fails_the_case(robot, monkeypatch):
    row = row_named("reply late by a period", "once")
    assert run(robot, row).verdict == "pass"
    monkeypatch.setattr(exchange, "_DISTINCT_LENGTHS", 1)
    judged = run(robot, row)
    assert judged.verdict == "fail"
    assert any("old data for fresh" in words for words in judged.safety_violations)


def test_a_bus_that_takes_any_answer_for_a_confirmation_fails_the_case(robot, monkeypatch):
    def put(registers, id_, cell, raw):
        registers._port.deadline_ns = registers._clock.now_ns() + 50_000_000
        registers._port.request(codec.build_write(id_, cell.address, cell.encode(raw)))
        packet, _ = registers._port.receive()
        while packet is not None and packet.id != id_:
            packet, _ = registers._port.receive()
        return packet is not None

    monkeypatch.setattr(RegisterAccess, "put", put)
    monkeypatch.setattr(
        DynamixelBus, "_switch",
        lambda bus, id_, on: put(
            bus._registers, id_, bus._table[Register.TORQUE_ENABLE], int(on)
        ),
    )  # fmt: skip
    judged = run(robot, row_named("torque off unheard, late replies", "the first to each servo"),
                 LEGACY)  # fmt: skip
    assert judged.verdict == "fail"
    assert any("says that it is released" in words for words in judged.safety_violations)


@pytest.mark.parametrize(
    "row", [r for r in VIRTUAL if r.must is RECOVERED][::6], ids=lambda row: row.fault
)
def test_a_bus_that_does_not_read_again_fails_the_case(robot, monkeypatch, row):
    def leave_no_time(bus):
        bus._feedback.usual_ns = 1_000_000_000

    monkeypatch.setattr(DynamixelBus, "_check_replies", leave_no_time)
    judged = run(robot, row)
    assert judged.verdict == "fail"
    assert any("ticks lost, not 0" in words for words in judged.deviations)


def test_goals_that_jump_after_a_replug_fail_the_case(robot, monkeypatch):
    row = row_named("unplug and replug", "configured to go on")
    reopen, write, reopened = DynamixelBus.reopen, DynamixelBus.write, []

    def note_reopening(bus):
        reopened.append(reopen(bus))
        return reopened[-1]

    def write_apart(bus, goal_rad, deadline_ns):
        return write(bus, goal_rad + 0.1 * any(reopened), deadline_ns)

    monkeypatch.setattr(DynamixelBus, "reopen", note_reopening)
    monkeypatch.setattr(DynamixelBus, "write", write_apart)
    judged = run(robot, row)
    assert any(reopened)
    assert judged.verdict == "fail"
    assert any("a goal jumped by 0.0" in words for words in judged.safety_violations)


def test_a_fault_that_never_occurs_fails_the_case(robot):
    """Without feedback of the tip there is no innovation to change."""
    row = FaultRow("x", "y", Expectation("finished"), (Injection("innovation", 1000),))
    assert run(robot, row).deviations == ["the fault did not occur"]


# --- real processes

_TRIES = 3
"""The host may disturb the course of a run in real time, but not its safety."""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "how"),
    [
        ("SIGKILL in motion", "once"),
        ("unplug and replug", "another name, configured to go on"),
        ("SIGHUP in motion", "once"),
    ],
)
def test_a_fault_of_the_process_ends_as_its_row_says(toy_bundle, tmp_path, fault, how, request):
    robot = CaseRobot(ModelBundle.load(toy_bundle), build_twin(NOMINAL, 1, tmp_path))
    if fault == "SIGHUP in motion":  # as under nohup
        before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
        request.addfinalizer(lambda: signal.signal(signal.SIGHUP, before))
    row, deviations = row_named(fault, how), []
    for _ in range(_TRIES):
        run = run_process(robot, row, row.models[0], 1)
        judged = judge_case(FaultCase(row, "process", row.models[0], 1), run, PERIOD_S)
        assert not judged.safety_violations
        assert not run.live
        if fault == "SIGKILL in motion":
            assert (run.ended, run.unheard_ns) == ("killed", 60_000_000)
        if judged.verdict in ("pass", "inconclusive"):
            return
        deviations.append(judged.deviations)
    pytest.fail(f"{_TRIES} times with deviations: {deviations}")


# --- a campaign that is ended early keeps its verdicts

BUNDLE = SimpleNamespace(manifest=manifest(1), directory=Path("bundle"))
CASES = cases_of(1, ["virtual"], [1])


def passing(row):
    """What the row asks for, as far as the verdict looks at it."""
    return CaseObservation(row.must.ended.split(" or ")[0], row.must.reason.split("|")[0])


def ended_at(which, number, error=None):
    """Runner of cases of which one gets a signal, in a loop that takes it for its stop."""
    ran = []

    def run(robot, row, model, seed):
        ran.append(row)
        if len(ran) == which:
            with signals_to(lambda name: None):
                os.kill(os.getpid(), number)
            if error:
                raise error
        return passing(row)

    return run


def call(monkeypatch, out, runner, *more):
    monkeypatch.setattr(ModelBundle, "load", lambda path: BUNDLE)
    monkeypatch.setitem(campaign.RUNNERS, "virtual", runner)
    return main(["faults", "--bundle", "b", "--fmu", "f", "--line", "virtual", "--out", str(out),
                 *more])  # fmt: skip


@pytest.mark.parametrize(
    ("number", "error"),
    [(signal.SIGTERM, None), (signal.SIGINT, BrokenPipeError())],
    ids=["stopped by SIGTERM", "broken by SIGINT"],
)
def test_a_signal_in_a_case_ends_the_campaign_which_writes_its_verdicts_as_incomplete(
    monkeypatch, tmp_path, capsys, number, error
):
    assert call(monkeypatch, tmp_path, ended_at(3, number, error)) == 128 + number
    assert f"2 of {len(CASES)}" in capsys.readouterr().err
    document = read_faults(tmp_path / "faults.json")
    assert (len(document.cases), document.not_run) == (2, len(CASES) - 2)
    assert document.verdict != "pass"
    suite = ET.parse(tmp_path / "faults.xml").getroot()
    assert suite.find("testcase[last()]/skipped").get("message").startswith("incomplete")
    page = (tmp_path / "report.html").read_text()
    assert "incomplete" in page and f"2 of {len(CASES)}" in page


def test_the_verdicts_are_written_after_each_case(monkeypatch, tmp_path):
    written = []

    def run(robot, row, model, seed):
        path = tmp_path / "faults.json"
        written.append(len(read_faults(path).cases) if path.exists() else 0)
        return passing(row)

    call(monkeypatch, tmp_path, run, "--only", "lost reply")
    assert written == list(range(len(written)))
    assert read_faults(tmp_path / "faults.json").not_run == 0


@pytest.mark.parametrize(
    ("words", "cause"),
    [
        ("SIGTERM", "--line process"),
        ("one servo silent, once", "two joints"),
        ("noyse", "no fault"),
    ],
)
def test_faults_that_this_bundle_or_line_does_not_have_are_refused(
    monkeypatch, tmp_path, capsys, words, cause
):
    assert call(monkeypatch, tmp_path, None, "--only", words) == 2
    assert cause in capsys.readouterr().err
