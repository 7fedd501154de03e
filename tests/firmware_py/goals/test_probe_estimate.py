"""Probing motion on the robot: goals, what becomes of its estimate, data that is stale or wrong."""

import math

import msgspec
import numpy as np
import pytest

from firmware_py.core.documents import write_document
from firmware_py.core.errors import InputError
from firmware_py.core.signals import PERIOD_S
from firmware_py.goals.plan_goals import PlanGoals
from firmware_py.goals.stiffness_estimate import ProbeDesign, ProbeEstimate, wrong_in_probe
from firmware_py.goals.tip_feedback import TipFeedback
from firmware_py.goals.tip_plan import (
    FeedbackDesign,
    PayloadPlan,
    RateFilter,
    StiffnessSlopes,
    TipPlan,
    read_tip_plan,
)
from firmware_py.inference.estimator import Estimate
from firmware_py.inference.predictor import Prediction
from firmware_py.link.link_facts import STUDY_FACTS
from firmware_py.safety.estimate_trust import TrustOptions, TrustState

ROWS, PROBE_ROWS = 60, 100
PHASE = 2 * np.pi * np.arange(PROBE_ROWS) / PROBE_ROWS
BY_STIFFNESS, BY_PAYLOAD = np.sin(2 * PHASE), np.sin(3 * PHASE)
"""Currents in A per relative stiffness and per kg."""
STIFFNESS, PAYLOADS_KG = np.arange(-3, 4) * 0.1, np.arange(9) * 0.25
PER_A = 40.0


def features(k, m):
    return (PER_A * PROBE_ROWS / 2 * np.array([k, m]) / 10.0).tolist()


def probe_of(**changes):
    weights = tuple((tuple((PER_A / 10.0 * w).tolist()),) for w in (BY_STIFFNESS, BY_PAYLOAD))
    goals = 0.02 * np.sin(PHASE) * np.sin(np.pi * np.arange(PROBE_ROWS) / (PROBE_ROWS - 1))
    values = {
        "goals_rad": ((0.0, *goals[1:-1].tolist(), 0.0),), "weights": weights,
        "stiffness": tuple(STIFFNESS.tolist()), "payloads_kg": tuple(PAYLOADS_KG.tolist()),
        "expected": tuple(tuple(tuple(features(k, m)) for m in PAYLOADS_KG) for k in STIFFNESS),
    }  # fmt: skip
    return ProbeDesign(**(values | changes))


def plan_with(probe):
    still = ((0.0,) * ROWS,)
    gain = RateFilter(a=((0.0,),), b=((0.0,),), c=((0.0,),), d=((0.0,),))
    slopes = StiffnessSlopes(
        goals_rad=((0.1,) * ROWS,), current_a=still, unmatched_a=still, friction_a=still,
        weight=still, unseen_m=still,
    )  # fmt: skip
    payloads = tuple(
        PayloadPlan(
            payload_kg=kg, goals_rad=still, tip_m=still, current_a=still, residual_rms_m=0.0,
            rigid_rms_m=0.0, expected_rms_m=0.0, stiffness=slopes,
        )
        for kg in (0.0, 2.0)
    )  # fmt: skip
    design = FeedbackDesign(
        filters=((gain,), (gain,)), margins=(), size_rad=0.03, rate_rad_s=0.16, innovation_a=0.25
    )
    return TipPlan(
        schema=1, path="hold", method="inverse", dof=1, period_s=PERIOD_S, rest_s=PERIOD_S,
        start_row=0, end_row=ROWS, drawn=(), desired_m=still, payloads=payloads,
        payload_rate_kg_s=0.5, plant_error_rms_m=None, plant_sha256="", bundle_sha256="",
        link=STUDY_FACTS,
        feedback=design, probe=probe,
    )  # fmt: skip


class Robot:
    """Feedback of a plan with a probe, link and payload as given."""

    def __init__(self, stiffness, payload_kg, known_kg=None, **options):
        self.goals = PlanGoals(plan_with(probe_of()), known_kg)
        self.told, self._current = [], stiffness * BY_STIFFNESS + payload_kg * BY_PAYLOAD
        self.feedback = TipFeedback(
            plan_with(probe_of()), self.goals, TrustOptions(**options), [0], self.told.append
        )

    def tick(self, slot, fresh=True, current=None, innovation=0.1):
        own = self._current[slot] if -PROBE_ROWS <= slot < 0 else 0.0
        prediction = Prediction(np.array([0.0, 0.0, 1.0]), np.array([1.0]), np.full(3, 0.01))
        estimate = Estimate(0.0, 1.0, np.array([innovation]))
        current = np.array([own if current is None else current])
        return float(self.feedback.update(slot, PERIOD_S, fresh, current, estimate, prediction)[0])

    def probe(self, stale=(), skipped=(), **wrong):
        for slot in range(-PROBE_ROWS - 5, 0):
            if slot not in skipped:
                self.tick(slot, fresh=slot not in stale, **wrong)
        return [self.tick(slot) for slot in range(ROWS)]


