"""Verdicts on synthetic runs: missed deadlines attributed to host or loop; parts of a tick."""

import xml.etree.ElementTree as ET
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_py.bus.bus_plan import plans
from firmware_py.bus.servo_bus import BusStatus
from firmware_py.bus.servo_models import MODELS
from firmware_py.core.signals import STAGES, tick_dtype
from firmware_py.safety.states import Fault, SafetyState
from firmware_py.system.timing import Cause
from hil.emulator.emulator import Releases
from hil.sil import tick_budget
from hil.sil.probe import PROBE_PERIOD_NS, ProbeRecord
from hil.sil.timing_verdict import judge_timing, slots_needed, timing_junit
from hil.verdict import Verdict

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


def slow_run(busy_ns: int, **more) -> np.ndarray:
    """A run whose tick 500 takes longer."""
    records = run_of()
    slow_down(records, 500, busy_ns, **more)
    return records


def begin_ns(records, tick: int = 500) -> int:
    """Time at which a tick has just woken."""
    return int(records["deadline_ns"][tick]) + 30_000


def probe_over(records, *stalls: tuple[int, int], own_ns: int = 20_000) -> ProbeRecord:
    """A probe that was on time except for stalls (start, length) of its processor."""
    first, last = int(records["deadline_ns"][0]) - PERIOD_NS, int(records["deadline_ns"][-1])
    due = np.arange(first, last + PERIOD_NS, PROBE_PERIOD_NS)
    wake = due + 25_000
    for start_ns, length_ns in stalls:
        inside = (wake >= start_ns) & (wake < start_ns + length_ns)
        wake[inside] = start_ns + length_ns
    keep = np.append(True, np.diff(wake) > 0)  # the first one due has the whole lateness
    return ProbeRecord(wake[keep], (wake - due)[keep], np.full(keep.sum(), own_ns))


def judge(records, *stalls, **more):
    """Verdict with quiet probes on both processors, or stalls on the loop's."""
    return judge_timing(records, 0.017, probe_over(records, *stalls), probe_over(records), **more)


def test_a_calm_run_passes():
    timing = judge(run_of())
    assert (timing.verdict, timing.verdict.exit_code) == ("pass", 0)
    assert timing.misses == timing.host.preempted_ticks == 0
    assert timing.own_cost.p99_ns == 300_000
    assert timing.slots == timing.ticks == 1000
    assert timing.own_miss_rate_upper_bound_95 == pytest.approx(1.0 - 0.05 ** (1 / 1000))


