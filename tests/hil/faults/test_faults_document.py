"""Verdict on a case, and the document that holds them."""

import json
from dataclasses import replace
from xml.etree import ElementTree as ET

import msgspec
import pytest

from firmware_py.core.documents import write_document
from hil.faults.fault_row import Expectation, FaultRow, Injection
from hil.faults.faults_document import (
    FaultCase,
    faults_document,
    faults_junit,
    judge_case,
    read_faults,
)
from hil.faults.observation import CaseObservation
from tests.hil.faults.toy_robot import PERIOD_S, manifest

PRO_A = 54025


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"unheard_ns": 60_000_001}, "without supervision"),
        ({"live": True}, "still drives"),
        ({"ended": "refused", "driven": True}, "although it was refused"),
        ({"live": True, "watched": False, "ended": "killed", "drift_rad": 0.201}, "it moved"),
        ({"goal_jump_rad": 2.1e-3}, "a goal jumped"),
        ({"stale_as_fresh": 1}, "old data"),
        ({"fade_ticks": 13}, "corrections faded"),
        ({"ended": "tripped"}, "not finished"),
        ({"lost_ticks": 2}, "2 ticks lost"),
        ({"detected_ticks": None}, "seen in tick None"),
        ({"detected_ticks": 2}, "seen in tick 2"),
        ({"replugs": 1}, "went on 1 times"),
        ({"injected": False}, "did not occur"),
        ({"reason": "another"}, "the reason is"),
    ],
)
def test_each_condition_of_a_case_is_checked(change, words):
    row = FaultRow("x", "y", Expectation("finished", 1, 1, "over"), (Injection("lost"),))
    good = CaseObservation("finished", "the motion is over", detected_ticks=1, lost_ticks=1,
                       unheard_ns=60_000_000, goal_jump_rad=1.9e-3, fade_ticks=12)  # fmt: skip
    case = FaultCase(row, "socket", PRO_A, 0)
    assert judge_case(case, good, PERIOD_S).verdict == "pass"
    judged = judge_case(case, msgspec.structs.replace(good, **change), PERIOD_S)
    assert judged.verdict == "fail"
    assert any(words in complaint for complaint in judged.complaints)


@pytest.mark.parametrize(
    "witness",
    [
        {"misses": {"preempted by the host": 1}},
        {"late_replies": 1},
        {"held_up_replies": 1},
        {"held_up_ticks": 1},
    ],
)
def test_preemption_by_the_host_excuses_the_course_of_a_run_but_not_its_safety(witness):
    case = FaultCase(FaultRow("x", "y", Expectation("finished", lost=0)), "socket", PRO_A, 0)
    without = CaseObservation("finished", "", lost_ticks=1)
    assert judge_case(case, without, PERIOD_S).verdict == "fail"
    run = msgspec.structs.replace(without, **witness)
    assert judge_case(case, run, PERIOD_S).verdict == "inconclusive"
    assert judge_case(replace(case, line="virtual"), run, PERIOD_S).verdict == "fail"
    for old, verdict in ((run.late_replies, "inconclusive"), (run.late_replies + 1, "fail")):
        took_old = msgspec.structs.replace(run, stale_as_fresh=old)
        assert judge_case(case, took_old, PERIOD_S).verdict == verdict


def test_verdicts_are_counted_and_written(tmp_path):
    case = FaultCase(FaultRow("x", "y", Expectation("finished")), "virtual", PRO_A, 0)
    good, bad = CaseObservation("finished", ""), CaseObservation("tripped", "why")
    judged = [judge_case(case, run, PERIOD_S) for run in (good, bad)]
    document = faults_document(manifest(2), judged)
    assert document.counts == {"pass": 1, "fail": 1, "inconclusive": 0}
    assert (document.verdict, document.verdict.exit_code) == ("fail", 1)
    assert document.cases[1].complaints == ("tripped (why), not finished",)
    write_document(tmp_path / "faults.json", document)
    assert read_faults(tmp_path / "faults.json") == document
    written = json.loads((tmp_path / "faults.json").read_text())
    assert written["cases"][0]["model"] == "H54-200-S500-R(A)"
    suite = ET.fromstring(faults_junit(judged))
    assert (suite.get("tests"), suite.get("failures")) == ("2", "1")
    assert suite.find("testcase/failure").get("message") == "tripped (why), not finished"
