"""Strength consistency: its distribution on a linear model, and stand-ins on simulated trials."""

from dataclasses import dataclass, field
from itertools import pairwise

import msgspec
import numpy as np
import pytest
from scipy.stats import binom, kstest

from models.gap.diagnosis import all_fit_parameters
from models.gap.estimation.gauss_newton import GaussNewton
from models.gap.estimation.noise_floor import NoiseFloor
from models.gap.estimation.noise_floor_fit import noise_floor_of
from models.gap.residuals.fit_parameters import FitParameter
from models.gap.residuals.residuals import Residuals
from models.gap.search.strength_consistency import strength_consistency_of
from models.gap.settings import DEFAULT_SETTINGS, GapSettings
from models.plant.identification.noise_floor import TrialGroup

EFFECTS = ("dead_time", "viscous_friction", "current_bias", "unmodelled_payload")
STRICT = msgspec.structs.replace(DEFAULT_SETTINGS, tolerated_difference_fraction=0.0)
"""No difference of the strengths is tolerated: the probability is that of noise alone."""

SIZE, SIGNALS, PAYLOADS_KG = 64, ("x", "y"), (0.0, 1.0, 2.0)
BLOCKS = len(SIGNALS) * len(PAYLOADS_KG) * DEFAULT_SETTINGS.consistency_bands
INFORMATION = 400.0
"""Of each block: its strength has a standard error of 1/20."""
SEEDS = 300


@dataclass
class LinearResiduals:
    """Residuals that are linear in one effect, of which every block has the same information."""

    trials: list
    rows: np.ndarray
    effect: np.ndarray
    settings: GapSettings = DEFAULT_SETTINGS
    plant: object = None
    fit_parameters: tuple = (FitParameter("strength", "effect", effect="effect"),)
    groups: list = field(init=False)

    def __post_init__(self):
        self.groups = [TrialGroup("linear", tuple(range(len(self.trials))), SIGNALS, SIZE)]

    def as_counted(self, group, spectra):
        return spectra

    def residuals(self, values):
        return [self.rows - values[0] * self.effect]

    def jacobian(self, values, wanted):
        return [self.effect[..., None]]


def bands():
    edges = np.round(np.geomspace(1, SIZE, DEFAULT_SETTINGS.consistency_bands + 1)).astype(int)
    edges[0] = 0
    return [slice(a, b) for a, b in pairwise(edges)]


@pytest.fixture
def linear(make_trial):
    """Function (rng, differences of the blocks' strengths, settings) -> strength consistency."""
    trials = [make_trial(np.zeros(SIZE), payload_kg=p) for p in PAYLOADS_KG]
    shape = (len(trials), len(SIGNALS), SIZE)
    hz = np.array([0.0, 1e3])
    unit = NoiseFloor(hz, {s: np.ones(2) for s in SIGNALS}, {s: np.zeros(2) for s in SIGNALS},
                      learned=False)  # fmt: skip

    def run(rng, differences, settings):
        effect, rows = np.empty(shape), rng.standard_normal(shape)
        blocks = iter(differences)
        for a in range(shape[0]):
            for b in range(shape[1]):
                for band in bands():
                    drawn = rng.standard_normal(band.stop - band.start)
                    effect[a, b, band] = drawn * np.sqrt(INFORMATION / np.sum(drawn**2))
                    rows[a, b, band] += (1 + next(blocks)) * effect[a, b, band]
        estimator = GaussNewton(LinearResiduals(trials, rows, effect, settings), unit)
        free = np.array([True])
        point = estimator.fit(estimator.start(), free)
        return strength_consistency_of(estimator, point, free, free)

    return run


def test_the_probability_of_equal_strengths_is_uniform(linear):
    """By definition of a probability; the rank of the blocks is one less than their number."""
    rng = np.random.default_rng(0)
    found = [linear(rng, np.zeros(BLOCKS), STRICT) for _ in range(SEEDS)]
    assert kstest([c.probability for c in found], "uniform").pvalue > 1e-3


