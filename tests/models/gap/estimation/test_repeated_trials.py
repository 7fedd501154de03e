"""Noise of repetitions at hand, pooled with that of the floor."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from models.gap.estimation.fitted_floor import with_amplified_scatter, with_repeated_trials
from models.gap.estimation.noise_floor import NoiseFloor
from models.plant.identification.noise_floor import (
    TrialGroup,
    floor_from_residuals,
    trial_group_key,
)

SIZE = 155
DEVIATION_HERE = {0.0: 1.0, 2.0: 10.0}
"""In the trials at hand; 1 in those of the floor."""


def residual_rows(rng, trials, deviation):
    """Residual spectra, (trials, 1, K): noise by payload on an error that repeats."""
    standing = {p: 5.0 * rng.standard_normal(SIZE) for p in deviation}
    return np.array([
        [standing[t.meta.payload_kg] + deviation[t.meta.payload_kg] * rng.standard_normal(SIZE)]
        for t in trials
    ])  # fmt: skip


@pytest.fixture
def trials(make_trial):
    """Two repetitions without and two with a payload."""
    return [
        make_trial(np.zeros(600), payload_kg=payload, trial=number)
        for payload in DEVIATION_HERE
        for number in (1, 2)
    ]


def floor_and_residuals(rng, trials, kept):
    """Floor of noise of one, and the residuals of some of the trials."""
    key = trial_group_key(trials[0])
    group = TrialGroup(key, tuple(range(len(trials))), ("x",), SIZE)
    rows = residual_rows(rng, trials, dict.fromkeys(DEVIATION_HERE, 1.0))
    floor = NoiseFloor.of(floor_from_residuals([group], trials, [rows]))
    own = [trials[k] for k in kept]
    group = replace(group, trials=tuple(range(len(own))))
    return floor, SimpleNamespace(groups=[group], trials=own)


def noise_power(floor, payload_kg, hz):
    """Mean noise of a floor at a payload."""
    noise = np.interp(hz, floor.frequency_hz, floor.noise["x"])
    return float(np.mean(noise * floor.ratios.noise_at("x", payload_kg, hz)))


@pytest.mark.parametrize("seed", range(8))
def test_noise_is_the_mean_of_both_estimates_where_each_has_two_trials(trials, seed):
    rng = np.random.default_rng(seed)
    floor, residuals = floor_and_residuals(rng, trials, range(4))
    rows = residual_rows(rng, trials, DEVIATION_HERE)
    pooled = with_repeated_trials(floor, residuals, [rows])
    hz = np.linspace(0.5, 7.5, 50)
    assert noise_power(pooled, 0.0, hz) == pytest.approx(1.0, rel=0.5)
    assert noise_power(pooled, 2.0, hz) == pytest.approx((1.0 + 100.0) / 2, rel=0.5)


def test_an_error_that_repeats_is_no_noise(trials):
    rng = np.random.default_rng(0)
    floor, residuals = floor_and_residuals(rng, trials, range(4))
    rows = residual_rows(rng, trials, DEVIATION_HERE)
    shifted = rows + 100 * rng.standard_normal(SIZE)
    hz = np.linspace(0.5, 7.5, 50)
    noise = [
        noise_power(with_repeated_trials(floor, residuals, [r]), 2.0, hz) for r in (rows, shifted)
    ]
    assert noise[1] == pytest.approx(noise[0])


def test_one_trial_of_each_payload_leaves_the_floor_as_it_was(trials):
    rng = np.random.default_rng(0)
    floor, residuals = floor_and_residuals(rng, trials, (0, 2))
    pooled = with_repeated_trials(
        floor, residuals, [residual_rows(rng, residuals.trials, DEVIATION_HERE)]
    )
    hz = floor.ratios.frequency_hz
    for payload_kg in DEVIATION_HERE:
        before = noise_power(floor, payload_kg, hz)
        assert noise_power(pooled, payload_kg, hz) == pytest.approx(before, rel=0.02)


def test_a_floor_of_these_very_trials_is_not_pooled_with_them(trials):
    rng = np.random.default_rng(0)
    floor, residuals = floor_and_residuals(rng, trials, range(4))
    floor = replace(floor, learned=False)
    rows = [residual_rows(rng, trials, DEVIATION_HERE)]
    assert with_repeated_trials(floor, residuals, rows) is floor


@pytest.mark.parametrize("seed", range(8))
def test_noise_and_own_error_grow_at_the_payload_whose_repetitions_scatter(trials, seed):
    rng = np.random.default_rng(seed)
    floor, residuals = floor_and_residuals(rng, trials, range(4))
    rows = residual_rows(rng, trials, DEVIATION_HERE)
    grown = with_amplified_scatter(floor, residuals, [rows])
    assert set(grown.amplification_power) == {2.0}
    assert grown.amplification_power[2.0] == pytest.approx((1.0 + 100.0) / 2, rel=0.5)
    (group,) = residuals.groups
    larger = rows.copy()
    larger[2:] *= np.sqrt(grown.amplification_power[2.0])
    before, after = (
        np.einsum("skij,jsk->isk", f.whitener(group, trials), r)
        for f, r in ((floor, rows), (grown, larger))
    )
    assert after == pytest.approx(before, rel=1e-6, abs=1e-9)


@pytest.mark.parametrize("seed", range(8))
def test_repetitions_that_differ_as_expected_leave_the_floor_as_it_was(trials, seed):
    rng = np.random.default_rng(seed)
    floor, residuals = floor_and_residuals(rng, trials, range(4))
    rows = residual_rows(rng, trials, dict.fromkeys(DEVIATION_HERE, 1.0))
    assert not with_amplified_scatter(floor, residuals, [rows]).amplification_power
    single, residuals = floor_and_residuals(rng, trials, (0, 2))
    rows = residual_rows(rng, residuals.trials, DEVIATION_HERE)
    assert not with_amplified_scatter(single, residuals, [rows]).amplification_power
