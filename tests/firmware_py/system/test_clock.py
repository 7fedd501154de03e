"""Clocks, and a thread that is made real-time and restored."""

import gc
import os

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_py.system.clock import RealTimeOptions, SimClock, real_time


@given(st.lists(st.tuples(st.booleans(), st.integers(0, 10**12)), max_size=30))
def test_simulated_time_moves_only_when_told_and_never_back(moves):
    clock, before = SimClock(), 0
    for waits, value in moves:
        clock.sleep_until(value) if waits else clock.advance(value)
        expected = max(before, value) if waits else before + value
        assert clock.now_ns() == expected
        before = expected


@pytest.mark.parametrize("collecting", [True, False])
def test_a_thread_is_given_back_as_it_was(collecting):
    before = os.sched_getscheduler(0), os.sched_getaffinity(0)
    cpu = min(before[1])
    (gc.enable if collecting else gc.disable)()
    try:
        with real_time(RealTimeOptions(priority=1, lock_memory=False, cpu=cpu)) as refused:
            assert not gc.isenabled()
            assert os.sched_getaffinity(0) == {cpu}
            fifo = os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO
            assert fifo is not any("SCHED_FIFO" in sentence for sentence in refused)
        assert gc.isenabled() is collecting
        assert (os.sched_getscheduler(0), os.sched_getaffinity(0)) == before
    finally:
        gc.enable()


def test_what_is_refused_is_said(monkeypatch):
    def refuse(*_):
        raise PermissionError

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    monkeypatch.setattr("firmware_py.system.clock._has_capability", lambda _: False)
    monkeypatch.setattr("resource.getrlimit", lambda _: (65536, 65536))
    with real_time(RealTimeOptions(cpu=10_000)) as refused:
        assert [s.split()[0] for s in refused] == ["memory", "processor", "SCHED_FIFO"]
