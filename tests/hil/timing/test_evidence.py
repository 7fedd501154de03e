"""What a run leaves behind as evidence: budget, histogram file, timeline, reference."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_py.bus.bus_plan import plans
from firmware_py.bus.registers import PRO_P
from firmware_py.bus.servo_bus import BusStatus
from firmware_py.realtime.percentiles import Percentiles
from firmware_py.signals import STAGES, tick_dtype
from hil.timing import reference_jitter, tick_budget, timeline
from hil.timing.cpu_accounts import ProbeRecord
from hil.timing.hdr_histogram import write_hgrm

MS = 1_000_000
PERIOD_NS = 17 * MS
NO_REFERENCE = Percentiles.of(np.zeros(0, np.int64))


def run_of(ticks: int) -> np.ndarray:
    """Ticks whose stages add up: 20 µs each, the read with 1 ms on top for the bus."""
    records = np.zeros(ticks, tick_dtype(1))
    records["tick"] = np.arange(ticks)
    records["deadline_ns"] = 10**12 + records["tick"] * PERIOD_NS
    for stage in STAGES:
        records[f"{stage}_ns"] = 20_000
    records["read_ns"] += MS
    records["bus_wait_ns"], records["lateness_ns"] = MS, 20_000
    records["busy_ns"] = sum(records[f"{s}_ns"] for s in STAGES) - records["lateness_ns"]
    return records


@given(st.lists(st.integers(0, 10**9), min_size=1, max_size=400))
def test_a_histogram_file_never_understates_a_percentile(tmp_path_factory, durations_ns):
    path = tmp_path_factory.mktemp("hgrm") / "tick.hgrm"
    write_hgrm(path, np.array(durations_ns))
    lines = path.read_text().splitlines()
    rows = [tuple(map(float, line.split()[:3])) for line in lines[2:] if not line.startswith("#")]
    values = np.array(durations_ns) / 1e3
    for value_us, fraction, count in rows:
        assert np.mean(values <= value_us + 1e-3) >= fraction - 1e-9
        assert count == np.sum(values <= value_us + 5e-4)
    assert [f for _, f, _ in rows] == sorted({f for _, f, _ in rows})
    assert rows[-1] == (pytest.approx(values.max(), abs=1e-3), 1.0, len(values))
    found = re.search(r"#\[Max +=(.*), Total count +=(.*)\]", path.read_text())
    assert (float(found[1]), int(found[2])) == (pytest.approx(values.max(), abs=1e-3), len(values))


def test_the_account_takes_the_read_apart_and_adds_up_to_the_period():
    records, plan = run_of(1000), plans(PRO_P, 2, 1_000_000)[0]
    times = tick_budget.plan_times(plan)
    reference = Percentiles(n=1, p50_ns=10_000, p99_ns=10_000, p99_9_ns=0, max_ns=0)
    account = tick_budget.measure_budget(records, 0.017, times, reference)
    parts_ns = sum(account.read[part].p50_ns for part in ("own", "transmission", "servo", "wait"))
    assert parts_ns == records["read_ns"][0]
    assert (times.transmission_ns + times.servo_ns) * 1e-9 == pytest.approx(plan.read_s, abs=1e-9)
    stages_ns = sum(row.p50_ns for row in account.budget.values()) + MS
    assert stages_ns + account.slack.p50_ns == PERIOD_NS
    assert account.cpu_fraction == pytest.approx((len(STAGES) - 1) * 20_000 / PERIOD_NS)
    assert account.lateness_against_reference == {"p50_ns": 2.0, "p99_ns": 2.0}


@pytest.mark.parametrize("stage", STAGES)
def test_a_stage_beyond_its_budget_is_named(stage):
    times = tick_budget.plan_times(plans(PRO_P, 1, 1_000_000)[0])
    for excess_ns in (0, 1):
        records = run_of(100)
        records[f"{stage}_ns"][-2:] = tick_budget.BUDGET_NS[stage] + excess_ns
        records["read_ns"][-2:] += MS if stage == "read" else 0
        rows = tick_budget.measure_budget(records, 0.017, times, NO_REFERENCE).budget
        over = [name for name, row in rows.items() if not row.within_budget]
        assert over == ([stage] if excess_ns else [])
        text = "\n".join(
            tick_budget.describe_budget(
                tick_budget.measure_budget(records, 0.017, times, NO_REFERENCE)
            )
        )
        assert ("over" in text) is bool(excess_ns)


def test_one_long_tick_is_the_high_water_mark_and_the_least_slack():
    records = run_of(500)
    records["busy_ns"][123] = 16 * MS
    times = tick_budget.plan_times(plans(PRO_P, 1, 1_000_000)[0])
    account = tick_budget.measure_budget(records, 0.017, times, NO_REFERENCE)
    assert account.high_water_mark_ns == 16 * MS + 20_000
    assert account.slack.min_ns == PERIOD_NS - account.high_water_mark_ns


def test_a_lost_reply_is_accounted_for_with_what_it_cost():
    records = run_of(100)
    records["bus_status"][[20, 40]] = BusStatus.TIMEOUT, BusStatus.CORRUPT
    records["bus_status"][60] = BusStatus.ALERT  # which is fresh data
    records["bus_status"][80], records["busy_ns"][80] = BusStatus.RETRIED, 7 * MS
    records["busy_ns"][40] = 18 * MS
    records["missed"][41] = 1
    times = tick_budget.plan_times(plans(PRO_P, 1, 1_000_000)[0])
    account = tick_budget.measure_budget(records, 0.017, times, NO_REFERENCE)
    blind = account.without_data
    assert (blind.n, blind.max_ns, blind.missed_slots) == (2, 18 * MS + 20_000, 1)
    again = account.read_again
    assert (again.n, again.max_ns, again.missed_slots) == (1, 7 * MS + 20_000, 0)
    words = "\n".join(tick_budget.describe_budget(account))
    assert "2 ticks without data" in words
    assert "1 ticks that read twice took at most 7.02 ms" in words


def events_of(path):
    events = json.loads(path.read_text())["traceEvents"]
    return [event for event in events if event["ph"] == "X"], events


def test_a_timeline_nests_stages_in_ticks_and_marks_what_missed(tmp_path):
    records = run_of(50)
    records["wake_ns"][7] = records["lateness_ns"][7] = PERIOD_NS
    stall = ProbeRecord(records["deadline_ns"][7:8] + 3 * MS, np.array([2 * MS]), np.array([0]))
    timeline.write_timeline(tmp_path / "t.json", records, stall, PERIOD_NS)
    slices, events = events_of(tmp_path / "t.json")
    ticks = [s for s in slices if s["name"].startswith("tick ")]
    stages = [s for s in slices if s["tid"] == 1 and s not in ticks]
    assert (len(ticks), len(stages)) == (50, 50 * len(STAGES))
    for tick, first in zip(ticks, range(0, len(stages), len(STAGES)), strict=True):
        inside = stages[first : first + len(STAGES)]
        assert inside[0]["ts"] == tick["ts"]
        assert inside[-1]["ts"] + inside[-1]["dur"] == pytest.approx(tick["ts"] + tick["dur"])
    assert [e["ts"] for e in events if e["name"] == "missed"] == [8 * PERIOD_NS / 1e3]
    [stood] = [s for s in slices if s["tid"] == 3]
    assert (stood["ts"], stood["dur"]) == (7 * PERIOD_NS / 1e3 + 1e3, 2e3)


def test_a_long_timeline_is_thinned_out_and_keeps_what_is_remarkable():
    records = run_of(100_000)
    worst = np.random.default_rng(0).choice(len(records), 40, replace=False)
    records["busy_ns"][worst] = 18 * MS
    shown = timeline.select_ticks(records, PERIOD_NS)
    assert shown[worst].all()
    assert shown.sum() <= 2 * timeline.MOST_TICKS


@given(st.dictionaries(st.integers(0, 500), st.integers(1, 1000), min_size=1))
def test_percentiles_of_the_reference_are_those_of_its_samples(counts):
    samples = np.repeat(list(counts), list(counts.values()))
    summary = reference_jitter.histogram_percentiles(counts, len(samples), max(counts))
    for name, fraction in (("p50_ns", 0.5), ("p99_ns", 0.99), ("p99_9_ns", 0.999)):
        assert getattr(summary, name) == 1000 * np.quantile(
            samples, fraction, method="inverted_cdf"
        )


def test_what_lies_beyond_the_references_histogram_counts_as_its_maximum():
    summary = reference_jitter.histogram_percentiles({10: 98}, 100, 70_000)
    assert summary == Percentiles(
        n=100, p50_ns=10_000, p99_ns=70_000_000, p99_9_ns=70_000_000, max_ns=70_000_000
    )


def test_without_cyclictest_there_is_no_reference(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    with reference_jitter.cyclictest(0, 0.017, tmp_path) as running:
        assert running.stop() is None
