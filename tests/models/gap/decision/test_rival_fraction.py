"""Rival of a named effect: what another one explains in its place, beside the others."""

import numpy as np
import pytest

from models.gap.decision.evidence import rival_fraction
from models.gap.estimation.gauss_newton import FitPoint
from models.gap.search.candidate import SearchResult

NOTHING = 1000.0


def fraction(named, **explained):
    """Rival fraction of named effects, with the fall of the cost by sets joined with "_and_"."""
    point = lambda fall: FitPoint(np.zeros(1), NOTHING - fall, [])  # noqa: E731
    sets = {tuple(text.split("_and_")): fall for text, fall in explained.items()}
    result = SearchResult(point(0.0), point(sets[named]), named=list(named))
    for effects, fall in sets.items():
        result.explore(effects, point(fall))
    return rival_fraction(result)


def test_the_best_other_effect_counts_and_sets_of_another_size_do_not():
    own = {"creep": 100.0, "creep_and_backlash": 180.0}
    assert fraction(("creep",), **own, hysteresis=60.0, prebend=30.0) == pytest.approx(0.6)
    assert fraction(("creep",), **own) == 0.0


def test_beside_a_larger_effect_only_the_part_of_the_smaller_one_counts():
    found = fraction(
        ("creep", "backlash"), creep=100.0, backlash=20.0, creep_and_backlash=120.0,
        creep_and_hysteresis=105.0, hysteresis=90.0,
    )  # fmt: skip
    assert found == pytest.approx(0.25)


def test_what_fits_better_than_a_name_that_is_left_has_more_than_its_part():
    assert fraction(("creep",), creep=50.0, hysteresis=80.0) == pytest.approx(1.6)
