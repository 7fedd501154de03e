"""The campaign of faults: it injects what it says, sees what happens, and can fail."""

from __future__ import annotations

import json
from dataclasses import replace
from types import SimpleNamespace
from xml.etree import ElementTree as ET

import msgspec
import numpy as np
import pytest

from firmware_py.bus import codec
from firmware_py.bus.codec import BROADCAST, Instruction, Packet
from firmware_py.bus.dynamixel import DynamixelBus
from firmware_py.bus.port import RegisterAccess
from firmware_py.bus.registers import Register
from firmware_py.bus.servo_models import MODELS
from firmware_py.core.errors import InputError
from firmware_py.inference.bundle import ModelBundle
from firmware_py.inference.estimator import NoEstimator
from firmware_py.inference.manifest import Manifest
from firmware_py.inference.predictor import Prediction
from hil.faults import fault_docs, fault_verdict
from hil.faults.campaign import cases_of
from hil.faults.cases import virtual_case
from hil.faults.cases.case_robot import CaseRobot
from hil.faults.fault_row import Expectation, FaultRow
from hil.faults.fault_table import RECOVERED, ROWS
from hil.faults.fault_verdict import FaultCase, judge_case
from hil.faults.faults_document import faults_document, read_faults, write_faults
from hil.faults.injection import FAULT_KINDS, FaultSchedule, Injection, OnReply
from hil.faults.observation import CaseObservation
from hil.faults.servo_log import LATE_NS, LoggedBus, LoggedServo

LEGACY, PRO_A, PERIOD_S = 54024, 54025, 0.017
LINE_FAULTS = [name for name, kind in FAULT_KINDS.items() if isinstance(kind, OnReply)]
MANIFEST = {
    "dof": 2, "period_s": PERIOD_S, "degree": 1, "estimator": "none", "features": (),
    "outputs": (), "lag_ticks": (0,), "training_data_sha256": "", "plant_sha256": "",
    "libraries": {}, "metrics": {}, "coefficients": {}, "files": {},
}  # fmt: skip
VIRTUAL = [row for row in ROWS if "virtual" in row.lines]


class StillPredictor:
    wanted = ()

    def predict(self, angle_rad, current_a, di, *_):
        return Prediction(np.array([0.0, 0.0, 1.0]), np.ones(1), np.full(3, 0.01))


@pytest.fixture
def robot(bus_of, monkeypatch, tmp_path):
    """Two joints over a plant that needs no compiler."""
    plant = type(bus_of().physics)

    class Physics(plant):
        def __init__(self, fmu, dof):
            super().__init__(dof)
            self.fmu = SimpleNamespace(close=lambda: None)

    monkeypatch.setattr(virtual_case, "FmuPhysics", Physics)
    manifest = Manifest(**MANIFEST)
    return CaseRobot(ModelBundle(tmp_path, manifest, NoEstimator(), StillPredictor()), tmp_path)


def row_named(fault, how):
    return next(row for row in ROWS if (row.fault, row.how) == (fault, how))


def run(robot, row, number=PRO_A, seed=5):
    case = FaultCase(row, "virtual", number, seed)
    return judge_case(case, virtual_case.run_virtual(robot, row, number, seed), PERIOD_S)


@pytest.mark.parametrize("row", VIRTUAL, ids=lambda row: f"{row.fault}, {row.how}")
def test_every_fault_ends_as_the_table_says(robot, row):
    for number in row.models:
        judged = run(robot, row, number)
        assert judged.verdict == "pass", judged.safety_violations + judged.deviations


def test_the_same_seed_gives_the_same_run_and_another_one_another(robot):
    row = row_named("bit flip in payload", "both reads of two ticks")
    first, second, other = (run(robot, row, seed=seed).observation for seed in (1, 1, 2))
    assert first == second
    starts = {FaultSchedule(row.injections, seed).start for seed in range(20)}
    assert len(starts) > 10
    assert other.ended == first.ended


# --- the campaign can fail -------------------------------------------------------------------


def test_a_bus_that_takes_late_answers_for_fresh_is_found_out(robot, monkeypatch):
    row = row_named("reply late by a period", "once")
    assert run(robot, row).verdict == "pass"
    monkeypatch.setattr("firmware_py.bus.exchange._DISTINCT_LENGTHS", 1)
    judged = run(robot, row)
    assert judged.verdict == "fail"
    assert any("old data for fresh" in words for words in judged.safety_violations)


def test_a_bus_that_takes_any_answer_for_a_confirmation_is_found_out(robot, monkeypatch):
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


@pytest.mark.parametrize("row", [r for r in VIRTUAL if r.must is RECOVERED], ids=str)
def test_a_bus_that_does_not_read_again_is_found_out(robot, monkeypatch, row):
    monkeypatch.setattr(DynamixelBus, "_check_replies", only_once)
    judged = run(robot, row)
    assert judged.verdict == "fail"
    assert any("ticks lost, not 0" in words for words in judged.deviations)