@pytest.mark.parametrize(
    ("slow", "cause"),
    [
        ({"busy_ns": 40 * MS}, Cause.OWN_COMPUTE),
        ({"busy_ns": 18 * MS, "wait_ns": 17 * MS}, Cause.BUS_WAIT),
        ({"busy_ns": 2 * MS, "wait_ns": MS // 2, "lateness_ns": 20 * MS}, Cause.OWN_COMPUTE),
    ],
)
def test_a_miss_that_no_counter_explains_is_the_loops_also_beside_a_busy_host(slow, cause):
    records = slow_run(**slow)
    records["preempted_ns"][100:200] = 2 * MS
    timing = judge(records, (int(records["deadline_ns"][400]), 20 * MS))
    assert (timing.verdict, timing.verdict.exit_code) == ("fail", 1)
    assert timing.own_misses == timing.misses == timing.causes[cause]
    assert timing.longest_run_of_misses == timing.missed[0].slots


def test_a_stall_that_the_probe_measured_is_the_hosts_if_it_explains_the_excess():
    records = slow_run(22 * MS)
    stall = begin_ns(records), 20 * MS
    timing = judge(records, stall)
    assert (timing.verdict, timing.misses, timing.own_misses) == ("inconclusive", 1, 0)
    assert timing.causes[Cause.PREEMPTED] == 1
    unproven = replace(probe_over(records, stall), privileged=False)
    assert judge_timing(records, 0.017, unproven, probe_over(records)).verdict == "fail"
    longer = slow_run(40 * MS)
    assert judge(longer, (begin_ns(longer), 10 * MS)).verdict == "fail"


def test_two_stalls_in_one_tick_excuse_it_together():
    records = slow_run(72 * MS)
    first, second = (begin_ns(records), 21 * MS), (begin_ns(records) + 24 * MS, 44 * MS)
    one, both = judge(records, second), judge(records, first, second)
    assert (one.verdict, both.verdict) == ("fail", "inconclusive")
    assert 65 * MS - 2 * PROBE_PERIOD_NS <= both.host.max_ns <= 65 * MS


def test_a_stall_that_may_lie_outside_the_tick_excuses_it_and_does_not_count_as_preemption():
    records = slow_run(17_500_000)
    # Due shortly before the end of the tick and late by 2 ms: hardly any of it is certain.
    due_ns = begin_ns(records) + 17_200_000 + np.array([-1, 0, 1]) * PROBE_PERIOD_NS
    lateness_ns = np.array([0, 2 * MS, 0])
    probe = ProbeRecord(due_ns + lateness_ns, lateness_ns, np.zeros(3, np.int64))
    timing = judge_timing(records, 0.017, probe, probe_over(records))
    assert (timing.misses, timing.own_misses) == (1, 0)
    assert timing.host.max_ns == 300_000
    assert timing.host.preempted_ticks == 0


def test_a_wait_in_the_run_queue_is_the_hosts_unless_this_program_had_the_processor():
    records = slow_run(1_500_000, lateness_ns=20 * MS)
    records["preempted_ns"][500] = 20 * MS
    timing = judge(records)
    assert (timing.verdict, timing.causes[Cause.PREEMPTED]) == ("inconclusive", 1)
    probe = probe_over(records)
    inside = np.searchsorted(probe.wake_ns, records["deadline_ns"][500] + 20 * MS)
    probe.own_ns[inside] = 20 * MS
    assert judge_timing(records, 0.017, probe, probe_over(records)).verdict == "fail"


def test_steal_time_while_the_tick_computes_is_the_hosts():
    records = slow_run(22 * MS)
    records["steal_ns"][500] = 20 * MS
    assert judge(records).verdict == "inconclusive", "in stalls too short for a probe"


@pytest.mark.parametrize(("steal_ns", "ticks"), [(499_999, 0), (500_000, 1)])
def test_half_a_millisecond_of_host_time_makes_a_tick_preempted(steal_ns, ticks):
    records = run_of(100)
    records["preempted_ns"], records["steal_ns"][50] = 0, steal_ns
    quiet = probe_over(records, own_ns=0)
    assert judge_timing(records, 0.017, quiet, quiet).host.preempted_ticks == ticks


def test_a_wait_no_longer_than_usual_is_not_the_hosts_though_the_emulator_waited():
    records = run_of(100)
    due = records["deadline_ns"] + MS
    queued = np.full(len(due), 2 * MS)
    quiet = probe_over(records, own_ns=0)
    timing = judge_timing(records, 0.017, quiet, quiet, Releases(due, due, queued))
    assert timing.host.max_ns < 100_000


def test_a_late_reply_is_the_hosts_only_if_the_emulator_waited_in_the_run_queue():
    records = slow_run(18 * MS, wait_ns=17 * MS)
    start = int(records["deadline_ns"][500])
    due = records["deadline_ns"] + MS
    written, queued = due + 50_000, np.full(len(due), 5000)
    written[500], queued[500] = start + 17 * MS, 16 * MS
    releases, quiet = Releases(due, written, queued), probe_over(records, own_ns=0)
    assert judge_timing(records, 0.017, quiet, quiet, releases).verdict == "inconclusive"
    queued[500] = 5000  # the emulator was running all the time: slow by itself
    assert judge_timing(records, 0.017, quiet, quiet, releases).verdict == "fail"


def test_a_tick_that_ends_with_its_slot_misses_nothing():
    assert judge(slow_run(PERIOD_NS - 30_000)).misses == 0
    assert judge(slow_run(PERIOD_NS - 30_000 + 1)).misses == 1


def test_deadlines_that_were_met_beside_a_busy_host_pass():
    records = run_of()
    records["preempted_ns"][100:400] = 2 * MS
    timing = judge(records)
    assert (timing.verdict, timing.host.preempted_ticks) == ("pass", 300)


@pytest.mark.parametrize(("miss_rate", "slots"), [(1e-3, 2995), (1e-2, 299), (1.0, 1)])
def test_the_slots_that_bound_a_miss_rate(miss_rate, slots):
    """1 − 0.05^(1/n) is the bound of n slots without a miss."""
    assert slots_needed(miss_rate) == slots
    assert 1 - 0.05 ** (1 / slots) <= miss_rate


@pytest.mark.parametrize(
    ("ticks", "missed", "verdict", "code"),
    [
        (2994, 0, "inconclusive", 3),  # 3/n is not below the rate
        (2995, 0, "pass", 0),
        (4000, 1, "inconclusive", 3),
        (5000, 1, "pass", 0),
    ],
)
def test_a_run_has_to_be_long_enough_for_its_miss_rate(ticks, missed, verdict, code):
    records = run_of(ticks)
    if missed:
        slow_down(records, 100, 22 * MS)
        records["steal_ns"][100] = 20 * MS
    timing = judge(records, miss_rate=1e-3)
    assert (timing.misses, timing.own_misses) == (missed, 0)
    assert (timing.verdict, timing.verdict.exit_code) == (verdict, code)


@given(st.lists(st.tuples(st.integers(0, 98), st.integers(MS, 60 * MS)), max_size=10))
def test_every_lost_slot_is_counted_once_and_has_one_cause(slow):
    records = run_of(100)
    for tick, busy_ns in dict(slow).items():
        slow_down(records, tick, busy_ns)
    timing = judge_timing(records, 0.017)
    assert timing.misses == records["missed"].sum() == sum(timing.causes.values())
    assert timing.slots == records["tick"][-1] + 1
    assert timing.misses == sum(m.slots for m in timing.missed)


def test_a_stopped_robot_fails():
    timing = judge(run_of(), stopped="no fresh data", faults={Fault.DATA})
    assert (timing.verdict, timing.verdict.exit_code) == ("fail", 1)
    assert "no fresh data" in timing.reason


def test_a_run_that_a_signal_ended_early_is_inconclusive_unless_the_loop_missed_a_slot():
    why = "SIGINT ended the run after 900 of 2000 slots"
    timing = judge(run_of(), interrupted=why)
    assert (timing.verdict, timing.verdict.exit_code) == ("inconclusive", 3)
    assert why in timing.reason
    assert timing.interrupted == why
    assert judge(slow_run(40 * MS), interrupted=why).verdict == "fail"


@pytest.mark.parametrize(("stalled", "verdict"), [(False, "fail"), (True, "inconclusive")])
def test_a_stop_for_missed_slots_is_excused_if_the_host_took_them_and_nothing_else_failed(
    stalled, verdict
):
    records = slow_run(72 * MS)
    records["state"] = SafetyState.RUNNING
    records["state"][501:] = SafetyState.STOPPING
    stalls = [(begin_ns(records), 70 * MS)] if stalled else []
    why = {"stopped": "4 slots missed in a row", "faults": {Fault.SLOTS}}
    assert judge(records, *stalls, **why).verdict == verdict
    why = {"stopped": "a limit; then 4 slots missed", "faults": {Fault.MEASUREMENT, Fault.SLOTS}}
    assert judge(records, *stalls, **why).verdict == "fail"


@pytest.mark.parametrize("stopping_from", [502, 480])  # stopped by it, or while it stopped
@pytest.mark.parametrize(
    ("stalls_ns", "verdict"),
    [
        ((7 * MS, 7 * MS, 7 * MS), "inconclusive"),
        ((7 * MS, 0, 7 * MS), "fail"),  # one reply was lost without the host
        ((7 * MS, 2 * MS, 7 * MS), "fail"),
    ],
)
def test_a_stop_for_stale_data_is_excused_only_if_the_host_delayed_every_reply(
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
    loop, line = probe_over(records), probe_over(records, *stalls)
    why = {"stopped": "no fresh data for 3 ticks", "faults": {Fault.DATA}}
    timing = judge_timing(records, 0.017, loop, line, **why)
    assert (timing.verdict, timing.own_misses) == (verdict, 0)
    records["bus_status"][501] = BusStatus.PORT_GONE  # no wait for the host to lengthen
    records["bus_wait_ns"][501] = 0
    assert judge_timing(records, 0.017, loop, line, **why).verdict == "fail"


@pytest.mark.parametrize(
    ("busy_ns", "steal_ns", "why"),
    [
        (MS, 0, {}),
        (MS, 0, {"stopped": "why"}),
        (MS, 0, {"interrupted": "x"}),
        (22 * MS, 0, {}),
        (22 * MS, 20 * MS, {}),
    ],
)
def test_junit_has_the_same_verdict(busy_ns, steal_ns, why):
    records = slow_run(busy_ns)
    records["steal_ns"][500] = steal_ns
    timing = judge(records, **why)
    suite = ET.fromstring(timing_junit(timing, {"line": "socket"}))
    assert len(suite.findall("testcase/failure")) == (timing.verdict == "fail")
    assert len(suite.findall("testcase/skipped")) == (timing.verdict == "inconclusive")


PLAN = tick_budget.plan_times(plans(MODELS[54025].table, 2, 1_000_000)[0])


def staged_run(ticks: int = 500) -> np.ndarray:
    """Ticks whose stages add up: 20 µs each, the read with 1 ms on top for the bus."""
    records = run_of(ticks)
    for stage in STAGES:
        records[f"{stage}_ns"] = 20_000
    records["read_ns"] += MS
    records["bus_wait_ns"], records["lateness_ns"] = MS, 20_000
    records["busy_ns"] = sum(records[f"{s}_ns"] for s in STAGES) - records["lateness_ns"]
    return records


def test_the_parts_of_the_read_and_the_stages_add_up_to_the_period():
    records = staged_run()
    timing, read = judge_timing(records, 0.017), tick_budget.read_parts(records, PLAN)
    parts_ns = sum(read[part].p50_ns for part in ("own", "transmission", "servo", "wait"))
    assert parts_ns == timing.stages["read"].p50_ns
    read_s = plans(MODELS[54025].table, 2, 1_000_000)[0].read_s
    assert (PLAN.transmission_ns + PLAN.servo_ns) * 1e-9 == pytest.approx(read_s, abs=1e-9)
    stages_ns = sum(stage.p50_ns for stage in timing.stages.values())
    assert stages_ns + timing.slack.p50_ns == PERIOD_NS


@pytest.mark.parametrize("stage", ["wake", "read", "log"])
def test_a_stage_beyond_its_budget_is_reported_and_not_judged(stage):
    for excess_ns in (0, 1):
        records = staged_run(100)
        records[f"{stage}_ns"][-2:] = tick_budget.BUDGET_NS[stage] + excess_ns
        records["read_ns"][-2:] += MS if stage == "read" else 0
        timing = judge_timing(records, 0.017)
        over = [name for name, row in timing.stages.items() if not row.within_budget]
        assert over == ([stage] if excess_ns else [])
        assert timing.verdict is Verdict.PASS


def test_the_longest_tick_leaves_the_least_slack():
    records = staged_run()
    records["busy_ns"][123] = 16 * MS
    slack = judge_timing(records, 0.017).slack
    assert slack.min_ns == PERIOD_NS - 16 * MS - 20_000 < slack.p50_ns
