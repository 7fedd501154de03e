"""Verdict and acceptance where a further effect is inconsistent, or a bias was taken out."""

from dataclasses import dataclass, field
from types import SimpleNamespace

import numpy as np
import pytest

from models.gap.decision import acceptance
from models.gap.decision.acceptance import Acceptance
from models.gap.decision.gap_verdict import certain_effects, gap_verdict
from models.gap.estimation.gauss_newton import FitPoint
from models.gap.search.candidate import Candidate, SearchResult
from models.gap.search.null_distribution import NullDistribution
from models.gap.search.refused_effect import RefusedEffect
from models.gap.search.strength_consistency import StrengthConsistency
from models.gap.settings import DEFAULT_SETTINGS


def point(mean_square):
    """Fit whose whitened residual has a mean square."""
    return FitPoint(np.zeros(1), 0.0, [np.full(100, np.sqrt(mean_square))])


@dataclass
class Search:
    """What the verdict needs of a search."""

    bias_before: dict = field(default_factory=dict)
    settings = DEFAULT_SETTINGS
    learned = True
    null_distribution = NullDistribution(threshold=4.5, explained=2.0)
    first = SimpleNamespace(whitened=lambda rows: rows)

    def nuisance_bias(self, fit):
        return self.bias_before if fit.rows[0][0] > np.sqrt(2.0) else {}

    def mean_residual(self, fit):
        return float(np.mean(fit.rows[0] ** 2))

    def has_gap(self, fit):
        return self.mean_residual(fit) > self.null_distribution.explained


LEAST = 10.0
"""d′ that an effect of these tests must reach."""


def result(before, after, *named, refused=(), separation=LEAST):
    chosen = [Candidate((e,), point(after), separation**2 / 2, LEAST, LEAST) for e in named]
    return SearchResult(
        point(before), point(after), named=list(named), refused=list(refused), chosen=chosen
    )


def inconsistent(effect):
    return RefusedEffect(
        effect=effect, kind="inconsistent", name="", value=0.4, limit=0.0, unit="1", reason=""
    )


def test_what_is_left_counts_unless_a_bias_was_taken_out_of_the_trials():
    """A clock that is off in every trial goes into the trials' clocks, and leaves no residual."""
    found = result(2.1, 1.9, "sync_offset")
    assert gap_verdict(Search(), found, {})[0] == "not in the catalogue"
    assert gap_verdict(Search({"sync_s": -14.0}), found, {})[0] == "closed"


def test_an_effect_that_leaves_most_of_a_usual_residual_says_nothing():
    """The plant's own error on a link that changed has as large a residual."""
    assert gap_verdict(Search(), result(1.9, 1.85, "stiction"), {})[0] == "no gap"
    assert gap_verdict(Search(), result(1.9, 1.2, "stiction"), {})[0] == "closed"
    assert gap_verdict(Search(), result(4.0, 3.9, "stiction"), {})[0] == "not in the catalogue"


@pytest.mark.parametrize(
    ("held_out_left", "verdict"), [(1.0, "no gap"), (0.9, "no gap"), (0.8, "closed")]
)
def test_an_effect_that_lowers_the_errors_on_what_was_left_out_is_named(held_out_left, verdict):
    """The plant's own error is in the trials that were left out, too."""
    found = result(1.9, 1.85, "stiction")
    assert gap_verdict(Search(), found, {}, held_out_left)[0] == verdict
    differing = {"stiction": StrengthConsistency(0.5, 0.0, 0.25, False)}
    assert gap_verdict(Search(), found, differing, held_out_left)[0] == "no gap"
    large = result(4.0, 3.9, "stiction")
    assert gap_verdict(Search(), large, {}, held_out_left)[0] == "not in the catalogue"