def test_goals_probe_before_slot_0_and_only_once():
    probe = probe_of()
    goals = PlanGoals(plan_with(probe), 1.0)
    assert goals.lead == PROBE_ROWS
    before = [float(goals.at(slot)[0]) for slot in range(-PROBE_ROWS, 0)]
    assert before == pytest.approx(probe.goals_rad[0])
    assert goals.at(-PROBE_ROWS - 1)[0] == goals.at(0)[0] == goals.at(ROWS)[0] == 0.0
    without = PlanGoals(plan_with(probe), 1.0, probes=False)
    assert without.lead == 0 and without.at(-3)[0] == 0.0


@pytest.mark.parametrize("known_kg", [None, 1.1])
def test_what_the_probe_told_is_taken_over_at_slot_0(known_kg):
    robot = Robot(0.12, 1.1, known_kg)
    values = robot.probe()
    assert robot.feedback.stiffness == pytest.approx(0.12, abs=0.01)
    assert robot.told == [known_kg] if known_kg else robot.told[0] == pytest.approx(1.1, abs=0.01)
    assert len(robot.told) == 1
    assert values[0] == 0.0
    assert values[-1] == pytest.approx(0.1 * robot.feedback.stiffness)
    assert max(np.abs(np.diff(values))) <= 0.16 * PERIOD_S + 1e-12


@pytest.mark.parametrize("wrong", [{"stale": range(-50, -47)}, {"skipped": range(-50, -47)},
                                   {"skipped": range(-4, 0)}])  # fmt: skip
def test_a_probe_with_missing_rows_tells_nothing(wrong):
    for known_kg in (None, 1.1):
        robot = Robot(0.12, 1.1, known_kg)
        robot.probe(**wrong)
        assert robot.feedback.found is None
        assert robot.feedback.stiffness == 0.0
        assert robot.told == [known_kg], "the observer estimates afresh, or keeps what is known"


@pytest.mark.parametrize("wrong", [{"stale": (-50,)}, {"skipped": (-50,)}, {"stale": (-1,)}])
def test_a_probe_with_one_missing_row_counts(wrong):
    robot = Robot(0.12, 1.1)
    robot.probe(**wrong)
    assert robot.feedback.stiffness == pytest.approx(0.12, abs=0.02)


def test_currents_that_nothing_explains_are_not_taken_over():
    extra = probe_of(
        weights=(*probe_of().weights, (tuple((PER_A / 10 * np.cos(PHASE)).tolist()),)),
        expected=tuple(
            tuple((*features(k, m), 0.0) for m in PAYLOADS_KG) for k in STIFFNESS
        ),
    )  # fmt: skip
    for size_a, certain in ((0.0, True), (0.5, False)):
        estimate = ProbeEstimate(extra, None)
        for row in range(PROBE_ROWS):
            current = 0.1 * BY_STIFFNESS[row] + BY_PAYLOAD[row] + size_a * np.cos(PHASE[row])
            estimate.take(row, True, np.array([current]))
        assert estimate.found().certain is certain


def test_an_observer_misled_by_the_probe_does_not_cost_the_trust():
    """The innovation is large while the link is not the observer's, whatever is configured."""
    robot = Robot(0.12, 1.1, when_lost="stop")
    robot.probe(innovation=2.0)
    assert robot.feedback.trust is TrustState.TRUSTED
    assert robot.feedback.lost_because == robot.feedback.stop_reason == ""


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"goals_rad": ()}, "a probe of 0 rows"),
        ({"goals_rad": ((0.0,) * 50,)}, "columns of 50 rows"),
        ({"stiffness": (0.0, 0.1)}, "a grid of 2 times 9"),
        ({"stiffness": (-0.3, -0.2, -0.1, 0.0, 0.1, 0.2, 0.4)}, "equal steps"),
        ({"payloads_kg": tuple((PAYLOADS_KG[::-1]).tolist())}, "equal steps"),
        ({"stiffness": tuple((STIFFNESS - 0.8).tolist())}, "without stiffness"),
        ({"expected": ()}, "do not fit"),
        ({"goals_rad": ((math.nan,) * PROBE_ROWS,)}, "not finite"),
        ({"goals_rad": ((0.01,) * PROBE_ROWS,)}, "begin and end at zero"),
    ],
)
def test_a_probe_that_cannot_be_is_refused(change, sentence, tmp_path):
    assert sentence in wrong_in_probe(probe_of(**change), 1)


def test_a_document_holds_its_probe_and_one_without_feedback_is_refused(tmp_path):
    plan = plan_with(probe_of())
    write_document(tmp_path / "plan.json", plan)
    assert read_tip_plan(tmp_path / "plan.json") == plan
    write_document(tmp_path / "plan.json", msgspec.structs.replace(plan, feedback=None))
    with pytest.raises(InputError, match="a probe without feedback"):
        read_tip_plan(tmp_path / "plan.json")
