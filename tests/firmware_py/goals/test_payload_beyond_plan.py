"""Estimated payloads inside and outside of those of a plan."""

import msgspec
import numpy as np
import pytest

from firmware_py.core.signals import tick_dtype
from firmware_py.goals.plan_goals import payload_beyond_plan, recording_beyond_plan
from firmware_py.safety.states import SafetyState
from firmware_py.summary import Ended, RunSummary
from firmware_py.system.timing import Timing
from tests.firmware_py.goals.small_plan import small_plan


@pytest.fixture
def said(toy_bundle):
    """Sentence about a run with an estimate for each tick, of a plan from 0 to 1 kg."""

    def said(estimated_kg, told_kg=None, **columns):
        records = np.zeros(100, tick_dtype(1))
        records["tick"], records["state"] = np.arange(100), SafetyState.RUNNING
        records["payload_kg"] = estimated_kg
        for name, values in columns.items():
            records[name] = values
        summary = RunSummary(Ended.FINISHED, "", 100, {}, 0, Timing(), records, 0)
        return payload_beyond_plan(small_plan(toy_bundle), told_kg, summary)

    return said


def test_an_estimate_that_stays_beyond_the_plan_is_told(said):
    assert all(word in said(1.4) for word in ("1.40 kg", "0 to 1 kg", "for 1 kg", "--payloads"))
    assert "-0.20 kg" in said(-0.2) and "for 0 kg" in said(-0.2)


@pytest.mark.parametrize("payload_kg", [0.0, 0.5, 1.0, 1.04, np.nan])
def test_an_estimate_inside_the_plan_or_of_its_end_is_not(said, payload_kg):
    assert said(payload_kg) == ""


def test_a_payload_that_is_known_was_not_estimated(said):
    assert said(1.4, told_kg=1.0) == ""


def test_only_what_the_estimate_settles_to_counts(said):
    settling = np.where(np.arange(100) < 45, 1.4, 0.8)
    assert said(settling) == ""
    assert said(settling[::-1]) != ""
    before = np.where(np.arange(100) < 90, -1, 5)  # an approach that outlasts the motion
    assert said(np.where(before < 0, 1.4, 0.8), tick=before) == ""
    assert said(1.4, state=SafetyState.STOPPING) == ""


def test_a_recording_of_a_payload_beyond_the_plan_is_told(toy_bundle):
    plan = small_plan(toy_bundle)
    said = recording_beyond_plan(plan, 3.0)
    assert all(word in said for word in ("3 kg", "0 to 1 kg", "for 1 kg", "--payloads"))
    assert recording_beyond_plan(plan, 0.4) == "" == recording_beyond_plan(plan, 1.04)
    alone = msgspec.structs.replace(plan, payloads=plan.payloads[1:])
    assert "1 kg alone" in recording_beyond_plan(alone, 0.4)