def test_an_effect_that_stands_out_clearly_is_named_in_a_usual_residual():
    """No effect reached that d′ where nothing was missing; a gap is more than a usual residual."""
    clear = 1.01 * DEFAULT_SETTINGS.clear_separation_fraction * LEAST
    found = result(1.9, 1.85, "stiction", separation=clear * np.sqrt(1.85))
    assert gap_verdict(Search(), found, {})[0] == "closed"
    found = result(1.9, 1.85, "stiction", separation=clear)
    assert gap_verdict(Search(), found, {})[0] == "no gap", "the residual's size counts"
    differing = {"stiction": SimpleNamespace(holds=False, probability=0.0)}
    found = result(1.9, 1.85, "stiction", separation=10 * clear)
    assert gap_verdict(Search(), found, differing)[0] == "no gap"
    found = result(4.0, 3.9, "stiction", separation=10 * clear)
    assert gap_verdict(Search(), found, {})[0] == "not in the catalogue"


@pytest.mark.parametrize(
    ("probability", "factor", "verdict"),
    [
        (0.5, 1.01, "reduced"),
        (1e-6, 1.01, "not in the catalogue"),
        (0.5, 0.9, "not in the catalogue"),
    ],
)
def test_a_clear_effect_of_one_strength_explains_a_gap_that_is_mostly_left(
    probability, factor, verdict
):
    """The plant's own error grows with a payload that moves the link out of its known range."""
    clear = DEFAULT_SETTINGS.clear_separation_fraction * LEAST * np.sqrt(3.9)
    found = result(4.0, 3.9, "stiction", separation=factor * clear)
    alike = {"stiction": SimpleNamespace(holds=True, probability=probability)}
    assert gap_verdict(Search(), found, alike)[0] == verdict


def test_a_bias_that_is_still_there_is_no_explanation():
    found = result(2.3, 2.2, "sync_offset")
    assert gap_verdict(Search({"sync_s": -14.0}), found, {})[0] == "not in the catalogue"


@pytest.mark.parametrize(
    ("probability", "verdict"), [(0.5, "reduced"), (1e-6, "not in the catalogue")]
)
def test_a_bias_beside_an_effect_that_is_certain_is_what_is_left(probability, verdict):
    """The eccentricity of the payload takes up what the equation of another effect misses."""
    clear = 1.01 * DEFAULT_SETTINGS.clear_separation_fraction * LEAST * np.sqrt(2.1)
    found = result(9.0, 2.1, "directional_stiffness", separation=clear)
    search = Search({"eccentricity_m": -16.0})
    search.null_distribution = NullDistribution(threshold=4.5, explained=3.0)
    alike = {"directional_stiffness": SimpleNamespace(holds=True, probability=probability)}
    assert not search.has_gap(found.after), "the bias alone is left"
    assert gap_verdict(search, found, alike)[0] == verdict


def test_only_effects_of_one_strength_that_stand_out_are_certain():
    found = result(9.0, 1.0, "stiction", "creep", "backlash", separation=1.6 * LEAST)
    found.chosen[2] = Candidate(("backlash",), found.after, LEAST**2 / 2, LEAST, LEAST)
    known = {e: SimpleNamespace(probability=p) for e, p in [("stiction", 0.5), ("creep", 1e-6)]}
    assert certain_effects(Search(), found, known) == ["stiction"]
    known["backlash"] = SimpleNamespace(probability=0.5)
    assert certain_effects(Search(), found, known) == ["stiction"]


def test_beside_a_refused_effect_less_of_the_gap_may_be_left():
    """As where several are named: two effects that leave more are no explanation."""
    left = DEFAULT_SETTINGS.gap_left_limit_fraction_of_several + 0.1
    after = 1 + 1.5 * left**2
    alone = result(2.5, after, "coulomb_friction")
    beside = result(2.5, after, "coulomb_friction", refused=[inconsistent("creep")])
    assert gap_verdict(Search(), alone, {})[0] == "closed"
    assert gap_verdict(Search(), beside, {})[0] == "not in the catalogue"


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
