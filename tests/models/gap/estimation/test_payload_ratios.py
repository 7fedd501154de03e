"""Noise floor that grows with the payload."""

import numpy as np
import pytest

from models.plant.identification.noise_floor import NO_RATIOS, payload_ratios

HZ = np.arange(155) * 0.0516


def spectra(rng, repetitions, deviation, error):
    """Residual spectra of repeated trials: noise of a deviation, and an error that repeats."""
    standing = error * rng.standard_normal((1, 2, len(HZ)))
    return standing + deviation * rng.standard_normal((repetitions, 2, len(HZ)))


@pytest.mark.parametrize("seed", range(5))
def test_noise_and_own_error_are_told_by_payload(seed):
    rng = np.random.default_rng(seed)
    parts = {0.0: spectra(rng, 4, 1.0, 10.0), 2.0: spectra(rng, 4, 5.0, 10.0)}
    ratios = payload_ratios(HZ, ["tip_x_m", "di"], parts)
    for signal in ("tip_x_m", "di"):
        light, heavy = (np.mean(ratios.noise_at(signal, p, HZ)) for p in (0.0, 2.0))
        assert heavy / light == pytest.approx(25.0, rel=0.5)
        light, heavy = (np.mean(ratios.model_at(signal, p, HZ)) for p in (0.0, 2.0))
        assert heavy / light == pytest.approx(1.0, rel=0.5)


def test_the_mean_over_payloads_is_the_common_floor():
    rng = np.random.default_rng(0)
    parts = {p: spectra(rng, 3, 1.0 + p, 0.0) for p in (0.0, 1.0, 2.0)}
    ratios = payload_ratios(HZ, ["tip_x_m", "di"], parts)
    mean = np.mean([ratios.noise_at("di", p, HZ) for p in parts], axis=0)
    assert mean == pytest.approx(np.ones(len(HZ)), abs=0.1)


def test_a_payload_between_two_others_has_a_ratio_between_theirs_and_one_beyond_the_last():
    rng = np.random.default_rng(0)
    parts = {0.0: spectra(rng, 4, 1.0, 0.0), 2.0: spectra(rng, 4, 4.0, 0.0)}
    at = {
        p: float(np.mean(payload_ratios(HZ, ["a", "b"], parts).noise_at("a", p, HZ)))
        for p in (0.0, 1.0, 2.0, 3.0)
    }
    assert at[0.0] < at[1.0] < at[2.0] == at[3.0]


@pytest.mark.parametrize(
    "parts", [{0.0: np.ones((4, 1, 155))}, {0.0: np.ones((2, 1, 155)), 1.0: np.ones((1, 1, 155))}]
)
def test_one_payload_or_one_repetition_tells_no_ratio(parts):
    ratios = payload_ratios(HZ, ["a"], parts)
    assert ratios is NO_RATIOS
    assert ratios.noise_at("a", 1.0, HZ) == pytest.approx(np.ones(len(HZ)))
