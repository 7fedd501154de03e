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
    RateFilter,
    StiffnessSlopes,
    read_tip_plan,
)
from firmware_py.safety.estimate_trust import TrustOptions, TrustState
from tests.firmware_py.goals.small_plan import payload_plan, plan_of
from tests.firmware_py.goals.test_tip_feedback import tick

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


def probing_plan():
    still = (0.0,) * ROWS
    gain = RateFilter(a=((0.0,),), b=((0.0,),), c=((0.0,),), d=((0.0,),))
    slopes = StiffnessSlopes(
        goals_rad=((0.1,) * ROWS,), current_a=(still,), unmatched_a=(still,), friction_a=(still,),
        weight=(still,), unseen_m=(still,),
    )  # fmt: skip
    design = FeedbackDesign(
        filters=((gain,), (gain,)), margins=(), size_rad=0.03, rate_rad_s=0.16, innovation_a=0.25
    )
    payloads = (payload_plan(kg, still, stiffness=slopes) for kg in (0.0, 2.0))
    return plan_of(*payloads, feedback=design, probe=probe_of())


class Robot:
    """Feedback of a probing plan, on a link of some stiffness and payload."""

    def __init__(self, stiffness, payload_kg, known_kg=None, **options):
        self.payloads_kg = []
        self._current = stiffness * BY_STIFFNESS + payload_kg * BY_PAYLOAD
        plan = probing_plan()
        self.feedback = TipFeedback(
            plan, PlanGoals(plan, known_kg), TrustOptions(**options), [0], self.payloads_kg.append
        )

    def tick(self, slot, fresh=True, innovation=0.1):
        current = self._current[slot] if -PROBE_ROWS <= slot < 0 else 0.0
        return tick(self.feedback, 0.0, slot, fresh, innovation=innovation, current=current)

    def probe(self, stale=(), skipped=(), **wrong):
        for slot in range(-PROBE_ROWS - 5, 0):
            if slot not in skipped:
                self.tick(slot, fresh=slot not in stale, **wrong)
        return [self.tick(slot) for slot in range(ROWS)]


@pytest.mark.parametrize("known_kg", [None, 1.1])
def test_the_estimate_of_the_probe_is_taken_over_at_slot_0(known_kg):
    robot = Robot(0.12, 1.1, known_kg)
    values = robot.probe()
    assert robot.feedback.stiffness == pytest.approx(0.12, abs=0.01)
    assert robot.payloads_kg == [known_kg if known_kg else pytest.approx(1.1, abs=0.01)]
    assert values[0] == 0.0
    assert values[-1] == pytest.approx(0.1 * robot.feedback.stiffness)
    assert max(np.abs(np.diff(values))) <= 0.16 * PERIOD_S + 1e-12


@pytest.mark.parametrize("known_kg", [None, 1.1])
@pytest.mark.parametrize(
    "wrong", [{"stale": range(-50, -47)}, {"skipped": range(-50, -47)}, {"skipped": range(-4, 0)}]
)
def test_a_probe_with_missing_rows_is_not_used(wrong, known_kg):
    robot = Robot(0.12, 1.1, known_kg)
    robot.probe(**wrong)
    assert robot.feedback.probe_result is None
    assert robot.feedback.stiffness == 0.0
    assert robot.payloads_kg == [known_kg], "the observer estimates afresh, or knows"


@pytest.mark.parametrize("wrong", [{"stale": (-50,)}, {"skipped": (-50,)}, {"stale": (-1,)}])
def test_a_probe_with_one_missing_row_counts(wrong):
    robot = Robot(0.12, 1.1)
    robot.probe(**wrong)
    assert robot.feedback.stiffness == pytest.approx(0.12, abs=0.02)


@pytest.mark.parametrize(("unexplained_a", "certain"), [(0.0, True), (0.5, False)])
def test_currents_that_nothing_explains_make_the_estimate_uncertain(unexplained_a, certain):
    extra = probe_of(
        weights=(*probe_of().weights, (tuple((PER_A / 10 * np.cos(PHASE)).tolist()),)),
        expected=tuple(tuple((*features(k, m), 0.0) for m in PAYLOADS_KG) for k in STIFFNESS),
    )
    estimate = ProbeEstimate(extra, None)
    for row in range(PROBE_ROWS):
        current = 0.1 * BY_STIFFNESS[row] + BY_PAYLOAD[row] + unexplained_a * np.cos(PHASE[row])
        estimate.take(row, True, np.array([current]))
    assert estimate.result().certain is certain


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
def test_a_probe_that_cannot_be_is_refused(change, sentence):
    assert sentence in wrong_in_probe(probe_of(**change), 1)


def test_a_plan_is_read_with_its_probe_and_refused_without_feedback(tmp_path):
    plan, path = probing_plan(), tmp_path / "plan.json"
    write_document(path, plan)
    assert read_tip_plan(path) == plan
    write_document(path, msgspec.structs.replace(plan, feedback=None))
    with pytest.raises(InputError, match="a probe without feedback"):
        read_tip_plan(path)
