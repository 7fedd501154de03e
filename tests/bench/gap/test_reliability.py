"""Reliability of probabilities: bins by hand, their table and the diagram."""

from itertools import pairwise

import pytest

from bench.gap.scores.fraction_interval import clopper_pearson
from bench.gap.scores.reliability import (
    EDGES,
    largest_deviation,
    reliability_bins,
    reliability_svg,
    reliability_table,
)

SAID = [
    (0.001, True), (0.049, False), (0.05, False), (0.1, False), (0.15, True), (0.2, False),
    (0.5, True), (0.5, False), (0.9, True), (0.97, True), (0.99, False), (1.0 + 1e-12, True),
]  # fmt: skip


def test_a_probability_counts_in_the_bin_that_it_begins_and_small_ones_in_none():
    bins = reliability_bins(SAID)
    assert [b["of"] for b in bins] == [3, 1, 2, 0, 0, 1, 3]
    assert [(b["from"], b["to"]) for b in bins] == list(pairwise(EDGES))
    first, last, empty = bins[0], bins[-1], bins[3]
    assert first["mean_probability"] == pytest.approx(0.1)
    assert first["fraction"] == pytest.approx(1 / 3)
    assert first["interval"] == list(clopper_pearson(1, 3))
    assert last["fraction"] == pytest.approx(2 / 3)
    assert empty == {"from": 0.6, "to": 0.8, "mean_probability": None, "of": 0}


def test_the_interval_is_that_of_clopper_and_pearson():
    """Values of the tables for 95 %; with none or all right it is the rule 1 - 0.025^(1/n)."""
    assert clopper_pearson(1, 3) == pytest.approx((0.0084, 0.9057), abs=1e-4)
    assert clopper_pearson(0, 10) == pytest.approx((0.0, 1 - 0.025**0.1))
    assert clopper_pearson(10, 10) == pytest.approx((0.025**0.1, 1.0))


def test_the_largest_deviation_is_over_bins_of_twenty_effects_or_more():
    right = [(0.95, k < 19) for k in range(20)]
    too_low = [(0.5, k < 12) for k in range(20)]
    few = [(0.99, False)] * 19
    assert largest_deviation(reliability_bins(right)) == pytest.approx(0.0)
    assert largest_deviation(reliability_bins(right + too_low + few)) == pytest.approx(0.1)
    assert largest_deviation(reliability_bins(few)) is None


def test_the_table_has_a_column_for_each_rig_and_none_where_nothing_was_said():
    table = reliability_table({"a": reliability_bins(SAID), "b": reliability_bins([])})
    assert "| 0.05 to 0.2 | 1 of 3 | – |" in table.splitlines()
    assert len(table.splitlines()) == 2 + len(EDGES) - 1
    assert reliability_table({"b": reliability_bins([])}) == ""


@pytest.mark.parametrize("purposes", [(), ("tuning",), ("test",), ("tuning", "test")])
def test_the_diagram_tells_rigs_for_tuning_from_those_for_tests(purposes):
    svg = reliability_svg({p: reliability_bins(SAID) for p in purposes})
    assert ("rigs for tuning" in svg) == ("tuning" in purposes)
    assert ("rigs for testing" in svg) == ("test" in purposes)
    assert "Clopper–Pearson" in svg and "fraction that was missing" in svg
    assert svg == reliability_svg({p: reliability_bins(SAID) for p in purposes})


def test_rigs_without_any_probability_are_not_in_the_diagram():
    svg = reliability_svg({"tuning": reliability_bins(SAID), "test": reliability_bins([])})
    assert "rigs for tuning" in svg and "rigs for testing" not in svg
    assert "rigs for" not in reliability_svg({"test": reliability_bins([])})