def test_the_standard_deviation_is_that_of_the_strengths(linear):
    """Mean of D² over many seeds, beside the differences that were put in and its standard error.

    With n blocks of equal information, the common strength refitted, D² = Σ δ² / (n − 1).
    """
    rng = np.random.default_rng(1)
    for size in (0.0, 0.1, 0.4):
        differences = size * np.resize([1.0, -1.0], BLOCKS)
        expected = BLOCKS * size**2 / (BLOCKS - 1)
        squares = [
            linear(rng, differences, STRICT).standard_deviation ** 2 for _ in range(SEEDS)
        ]  # clipped at zero: without differences half of them lie above
        error = np.std(squares) / np.sqrt(SEEDS)
        clipped = np.sqrt(2 / (BLOCKS - 1)) / INFORMATION if size == 0 else 0.0
        assert abs(np.mean(squares) - expected) < 4 * error + clipped + 0.01 * expected


def test_differences_within_the_tolerance_are_refused_no_more_often_than_by_chance(linear):
    """Refusals are binomial with the probability of the settings, or fewer."""
    rng = np.random.default_rng(2)
    tolerated, chance = (
        DEFAULT_SETTINGS.tolerated_difference_fraction, DEFAULT_SETTINGS.inconsistency_probability
    )  # fmt: skip
    refused = sum(
        not linear(rng, tolerated * rng.standard_normal(BLOCKS), DEFAULT_SETTINGS).holds
        for _ in range(SEEDS)
    )
    assert refused <= binom.ppf(0.999, SEEDS, chance)


def test_differences_of_four_times_the_tolerance_are_always_refused(linear):
    rng = np.random.default_rng(3)
    tolerated = DEFAULT_SETTINGS.tolerated_difference_fraction
    differences = 4 * tolerated * np.resize([1.0, -1.0], BLOCKS)
    assert not any(linear(rng, differences, DEFAULT_SETTINGS).holds for _ in range(30))


@pytest.fixture(scope="module")
def fitted(two_cycles, trials_of):
    """Function (hidden parameter and change, named effect, seed) -> fit of the named effect."""

    plant, _ = two_cycles

    def fit(hidden, change, named, seed=11):
        full = plant.with_effects(*EFFECTS)
        value = full.parameters[hidden].value + change
        trials = trials_of(full.with_values({hidden: value}), seed, cycles=2)
        parameters = all_fit_parameters(plant, trials, EFFECTS)
        estimator = GaussNewton(
            Residuals(plant, trials.trials, parameters), noise_floor_of(plant, 1)
        )
        own = np.array([q.effect == named for q in parameters])
        free = own | np.array([q.kind != "effect" for q in parameters])
        point = estimator.fit(estimator.start(), free)
        return strength_consistency_of(estimator, point, free, own)

    return fit


@pytest.mark.parametrize(
    ("hidden", "change", "named"),
    [
        ("dead_time_1_s", 0.02, "dead_time"),
        ("viscous_friction_1_nm_s_rad", 3.0, "viscous_friction"),
        ("current_bias_1_a", 0.2, "current_bias"),
    ],
)
def test_the_strength_of_an_effect_that_is_there_is_the_same_everywhere(
    fitted, variation, hidden, change, named
):
    """It differs by less than trials do by construction: friction by 5 %, pressure by 1 %."""
    for seed in (11, 12, 13):
        found = fitted(hidden, change, named, seed)
        assert found.holds
        assert found.standard_deviation < variation["friction"]


@pytest.mark.parametrize("seed", [11, 12, 13])
def test_the_strength_of_a_stand_in_is_not(fitted, seed):
    """Friction for a delay. What the nuisance can take up, like a payload, leaves no stand-in."""
    found = fitted("dead_time_1_s", 0.02, "viscous_friction", seed)
    assert not found.holds
    assert found.standard_deviation > found.tolerated


def test_noise_alone_does_not_make_a_strength_inconsistent(fitted):
    """Nothing hidden: whatever small strength is fitted may differ, but not beyond chance."""
    for seed in range(20, 26):
        assert fitted("current_bias_1_a", 0.0, "current_bias", seed).holds
