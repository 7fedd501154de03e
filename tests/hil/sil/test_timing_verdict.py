"""Verdicts on synthetic runs: each missed deadline attributed to host or loop."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_py.bus.servo_bus import BusStatus
from firmware_py.core.signals import tick_dtype
from firmware_py.safety.states import Fault, SafetyState
from firmware_py.system.percentiles import Percentiles
from firmware_py.system.timing import Cause
from hil.emulator.emulator import Releases
from hil.sil import timing_verdict
from hil.sil.cpu_accounts import PROBE_PERIOD_NS, ProbeRecord

MS = 1_000_000
PERIOD_NS = 17 * MS
START_NS = 10**12


def run_of(ticks: int = 1000) -> np.ndarray:
    """A calm run: every tick takes 1.5 ms, 1.2 of them bus wait, and wakes 30 µs late."""
    records = np.zeros(ticks, tick_dtype(1))
    records["tick"] = np.arange(ticks)
    records["deadline_ns"] = START_NS + records["tick"] * PERIOD_NS
    records["lateness_ns"], records["preempted_ns"] = 30_000, 8_000
    records["busy_ns"], records["bus_wait_ns"] = 1_500_000, 1_200_000
    return records


def slow_down(records, tick: int, busy_ns: int, *, lateness_ns=30_000, wait_ns=1_200_000):
    """Let one tick take longer; the loop skips the slots that began meanwhile."""
    records["busy_ns"][tick], records["bus_wait_ns"][tick] = busy_ns, wait_ns
    records["lateness_ns"][tick] = lateness_ns
    late = busy_ns + lateness_ns - PERIOD_NS
    skipped = -(-late // PERIOD_NS) if late > 0 else 0
    records["missed"][tick + 1] = skipped
    records["tick"][tick + 1 :] += skipped
    records["deadline_ns"][tick + 1 :] += skipped * PERIOD_NS


def probe_over(records, *stalls: tuple[int, int], own_ns: int = 20_000) -> ProbeRecord:
    """A probe that was on time but for stalls (start, length) of its processor."""
    first, last = int(records["deadline_ns"][0]) - PERIOD_NS, int(records["deadline_ns"][-1])
    due = np.arange(first, last + PERIOD_NS, PROBE_PERIOD_NS)
    wake = due + 25_000
    for start_ns, length_ns in stalls:
        inside = (wake >= start_ns) & (wake < start_ns + length_ns)
        wake[inside] = start_ns + length_ns
    keep = np.append(True, np.diff(wake) > 0)  # what was due first says how late it was
    return ProbeRecord(wake[keep], (wake - due)[keep], np.full(keep.sum(), own_ns))


def judge(records, *watches, **more):
    return timing_verdict.judge_timing(records, 0.017, *watches, **more)


def test_a_calm_run_passes():
    records = run_of()
    timing = judge(records, probe_over(records), probe_over(records))
    assert (timing.verdict, timing.verdict.exit_code) == ("pass", 0)
    assert timing.misses == timing.host.preempted_ticks == 0
    assert timing.own_cost.p99_ns == 300_000
    assert timing.slots == timing.ticks == 1000
    assert timing.own_miss_rate_upper_bound_95 == pytest.approx(1.0 - 0.05 ** (1 / 1000))


def test_computing_too_long_is_our_own_doing():
    records = run_of()
    slow_down(records, 500, 40 * MS)
    timing = judge(records, probe_over(records), probe_over(records))
    assert (timing.verdict, timing.verdict.exit_code) == ("fail", 1)
    assert timing.causes == {Cause.OWN_COMPUTE: 2, Cause.BUS_WAIT: 0, Cause.PREEMPTED: 0}
    assert timing.longest_run_of_misses == 2
    assert timing.slots == 1002


def test_waiting_too_long_for_the_bus_is_the_loops():
    records = run_of()
    slow_down(records, 500, 18 * MS, wait_ns=17 * MS)
    timing = judge(records, probe_over(records), probe_over(records))
    assert timing.verdict == "fail"
    assert timing.causes[Cause.BUS_WAIT] == 1


def test_a_stall_that_the_probe_saw_too_is_the_hosts():
    records = run_of()
    slow_down(records, 500, 22 * MS)
    stall = (int(records["deadline_ns"][500]) + 30_000, 20 * MS)
    timing = judge(records, probe_over(records, stall), probe_over(records))
    assert (timing.verdict, timing.misses, timing.own_misses) == ("inconclusive", 1, 0)
    assert timing.causes[Cause.PREEMPTED] == 1


def test_two_stalls_in_one_tick_excuse_it_together():
    records = run_of()
    slow_down(records, 500, 72 * MS)
    begin_ns = int(records["deadline_ns"][500]) + 30_000
    stalls = (begin_ns, 21 * MS), (begin_ns + 24 * MS, 44 * MS)
    one = judge(records, probe_over(records, stalls[1]), probe_over(records))
    both = judge(records, probe_over(records, *stalls), probe_over(records))
    assert (one.verdict, both.verdict) == ("fail", "inconclusive")
    assert 65 * MS - 2 * PROBE_PERIOD_NS <= both.host.max_ns <= 65 * MS


def test_a_stall_that_may_have_fallen_outside_the_tick_excuses_it_and_does_not_count():
    records = run_of()
    slow_down(records, 500, 17_500_000)
    # Due shortly before the end of the tick and late by 2 ms: hardly any of it is certain.
    end_ns = int(records["deadline_ns"][500]) + 17_530_000
    due_ns = end_ns - 300_000 + np.array([-1, 0, 1]) * PROBE_PERIOD_NS
    lateness_ns = np.array([0, 2 * MS, 0])
    watch = ProbeRecord(due_ns + lateness_ns, lateness_ns, np.zeros(3, np.int64))
    timing = judge(records, watch, probe_over(records))
    assert (timing.misses, timing.own_misses) == (1, 0)
    assert timing.host.max_ns == 300_000
    assert timing.host.preempted_ticks == 0


def test_a_stall_that_does_not_suffice_as_an_excuse_is_none():
    records = run_of()
    slow_down(records, 500, 40 * MS)
    stall = (int(records["deadline_ns"][500]) + 30_000, 10 * MS)
    timing = judge(records, probe_over(records, stall), probe_over(records))
    assert timing.verdict == "fail"


def test_a_probe_without_its_priority_proves_nothing():
    records = run_of()
    slow_down(records, 500, 22 * MS)
    stall = (int(records["deadline_ns"][500]) + 30_000, 20 * MS)
    watch = replace(probe_over(records, stall), privileged=False)
    assert judge(records, watch, probe_over(records)).verdict == "fail"


def test_a_stall_at_another_time_is_no_excuse():
    records = run_of()
    slow_down(records, 500, 22 * MS)
    stall = (int(records["deadline_ns"][400]), 20 * MS)
    assert judge(records, probe_over(records, stall), probe_over(records)).verdict == "fail"


def test_waiting_in_the_run_queue_behind_a_stranger_is_the_hosts():
    records = run_of()
    slow_down(records, 500, 1_500_000, lateness_ns=20 * MS)
    records["preempted_ns"][500] = 20 * MS
    timing = judge(records, probe_over(records), probe_over(records))
    assert (timing.verdict, timing.causes[Cause.PREEMPTED]) == ("inconclusive", 1)


def test_waiting_in_the_run_queue_behind_ourselves_is_ours():
    records = run_of()
    slow_down(records, 500, 1_500_000, lateness_ns=20 * MS)
    records["preempted_ns"][500] = 20 * MS
    watch = probe_over(records)
    inside = np.searchsorted(watch.wake_ns, records["deadline_ns"][500] + 20 * MS)
    watch.own_ns[inside] = 20 * MS
    assert judge(records, watch, probe_over(records)).verdict == "fail"


def test_lateness_that_nothing_explains_is_ours():
    records = run_of()
    slow_down(records, 500, 1_500_000, lateness_ns=20 * MS)
    assert judge(records, probe_over(records), probe_over(records)).verdict == "fail"


def test_a_reply_that_the_host_held_up_is_the_hosts_and_one_that_we_held_up_is_ours():
    def with_wait():
        records = run_of()
        slow_down(records, 500, 18 * MS, wait_ns=17 * MS)
        return records, int(records["deadline_ns"][500])

    records, start = with_wait()
    due = records["deadline_ns"] + MS
    written, queued = due + 50_000, np.full(len(due), 5000)
    written[500], queued[500] = start + 17 * MS, 16 * MS
    releases = Releases(due, written, queued)
    quiet = probe_over(records, own_ns=0)
    assert judge(records, quiet, quiet, releases=releases).verdict == "inconclusive"
    queued[500] = 5000  # the emulator was running all the time: slow by itself
    assert judge(records, quiet, quiet, releases=releases).verdict == "fail"


def test_deadlines_that_were_met_beside_a_busy_host_pass():
    records = run_of(1000)
    records["preempted_ns"][100:400] = 2 * MS
    timing = judge(records, probe_over(records), probe_over(records))
    assert (timing.verdict, timing.host.preempted_ticks) == ("pass", 300)


@pytest.mark.parametrize(("miss_rate", "slots"), [(1e-3, 2995), (1e-2, 299), (1.0, 1)])
def test_the_slots_that_bound_a_miss_rate(miss_rate, slots):
    """1 − 0.05^(1/n) is the bound of n slots without a miss."""
    assert timing_verdict.slots_needed(miss_rate) == slots
    assert 1 - 0.05 ** (1 / slots) <= miss_rate


@pytest.mark.parametrize(
    ("ticks", "missed", "miss_rate", "verdict", "code"),
    [
        (2994, 0, 1e-3, "inconclusive", 3),  # 3/n is not below the rate
        (2995, 0, 1e-3, "pass", 0),
        (300, 0, 1e-2, "pass", 0),
        (4000, 1, 1e-3, "inconclusive", 3),
        (5000, 1, 1e-3, "pass", 0),
    ],
)
def test_a_run_has_to_be_long_enough_for_its_miss_rate(ticks, missed, miss_rate, verdict, code):
    records = run_of(ticks)
    if missed:
        slow_down(records, 100, 22 * MS)
        records["steal_ns"][100] = 20 * MS
    timing = judge(records, probe_over(records), miss_rate=miss_rate)
    assert (timing.misses, timing.own_misses) == (missed, 0)
    assert (timing.verdict, timing.verdict.exit_code) == (verdict, code)


def test_a_miss_of_ours_is_not_excused_by_a_restless_host():
    records = run_of()
    records["preempted_ns"][100:200] = 2 * MS
    slow_down(records, 500, 40 * MS)
    assert judge(records, probe_over(records), probe_over(records)).verdict == "fail"


def test_a_processor_that_stood_still_while_the_tick_computed_is_the_hosts():
    records = run_of()
    slow_down(records, 500, 22 * MS)
    assert judge(records, probe_over(records)).verdict == "fail"
    records["steal_ns"][500] = 20 * MS
    timing = judge(records, probe_over(records))
    assert timing.verdict == "inconclusive", "in stalls too short for a probe"


@given(st.lists(st.tuples(st.integers(0, 98), st.integers(MS, 60 * MS)), max_size=10))
def test_every_lost_slot_is_counted_once_and_has_one_cause(slow):
    records = run_of(100)
    for tick, busy_ns in dict(slow).items():
        slow_down(records, tick, busy_ns)
    timing = judge(records)
    assert timing.misses == records["missed"].sum() == sum(timing.causes.values())
    assert timing.slots == records["tick"][-1] + 1
    assert timing.misses == sum(m.slots for m in timing.missed)


@given(st.lists(st.integers(0, 10**9), min_size=1, max_size=200))
def test_percentiles_are_values_that_at_least_that_fraction_does_not_exceed(values):
    summary = Percentiles.of(np.array(values))
    for fraction, name in ((0.5, "p50_ns"), (0.99, "p99_ns"), (0.999, "p99_9_ns"), (1.0, "max_ns")):
        assert getattr(summary, name) in values
        assert np.mean(np.array(values) <= getattr(summary, name)) >= fraction - 1e-12


def test_a_robot_that_was_stopped_has_not_passed():
    records = run_of()
    timing = judge(
        records,
        probe_over(records),
        probe_over(records),
        stopped="no fresh data",
        faults={Fault.DATA},
    )
    assert (timing.verdict, timing.verdict.exit_code) == ("fail", 1)
    assert "no fresh data" in timing.reason


def test_a_run_that_a_signal_ended_early_has_not_passed():
    records = run_of()
    why = "SIGINT ended the run after 900 of 2000 slots"
    timing = judge(records, interrupted=why)
    assert (timing.verdict, timing.verdict.exit_code) == ("inconclusive", 3)
    assert why in timing.reason
    assert timing.interrupted == why
    slow_down(records, 500, 40 * MS)
    assert judge(records, interrupted=why).verdict == "fail", "what was missed was missed"


@pytest.mark.parametrize(("stalled", "verdict"), [(False, "fail"), (True, "inconclusive")])
def test_a_stop_proves_nothing_where_the_host_took_the_slots(stalled, verdict):
    records = run_of()
    slow_down(records, 500, 72 * MS)
    records["state"] = SafetyState.RUNNING
    records["state"][501:] = SafetyState.STOPPING
    stalls = [(int(records["deadline_ns"][500]) + 30_000, 70 * MS)] if stalled else []
    watch = probe_over(records, *stalls)
    why = {"stopped": "4 slots missed in a row", "faults": {Fault.SLOTS}}
    timing = judge(records, watch, probe_over(records), **why)
    assert timing.verdict == verdict
    why = {"stopped": "a limit; then 4 slots missed", "faults": {Fault.MEASUREMENT, Fault.SLOTS}}
    assert judge(records, watch, probe_over(records), **why).verdict == "fail"


@pytest.mark.parametrize("stopping_from", [502, 480])  # stopped by it, or while it stopped
@pytest.mark.parametrize(
    ("stalls_ns", "verdict"),
    [
        ((7 * MS, 7 * MS, 7 * MS), "inconclusive"),
        ((7 * MS, 0, 7 * MS), "fail"),  # one reply was lost while the host left us alone
        ((7 * MS, 2 * MS, 7 * MS), "fail"),
        ((0, 0, 0), "fail"),
    ],
)
def test_a_stop_for_want_of_data_proves_nothing_where_the_host_held_up_every_reply(
    stalls_ns, verdict, stopping_from
):
    records = run_of()
    records["stale_ticks"][500:503] = 1, 2, 3
    records["busy_ns"][500:503], records["bus_wait_ns"][500:503] = 8_300_000, 8 * MS
    records["state"] = SafetyState.RUNNING
    records["bus_status"][500:503] = BusStatus.TIMEOUT
    records["state"][stopping_from:] = SafetyState.STOPPING
    stalls = [
        (int(records["deadline_ns"][500 + k]) + 300_000, stall_ns)
        for k, stall_ns in enumerate(stalls_ns)
        if stall_ns
    ]
    line = probe_over(records, *stalls)
    why = {"stopped": "no fresh data for 3 ticks", "faults": {Fault.DATA}}
    timing = judge(records, probe_over(records), line, **why)
    assert (timing.verdict, timing.own_misses) == (verdict, 0)
    records["bus_status"][501] = BusStatus.PORT_GONE  # no wait for the host to lengthen
    records["bus_wait_ns"][501] = 0
    assert judge(records, probe_over(records), line, **why).verdict == "fail"


@pytest.mark.parametrize(
    ("slow_ns", "preempted", "why"),
    [
        (0, 0, {}),
        (40 * MS, 0, {}),
        (0, 50, {}),
        (0, 0, {"stopped": "why"}),
        (0, 0, {"interrupted": "why"}),
    ],
)
def test_junit_says_the_same(slow_ns, preempted, why):
    records = run_of()
    records["preempted_ns"][100 : 100 + preempted] = 2 * MS
    if slow_ns:
        slow_down(records, 500, slow_ns)
    timing = judge(records, **why)
    suite = ET.fromstring(timing_verdict.timing_junit(timing, {"line": "socket"}))
    assert len(suite.findall("testcase")) == int(suite.get("tests"))
    assert len(suite.findall("testcase/failure")) == (timing.verdict == "fail")
    assert len(suite.findall("testcase/skipped")) == (timing.verdict == "inconclusive")
    assert len(suite.findall("testcase/failure")) == int(suite.get("failures"))
    assert suite.find("properties/property[@name='line']").get("value") == "socket"
