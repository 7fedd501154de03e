"""Plans on the robot: interpolation by payload, its rate, limits, documents that are refused."""

import math

import msgspec
import numpy as np
import pytest

from firmware_py.core.documents import write_document
from firmware_py.core.errors import InputError
from firmware_py.core.signals import PERIOD_S, tick_dtype
from firmware_py.goals.plan_goals import (
    PlanGoals,
    check_plan_goals,
    payload_beyond_plan,
    recording_beyond_plan,
)
from firmware_py.goals.tip_plan import PayloadPlan, TipPlan, read_tip_plan
from firmware_py.inference.estimator import Estimate
from firmware_py.link.link_facts import STUDY_FACTS
from firmware_py.safety.limits import Limits
from firmware_py.safety.states import SafetyState
from firmware_py.safety.supervisor import SafetySupervisor
from firmware_py.summary import Ended, RunSummary
from firmware_py.system.timing import Timing
from tests.firmware_py.goals.small_plan import small_plan

ROWS = 40


def column(factor):
    return tuple((factor * 0.1 * np.sin(np.pi * np.arange(ROWS) / (ROWS - 1)) ** 3).tolist())


def payload_plan(payload_kg, factor):
    own = column(factor)
    return PayloadPlan(
        payload_kg=payload_kg, goals_rad=(own, own), tip_m=(own, own), current_a=(own, own),
        residual_rms_m=1e-3, rigid_rms_m=5e-2, expected_rms_m=2e-3,
    )  # fmt: skip


@pytest.fixture
def plan():
    own = column(1.0)
    return TipPlan(
        schema=1, path="circle", method="inverse", dof=2, period_s=PERIOD_S, rest_s=PERIOD_S,
        start_row=5, end_row=30, drawn=((5, 30),), desired_m=(own, own),
        payloads=(payload_plan(0.0, 1.2), payload_plan(1.0, 1.0), payload_plan(2.0, 0.6)),
        payload_rate_kg_s=0.5, plant_error_rms_m=None, plant_sha256="", bundle_sha256="",
        link=STUDY_FACTS,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("payload_kg", "factor"), [(0.0, 1.2), (0.25, 1.15), (1.0, 1.0), (1.5, 0.8), (2.0, 0.6)]
)
def test_goals_of_a_known_payload_lie_between_their_neighbours(plan, payload_kg, factor):
    goals = PlanGoals(plan, payload_kg)
    goals.follow(Estimate(0.0, 1.9), 10.0)
    table = np.array([goals.at(slot) for slot in range(ROWS)])
    assert table[:, 0] == pytest.approx(np.array(column(factor)), abs=1e-12)


def test_the_payload_follows_the_estimate_at_a_limited_rate(plan):
    goals = PlanGoals(plan)
    assert goals.payload_kg == 1.0
    goals.follow(Estimate(0.0, 2.0), 0.1)
    assert goals.payload_kg == pytest.approx(1.05)
    goals.follow(Estimate(0.0, math.nan), 0.1)
    assert goals.payload_kg == pytest.approx(1.05)
    goals.follow(Estimate(0.0, math.inf), 0.1)
    assert goals.payload_kg == pytest.approx(1.05)
    goals.follow(Estimate(0.0, 5.0), 60.0)
    assert goals.payload_kg == 2.0, "the end of the grid"
    goals.follow(Estimate(0.0, -1.0), 60.0)
    assert goals.payload_kg == 0.0


def test_no_estimate_brings_a_checked_plan_beyond_a_limit(plan):
    """The worst that an estimate can do: jump between the ends of the grid at any time."""
    limits = Limits(rate_rad_s=2.0)
    check_plan_goals(plan, limits, "plan")
    rng = np.random.default_rng(1)
    for _ in range(20):
        goals, supervisor = PlanGoals(plan), SafetySupervisor(limits, 2)
        supervisor.arm(goals.at(0))
        supervisor.start()
        for slot in range(ROWS):
            goals.follow(Estimate(0.0, rng.choice([0.0, 2.0])), PERIOD_S)
            supervisor.admit(goals.at(slot))
            assert not supervisor.tripped, supervisor.reason


@pytest.mark.parametrize(
    ("limits", "sentence"),
    [
        (Limits(angle_rad=(-0.11, 0.11)), r"plan: row \d+ \(.* s\), 0 kg: .* joint 1 is"),
        (Limits(rate_rad_s=0.3), r"row \d+ .*, 0 kg: .* moves at"),
        (Limits(acceleration_rad_s2=3.0), r"row \d+ .* accelerates at"),
    ],
)  # fmt: skip
def test_goals_beyond_a_limit_are_refused_with_the_row(plan, limits, sentence):
    with pytest.raises(InputError, match=sentence):
        check_plan_goals(plan, limits, "plan")


def test_a_change_of_the_payload_counts_in_the_limits(plan):
    rate = np.max(np.abs(np.diff(column(1.2)))) / PERIOD_S
    limits = Limits(rate_rad_s=float(rate) + 1e-3)
    with pytest.raises(InputError, match="while the estimate of the payload changes"):
        check_plan_goals(plan, limits, "plan")
    alone = msgspec.structs.replace(plan, payloads=plan.payloads[:1])
    check_plan_goals(alone, limits, "plan")


def test_a_known_payload_beyond_the_grid_is_refused(plan):
    with pytest.raises(InputError, match=r"payload_kg: .*2\.5 kg.* 0 to 2 kg.*--payloads"):
        PlanGoals(plan, 2.5)
    alone = msgspec.structs.replace(plan, payloads=plan.payloads[1:2])
    with pytest.raises(InputError, match="holds 1 kg alone"):
        PlanGoals(alone, 2.0)


def test_a_document_is_read_as_it_was_written(plan, tmp_path):
    write_document(tmp_path / "plan.json", plan)
    assert read_tip_plan(tmp_path / "plan.json") == plan


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"dof": 3}, "3 joints"),
        ({"dof": 1}, "needs 1 columns"),
        ({"period_s": 0.0}, "period of 0 s"),
        ({"payloads": ()}, "no payload"),
        ({"desired_m": (column(1.0), column(1.0)[:-1])}, "different length"),
        ({"end_row": ROWS + 1}, "outside of its 40 rows"),
        ({"payloads": (payload_plan(1.0, 1.0), payload_plan(1.0, 1.0))}, "do not rise"),
        ({"payloads": (payload_plan(-1.0, 1.0),)}, "negative"),
    ],
)
def test_a_document_that_cannot_be_run_is_refused(plan, tmp_path, change, sentence):
    write_document(tmp_path / "plan.json", msgspec.structs.replace(plan, **change))
    with pytest.raises(InputError, match=sentence):
        read_tip_plan(tmp_path / "plan.json")


def test_a_column_of_another_length_or_a_gap_is_refused(plan, tmp_path):
    for wrong in (column(1.0)[:-1], (math.nan, *column(1.0)[1:])):
        own = msgspec.structs.replace(plan.payloads[0], goals_rad=(wrong, column(1.0)))
        write_document(tmp_path / "plan.json", msgspec.structs.replace(plan, payloads=(own,)))
        with pytest.raises(InputError, match=r"goals_rad|does not fit"):
            read_tip_plan(tmp_path / "plan.json")


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