def only_once(bus):
    """Leave no time for a second read."""
    bus._feedback.usual_ns = 1_000_000_000


def test_goals_that_jump_after_a_replug_are_found_out(robot, monkeypatch):
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


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"unheard_ns": 60_000_001}, "without supervision"),
        ({"live": True}, "still drives"),
        ({"ended": "refused", "told": "goals along the motion"}, "although it was refused"),
        ({"live": True, "watched": False, "ended": "killed", "drift_rad": 0.201}, "it moved"),
        ({"goal_jump_rad": 2.1e-3}, "a goal jumped"),
        ({"stale_as_fresh": 1}, "old data"),
        ({"ended": "tripped"}, "not finished"),
        ({"lost_ticks": 2}, "2 ticks lost"),
        ({"detected_ticks": None}, "seen in tick None"),
        ({"detected_ticks": 2}, "seen in tick 2"),
        ({"replugs": 1}, "went on 1 times"),
        ({"injected": False}, "never befell"),
        ({"reason": "another"}, "the reason is"),
    ],
)
def test_each_thing_that_must_hold_is_looked_at(change, words):
    row = FaultRow("x", "y", Expectation("finished", 1, 1, "over"), (Injection("lost"),))
    good = CaseObservation("finished", "the motion is over", detected_ticks=1, lost_ticks=1,
                       unheard_ns=60_000_000, goal_jump_rad=1.9e-3)  # fmt: skip
    case = FaultCase(row, "socket", PRO_A, 0)
    assert judge_case(case, good, PERIOD_S).verdict == "pass"
    judged = judge_case(case, msgspec.structs.replace(good, **change), PERIOD_S)
    assert judged.verdict == "fail"
    assert any(words in complaint for complaint in judged.safety_violations + judged.deviations)


@pytest.mark.parametrize(
    "witness",
    [
        {"misses": {"preempted by the host": 1}},
        {"late_replies": 1},
        {"held_up_replies": 1},
        {"held_up_ticks": 1},
    ],
)
def test_the_host_is_an_excuse_for_the_course_but_not_for_safety(witness):
    case = FaultCase(FaultRow("x", "y", Expectation("finished", lost=0)), "socket", PRO_A, 0)
    without = CaseObservation("finished", "", lost_ticks=1)
    assert judge_case(case, without, PERIOD_S).verdict == "fail"
    seen = msgspec.structs.replace(without, **witness)
    assert judge_case(case, seen, PERIOD_S).verdict == "inconclusive"
    assert judge_case(replace(case, line="virtual"), seen, PERIOD_S).verdict == "fail"
    for old, verdict in ((seen.late_replies, "inconclusive"), (seen.late_replies + 1, "fail")):
        took_old = msgspec.structs.replace(seen, stale_as_fresh=old)
        assert judge_case(case, took_old, PERIOD_S).verdict == verdict


def test_a_reply_that_leaves_late_is_counted(bus_of):
    bus = LoggedBus([LoggedServo(MODELS[PRO_A])], type(bus_of().physics)(1), FaultSchedule((), 1))
    for late_ns in (0, LATE_NS, LATE_NS + 1):
        bus.note_release(5, 5 + late_ns)
    assert bus.log(10).late_replies == 1


class DrivenBus(LoggedBus):
    driven = True


def test_a_reply_before_which_the_host_held_the_servos_up_is_counted(bus_of):
    """Such a reply is late for the loop, though it leaves on time after a late instruction."""
    plant = type(bus_of().physics)
    for kind, count in ((DrivenBus, 1), (LoggedBus, 0)):  # what the set-up waits for is none
        bus = kind([LoggedServo(MODELS[PRO_A])], plant(1), FaultSchedule((), 1))
        for delay_ns in (0, LATE_NS, 2 * LATE_NS + 1, 2 * LATE_NS + 1):
            bus.note_release(5, 5, delay_ns)
        log = bus.log(10)
        assert (log.held_up_replies, log.late_replies) == (count, 0)


def test_verdicts_are_counted_and_written(tmp_path):
    case = FaultCase(FaultRow("x", "y", Expectation("finished")), "virtual", PRO_A, 0)
    good, bad = CaseObservation("finished", ""), CaseObservation("tripped", "why")
    judged = [judge_case(case, seen, PERIOD_S) for seen in (good, bad)]
    manifest = Manifest(**MANIFEST)
    document = faults_document(manifest, judged)
    assert document.counts == {"pass": 1, "fail": 1, "inconclusive": 0}
    assert (document.verdict, document.verdict.exit_code) == ("fail", 1)
    assert document.cases[1].complaints == ("tripped (why), not finished",)
    write_faults(tmp_path / "faults.json", document)
    assert read_faults(tmp_path / "faults.json") == document
    written = json.loads((tmp_path / "faults.json").read_text())
    assert written["cases"][0]["model"] == "H54-200-S500-R(A)"
    (tmp_path / "faults.json").write_text(json.dumps(written | {"schema": 1}))
    with pytest.raises(InputError, match=r"schema version 1.*dropstitch faults"):
        read_faults(tmp_path / "faults.json")
    suite = ET.fromstring(fault_verdict.faults_junit(judged))
    assert (suite.get("tests"), suite.get("failures")) == ("2", "1")
    assert suite.find("testcase/failure").get("message") == "tripped (why), not finished"


