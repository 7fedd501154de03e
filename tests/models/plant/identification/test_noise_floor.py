"""Noise floor of an identification: its trials, and how it grows with the payload."""

import numpy as np
import pytest

from firmware_py.core.errors import InputError
from firmware_py.core.motion import Motion
from models.plant.identification.noise_floor import payload_ratios
from models.plant.identification.trial_spectra import aligned, check_duration
from models.trials.trial import TrialSet

MOTION = Motion("sinusoid", period_s=2.0)
STEP_S = 0.017
HZ = np.arange(155) * 0.0516


def spectra(rng, repetitions, deviation, error):
    """Residual spectra of repeated trials: noise of a deviation, and an error that repeats."""
    standing = error * rng.standard_normal((1, 2, len(HZ)))
    return standing + deviation * rng.standard_normal((repetitions, 2, len(HZ)))


def test_noise_and_model_error_are_separated_by_payload():
    rng = np.random.default_rng(0)
    parts = {0.0: spectra(rng, 4, 1.0, 10.0), 2.0: spectra(rng, 4, 5.0, 10.0)}
    ratios = payload_ratios(HZ, ["tip_x_m", "di"], parts)
    for at, expected in ((ratios.noise_at, 25.0), (ratios.model_at, 1.0)):
        light, middle, heavy, beyond = (np.mean(at("di", p, HZ)) for p in (0.0, 1.0, 2.0, 3.0))
        assert heavy / light == pytest.approx(expected, rel=0.5)
        assert min(light, heavy) <= middle <= max(light, heavy) and beyond == heavy


def test_a_trial_below_three_quarters_of_a_second_is_refused(make_trial):
    """Its spectrum up to 8 Hz would have fewer coefficients than three bands of four."""
    check_duration(make_trial(np.zeros(50), step_s=0.017, rest_samples=0))
    with pytest.raises(InputError, match=r"give at least 0\.75 s"):
        check_duration(make_trial(np.zeros(40), step_s=0.017, rest_samples=0))


@pytest.fixture
def recorded(make_trial):
    def recorded(rest, end=0, stated_rest=None):
        rows = np.arange(rest + round(MOTION.duration_s / STEP_S) + end) - rest
        return make_trial(
            MOTION.goal_rad(rows * STEP_S), motion="sinusoid", period_s=2.0,
            amplitude_rad=MOTION.amplitude_rad,
            rest_samples=rest if stated_rest is None else stated_rest,
        )  # fmt: skip

    return recorded


def test_rests_and_ends_of_a_motion_become_equal(recorded):
    trials = aligned(TrialSet((recorded(40, 9), recorded(25, 12), recorded(61, 3, 60))))
    assert {t.meta.rest_samples for t in trials} == {25}
    first = trials[0].goal_rad
    assert all(np.array_equal(t.goal_rad, first) for t in trials)
    assert len(first) == 25 + round(MOTION.duration_s / STEP_S) + 3


def test_a_trial_that_was_broken_off_does_not_shorten_the_others(recorded):
    whole, broken_off = recorded(40), recorded(30, -100)
    long, short = aligned(TrialSet((whole, broken_off)))
    assert len(long) == len(whole) - 10 and len(short) == len(broken_off)
