"""The probe's inner loop, called in this process: its rows are consistent on any machine."""

import ctypes
import os
import time

import numpy as np
import pytest

from firmware_py.core.errors import InputError
from hil.sil import probe
from models.shared.c_compiler import compile_library

PERIOD_NS = 200_000


@pytest.fixture(scope="module")
def watch(tmp_path_factory):
    """Fill some rows: `watch(state, count, accounts)`, which nobody stops, or somebody at once."""
    path = compile_library([probe._SOURCE], tmp_path_factory.mktemp("probe") / "probe.so")
    function = ctypes.CDLL(str(path)).watch
    function.restype = ctypes.c_int64

    def call(state, count, accounts=(), stopped=False):
        rows = np.full((count, 3), -1, np.int64)
        reading, writing = os.pipe()
        if stopped:
            os.write(writing, b"x")
        filled = function(
            reading, ctypes.c_int64(PERIOD_NS), (ctypes.c_int * len(accounts))(*accounts),
            len(accounts), state, ctypes.c_void_p(rows.ctypes.data), ctypes.c_int64(count),
        )  # fmt: skip
        os.close(reading)
        os.close(writing)
        return rows[:filled]

    return call


def test_wake_ups_lie_on_one_grid_behind_their_deadlines_over_several_calls(watch):
    state, start_ns = (ctypes.c_int64 * 2)(), time.monotonic_ns()
    wake, lateness, ours = np.concatenate([watch(state, 20) for _ in range(3)]).T
    assert len(wake) == 60
    assert start_ns < wake[0] and wake[-1] < time.monotonic_ns()
    assert (np.diff(wake) > 0).all()
    assert (lateness >= 0).all()
    assert not (np.diff(wake - lateness) % PERIOD_NS).any()
    assert (ours > 0).all() and ours.sum() < wake[-1] - start_ns


def test_it_stops_before_the_next_wake_up(watch):
    assert len(watch((ctypes.c_int64 * 2)(), 20, stopped=True)) == 0


def test_the_time_of_neighbours_counts_as_ours(watch):
    """The neighbour is this very thread, so its time is counted twice, but for the start."""
    account = os.open("/proc/self/schedstat", os.O_RDONLY)
    before_ns = time.thread_time_ns()
    ours = watch((ctypes.c_int64 * 2)(), 50, (account,))[:, 2].sum()
    spent_ns = time.thread_time_ns() - before_ns
    os.close(account)
    assert 0 < ours <= 2 * spent_ns + 20_000_000  # schedstat is brought up to date by the tick


def test_a_neighbour_that_has_ended_does_no_harm(watch):
    reading, writing = os.pipe()  # which cannot be read at an offset
    rows = watch((ctypes.c_int64 * 2)(), 5, (reading,))
    os.close(reading)
    os.close(writing)
    assert len(rows) == 5 and (rows[:, 2] > 0).all()


def test_a_probe_that_cannot_start_is_reported_in_one_sentence():
    no_process = 2**22 + 1  # above the kernel's largest
    with pytest.raises(InputError, match="probe on processor 0: did not start"):
        probe.Probe(0, (no_process,))
