"""Tick budget: the parts add up, and what exceeds its budget is named."""

from __future__ import annotations

import numpy as np
import pytest

from firmware_py.bus.bus_plan import plans
from firmware_py.bus.servo_bus import BusStatus
from firmware_py.bus.servo_models import MODELS
from firmware_py.core.signals import STAGES
from firmware_py.system.percentiles import Percentiles
from hil.sil import tick_budget

MS = 1_000_000
PERIOD_NS = 17 * MS
NO_REFERENCE = Percentiles.of(np.zeros(0, np.int64))


def test_the_account_takes_the_read_apart_and_adds_up_to_the_period(run_of):
    records, plan = run_of(1000), plans(MODELS[54025].table, 2, 1_000_000)[0]
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
def test_a_stage_beyond_its_budget_is_named(run_of, stage):
    times = tick_budget.plan_times(plans(MODELS[54025].table, 1, 1_000_000)[0])
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


def test_one_long_tick_is_the_high_water_mark_and_the_least_slack(run_of):
    records = run_of(500)
    records["busy_ns"][123] = 16 * MS
    times = tick_budget.plan_times(plans(MODELS[54025].table, 1, 1_000_000)[0])
    account = tick_budget.measure_budget(records, 0.017, times, NO_REFERENCE)
    assert account.high_water_mark_ns == 16 * MS + 20_000
    assert account.slack.min_ns == PERIOD_NS - account.high_water_mark_ns


def test_a_lost_reply_is_accounted_for_with_what_it_cost(run_of):
    records = run_of(100)
    records["bus_status"][[20, 40]] = BusStatus.TIMEOUT, BusStatus.CORRUPT
    records["bus_status"][60] = BusStatus.ALERT  # which is fresh data
    records["bus_status"][80], records["busy_ns"][80] = BusStatus.RETRIED, 7 * MS
    records["busy_ns"][40] = 18 * MS
    records["missed"][41] = 1
    times = tick_budget.plan_times(plans(MODELS[54025].table, 1, 1_000_000)[0])
    account = tick_budget.measure_budget(records, 0.017, times, NO_REFERENCE)
    blind = account.without_data
    assert (blind.n, blind.max_ns, blind.missed_slots) == (2, 18 * MS + 20_000, 1)
    again = account.read_again
    assert (again.n, again.max_ns, again.missed_slots) == (1, 7 * MS + 20_000, 0)
    words = "\n".join(tick_budget.describe_budget(account))
    assert "2 ticks without data" in words
    assert "1 ticks" in words and "7.02 ms" in words
