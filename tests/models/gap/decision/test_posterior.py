"""Posterior over sets of effects: sums to one, follows the scores, spreads where they are alike."""

from dataclasses import dataclass, field

import numpy as np
import pytest

from models.gap.decision.answers import Answers
from models.gap.decision.posterior import effect_probabilities, posterior_of
from models.gap.estimation.gauss_newton import FitPoint
from models.gap.search.candidate import Candidate, SearchResult
from models.gap.search.null_distribution import NullDistribution


@dataclass
class Search:
    """What the posterior needs of a search."""

    learned: bool = True
    of: dict = field(default_factory=lambda: dict.fromkeys(range(30)))
    null_distribution: NullDistribution = field(
        default_factory=lambda: NullDistribution(threshold=4.5, explained=2.0)
    )

    def least(self, effects, point):
        return self.null_distribution.least(effects)

    def free(self, effects):
        return np.zeros(3, dtype=bool)


def point(cost):
    return FitPoint(np.zeros(3), cost, [])


CATALOGUE = Answers(nothing=0.0, catalogue=1.0, outside=0.0)


def found(none, answers=CATALOGUE, **costs):
    """Probabilities of single effects, by their d′."""
    before = point(none)
    result = SearchResult(before, before)
    for effect, separation in costs.items():
        result.explore([effect], point(none - separation**2 / 2))
    return {h.effects: h.probability for h in posterior_of(Search(), result, answers)}


def test_probabilities_follow_the_answers_and_the_separation():
    rows = found(500.0, Answers(0.1, 0.7, 0.2), creep=12.0, hysteresis=11.8, backlash=3.0)
    assert rows[()] == pytest.approx(0.1)
    assert sum(rows.values()) == pytest.approx(0.8, abs=0.01), "0.2 are something else"
    assert next(iter(rows)) == ("creep",)
    assert rows["creep",] > rows["hysteresis",] > rows.get(("backlash",), 0.0)


def test_without_a_set_of_effects_the_catalogue_has_nothing_to_hold():
    assert found(500.0, Answers(0.5, 0.3, 0.2)) == {(): pytest.approx(0.8)}


def test_a_name_shares_with_its_look_alikes_and_with_what_adds_to_it_alone():
    """The answer is about the names: a better fit that the tests refused is something else."""
    before = point(5000.0)
    fits = {
        ("creep",): 40.0, ("hysteresis",): 39.7, ("aerodynamic_drag",): 60.0,
        ("creep", "backlash"): 41.0, ("aerodynamic_drag", "hysteresis"): 61.0,
    }  # fmt: skip
    result = SearchResult(before, before, named=["creep"])
    for effects, separation in fits.items():
        result.explore(effects, point(5000.0 - separation**2 / 2))
    chosen, alike = (
        Candidate((e,), point(0.0), separation**2 / 2, 4.5, 4.5)
        for e, separation in (("creep", 40.0), ("hysteresis", 39.7))
    )
    result.chosen, result.rounds = [chosen], [[chosen, alike]]
    rows = {h.effects: h.probability for h in posterior_of(Search(), result, CATALOGUE)}
    assert set(rows) - {()} <= {("creep",), ("hysteresis",), ("backlash", "creep")}
    assert sum(rows.values()) == pytest.approx(1.0, abs=0.01)
    assert rows["creep",] > rows["hysteresis",] > 0.1


def test_all_that_are_named_are_missing_or_their_look_alikes():
    """A part of the names is not among the hypotheses: the answer holds for all of them."""
    before = point(5000.0)
    result = SearchResult(before, before, named=["creep", "backlash"])
    for effects, separation in {("creep",): 40.0, ("creep", "backlash"): 42.0}.items():
        result.explore(effects, point(5000.0 - separation**2 / 2))
    pair = Candidate(("creep", "backlash"), point(0.0), 42.0**2 / 2, 6.4, 6.4)
    result.chosen, result.rounds = [pair], [[pair]]
    hypotheses = posterior_of(Search(), result, Answers(0.1, 0.8, 0.1))
    assert effect_probabilities(hypotheses) == pytest.approx({"creep": 0.8, "backlash": 0.8})


@pytest.mark.parametrize("separation", [8.0, 30.0, 100.0])
def test_effects_of_one_score_share_their_probability(separation):
    rows = found(1e4, creep=separation, hysteresis=separation)
    assert rows["creep",] == pytest.approx(rows["hysteresis",], rel=1e-9)
    assert rows["creep",] + rows["hysteresis",] == pytest.approx(1.0, abs=0.01)


def test_a_large_gap_separates_no_better_than_its_equation_allows():
    """An error of a fraction of the gap is as large as the difference of two effects' gains."""
    near = found(1e4, creep=100.0, hysteresis=99.5)
    assert near["hysteresis",] > 0.01, "a difference of d′ = 10: by noise alone below 1e-14"
    assert found(1e4, creep=100.0, hysteresis=80.0)["creep",] > 0.97


def test_useless_effects_beside_the_right_one_do_not_outweigh_it():
    """Every pair with the right effect fits as well; one more effect is as improbable as many."""
    before = point(5000.0)
    result = SearchResult(before, before)
    result.explore(["softening"], point(5000.0 - 70.0**2 / 2))
    for k in range(29):
        result.explore(["softening", f"other_{k}"], point(5000.0 - 70.0**2 / 2))
    hypotheses = posterior_of(Search(), result, CATALOGUE)
    assert hypotheses[0].effects == ("softening",)
    assert hypotheses[0].probability > 0.4
    by_effect = effect_probabilities(hypotheses)
    assert by_effect["softening"] == pytest.approx(1.0, abs=0.03)
    assert max((p for e, p in by_effect.items() if e != "softening"), default=0.0) < 0.05
