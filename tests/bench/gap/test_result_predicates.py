"""Predicates of one result: what was named beside what was hidden."""

import pytest

from bench.gap.scores.result_predicates import is_class_right, is_pair_in_class


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


@pytest.mark.parametrize(
    ("named", "chosen", "look_alikes", "right"),
    [
        (["creep"], [["creep"]], [[]], True),
        (["prebend"], [["prebend"]], [[["creep"]]], True),
        (["creep"], [["joint_elasticity"], ["creep"]], [[], []], True),
        (["prebend"], [["creep"], ["prebend"]], [[], []], False),
        (["prebend"], [["backlash"], ["prebend"]], [[["creep"]], []], False),
        (["prebend", "creep"], [["prebend"], ["creep"]], [[], []], False),
        (["prebend", "creep"], [["prebend", "creep"]], [[]], True),
        ([], [["creep"]], [[]], False),
    ],
)
def test_class_is_that_of_the_first_name_that_stands(named, chosen, look_alikes, right):
    result = {"case": {"hidden": {"creep": 0.3}}, "named": named, "chosen": chosen}
    assert is_class_right(result | {"look_alikes": look_alikes}) is right
