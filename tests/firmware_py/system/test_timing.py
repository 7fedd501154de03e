"""Percentiles, histograms, causes of misses and the bound on their rate."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import beta, binomtest

from firmware_py.system.timing import (
    Cause,
    Histogram,
    Percentiles,
    Timing,
    cause_of_miss,
    miss_rate_bound,
)

durations = st.lists(st.integers(0, 2**40), min_size=1, max_size=200)


@given(durations, st.sampled_from([0.5, 0.99, 0.999, 1.0]))
def test_percentiles_of_a_histogram_are_exact_within_a_bucket(values, fraction):
    histogram = Histogram()
    for value in values:
        histogram.add(value)
    exact = sorted(values)[math.ceil(fraction * len(values)) - 1]
    assert exact <= histogram.percentile_ns(fraction) <= exact * (1 + 1 / 64)
    summary = histogram.summary()
    assert (summary.n, summary.max_ns) == (len(values), max(values))


def test_durations_outside_the_buckets_are_counted():
    histogram = Histogram()
    histogram.add(-5)
    histogram.add(2**60)
    assert histogram.count == sum(histogram.counts) == 2
    assert histogram.max_ns == 2**60


def test_the_percentiles_of_nothing_are_zero():
    zeros = Percentiles(n=0, p50_ns=0, p99_ns=0, p99_9_ns=0, max_ns=0)
    assert Histogram().summary() == Percentiles.of(np.zeros(0, np.int64)) == zeros


@given(durations)
def test_a_percentile_is_a_measured_value_that_this_fraction_does_not_exceed(values):
    summary = Percentiles.of(np.array(values))
    for fraction, name in ((0.5, "p50_ns"), (0.99, "p99_ns"), (0.999, "p99_9_ns"), (1.0, "max_ns")):
        assert getattr(summary, name) in values
        assert np.mean(np.array(values) <= getattr(summary, name)) >= fraction - 1e-12


@pytest.mark.parametrize(
    ("excess", "host", "busy", "wait", "cause"),
    [
        (3, 0, 20, 2, Cause.OWN_COMPUTE),
        (3, 2, 20, 2, Cause.OWN_COMPUTE),  # late without the host as well
        (3, 0, 20, 15, Cause.BUS_WAIT),
        (3, 3, 20, 15, Cause.PREEMPTED),
    ],
)
def test_a_miss_is_the_hosts_if_the_tick_had_ended_in_time_without_it(
    excess, host, busy, wait, cause
):
    ms = 1_000_000
    assert cause_of_miss(excess * ms, host * ms, busy * ms, wait * ms) is cause


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


@pytest.mark.parametrize("misses", [0, 40, 999_999])
def test_the_bound_of_long_runs_is_a_quantile_of_the_beta_distribution(misses):
    exact = beta.ppf(0.95, misses + 1, 1_000_000 - misses)
    assert miss_rate_bound(misses, 1_000_000) == pytest.approx(exact, rel=1e-8)


def test_the_bound_is_one_without_slots_or_with_all_of_them_missed():
    assert miss_rate_bound(0, 0) == miss_rate_bound(1000, 1000) == 1.0
