"""Goals of another program in the loop: followed, carried on, every fault a controlled stop."""

import re

import numpy as np
import pytest

from firmware_py.core.signals import PERIOD_S
from firmware_py.goals.outside_goals import FIRST_WAIT_S, MOST_IN_A_TICK
from firmware_py.safety.states import Fault
from firmware_py.summary import Ended
from tests.firmware_py.goals.scripted_program import LIMITS, Program, linear_map, run, swinging


def goal(status, value):
    return {"tick": status["tick"], "joint_rad": [value]}


def end(status):
    return {"tick": status["tick"], "end": True}


def after(tick, strange):
    """A program that is sane until a tick."""
    return lambda status: [swinging(status)] if status["tick"] < tick else strange(status)


def sent_goals(summary):
    records = summary.records
    inside = records["tick"] >= 0
    return records["tick"][inside], records["goal_1_rad"][inside]


def test_goals_arrive_one_tick_after_the_status_that_they_answer():
    program = Program(lambda status: [swinging(status)])
    summary, bus, _ = run(program)
    assert (summary.ended, summary.reason) == (Ended.FINISHED, "the motion is over")
    tick, sent = sent_goals(summary)
    wanted = [swinging({"tick": k - 1, "time_s": (k - 1) * PERIOD_S})["joint_rad"][0] for k in tick]
    assert sent[1:115] == pytest.approx(np.array(wanted[1:115]), abs=1e-12)
    status = program.statuses[50]
    assert (status["tick"], status["state"], status["reason"]) == (50, "RUNNING", "")
    assert status["goal_rad"] == [pytest.approx(sent[50])]
    assert (status["payload_kg"], status["in_range"]) == (None, True)
    assert not bus.driven


@pytest.mark.parametrize("gone", [False, True], ids=["it stays", "it goes while the robot stops"])
def test_a_program_ends_the_run_without_a_fault(gone):
    summary, *_ = run(Program(after(40, lambda s: [end(s), None] if gone else [end(s)])))
    assert summary.ended is Ended.FINISHED
    assert not summary.faults


FAULTS = {
    "angle, then end": (
        lambda status: [goal(status, 0.7), end(status)],
        r"wants joint 1 at 0\.7 rad, outside -0\.6",
    ),
    "silent": (lambda status: [], r"has sent none for 3 ticks"),
    "vanished": (lambda status: [None], r"has gone"),
    "flooding": (
        lambda status: [swinging(status)] * (MOST_IN_A_TICK + 1),
        r"sends more than 4 goals in a tick",
    ),
    "stale": (
        lambda status: [swinging(status) | {"tick": 39}],
        r"sends goals that are 4 ticks old",
    ),
    "ahead": (lambda status: [goal(status, 0.0) | {"tick": 400}], r"answers status 400, after"),
    "not JSON": (lambda status: [b"\xff{"], r"sends a message that cannot be read"),
    "infinite": (lambda status: [b'{"tick": 40, "joint_rad": [1e999]}'], r"a message that "),
    "joints": (lambda status: [goal(status, 0.0) | {"joint_rad": [0, 0]}], r"has 2 values for 1"),
    "both": (lambda status: [goal(status, 0.0) | {"tip_m": [0.0]}], r"needs one of joint_rad"),
    "too long": (lambda status: [b" " * 600], r"has more than 512 bytes"),
    "angle": (lambda status: [goal(status, 0.7)], r"wants joint 1 at 0\.7 rad, outside -0\.6"),
    "rate": (lambda status: [goal(status, 0.3)], r"moves joint 1 at .* rad/s, the limit is 2"),
    "tip": (lambda status: [{"tick": status["tick"], "tip_m": [0.0]}], r"there is no map"),
}


@pytest.mark.parametrize("name", FAULTS)
def test_what_is_wrong_with_the_program_ends_in_a_controlled_stop(name):
    strange, sentence = FAULTS[name]
    program = Program(after(40, strange))
    summary, bus, _ = run(program)
    assert summary.ended is Ended.TRIPPED
    assert summary.faults == {Fault.GOAL}
    assert summary.released
    assert not bus.driven
    assert re.search(sentence, summary.reason)
    tick, sent = sent_goals(summary)
    rate = np.diff(sent) / PERIOD_S
    assert tick[-1] < 120, "it did not go on"
    assert np.abs(rate).max() <= LIMITS.rate_rad_s
    slowing = np.abs(np.diff(rate[45:])) / PERIOD_S
    assert slowing.max() <= LIMITS.stop_deceleration_rad_s2 + 1e-6
    assert program.statuses[-1]["reason"] == summary.reason


def test_two_ticks_without_a_message_go_on_at_the_latest_rate():
    program = Program(lambda s: [] if s["tick"] in (50, 51) else [swinging(s)])
    summary, *_ = run(program)
    assert summary.ended is Ended.FINISHED
    _, sent = sent_goals(summary)
    assert sent[51:53] == pytest.approx(sent[50] + (sent[50] - sent[49]) * np.array([1, 2]))


def test_the_first_goals_must_come_and_begin_at_rest():
    summary, *_ = run(Program(lambda status: []), slots=600)
    assert f"has sent none within {FIRST_WAIT_S:g} s" in summary.reason
    summary, *_ = run(Program(lambda status: [goal(status, 0.2)]))
    assert "moves joint 1 at 11.76 rad/s" in summary.reason


def test_places_become_goals_at_rest_and_are_shaped_by_the_payload():
    """A step of the place: half at once, the rest half a period (ten ticks) later."""

    def answer(status):
        place = min(0.015 * max(status["tick"] - 20, 0), 0.1)
        return [{"tick": status["tick"], "tip_m": [place]}]

    summary, _, goals = run(Program(answer), goal_map=linear_map(half_period_s=10 * PERIOD_S))
    assert summary.ended is Ended.FINISHED
    assert goals.payload_kg == 1.0
    _, sent = sent_goals(summary)
    assert sent[28] == pytest.approx(1.5 * 0.1 / 1.8), "weight 1 / (1 + decay)"
    assert sent[40] == pytest.approx(1.5 * 0.1)
    known, *_ = run(Program(answer), goal_map=linear_map(), payload_kg=2.0)
    assert sent_goals(known)[1][60] == pytest.approx(2.0 * 0.1)


@pytest.mark.parametrize("place", [0.47, -0.6])
def test_a_place_out_of_reach_is_refused(place):
    def answer(status):
        tick = status["tick"]
        return [{"tick": tick, "tip_m": [0.0 if tick < 30 else place]}]

    summary, *_ = run(Program(answer), goal_map=linear_map(slope=0.5, gap=True))
    assert f"({place}) m" in summary.reason and "out of reach" in summary.reason
