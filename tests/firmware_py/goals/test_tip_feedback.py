"""Feedback of the tip: bounds, no wind-up, loss of trust, estimate of the stiffness."""

import math

import msgspec
import numpy as np
import pytest

from firmware_py.core.errors import InputError
from firmware_py.core.signals import PERIOD_S
from firmware_py.goals.plan_goals import PlanGoals, check_plan_goals
from firmware_py.goals.stiffness_estimate import StiffnessEstimate
from firmware_py.goals.tip_feedback import TipFeedback
from firmware_py.goals.tip_plan import (
    FeedbackDesign,
    RateFilter,
    StiffnessSlopes,
    wrong_in_feedback,
)
from firmware_py.inference.estimator import Estimate
from firmware_py.inference.predictor import Prediction
from firmware_py.safety.estimate_trust import TrustOptions, TrustState
from firmware_py.safety.limits import Limits
from tests.firmware_py.goals.small_plan import payload_plan, plan_of

ROWS, SIZE, RATE = 400, 0.03, 0.16
GAIN = RateFilter(a=((0.0,),), b=((0.0,),), c=((0.0,),), d=((2.0,),))
BOUNDED = FeedbackDesign(
    filters=((GAIN,),), margins=(), size_rad=SIZE, rate_rad_s=RATE, innovation_a=0.8
)  # fmt: skip
PHASE = 2 * np.pi * np.arange(ROWS) / ROWS


def plan_with(design=BOUNDED, stiffness=None):
    return plan_of(payload_plan(1.0, (0.0,) * ROWS, stiffness=stiffness), feedback=design)


def feedback_of(plan, **options):
    return TipFeedback(plan, PlanGoals(plan, 1.0), TrustOptions(**options), [0])


def tick(
    feedback, tip_m, slot=0, fresh=True, in_range=1.0, half_m=0.01, innovation=0.1, current=0.0,
    following=True,
):  # fmt: skip
    prediction = Prediction(np.array([tip_m, 0.0, 1.0]), np.array([in_range]), np.full(3, half_m))
    estimate = Estimate(0.0, 1.0, np.array([innovation]))
    return float(feedback.update(
        slot, PERIOD_S, fresh, np.array([current]), estimate, prediction, following
    )[0])  # fmt: skip


def test_a_steady_error_is_integrated_away():
    feedback, goal = feedback_of(plan_with()), 0.0
    for _ in range(300):
        goal = tick(feedback, 0.004 + goal)  # a link of 1 m: the tip moves with the goal
    assert goal == pytest.approx(-0.004, abs=1e-5)


def test_corrections_are_bounded_in_size_and_rate_and_do_not_wind_up():
    feedback = feedback_of(plan_with())
    values = [0.0] + [tick(feedback, -0.5) for _ in range(200)]
    assert values[-1] == pytest.approx(SIZE)
    assert np.max(np.abs(np.diff(values))) <= RATE * PERIOD_S + 1e-12
    back = [tick(feedback, 0.5) for _ in range(2)]
    assert back[0] < SIZE, "the integral stood at its bound, not behind it"


def test_nothing_is_integrated_while_the_goals_blend_into_the_plan():
    """Far from the path on purpose, not by an error."""
    feedback, before = feedback_of(plan_with()), 0.0
    for _ in range(20):
        before = tick(feedback, 0.001)
    assert before < 0.0
    assert {tick(feedback, -0.2, following=False) for _ in range(300)} == {before}
    assert feedback.trust is TrustState.TRUSTED
    assert tick(feedback, 0.001) < before, "it goes on from there"


