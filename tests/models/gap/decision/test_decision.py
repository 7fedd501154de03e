"""What is tried in place of an effect that was refused, and what is kept."""

import sys
from dataclasses import dataclass, field, replace
from types import SimpleNamespace

import numpy as np
import pytest

from models.gap.decision import decision
from models.gap.decision.answers import Answers
from models.gap.decision.decision import Decision, JudgedNames, decide
from models.gap.decision.further_effect import FurtherEffect
from models.gap.estimation.gauss_newton import FitPoint
from models.gap.search.candidate import Candidate, SearchResult
from models.gap.search.refused_effect import RefusedEffect
from models.gap.search.strength_consistency import StrengthConsistency
from models.gap.settings import DEFAULT_SETTINGS

POINT = FitPoint(np.zeros(1), 0.0, [])
ORDER = ["prebend", "encoder_offset", "marker_frame_tilt", "payload_offset"]
BELIEVED, DOUBTED = Answers(0.05, 0.9, 0.05), Answers(0.1, 0.2, 0.7)


def refusal(effect, kind="held-out error"):
    return RefusedEffect(
        effect=effect, kind=kind, name="", value=1.1, limit=1.0, unit="1", reason=""
    )


@dataclass
class Search:
    """Search that chooses the first of `ORDER` that is not excluded.

    Those of `alike` explain as much as it does.
    """

    learned: bool = True
    alike: tuple = ()
    bias: bool = False
    tried: list = field(default_factory=list)
    settings = DEFAULT_SETTINGS

    def search(self, excluded=()):
        chosen = next(e for e in ORDER if e not in excluded)
        self.tried.append(chosen)
        candidate = Candidate((chosen,), POINT, 1.0, 1.0, 1.0)
        row = [candidate, *(replace(candidate, effects=(e,)) for e in self.alike if e != chosen)]
        return SearchResult(POINT, POINT, [chosen], rounds=[row], chosen=[candidate])

    def nuisance_bias(self, point):
        return {"eccentricity_m": 31.0} if self.bias else {}

    def has_gap(self, point):
        return False

    def search_without(self, earlier, effects):
        return replace(self.search(effects), before=earlier.before)


@dataclass
class Outcome:
    """What the tests of one effect say: refusal, not written, strength that differs, belief.

    With it they leave the effects of `beside`.
    """

    refused: str = ""
    beside: tuple = ()
    failed: bool = False
    differs: bool = False
    catalogue: float = 0.9


@pytest.fixture
def decided(monkeypatch):
    """Function ({effect: Outcome}, learned, alike) -> decision, search."""

    def run(outcomes, learned=True, alike=()):
        def tested(search, result, model):
            effect = result.named[0]
            outcome = outcomes.get(effect, Outcome())
            differs = {effect: StrengthConsistency(0.5, 0.0, 0.25, not outcome.differs)}
            if outcome.refused:
                result.named, result.refused = [], [refusal(effect, outcome.refused)]
            result.named += outcome.beside
            answers = Answers(0.0, outcome.catalogue, 1.0 - outcome.catalogue)
            judged = (JudgedNames((effect,), None, answers),)
            failed = refusal(effect) if outcome.failed else None
            verdict = "closed" if result.named else "no gap"
            return Decision(result, None, failed, differs, judged, verdict, 0.0)

        monkeypatch.setattr(decision, "_decision", tested)
        search = Search(learned, alike)
        return decide(search, search.search()), search

    return run


def test_what_passes_is_not_searched_again(decided):
    found, search = decided({})
    assert found.result.named == ORDER[:1]
    assert search.tried == ORDER[:1]


@pytest.mark.parametrize("kind", ["at a bound", "impossible"])
def test_the_next_effect_is_named_in_place_of_one_that_a_test_refuses(decided, kind):
    found, search = decided({"prebend": Outcome(kind)})
    assert found.result.named == ["encoder_offset"]
    assert [r.effect for r in found.result.refused] == ["prebend"], "and the page says which"
    assert search.tried == ORDER[:2]


