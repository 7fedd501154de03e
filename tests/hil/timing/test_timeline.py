"""Timeline: stages nest in ticks, and the remarkable ticks of a long run are kept."""

from __future__ import annotations

import json

import numpy as np
import pytest

from firmware_py.signals import STAGES
from hil.timing import timeline
from hil.timing.cpu_accounts import ProbeRecord

MS = 1_000_000
PERIOD_NS = 17 * MS


def events_of(path):
    events = json.loads(path.read_text())["traceEvents"]
    return [event for event in events if event["ph"] == "X"], events


def test_a_timeline_nests_stages_in_ticks_and_marks_what_missed(run_of, tmp_path):
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


def test_a_long_timeline_is_thinned_out_and_keeps_what_is_remarkable(run_of):
    records = run_of(100_000)
    worst = np.random.default_rng(0).choice(len(records), 40, replace=False)
    records["busy_ns"][worst] = 18 * MS
    shown = timeline.select_ticks(records, PERIOD_NS)
    assert shown[worst].all()
    assert shown.sum() <= 2 * timeline.MOST_TICKS
