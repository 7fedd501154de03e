"""Probabilities of the answers: they follow the evidence in the direction that it speaks."""

import msgspec
import pytest

from models.gap.decision.answers import (
    OF_A_GAP,
    OF_NAMES,
    WRONG_NAME_COST,
    Answers,
    read_answer_model,
)
from models.gap.decision.evidence import Evidence, clearness_of
from models.gap.estimation.gauss_newton import FitPoint
from models.gap.search.candidate import Candidate, SearchResult

NOISE = Evidence(
    named=0.0, gap=-0.5, clearness=-1.0, difference=0.0,
    rise=0.0, further=0.0, rival=0.0,
    left=-0.5, servo=0.0, tip=0.0,
)  # fmt: skip
"""Of trials without a gap."""

EXPLAINED = Evidence(
    named=1.0, gap=1.0, clearness=2.0, difference=0.05,
    rise=0.0, further=-1.0, rival=-2.0,
    left=-1.0, servo=1.0, tip=1.0,
)  # fmt: skip
"""Of an effect that stands out, with one strength, and leaves noise."""


@pytest.fixture(scope="module")
def answers():
    """Function (evidence, changes of it) -> answers of the model in use for an unknown effect."""
    model, changed_to = read_answer_model(), msgspec.structs.replace
    return lambda evidence, **changed: model.answers(changed_to(evidence, **changed), ["other"])


def test_the_model_in_use_is_of_the_evidence_as_it_is_now():
    model = read_answer_model()
    assert tuple(model.catalogue.coefficient) == OF_NAMES
    assert tuple(model.outside.coefficient) == OF_A_GAP


@pytest.mark.parametrize("evidence", [NOISE, EXPLAINED])
def test_probabilities_add_up_to_one(answers, evidence):
    found = answers(evidence)
    assert sum(msgspec.structs.astuple(found)) == pytest.approx(1.0)
    assert min(msgspec.structs.astuple(found)) > 0


def test_noise_is_nothing_and_a_clear_effect_of_one_strength_is_believed(answers):
    assert answers(NOISE).nothing > 0.5 and not answers(NOISE).is_believed
    assert answers(EXPLAINED).is_believed


def test_an_effect_is_believed_the_more_the_clearer_it_stands_out(answers):
    rows = [answers(EXPLAINED, clearness=c).nothing for c in (0.1, 0.7, 1.5, 3.0)]
    assert rows == sorted(rows, reverse=True)


@pytest.mark.parametrize("name", ["gap", "difference", "rise", "further", "rival"])
def test_an_extreme_value_proves_no_more_than_the_bound(name):
    regression = read_answer_model().catalogue
    low, high = regression.bounds[name]
    said = [
        regression.probability(msgspec.structs.replace(EXPLAINED, **{name: value}), [])
        for value in (low - 5, low, high, high + 5)
    ]
    assert said[0] == said[1] > said[2] == said[3]


def test_a_strength_that_differs_speaks_for_something_else(answers):
    differing = answers(EXPLAINED, difference=0.6)
    assert differing.outside > answers(EXPLAINED).outside


def test_held_out_errors_that_rise_speak_against_a_name(answers):
    assert answers(EXPLAINED, rise=0.9).catalogue < answers(EXPLAINED).catalogue


def test_a_name_that_does_not_fit_says_nothing_of_whether_anything_is_missing(answers):
    good, bad = answers(EXPLAINED), answers(EXPLAINED, difference=0.6, rise=0.9)
    assert bad.outside / bad.nothing == pytest.approx(good.outside / good.nothing)


@pytest.mark.parametrize("part", ["servo", "tip"])
def test_a_residual_beyond_noise_is_not_nothing(answers, part):
    unexplained = answers(NOISE, **{part: 2.0})
    assert unexplained.nothing < answers(NOISE).nothing
    assert unexplained.outside > answers(NOISE).outside


def test_a_residual_far_beyond_noise_is_not_nothing_though_no_effect_stands_out(answers):
    assert answers(NOISE, tip=5.8).is_outside and answers(NOISE, servo=5.8).is_outside


@pytest.mark.parametrize("probability", [0.3, 0.59, 0.61, 0.66, 0.67, 0.9])
@pytest.mark.parametrize("outside", [0.0, 0.3, 0.5, 1.0])
def test_what_is_said_has_the_least_expected_cost(probability, outside):
    rest = 1 - probability
    truth = {"nothing": rest * (1 - outside), "names": probability, "outside": rest * outside}
    cost = {
        said: sum(p * (WRONG_NAME_COST if said == "names" else 1.0) for true, p in truth.items()
                  if true != said)
        for said in truth
    }  # fmt: skip
    answers = Answers(truth["nothing"], truth["names"], truth["outside"])
    without = "outside" if answers.is_outside else "nothing"
    assert cost["names" if answers.is_believed else without] == min(cost.values())


def test_what_another_effect_would_explain_too_speaks_against_a_name(answers):
    """In place of the named one, or beside it."""
    assert answers(EXPLAINED, rival=0.0).catalogue < answers(EXPLAINED).catalogue
    assert answers(EXPLAINED, further=1.5).catalogue < answers(EXPLAINED).catalogue


def test_what_is_left_beside_the_names_speaks_against_them(answers):
    assert answers(EXPLAINED, left=0.0).catalogue < answers(EXPLAINED).catalogue


def test_several_effects_need_more_evidence_than_one(answers):
    assert answers(EXPLAINED, beyond_one=1.0).catalogue < answers(EXPLAINED).catalogue


def test_odds_of_several_effects_are_the_mean_of_theirs():
    regression = msgspec.structs.replace(
        read_answer_model().catalogue, of_effect={"creep": -2.0, "stiction": 2.0}
    )
    one, other, both, unknown = (
        regression.probability(EXPLAINED, names)
        for names in (["creep"], ["stiction"], ["creep", "stiction"], ["cogging"])
    )
    assert one < both == unknown < other


def test_the_effect_that_stands_out_least_counts():
    point = FitPoint([], 0.0, [])
    chosen = [
        Candidate(("stiction",), point, 30.0**2 / 2, 10.0, 10.0),
        Candidate(("creep",), point, 30.0**2 / 2, 20.0, 20.0),
    ]
    named = SearchResult(point, point, named=["stiction", "creep"], chosen=chosen)
    assert clearness_of(named) == pytest.approx(1.5)
    alone = SearchResult(point, point, named=["stiction"], chosen=chosen)
    assert clearness_of(alone) == pytest.approx(3.0)
    none = SearchResult(point, point, rounds=[[chosen[1]]])
    assert clearness_of(none) == pytest.approx(1.5), "the best candidate counts"
    assert clearness_of(SearchResult(point, point)) == 0.0