def test_the_next_effect_is_named_in_place_of_one_that_differs_from_payload_to_payload(decided):
    found, _ = decided({"prebend": Outcome("stand-in", differs=True)})
    assert found.result.named == ["encoder_offset"]


def test_what_is_named_beside_another_effect_is_not_said_to_be_refused(decided):
    doubted = {"prebend": Outcome("at a bound"), "encoder_offset": Outcome(beside=("prebend",))}
    found, _ = decided(doubted)
    assert found.result.named == ["encoder_offset", "prebend"] and found.result.refused == []


def test_what_the_trials_do_not_tell_from_a_first_choice_that_is_not_believed_is_tried(decided):
    found, search = decided({"prebend": Outcome("improbable")}, alike=ORDER[:2])
    assert found.result.named == ["encoder_offset"] and search.tried == ORDER[:2]


def test_each_look_alike_is_tried_once(decided):
    doubted = dict.fromkeys(ORDER, Outcome("improbable"))
    found, search = decided(doubted, alike=ORDER[:2])
    assert found.result.named == [] and search.tried == ORDER[:2]


def test_weak_evidence_speaks_against_every_effect(decided):
    found, search = decided({"prebend": Outcome("improbable")})
    assert found.result.named == []
    assert search.tried == ORDER[:1]


def test_the_first_decision_stands_where_no_alternative_passes(decided):
    found, search = decided(dict.fromkeys(ORDER, Outcome("at a bound")))
    assert found.verdict == "no gap"
    assert found.result.chosen[0].effects == (ORDER[0],)
    assert search.tried == ORDER[: 1 + DEFAULT_SETTINGS.most_alternatives]
    assert [r.effect for r in found.result.refused] == search.tried, "every refusal is said"


def test_an_effect_that_is_believed_is_named_although_its_plant_is_not_written(decided):
    found, search = decided({"prebend": Outcome(failed=True)})
    assert found.result.named == ["prebend"] and search.tried == ORDER[:1]
    assert [(r.effect, r.kind) for r in found.result.refused] == [("prebend", "not written")]


def test_an_effect_that_fails_on_held_out_errors_and_is_not_believed_is_replaced(decided):
    found, _ = decided({"prebend": Outcome("stand-in", failed=True)})
    assert found.result.named == ["encoder_offset"]
    kinds = [(r.effect, r.kind) for r in found.result.refused]
    assert kinds == [("prebend", "stand-in"), ("prebend", "held-out error")]


def test_what_was_judged_last_led_to_the_verdict(decided):
    found, _ = decided({"prebend": Outcome("at a bound", catalogue=0.1)})
    assert [t.effects for t in found.tested] == [("prebend",), ("encoder_offset",)]
    assert found.answers.catalogue == 0.9


def test_without_a_learned_floor_nothing_is_tried_again(decided):
    _, search = decided({"prebend": Outcome("at a bound")}, learned=False)
    assert search.tried == ORDER[:1]


COST = {"prebend": 9.0, "creep": 1.0}
"""Cost that each effect takes away."""


class PassingTests:
    """Acceptance that passes everything, but for one effect beside others."""

    blamed, held_out = None, False

    def __init__(self, search, result):
        self.search, self.result, self.withheld = search, result, None
        self.keeps_named = False
        self.judged = SimpleNamespace(errors=None)

    def accepted(self):
        if self.keeps_named and self.held_out:
            self.withheld = refusal(self.blamed)
        elif len(self.result.named) > 1:
            self.result.named = [e for e in self.result.named if e != self.blamed]
        cost = sum(COST[e] for e in COST if e not in self.result.named)
        self.result.after = SimpleNamespace(cost=cost)
        return " + ".join(self.result.named)

    def copy(self):
        return PassingTests(self.search, replace(self.result, named=list(self.result.named)))

    def without(self, effect):
        named = [e for e in self.result.named if e != effect]
        return PassingTests(self.search, replace(self.result, named=named))

    def with_further(self, effect):
        named = [*self.result.named, effect]
        return PassingTests(self.search, replace(self.result, named=named))

    def changed_link(self):
        return "link as refitted"

    def without_named(self, accepted, answers):
        self.result.named = []
        return "as given"


