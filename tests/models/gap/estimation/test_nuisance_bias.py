"""Trials that all differ alike hide an effect; trials that differ by chance do not."""

import numpy as np
import pytest

from models.gap.estimation.gauss_newton import FitPoint
from models.gap.estimation.nuisance_bias import STRAINED, excessive_nuisance_bias, nuisance_biases
from models.gap.residuals.fit_parameters import FitParameter

TRIALS = 6
KNOBS = [
    FitParameter(name, "trial", {}, outputs, spread, trial=t)
    for t in range(TRIALS)
    for name, outputs, spread in (
        ("eccentricity_m", {}, 0.003), ("frame_m", {"tip_x_m": 1.0}, 3e-4), ("sync_s", {}, 0.002),
    )
] + [FitParameter("link_mass_kg", "nuisance", {}, {}, 0.1)]  # fmt: skip
SPREAD = np.array([k.spread for k in KNOBS])


def point(values):
    return FitPoint(values, 0.0, [])


def test_chance_is_standard_normal_and_never_strains():
    rng = np.random.default_rng(11)
    drawn = [
        nuisance_biases(KNOBS, point(SPREAD * rng.standard_normal(len(KNOBS)))) for _ in range(400)
    ]
    assert set(drawn[0]) == {"eccentricity_m", "frame_m tip_x_m", "sync_s"}, "no nuisance of all"
    every = np.array([list(z.values()) for z in drawn])
    assert abs(every.mean()) < 0.15 and abs(every.std() - 1) < 0.1
    assert np.abs(every).max() < STRAINED


def test_what_all_trials_share_adds_up_and_what_cancels_does_not():
    values = np.zeros(len(KNOBS))
    own = np.array([k.name == "eccentricity_m" for k in KNOBS])
    values[own] = 4 * 0.003
    assert excessive_nuisance_bias(KNOBS, point(values)) == pytest.approx(
        {"eccentricity_m": 4 * TRIALS**0.5}
    )
    values[own] *= np.resize([1.0, -1.0], TRIALS)
    assert not excessive_nuisance_bias(KNOBS, point(values))
