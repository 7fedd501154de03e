"""Verdict by the probabilities of the answers, and further effects whose strength differs."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

from models.gap.decision import acceptance
from models.gap.decision.acceptance import Acceptance
from models.gap.decision.answers import CATALOGUE_ONLY, Answers
from models.gap.decision.further_effect import FurtherEffect
from models.gap.decision.gap_verdict import gap_left_fraction, gap_verdict
from models.gap.estimation.gauss_newton import FitPoint
from models.gap.search.candidate import SearchResult
from models.gap.search.null_distribution import NullDistribution
from models.gap.search.strength_consistency import StrengthConsistency
from models.gap.settings import DEFAULT_SETTINGS

CERTAIN = Answers(nothing=0.02, catalogue=0.95, outside=0.03)
DIFFERING = {"creep": StrengthConsistency(0.5, 0.0, 0.25, False)}


def point(mean_square):
    """Fit whose whitened residual has a mean square."""
    return FitPoint(np.zeros(1), 0.0, [np.full(100, np.sqrt(mean_square))])


@dataclass
class Search:
    """What the verdict needs of a search."""

    bias: bool = False
    learned: bool = True
    settings = DEFAULT_SETTINGS
    null_distribution = NullDistribution(threshold=4.5, explained=2.0)
    first = SimpleNamespace(whitened=lambda rows: rows)

    def nuisance_bias(self, fit):
        return {"sync_s": -14.0} if self.bias else {}

    def mean_residual(self, fit):
        return float(np.mean(fit.rows[0] ** 2))

    def has_gap(self, fit):
        return self.mean_residual(fit) > self.null_distribution.explained


def result(before, after, *named):
    return SearchResult(point(before), point(after), named=list(named))


@pytest.mark.parametrize(
    ("after", "bias", "verdict"),
    [(1.9, False, "closed"), (2.1, False, "reduced"), (1.9, True, "reduced")],
)
def test_what_is_believed_closes_the_gap_or_reduces_it(after, bias, verdict):
    found = result(9.0, after, "creep")
    assert gap_verdict(Search(bias), found, {}, CERTAIN, None, True) == verdict


@pytest.mark.parametrize(("separation", "verdict"), [(11.0, "closed"), (13.0, "reduced")])
def test_what_a_further_effect_explains_beyond_the_errors_of_equations_is_left(separation, verdict):
    further = FurtherEffect("hysteresis", separation, 12.0)
    found = result(9.0, 1.0, "creep")
    assert gap_verdict(Search(), found, {}, CERTAIN, further, True) == verdict


@pytest.mark.parametrize("named", [("creep",), ()])
def test_what_is_not_believed_leaves_the_likelier_one_of_the_other_answers(named):
    found = result(9.0, 1.0, *named)
    outside, nothing = Answers(0.1, 0.3, 0.6), Answers(0.6, 0.3, 0.1)
    assert gap_verdict(Search(), found, {}, outside, None, False) == "not in the catalogue"
    assert gap_verdict(Search(), found, {}, nothing, None, False) == "no gap"


@pytest.mark.parametrize("chosen", [[], ["a candidate"]])
@pytest.mark.parametrize("before", [1.5, 2.5])
def test_the_answers_decide_and_no_limit_beside_them(before, chosen):
    found = SearchResult(point(before), point(before), chosen=chosen)
    outside = Answers(0.1, 0.3, 0.6)
    assert gap_verdict(Search(), found, {}, outside, None, False) == "not in the catalogue"


def test_without_a_name_an_effect_of_the_catalogue_may_be_too_faint_to_name():
    faint = Answers(nothing=0.3, catalogue=0.6, outside=0.1)
    assert gap_verdict(Search(), result(1.5, 1.5), {}, faint, None, False) == "no gap"


@pytest.mark.parametrize(
    ("bias", "consistencies", "verdict"),
    [
        (False, {}, "no floor"),
        (True, {}, "not in the catalogue"),
        (False, DIFFERING, "not in the catalogue"),
    ],
)
def test_without_a_noise_floor_only_a_stand_in_is_told(bias, consistencies, verdict):
    found = result(9.0, 1.0, "creep")
    search = Search(bias, learned=False)
    assert (
        gap_verdict(search, found, consistencies, CATALOGUE_ONLY, None, bool(found.named))
        == verdict
    )


def test_the_fraction_left_is_of_the_amplitude_beyond_noise():
    assert gap_left_fraction(Search(), result(5.0, 2.0, "creep")) == pytest.approx(0.5)
    assert gap_left_fraction(Search(), result(0.9, 0.9)) == 0.0


@pytest.mark.parametrize(
    ("differing", "kept"),
    [
        ((), ["coulomb_friction", "creep", "backlash"]),
        (("creep",), ["coulomb_friction", "backlash"]),
        (("coulomb_friction",), ["coulomb_friction", "creep", "backlash"]),
    ],
)
def test_only_further_effects_are_refused_for_their_strength(monkeypatch, differing, kept):
    found = result(9.0, 1.0, "coulomb_friction", "creep", "backlash")
    tested = Acceptance.__new__(Acceptance)
    tested.search, tested.result = Search(), found

    def take_out(effects):
        found.named = [e for e in found.named if e not in effects]

    monkeypatch.setattr(tested, "_take_out", take_out)
    monkeypatch.setattr(
        acceptance,
        "consistencies_of_named",
        lambda search, of: {
            e: SimpleNamespace(holds=e not in differing, standard_deviation=0.4) for e in of.named
        },
    )
    while tested._refuses_inconsistent():
        pass
    assert found.named == kept
    assert [r.kind for r in found.refused] == ["inconsistent"] * (3 - len(kept))


@pytest.mark.parametrize("earned", [True, False])
def test_a_value_at_a_bound_is_told_only_where_the_changed_link_is_written(monkeypatch, earned):
    tested = Acceptance.__new__(Acceptance)
    tested.result, tested.settings = result(1.0, 1.0), DEFAULT_SETTINGS
    bounds = ["damping"]

    def refuses():
        tested.result.refused += bounds
        return bool(bounds) and bounds.pop()

    given, refitted = (SimpleNamespace(errors=name) for name in ("given", "refitted"))
    monkeypatch.setattr(tested, "_refuses_values", refuses)
    monkeypatch.setattr(tested, "_as_given", lambda: given)
    monkeypatch.setattr(tested, "_as_fitted", lambda: refitted)
    monkeypatch.setattr(acceptance, "refit_is_earned", lambda *of: earned)
    assert tested.changed_link() is (refitted if earned else given)
    assert tested.result.refused == (["damping"] if earned else [])
