"""Histograms, the kernel's counters and the causes of misses."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import beta, binomtest

from firmware_py.system.percentiles import Percentiles
from firmware_py.system.timing import (
    Cause,
    Histogram,
    Timing,
    cause_of_miss,
    miss_rate_bound,
)

durations = st.lists(st.integers(0, 2**40), min_size=1, max_size=200)


@given(durations, st.sampled_from([0.5, 0.9, 0.99, 0.999, 1.0]))
def test_percentiles_are_those_of_the_sorted_durations_within_a_bucket(values, share):
    histogram = Histogram()
    for value in values:
        histogram.add(value)
    exact = sorted(values)[math.ceil(share * len(values)) - 1]
    assert exact <= histogram.percentile_ns(share) <= exact * (1 + 1 / 64)


def test_maximum_and_count_are_exact():
    histogram = Histogram()
    for value in (3, 1_234_567_891, 17):
        histogram.add(value)
    assert histogram.summary().n == 3
    assert histogram.summary().max_ns == histogram.percentile_ns(1.0) == 1_234_567_891


def test_what_no_bucket_holds_is_counted_all_the_same():
    histogram = Histogram()
    histogram.add(-5)
    histogram.add(2**60)
    assert histogram.count == sum(histogram.counts) == 2
    assert histogram.max_ns == 2**60


def test_nothing_measured_is_zero():
    assert Histogram().summary() == Percentiles(n=0, p50_ns=0, p99_ns=0, p99_9_ns=0, max_ns=0)


@pytest.mark.parametrize(
    ("busy", "bus", "late", "preempted", "steal", "cause"),
    [
        (20, 2, 0, 0, 0, Cause.OWN_COMPUTE),
        (20, 15, 0, 0, 0, Cause.BUS_WAIT),
        (20, 2, 0, 15, 0, Cause.PREEMPTED),
        (20, 2, 0, 0, 30, Cause.PREEMPTED),
        (2, 1, 18, 18, 0, Cause.PREEMPTED),
        (2, 1, 18, 0, 0, Cause.PREEMPTED),
        (18, 2, 1, 1, 0, Cause.OWN_COMPUTE),
    ],
)
def test_the_cause_of_a_miss_is_what_took_most(busy, bus, late, preempted, steal, cause):
    ms = 1_000_000
    assert cause_of_miss(busy * ms, bus * ms, late * ms, preempted * ms, steal * ms) is cause


def test_misses_are_counted_by_slot_and_cause():
    timing = Timing()
    timing.add(range(8), 1, 28, 5)
    timing.miss(3, Cause.BUS_WAIT)
    timing.miss(1, Cause.PREEMPTED)
    summary = timing.summary()
    assert (summary.misses, summary.longest_run_of_misses) == (4, 3)
    assert summary.causes == {"own compute": 0, "bus wait": 3, "preempted by the host": 1}
    assert summary.stages["own"].max_ns == 23


@given(st.integers(1, 5000), st.data())
def test_the_bound_is_clopper_and_pearsons(slots, data):
    misses = data.draw(st.integers(0, slots))
    exact = binomtest(misses, slots, alternative="less").proportion_ci(0.95, method="exact").high
    assert miss_rate_bound(misses, slots) == pytest.approx(exact, rel=1e-9)


@pytest.mark.parametrize("misses", [0, 1, 40, 3_000, 500_000, 999_999])
def test_the_bound_is_a_quantile_of_the_beta_distribution_in_long_runs_too(misses):
    exact = beta.ppf(0.95, misses + 1, 1_000_000 - misses)
    assert miss_rate_bound(misses, 1_000_000) == pytest.approx(exact, rel=1e-8)


def test_without_a_miss_the_bound_is_the_rule_of_three():
    assert 0.998 * 3e-5 < miss_rate_bound(0, 100_000) < 3e-5
    assert miss_rate_bound(0, 0) == 1.0


def test_the_bound_on_the_miss_rate_rises_with_the_misses():
    bounds = [miss_rate_bound(k, 1000) for k in range(0, 1001, 50)]
    assert np.all(np.diff(bounds) > 0)
    assert bounds[-1] == 1.0