def decide_with(monkeypatch, believed, named=("prebend", "creep"), further=None, search=None):
    """Decision on effects, where some sets are believed, or have these answers.

    A further effect is found beside what it is not part of.
    """
    chosen = [
        Candidate(("prebend",), POINT, 50.0, 1.0, 1.0), Candidate(("creep",), POINT, 8.0, 1.0, 1.0)
    ]  # fmt: skip
    result = SearchResult(POINT, POINT, list(named), rounds=[[c] for c in chosen], chosen=chosen)
    known = believed if isinstance(believed, dict) else dict.fromkeys(believed, BELIEVED)
    model = SimpleNamespace(answers=lambda evidence, named: known.get(evidence, DOUBTED))
    monkeypatch.setattr(decision, "Acceptance", PassingTests)
    monkeypatch.setattr(decision, "read_answer_model", lambda: model)
    monkeypatch.setattr(decision, "consistencies_of_named", lambda search, of: {})
    monkeypatch.setattr(decision, "evidence_of", lambda search, of, *rest: tuple(of.named))
    monkeypatch.setattr(
        decision, "further_effect_of",
        lambda search, of: further if further and further.effect not in of.named else None,
    )  # fmt: skip
    monkeypatch.setattr(decision, "gap_verdict", lambda *of: "reduced" if of[5] else "no")
    monkeypatch.setattr(decision, "gap_left_fraction", lambda search, of: 0.6)
    return decide(search or Search(), result)


@pytest.mark.parametrize(
    ("believed", "named"),
    [
        ([("prebend", "creep")], ["prebend", "creep"]),
        ([("prebend",)], ["prebend"]),
        ([("creep",)], ["creep"]),
        ([], []),
    ],
)
def test_of_several_effects_that_are_not_believed_the_most_believed_may_stand(
    monkeypatch, believed, named
):
    found = decide_with(monkeypatch, believed)
    assert found.result.named == named
    assert found.accepted == (" + ".join(named) or "as given")
    tested = [t.effects for t in found.tested]
    rests = [] if len(named) > 1 else [("creep",), ("prebend",)]
    assert sorted(tested) == sorted([("prebend", "creep"), *rests])
    assert not named or tested[-1] == tuple(named), "the last one led to the verdict"


@pytest.mark.parametrize(
    ("both", "first", "named"),
    [
        (0.7, 0.98, ["prebend", "creep"]), (0.6, 0.98, ["prebend"]), (0.3, 0.6, []),
    ],
)  # fmt: skip
def test_the_largest_set_that_is_likelier_than_all_else_is_named(monkeypatch, both, first, named):
    rows = {("prebend", "creep"): both, ("prebend",): first}
    answers = {e: Answers((1 - p) / 2, p, (1 - p) / 2) for e, p in rows.items()}
    assert decide_with(monkeypatch, answers).result.named == named


@pytest.mark.parametrize(
    ("biased_beside", "named"),
    [
        (("prebend",), ["prebend", "creep"]), (("creep",), ["prebend"]), ((), ["prebend"]),
        (("prebend", "prebend + creep"), ["prebend"]),
    ],
)  # fmt: skip
def test_what_takes_a_deviation_from_all_trials_is_as_likely_as_the_effect_beside_it(
    monkeypatch, biased_beside, named
):
    """The evidence believes in the first effect alone, and not in both."""

    class BiasedSearch(Search):
        def nuisance_bias(self, point):
            rests = {1.0: "prebend", 9.0: "creep", 0.0: "prebend + creep"}
            return {"friction": 20.0} if rests.get(point.cost) in biased_beside else {}

    answers = {("prebend",): BELIEVED, ("prebend", "creep"): Answers(0.3, 0.3, 0.4)}
    found = decide_with(monkeypatch, answers, search=BiasedSearch())
    assert found.result.named == named


