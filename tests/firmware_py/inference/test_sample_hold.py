"""Samples that are late or missing: the step of the observer, and the age of its estimate."""

import numpy as np
import pytest

from firmware_py.inference.estimator import SampleHold
from tests.firmware_py.simulated_loop import Steps

STEP_S = 0.017
SAMPLE = (np.zeros(1), np.zeros(1), STEP_S)


def follow(estimator, fresh):
    hold = SampleHold(estimator)
    return [(hold.update(*SAMPLE, f).di, hold.age_s) for f in fresh]


def test_the_observer_waits_for_a_fresh_sample_and_gets_the_time():
    observer = Steps()
    answers = follow(observer, [True, True, False, False, True, True])
    assert observer.steps_s == pytest.approx([STEP_S, STEP_S, 3 * STEP_S, STEP_S])
    assert [di for di, _ in answers] == [1, 2, 2, 2, 3, 4]
    ages = [age_s for _, age_s in answers]
    assert ages[:4] == pytest.approx([0, 0, STEP_S, 2 * STEP_S])
    assert 0 < ages[5] < ages[4] < STEP_S  # a gap counts for a while


def test_a_sample_that_is_late_comes_with_the_time_between_it_and_its_neighbours():
    observer = Steps()
    hold = SampleHold(observer)
    late_s = {1: 0.005, 4: 0.003, 5: 0.003}
    ages = []
    for k, fresh in enumerate([True, True, True, False, True, True, False, True]):
        hold.update(*SAMPLE, fresh, late_s.get(k, 0.0))
        ages.append(hold.age_s)
    expected = [0.017, 0.022, 0.012, 0.037, 0.017, 0.031]
    assert observer.steps_s == pytest.approx(expected)
    assert ages[1] == ages[2] == 0.0, "no data was missing"
    assert (ages[3], ages[6]) == pytest.approx((0.017, 0.014))


def test_time_never_runs_backwards_after_a_leap_of_the_clock():
    observer = Steps()
    hold = SampleHold(observer)
    for late_s in (0.0, 5.0, 0.0, -3.0, 0.0):
        hold.update(*SAMPLE, True, late_s)
    follow(observer, [True, *[False] * 1000, True])  # a long silence costs no long computation
    assert all(0.0 < step_s < 2.0 for step_s in observer.steps_s)


def test_other_estimators_take_every_sample():
    counter = Steps()
    counter.waits_for_fresh = False
    answers = follow(counter, [True, False, True])
    assert counter.steps_s == [STEP_S] * 3 and [age_s for _, age_s in answers] == [0, 0, 0]


def test_a_missed_slot_counts_as_a_gap_until_a_reset():
    hold = SampleHold(Steps())
    hold.update(*SAMPLE, True)
    hold.update(*SAMPLE[:2], 3 * STEP_S, True)
    assert hold.age_s > 0
    hold.reset()
    hold.update(*SAMPLE, True)
    assert hold.age_s == 0