@pytest.mark.parametrize(
    ("wrong", "reason"),
    [
        ({"fresh": False}, "stale"),
        ({"in_range": 0.0}, "out of range"),
        ({"half_m": 0.1, "in_range": 0.0}, "out of range"),
        ({"half_m": math.nan}, "out of range"),
        ({"innovation": 0.9}, r"innovation is 0\.90 A"),
        ({"innovation": math.nan}, "innovation"),
        ({"tip_m": math.nan}, "not finite"),
    ],
)  # fmt: skip
def test_corrections_fade_within_200_ms_and_come_back(wrong, reason):
    feedback = feedback_of(plan_with())
    for _ in range(100):
        tick(feedback, -0.5)
    assert tick(feedback, **({"tip_m": -0.5} | wrong)) == pytest.approx(SIZE), "one tick is ignored"
    assert tick(feedback, -0.5) == pytest.approx(SIZE)
    faded = [tick(feedback, **({"tip_m": -0.5} | wrong)) for _ in range(2 + 12)]
    assert feedback.trust is TrustState.LOST
    assert faded[-1] == 0.0
    assert max(-np.diff(faded)) <= RATE * PERIOD_S + 1e-12
    assert feedback.stop_reason == ""
    assert feedback.lost_because
    regained = [tick(feedback, -0.01) for _ in range(70)]
    assert feedback.trust is TrustState.TRUSTED
    assert regained[50] == 0.0
    assert regained[-1] > 0.0
    for _ in range(5):
        tick(feedback, 0.0, half_m=0.02, in_range=0.0)
    assert feedback.trust is TrustState.TRUSTED, "the interval is wide, but not too wide"


def test_the_robot_stops_where_its_options_ask_for_it():
    feedback = feedback_of(plan_with(), when_lost="stop")
    for _ in range(2):
        tick(feedback, 0.0, innovation=2.0)
    assert "innovation is 2.00 A" in feedback.stop_reason


def test_the_limits_leave_room_for_corrections():
    check_plan_goals(plan_with(), Limits(), "plan")
    with pytest.raises(InputError, match="outside"):
        check_plan_goals(plan_with(), Limits(angle_rad=(-0.02, 0.02)), "plan")


def test_a_stiffer_link_is_estimated_from_its_current():
    """Currents of a link 10 % stiffer, 20 % more friction, noise: the estimate is 10 % ± 3 %."""
    rng, estimate = np.random.default_rng(3), StiffnessEstimate(1)
    by_stiffness, by_friction = 0.8 * np.sin(PHASE), 0.7 * np.sign(np.cos(PHASE))
    for _ in range(3):
        for k in range(ROWS):
            excess = 0.1 * by_stiffness[k] + 0.2 * by_friction[k] + 0.02 * rng.standard_normal()
            estimate.update(
                np.array([excess]), by_stiffness[k : k + 1], by_friction[k : k + 1], np.ones(1)
            )
    assert estimate.value == pytest.approx(0.1, abs=0.03)
    estimate.update(np.array([math.nan]), np.ones(1), np.ones(1), np.ones(1))
    assert math.isfinite(estimate.value)


def test_goals_follow_the_stiffness_with_a_known_payload_only():
    zero, wave = ((0.0,) * ROWS,), (tuple(np.sin(PHASE).tolist()),)
    slopes = StiffnessSlopes(
        goals_rad=((0.1,) * ROWS,), current_a=zero, unmatched_a=wave, friction_a=zero,
        weight=((1.0,) * ROWS,), unseen_m=zero,
    )  # fmt: skip
    plan = plan_with(stiffness=slopes)
    known = feedback_of(plan)
    unknown = TipFeedback(plan, PlanGoals(plan), TrustOptions(), [])
    for k in range(2 * ROWS):
        for feedback in (known, unknown):
            rest = 0.2 - feedback.stiffness  # goals for a stiffer link bring the current back
            tick(feedback, 0.0, slot=k, current=rest * np.sin(PHASE[k % ROWS]))
    assert known.stiffness == pytest.approx(0.2, abs=0.03)
    assert known.value_rad[0] == pytest.approx(0.1 * known.stiffness, abs=1e-3)
    assert unknown.stiffness == unknown.value_rad[0] == 0.0


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"filters": ()}, "a filter for each"),
        ({"filters": ((msgspec.structs.replace(GAIN, b=()),),)}, "fit together"),
        ({"filters": ((msgspec.structs.replace(GAIN, a=((1.0,),)),),)}, "stable"),
        ({"size_rad": 3.0}, "bounds"),
        ({"innovation_a": math.nan}, "bounds"),
    ],
)  # fmt: skip
def test_feedback_that_cannot_be_is_refused(change, sentence):
    values = {name: getattr(BOUNDED, name) for name in FeedbackDesign.__struct_fields__} | change
    assert sentence in wrong_in_feedback(FeedbackDesign(**values), (None,), 1, ROWS)
