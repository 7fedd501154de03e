"""Look-alikes: a name and its look-alikes hold 95 % of the posterior of their turn."""

import numpy as np
import pytest

from models.gap.decision.look_alikes import look_alikes_of
from models.gap.decision.posterior import set_weights
from models.gap.estimation.gauss_newton import FitPoint
from models.gap.search.candidate import Candidate, SearchResult

LEAST = 4.5


def turn(chosen=0, **separations):
    """Look-alikes of the candidate at a place of a turn, each given by its d′."""
    point = FitPoint(np.zeros(3), 0.0, [])
    rows = [Candidate((e,), point, d**2 / 2, LEAST, LEAST) for e, d in separations.items()]
    result = SearchResult(point, point, rounds=[rows], chosen=[rows[chosen]])
    result.screened = separations
    return [a.effects[0] for a in look_alikes_of(result, 0)]


def test_a_candidate_far_ahead_has_none():
    assert turn(creep=40.0, hysteresis=15.0, backlash=5.0) == []


@pytest.mark.parametrize("separation", [8.0, 40.0, 150.0])
def test_equal_candidates_are_look_alikes_at_any_size(separation):
    assert turn(prebend=separation, encoder_offset=separation) == ["encoder_offset"]


def test_the_error_of_an_equation_grows_with_the_gap():
    """The same difference of squares counts less beside a larger gap."""
    small, large = np.hypot(10.0, 6.0), np.hypot(40.0, 6.0)
    assert turn(creep=small, hysteresis=10.0) == []
    assert turn(creep=large, hysteresis=40.0) == ["hysteresis"]


def test_what_did_better_but_failed_another_test_is_a_look_alike():
    assert turn(1, creep=30.0, hysteresis=29.0) == ["creep"]


def test_a_name_and_its_look_alikes_are_the_smallest_set_that_holds_95_percent():
    rng = np.random.default_rng(3)
    for _ in range(50):
        sizes = np.sort(rng.uniform(5.0, 40.0, 8))[::-1]
        names = [f"effect_{k}" for k in range(8)]
        own = {names[0], *turn(**dict(zip(names, sizes, strict=True)))}
        weights = set_weights(np.ones(8), sizes**2 - LEAST**2, 8)
        weights /= weights.sum()
        held = sum(w for n, w in zip(names, weights, strict=True) if n in own)
        least = min(w for n, w in zip(names, weights, strict=True) if n in own)
        assert held >= 0.95 and held - least < 0.95
