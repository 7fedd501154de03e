"""Further effect: held against noise and the error of the equations of those named."""

from types import SimpleNamespace

import numpy as np
import pytest

from models.gap.decision.further_effect import further_effect_of, with_further_effect
from models.gap.estimation.gauss_newton import FitPoint
from models.gap.search.candidate import Candidate, SearchResult
from models.gap.settings import DEFAULT_SETTINGS

LEAST = {"hysteresis": 5.0, "backlash": 20.0}


def search(residual=1.0):
    """What is needed of a search whose fits leave a mean squared residual."""
    return SimpleNamespace(
        settings=DEFAULT_SETTINGS,
        mean_residual=lambda point: residual,
        least=lambda effects, point: LEAST[effects[0]],
    )


def found(separation=40.0, named=("creep",), **further):
    """Result with effects of one d′, and with further ones of their own beside it."""
    point = lambda gain: FitPoint(np.zeros(1), 5000.0 - gain / 2, [])  # noqa: E731
    own = [Candidate((e,), point(0.0), separation**2 / 2, 4.5, 4.5) for e in named]
    result = SearchResult(point(0.0), point(separation**2), list(named), chosen=own)
    for effect, size in further.items():
        result.explore([*named, effect], point(separation**2 + size**2))
    return result


def test_the_one_that_exceeds_its_least_most_counts():
    best = further_effect_of(search(), found(hysteresis=12.0, backlash=25.0))
    assert (best.effect, best.separation) == ("hysteresis", pytest.approx(12.0))
    assert best.is_missing


@pytest.mark.parametrize(("separation", "missing"), [(40.0, True), (200.0, False)])
def test_a_large_effect_may_miss_as_much_by_its_equation(separation, missing):
    assert further_effect_of(search(), found(separation, hysteresis=12.0)).is_missing is missing


def test_a_residual_above_the_floor_asks_for_more():
    assert not further_effect_of(search(residual=9.0), found(hysteresis=12.0)).is_missing


def test_there_is_none_without_a_name_or_a_trial_beside_it():
    assert further_effect_of(search(), found()) is None
    assert further_effect_of(search(), found(named=(), hysteresis=12.0)) is None


def test_the_result_with_the_further_effect_tells_its_separation_and_leaves_the_other_as_it_is():
    result = found(hysteresis=12.0)
    point = result.explored[frozenset(("creep", "hysteresis"))]
    candidate = SimpleNamespace(
        candidate=lambda effects, point, here: Candidate(
            effects, point, here.cost - point.cost, 5.0, 5.0
        )
    )
    more = with_further_effect(candidate, result, "hysteresis", point)
    assert more.named == ["creep", "hysteresis"] and more.after is point
    assert [c.effects for c in more.chosen] == [("creep",), ("hysteresis",)]
    assert more.chosen[1].separation == pytest.approx(12.0)
    assert result.named == ["creep"] and len(result.chosen) == 1
    again = with_further_effect(candidate, more, "hysteresis", point)
    assert len(again.chosen) == 2, "it was included in its turn"
