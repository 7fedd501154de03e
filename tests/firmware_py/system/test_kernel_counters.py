"""Counters of the kernel for the thread that computes."""

from __future__ import annotations

import contextlib
import threading
import time

from firmware_py.system.kernel_counters import KernelCounters


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


def test_a_thread_that_slept_was_not_robbed_of_its_processor():
    with contextlib.closing(KernelCounters()) as counters:
        other = threading.Thread(target=sum, args=(range(1_000_000),))
        counters.start_computing()
        other.start()
        other.join()
        assert counters.delays_ns()[1] == 0