@pytest.mark.parametrize(("blamed", "named"), [("prebend", ["prebend"]), ("creep", [])])
def test_what_the_tests_took_out_is_named_where_it_fits_better_than_the_rest(
    monkeypatch, blamed, named
):
    monkeypatch.setattr(PassingTests, "blamed", blamed)
    found = decide_with(monkeypatch, [(blamed,)])
    assert found.result.named == named
    first = ("creep",) if blamed == "prebend" else ("prebend",)
    assert [t.effects for t in found.tested] == [first, *([(blamed,)] if named else [])]


@pytest.mark.parametrize("whole", [True, False])
def test_an_effect_that_held_out_errors_refuse_is_named_where_the_whole_set_is_believed(
    monkeypatch, whole
):
    monkeypatch.setattr(PassingTests, "blamed", "creep")
    monkeypatch.setattr(PassingTests, "held_out", True)
    sets = [("prebend",), *([("prebend", "creep")] if whole else [])]
    found = decide_with(monkeypatch, sets)
    assert found.result.named == list(sets[-1])
    assert found.accepted == "prebend", "what passed is written"
    judged = {t.effects for t in found.tested}
    assert judged == {("prebend",), ("prebend", "creep")}
    assert found.tested[-1].effects == sets[-1], "the last one led to the verdict"
    rows = [(r.effect, r.kind) for r in found.result.refused]
    assert rows == ([("creep", "not written")] if whole else [])


@pytest.mark.parametrize(
    ("separation", "sets", "named"),
    [
        (30.0, [("prebend",), ("prebend", "creep")], ["prebend", "creep"]),
        (30.0, [("prebend",)], ["prebend"]),
        (9.0, [("prebend",), ("prebend", "creep")], ["prebend"]),
        (30.0, [("prebend", "creep")], []),
    ],
)
def test_a_further_effect_that_would_explain_more_is_judged_beside_what_is_believed(
    monkeypatch, separation, sets, named
):
    further = FurtherEffect("creep", separation, 10.0)
    found = decide_with(monkeypatch, sets, ["prebend"], further)
    assert found.result.named == named
    judged = {t.effects for t in found.tested}
    asked = separation > further.least and ("prebend",) in sets
    assert (("prebend", "creep") in judged) == asked


def test_effects_of_which_none_is_to_blame_are_judged_once(monkeypatch):
    class Withheld(PassingTests):
        def accepted(self):
            self.withheld, self.result.named = refusal("prebend"), ["prebend"]
            self.result.after = SimpleNamespace(cost=1.0)
            return "as given"

        def copy(self):
            return Withheld(self.search, replace(self.result, named=list(self.result.named)))

    monkeypatch.setattr(sys.modules[__name__], "PassingTests", Withheld)
    found = decide_with(monkeypatch, [("prebend",)])
    assert [t.effects for t in found.tested] == [("prebend",)]


def test_without_a_learned_floor_no_further_effect_is_judged(monkeypatch):
    monkeypatch.setattr(decision, "CATALOGUE_ONLY", BELIEVED)
    further = FurtherEffect("creep", 30.0, 10.0)
    found = decide_with(monkeypatch, [], ["prebend"], further, Search(learned=False))
    assert [t.effects for t in found.tested] == [("prebend",)]


def test_a_deviation_that_all_trials_share_is_never_nothing(monkeypatch):
    model = SimpleNamespace(answers=lambda evidence, named: Answers(0.9, 0.04, 0.06))
    monkeypatch.setattr(decision, "Acceptance", PassingTests)
    monkeypatch.setattr(decision, "read_answer_model", lambda: model)
    monkeypatch.setattr(decision, "consistencies_of_named", lambda search, of: {})
    monkeypatch.setattr(decision, "evidence_of", lambda *of: None)
    monkeypatch.setattr(decision, "further_effect_of", lambda *of: None)
    found = decide(Search(bias=True), SearchResult(POINT, POINT))
    assert found.verdict == "not in the catalogue"
    assert found.answers == Answers(0.0, 0.04, pytest.approx(0.96))
    assert found.accepted == ""
    plain = decide(Search(bias=False), SearchResult(POINT, POINT))
    assert (plain.verdict, plain.accepted) == ("no gap", "link as refitted")
