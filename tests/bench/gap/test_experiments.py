"""Figures of the benchmark of designed motions."""

import pytest

from bench.gap.experiments import PairResult, separation_figures, summary


def pair(before, designed, fixed):
    gains = [(d**2 - before**2) ** 0.5 for d in (designed, fixed)]
    return PairResult("a / b", 0.1, before, designed, fixed, *gains, "steps, 1 kg", None)


def test_only_look_alikes_that_some_motion_separates_count():
    known = separation_figures(
        [pair(0.0, 4.0, 2.0), pair(0.0, 2.0, 4.0), pair(0.0, 1.0, 2.0), pair(5, 9, 9)]
    )
    assert (known["pairs"], known["look_alikes"], known["separable"]) == (4, 3, 2)
    assert known["designed_fraction"] == 0.5
    assert known["least_gain"] == pytest.approx(2.0)
    assert known["least_ratio"] == pytest.approx(0.5)
    assert known["median_ratio"] == pytest.approx(1.25)


def test_without_a_separable_pair_there_is_no_ratio():
    results = [pair(0.0, 1.0, 2.0)]
    assert "least_ratio" not in separation_figures(results)
    assert "`a / b`" in summary(results)
