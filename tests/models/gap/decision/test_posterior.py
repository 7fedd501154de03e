"""Posterior over sets of effects: sums to one, follows the scores, spreads where they are alike."""

from dataclasses import dataclass, field

import numpy as np
import pytest

from models.gap.decision.posterior import effect_probabilities, posterior_of
from models.gap.estimation.gauss_newton import FitPoint
from models.gap.search.candidate import SearchResult
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


def found(none, **costs):
    """Search result with fits of single effects, by their d′."""
    before = point(none)
    result = SearchResult(before, before)
    for effect, separation in costs.items():
        result.explore([effect], point(none - separation**2 / 2))
    return {h.effects: h.probability for h in posterior_of(Search(), result)}


def test_probabilities_sum_to_one_and_follow_the_separation():
    rows = found(500.0, creep=12.0, hysteresis=11.0, backlash=3.0)
    assert sum(rows.values()) == pytest.approx(1.0, abs=0.01)
    assert next(iter(rows)) == ("creep",)
    assert rows["creep",] > rows["hysteresis",]


def test_without_a_gap_nothing_is_most_probable():
    rows = found(500.0, creep=2.0, hysteresis=3.0)
    assert next(iter(rows)) == () and rows[()] > 0.9


@pytest.mark.parametrize("separation", [8.0, 30.0, 100.0])
def test_effects_of_one_score_share_their_probability(separation):
    rows = found(1e4, creep=separation, hysteresis=separation)
    assert rows["creep",] == pytest.approx(rows["hysteresis",], rel=1e-9)
    assert rows["creep",] + rows["hysteresis",] + rows.get((), 0.0) == pytest.approx(1.0, abs=0.01)


def test_something_is_missing_the_surer_the_further_the_best_effect_exceeds_its_least():
    """4.5 is the least d′: what only just passes it may be the plant's own error."""
    nothing = [found(1e4, creep=d)[()] for d in (3.0, 4.5, 6.0, 7.5)]
    assert nothing == sorted(nothing, reverse=True)
    assert nothing[1] > 0.8 and nothing[3] < 0.5
    assert found(1e4, creep=20.0).get((), 0.0) < 1e-3


def test_a_large_gap_separates_no_better_than_its_equation_allows():
    """An error of a fraction of the gap is as large as the difference of two effects' gains."""
    near = found(1e4, creep=100.0, hysteresis=99.0)
    assert near["creep",] < 0.8
    assert found(1e4, creep=100.0, hysteresis=80.0)["creep",] > 0.9


def test_useless_effects_beside_the_right_one_do_not_outweigh_it():
    """Every pair with the right effect fits as well; one more effect is as improbable as many."""
    before = point(5000.0)
    result = SearchResult(before, before)
    result.explore(["softening"], point(5000.0 - 70.0**2 / 2))
    for k in range(29):
        result.explore(["softening", f"other_{k}"], point(5000.0 - 70.0**2 / 2))
    hypotheses = posterior_of(Search(), result)
    assert hypotheses[0].effects == ("softening",)
    assert hypotheses[0].probability > 0.4
    by_effect = effect_probabilities(hypotheses)
    assert by_effect["softening"] == pytest.approx(1.0, abs=0.03)
    assert max(p for effect, p in by_effect.items() if effect != "softening") < 0.05