# --- what is injected ------------------------------------------------------------------------

FRAME = codec.build_status(1, 0, bytes(range(10)))


def test_an_unknown_kind_of_fault_is_refused():
    with pytest.raises(ValueError, match="no fault 'noyse': choose from lost, late"):
        Injection("noyse")


@pytest.mark.parametrize(
    "kind", [name for name, kind in FAULT_KINDS.items() if not isinstance(kind, OnReply)]
)
def test_a_fault_that_nothing_applies_does_not_begin(kind):
    """A line without servos applies faults of replies alone."""
    script = FaultSchedule((Injection(kind, 1000),), seed=3)
    for exchange in range(script.start + 4):
        script.begin_exchange((), exchange)
        assert script.apply(FRAME) == [(0, FRAME)]
    assert script.began_ns is None


def test_a_fault_that_never_befell_the_robot_fails_its_row(robot):
    """No other program sends the goals here, so none can be silent."""
    row = FaultRow("x", "y", Expectation("finished"), (Injection("program silent", 1000),))
    judged = run(robot, row)
    assert judged.deviations == ["the fault never befell it"]


@pytest.mark.parametrize("kind", LINE_FAULTS)
def test_a_fault_of_the_line_acts_in_its_exchanges_and_no_other(kind):
    script = FaultSchedule((Injection(kind, 2, 5e-3),), seed=3)
    seen = {}
    for exchange in range(script.start + 4):
        script.begin_exchange((), exchange)
        seen[script.exchange] = script.apply(FRAME)
    hit = [k for k, arrivals in seen.items() if arrivals != [(0, FRAME)]]
    assert hit == [script.start, script.start + 1]
    assert script.began_ns == script.start - 1


@pytest.mark.parametrize(
    "kind", [k for k in LINE_FAULTS if k.startswith("flip") or k == "other id"]
)
@pytest.mark.parametrize("seed", range(20))
def test_a_flipped_bit_leaves_no_intact_answer_of_that_servo(kind, seed):
    script = FaultSchedule((Injection(kind, 1000),), seed)
    for _ in range(script.start):
        script.begin_exchange((), 0)
    ((_, damaged),) = script.apply(FRAME)
    assert len(damaged) == len(FRAME)
    assert not any(p.intact and p.id == 1 for p in codec.PacketSearch(host=False).feed(damaged))
    if kind != "other id":
        flipped = int.from_bytes(damaged, "big") ^ int.from_bytes(FRAME, "big")
        assert flipped.bit_count() == 1


# --- the servo log ---------------------------------------------------------------------------


def watched(bus_of, number, watchdog=3):
    servo = LoggedServo(MODELS[number])
    bus = LoggedBus([servo], type(bus_of().physics)(), FaultSchedule((), 0))
    servo.put(Register.TORQUE_ENABLE, 1)
    servo.put(Register.BUS_WATCHDOG, watchdog)
    return bus, servo


@pytest.mark.parametrize(
    ("number", "watchdog", "unheard_ms", "live"),
    [(PRO_A, 3, 60, False), (PRO_A, 0, 500, True), (LEGACY, 3, 500, True)],
)
def test_a_loop_that_dies_leaves_a_servo_driven_until_its_watchdog_trips(
    bus_of, number, watchdog, unheard_ms, live
):
    bus, _ = watched(bus_of, number, watchdog)
    bus.execute(Packet(BROADCAST, Instruction.PING, b""), 0)
    servo_log = bus.log(500_000_000)
    assert servo_log.unheard_ns == unheard_ms * 1_000_000
    assert (servo_log.live, servo_log.watched) == (live, number == PRO_A)


def test_a_servo_off_the_bus_neither_answers_nor_hears(bus_of):
    bus, servo = watched(bus_of, PRO_A)
    servo.hush(True)
    assert bus.execute(Packet(1, Instruction.PING, b""), 10_000_000) == []
    bus.execute(Packet(BROADCAST, Instruction.PING, b""), 70_000_000)
    assert servo.watchdog_tripped


# --- the table and the document --------------------------------------------------------------


def test_the_document_is_drawn_from_the_code():
    text = fault_docs.DOCUMENT.read_text(encoding="utf-8")
    assert fault_docs.redraw(text) == text, "run python -m hil.faults.fault_docs"


def test_in_real_time_a_row_runs_once():
    cases = cases_of(2, ("virtual", "socket", "process"), range(3))
    assert len({(c.row, c.line) for c in cases}) < len(cases)
    real = [(c.row, c.line) for c in cases if c.line != "virtual"]
    assert len(set(real)) == len(real)
    assert all(c.row.joints == 1 for c in cases_of(1, ("virtual",), range(1)))
