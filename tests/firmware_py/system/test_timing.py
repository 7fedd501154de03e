"""Timing: percentiles, causes of misses, the bound on their rate; clocks, counters, `bench`."""

import contextlib
import ctypes
import gc
import json
import math
import os
import threading
import time
from unittest.mock import Mock

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import beta, binomtest

from firmware_py.system.clock import RealTimeOptions, real_time
from firmware_py.system.kernel_counters import KernelCounters
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


def test_durations_outside_the_buckets_count_and_no_durations_are_zero():
    zeros = Percentiles(n=0, p50_ns=0, p99_ns=0, p99_9_ns=0, max_ns=0)
    histogram = Histogram()
    assert histogram.summary() == Percentiles.of(np.zeros(0, np.int64)) == zeros
    histogram.add(-5)
    histogram.add(2**60)
    assert histogram.count == sum(histogram.counts) == 2
    assert histogram.max_ns == 2**60


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


@pytest.mark.parametrize("misses", [0, 999_999])
def test_the_bound_of_long_runs_is_a_quantile_of_the_beta_distribution(misses):
    exact = beta.ppf(0.95, misses + 1, 1_000_000 - misses)
    assert miss_rate_bound(misses, 1_000_000) == pytest.approx(exact, rel=1e-8)
    assert miss_rate_bound(0, 0) == miss_rate_bound(1000, 1000) == 1.0


# --- clocks, and a thread that is made real-time and restored -----------------------------------


def timer_slack_ns():
    return ctypes.CDLL(None).prctl(30, 0, 0, 0, 0)  # PR_GET_TIMERSLACK


@pytest.mark.parametrize("collecting", [True, False])
def test_a_thread_is_restored_as_it_was(collecting):
    before = os.sched_getscheduler(0), os.sched_getaffinity(0), timer_slack_ns()
    cpu = min(before[1])
    (gc.enable if collecting else gc.disable)()
    try:
        with real_time(RealTimeOptions(priority=1, lock_memory=False, cpu=cpu)) as refused:
            assert not gc.isenabled()
            assert os.sched_getaffinity(0) == {cpu}
            fifo = os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO
            assert fifo is not any("SCHED_FIFO" in sentence for sentence in refused)
        assert gc.isenabled() is collecting
        assert (os.sched_getscheduler(0), os.sched_getaffinity(0), timer_slack_ns()) == before
    finally:
        gc.enable()


def test_a_processor_that_is_gone_at_the_end_leaves_the_rest_restored(monkeypatch):
    slack_ns = timer_slack_ns()
    try:
        with real_time(RealTimeOptions(priority=0, lock_memory=False)):
            monkeypatch.setattr(os, "sched_setaffinity", Mock(side_effect=OSError))
        assert gc.isenabled() and timer_slack_ns() == slack_ns
    finally:
        gc.enable()


def test_each_refusal_of_the_system_is_named(monkeypatch):
    def refuse(*_):
        raise PermissionError

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    monkeypatch.setattr("firmware_py.system.clock._has_capability", lambda _: False)
    monkeypatch.setattr("resource.getrlimit", lambda _: (65536, 65536))
    with real_time(RealTimeOptions(cpu=10_000)) as refused:
        assert [s.split()[0] for s in refused] == ["memory", "processor", "SCHED_FIFO"]


# --- counters of the kernel for the thread that computes ----------------------------------------


def test_the_kernel_counts_for_this_thread():
    with contextlib.closing(KernelCounters()) as counters:
        before_ns = counters.run_delay_ns()
        counters.start_computing()
        start_ns, ran_ns = time.monotonic_ns(), time.thread_time_ns()
        assert sum(k * k for k in range(100_000)) > 0
        ran_ns = time.thread_time_ns() - ran_ns
        delayed_ns, stolen_ns = counters.delays_ns()
        assert 0 <= stolen_ns <= time.monotonic_ns() - start_ns - ran_ns + 100_000
        assert before_ns <= delayed_ns <= counters.run_delay_ns()


def test_time_asleep_is_not_counted_as_stolen():
    with contextlib.closing(KernelCounters()) as counters:
        other = threading.Thread(target=sum, args=(range(1_000_000),))
        counters.start_computing()
        other.start()
        other.join()
        assert counters.delays_ns()[1] == 0


# --- the command `dropstitch bench` -------------------------------------------------------------


def test_bench_measures_every_stage_and_judges_its_own_cost(toy_bundle, call):
    code, output = call("bench", "--bundle", toy_bundle, "--seconds", "0.2", "--json")
    result = json.loads(output.out)
    assert code == (0 if result["good"] else 1)
    stages = result["timing"]["stages"]
    assert result["good"] is (stages["own"]["p99_ns"] <= result["limit_own_p99_ns"])
    assert {stage["n"] for stage in stages.values()} == {result["ticks"]}


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (["--seconds", "-5"], "--seconds: is -5 s; give"),
        (["--seconds", "nan"], "--seconds: is nan s; give"),
        (["--dof", "2"], "has 1; leave --dof out"),
    ],
)
def test_bench_refuses_what_it_would_not_measure(toy_bundle, call, options, sentence):
    code, output = call("bench", "--bundle", toy_bundle, *options)
    assert (code, sentence in output.err) == (2, True), output.err
