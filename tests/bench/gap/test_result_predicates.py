"""Predicates of one result: a pair counts as right where each effect has a name of its own."""

import pytest

from bench.gap.scores.result_predicates import is_pair_in_class


@pytest.mark.parametrize(
    ("chosen", "look_alikes", "right"),
    [
        ([["prebend"], ["creep"]], [[], []], True),
        ([["encoder_offset"], ["creep"]], [[["prebend"]], []], True),
        ([["encoder_offset"], ["backlash"]], [[["prebend"], ["creep"]], []], False),
        ([["prebend", "creep"]], [[]], True),
        ([["prebend"]], [[["creep"]]], False),
        ([], [], False),
    ],
)
def test_each_of_a_pair_needs_a_name_of_its_own(chosen, look_alikes, right):
    named = [e for turn in chosen for e in turn]
    hidden = {"prebend": 0.02, "creep": 0.3}
    result = {"case": {"hidden": hidden}, "named": named, "chosen": chosen}
    assert is_pair_in_class(result | {"look_alikes": look_alikes}) is right
