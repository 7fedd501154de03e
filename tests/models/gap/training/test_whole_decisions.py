"""Decisions on whole data sets, from the probabilities of their tests."""

import pytest

from models.gap.decision.evidence import Evidence
from models.gap.training.answer_tests import AnswerTest
from models.gap.training.whole_decisions import (
    decisions_table,
    mean_cost,
    whole_decisions,
)

NOTHING_FOUND = Evidence(0, 0, 0, 0, 0, 0, 0)


def answer_test(kind, data_set, answer, *effects):
    return AnswerTest(
        rig="drawn_1", data_set=data_set, kind=kind, same_link=True, effects=effects,
        answer=answer, evidence=NOTHING_FOUND,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("alone", "both", "outcome"),
    [
        (0.9, 0.7, "right name"),
        (0.9, 0.6, "wrong name"),
        (0.6, 0.6, "nothing"),
        (0.4, 0.7, "right name"),
    ],
)
def test_the_largest_set_that_is_believed_is_named(alone, both, outcome):
    names = {
        answer_test("pair", 1, "outside", "creep"): alone,
        answer_test("pair", 1, "catalogue", "backlash", "prebend"): both,
    }
    (decided,) = whole_decisions(names, {})
    assert decided[1] == outcome


def test_something_outside_is_said_where_no_name_is_believed():
    denied, null = answer_test("outside", 1, "outside", "creep"), answer_test("null", 2, "nothing")
    outside = {denied: 0.7, null: 0.2}
    told = [
        [outcome for _, outcome in whole_decisions({denied: name, null: 0.1}, outside)]
        for name in (0.7, 0.6)
    ]
    assert told == [["wrong name", "nothing"], ["outside", "nothing"]]


def test_a_name_is_given_sooner_where_nobody_knows_what_else_it_would_be():
    test = answer_test("single", 1, "catalogue", "creep")
    told = [whole_decisions({test: 0.62}, {test: outside})[0][1] for outside in (0.0, 0.5, 1.0)]
    assert told == ["nothing", "right name", "outside"]


def test_a_wrong_name_costs_twice_a_missing_one():
    test = answer_test("single", 1, "outside", "creep")
    costs = [mean_cost(whole_decisions({test: name}, {})) for name in (0.7, 0.6)]
    assert costs == [2.0, 1.0]


def test_mistakes_count_by_the_weight_of_their_kind():
    names = {answer_test("single", k, "catalogue", "creep"): 0.9 * (k > 1) for k in range(1, 5)}
    names[answer_test("null", 9, "nothing")] = 0.1
    decisions = whole_decisions(names, {})
    assert mean_cost(decisions) == pytest.approx(0.6 * 0.25 / 0.8)
    assert "link unchanged, single, 4: nothing 1, right name 3" in decisions_table(decisions)
