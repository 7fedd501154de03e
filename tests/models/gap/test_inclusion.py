"""Inclusions of an effect search, as a diagnosis tells them."""

from types import SimpleNamespace

import pytest

from models.gap.inclusion import inclusions_of
from models.gap.search.candidate import Candidate, SearchResult

PAIR = ("dead_time", "position_gain_change")


def candidate(effects, gain):
    return Candidate(effects, SimpleNamespace(cost=-gain, values=None), gain, 5.0, 5.0)


def told(named):
    """Inclusions where a pair was chosen and these effects are named in the end."""
    single, pair = candidate(PAIR[1:], 20.0), candidate(PAIR, 28.0)
    point = SimpleNamespace(cost=0.0, values=None)
    result = SearchResult(
        point, point, named=list(named), rounds=[[single, pair]], chosen=[pair],
        screened=dict.fromkeys(PAIR, 1.0),
    )  # fmt: skip
    (only,) = inclusions_of(result)
    return only


@pytest.mark.parametrize("named", [PAIR, PAIR[::-1]])
def test_a_pair_whose_effects_are_both_named_is_told_as_a_pair(named):
    assert (told(named).effects, told(named).kept) == (PAIR, True)
    assert told(named).separation == pytest.approx(56**0.5)


def test_a_pair_of_which_one_was_taken_out_is_told_as_the_other_one():
    """The effect that stays is named, with its own d′, and is no look-alike of itself."""
    only = told(PAIR[1:])
    assert (only.effects, only.kept) == (PAIR[1:], True)
    assert only.separation == pytest.approx(40**0.5)
    assert all(alike.effects != PAIR[1:] for alike in only.look_alikes)


def test_a_pair_of_which_nothing_is_named_is_told_and_not_kept():
    assert (told(()).effects, told(()).kept) == (PAIR, False)
