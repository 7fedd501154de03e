"""What is tried in place of an effect that was refused."""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from models.gap.decision import decision
from models.gap.decision.decision import Decision, decide
from models.gap.decision.posterior import Hypothesis
from models.gap.estimation.gauss_newton import FitPoint
from models.gap.search.candidate import Candidate, SearchResult
from models.gap.search.refused_effect import RefusedEffect
from models.gap.search.strength_consistency import StrengthConsistency
from models.gap.settings import DEFAULT_SETTINGS

POINT = FitPoint(np.zeros(1), 0.0, [])
ORDER = ["prebend", "encoder_offset", "marker_frame_tilt", "payload_offset"]


def refusal(effect, kind):
    return RefusedEffect(
        effect=effect, kind=kind, name="", value=1.1, limit=1.0, unit="1", reason=""
    )


@dataclass
class Search:
    """Search that chooses the first of `ORDER` that is not excluded."""

    learned: bool = True
    tried: list = field(default_factory=list)
    settings = DEFAULT_SETTINGS

    def search(self, excluded=()):
        chosen = next(e for e in ORDER if e not in excluded)
        self.tried.append(chosen)
        return SearchResult(
            POINT, POINT, [chosen], chosen=[Candidate((chosen,), POINT, 1.0, 1.0, 1.0)]
        )

    def search_without(self, earlier, effects):
        return replace(self.search(effects), before=earlier.before)


@pytest.fixture
def decided(monkeypatch):
    """Function (refused effects with their kind) -> decision, effects that were tried."""

    def run(refused, learned=True, inconsistent=()):
        def tested(search, result, nothing):
            effect = result.named[0]
            differs = {effect: StrengthConsistency(0.5, 0.0, 0.25, effect not in inconsistent)}
            if effect in refused or effect in inconsistent:
                result.named = []
                result.refused = [refusal(effect, refused.get(effect, "stand-in"))]
            return Decision(result, None, differs, "closed" if result.named else "no gap", 0.0)

        monkeypatch.setattr(decision, "_decision", tested)
        search = Search(learned)
        return decide(search, search.search(), []), search.tried

    return run


def test_what_passes_is_not_searched_again(decided):
    found, tried = decided({})
    assert found.result.named == ORDER[:1]
    assert tried == ORDER[:1]


@pytest.mark.parametrize("kind", ["at a bound", "impossible", "held-out error", "rise of a signal"])
def test_the_next_effect_is_named_in_place_of_one_that_a_test_refuses(decided, kind):
    found, tried = decided({"prebend": kind})
    assert found.result.named == ["encoder_offset"]
    assert [r.effect for r in found.result.refused] == ["prebend"], "and the page says which"
    assert tried == ORDER[:2]


def test_the_next_effect_is_named_in_place_of_one_that_differs_from_payload_to_payload(decided):
    found, _ = decided({}, inconsistent=("prebend",))
    assert found.result.named == ["encoder_offset"]


def test_weak_evidence_speaks_against_every_effect(decided):
    found, tried = decided({"prebend": "stand-in"})
    assert found.result.named == []
    assert tried == ORDER[:1]


def test_the_first_decision_stands_where_no_alternative_passes(decided):
    found, tried = decided(dict.fromkeys(ORDER, "held-out error"))
    assert found.verdict == "no gap"
    assert found.result.chosen[0].effects == (ORDER[0],)
    assert tried == ORDER[: 1 + DEFAULT_SETTINGS.most_alternatives]
    assert [r.effect for r in found.result.refused] == tried, "every refusal is said"


def test_without_a_learned_floor_nothing_is_tried_again(decided):
    _, tried = decided({"prebend": "held-out error"}, learned=False)
    assert tried == ORDER[:1]


@pytest.mark.parametrize(("nothing", "named"), [(0.4, ["prebend"]), (0.6, [])])
def test_nothing_is_named_where_it_is_likelier_that_nothing_is_missing(monkeypatch, nothing, named):
    class Untested(decision.Acceptance):
        def __init__(self, search, result):
            self.search, self.result, self.settings = search, result, search.settings

        def accepted(self):
            return None

        def held_out_left(self, accepted):
            return 1.0

        def _as_given(self):
            return None

    monkeypatch.setattr(decision, "Acceptance", Untested)
    monkeypatch.setattr(decision, "consistencies_of_named", lambda *_: {})
    monkeypatch.setattr(
        decision, "gap_verdict", lambda search, of, *_: ("closed" if of.named else "no gap", 0.0)
    )
    search = Search()
    none = Hypothesis((), nothing, 0.0, 0.0, np.zeros(1), np.zeros(1, dtype=bool))
    found = decide(search, search.search(), [none, replace(none, effects=("prebend",))])
    assert found.result.named == named
    assert found.verdict == ("closed" if named else "no gap")
    assert [r.kind for r in found.result.refused] == ["improbable"] * (1 - len(named))


@pytest.mark.parametrize(
    ("certain", "named"),
    [(["prebend"], ["prebend"]), ([], []), (["prebend", "creep"], [])],
)
def test_what_is_certain_is_kept_where_another_effect_stands_in_for_something(
    monkeypatch, certain, named
):
    """Two effects together leave too much of the gap; the first one alone may stand."""
    result = SearchResult(POINT, POINT, ["prebend", "creep"])

    class Tests:
        def __init__(self, search, found):
            self.found = found

        def accepted(self):
            return "both"

        def held_out_left(self, accepted):
            return 1.0

        def with_certain_only(self, effects):
            self.found.named = list(effects)
            return "the first"

        def without_stand_ins(self, accepted, verdict):
            self.found.named = []
            return "as given"

    def verdict(search, found, consistencies, held_out_left):
        return ("not in the catalogue" if len(found.named) > 1 else "reduced"), 0.6

    monkeypatch.setattr(decision, "Acceptance", Tests)
    monkeypatch.setattr(decision, "consistencies_of_named", lambda search, found: {})
    monkeypatch.setattr(decision, "certain_effects", lambda *of: certain)
    monkeypatch.setattr(decision, "gap_verdict", verdict)
    found = decide(Search(), result, [])
    assert found.result.named == named
    assert found.verdict == ("reduced" if named else "not in the catalogue")
    assert found.accepted == ("the first" if named else "as given")
