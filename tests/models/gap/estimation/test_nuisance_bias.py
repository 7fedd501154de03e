"""Bias of the nuisance: trials that all differ alike hide an effect, chance does not."""

import numpy as np
import pytest

from models.gap.estimation.gauss_newton import FitPoint
from models.gap.estimation.nuisance_bias import excessive_nuisance_bias, nuisance_biases
from models.gap.residuals.fit_parameters import FitParameter
from models.gap.settings import DEFAULT_SETTINGS, GapSettings

TRIALS = 6
PARAMETERS = [
    FitParameter(name, "trial", {}, outputs, deviation, trial=t)
    for t in range(TRIALS)
    for name, outputs, deviation in (
        ("eccentricity_m", {}, 0.003), ("frame_m", {"tip_x_m": 1.0}, 3e-4), ("friction", {}, 0.05),
        ("pressure", {}, 0.01), ("sync_s", {}, 0.002),
    )
] + [FitParameter("link_mass_kg", "nuisance", {}, {}, 0.1)]  # fmt: skip
DEVIATION = np.array([q.standard_deviation for q in PARAMETERS])


def point(values):
    return FitPoint(values, 0.0, [])


def test_chance_is_standard_normal_and_is_never_a_bias():
    rng = np.random.default_rng(11)
    drawn = []
    for _ in range(400):
        values = DEVIATION * rng.standard_normal(len(PARAMETERS))
        drawn.append(nuisance_biases(PARAMETERS, point(values)))
    assert set(drawn[0]) == {"eccentricity_m", "frame_m tip_x_m", "friction"}, (
        "no nuisance of all, no clock"
    )
    every = np.array([list(z.values()) for z in drawn])
    assert abs(every.mean()) < 0.15 and abs(every.std() - 1) < 0.1
    assert np.abs(every).max() < DEFAULT_SETTINGS.nuisance_bias_limit_sd


def test_what_all_trials_share_adds_up_and_what_cancels_does_not():
    values = np.zeros(len(PARAMETERS))
    own = np.array([q.name == "eccentricity_m" for q in PARAMETERS])
    values[own] = 6 * 0.003
    assert excessive_nuisance_bias(PARAMETERS, point(values)) == pytest.approx(
        {"eccentricity_m": 6 * TRIALS**0.5}
    )
    values[own] *= np.resize([1.0, -1.0], TRIALS)
    assert not excessive_nuisance_bias(PARAMETERS, point(values))


def test_pressure_is_judged_on_the_same_link_alone():
    """A link that is stiffer throughout differs in all trials alike, and is no effect."""
    same = GapSettings(same_link=True)
    assert "pressure" in nuisance_biases(PARAMETERS, point(DEVIATION), same)
    assert "pressure" not in nuisance_biases(PARAMETERS, point(DEVIATION))
