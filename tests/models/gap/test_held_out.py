"""Errors on what was left out: which trials go together, and what counts as a lower error."""

from types import SimpleNamespace

import numpy as np
import pytest

from models.gap.estimation.noise_floor import NoiseFloor
from models.gap.search.held_out import (
    HeldOutErrors,
    SquaredError,
    flattened,
    held_out_folds,
    is_written,
    lowers_held_out_error,
)
from models.plant.identification.residual_spectra import FitParameter
from models.plant.identification.trial_spectra import TrialGroup
from models.plant.plant import read_plant

ROWS = 100


def errors_of(*folds):
    """Errors whose root mean square is given by signal, for each fold of 100 rows."""
    return HeldOutErrors(
        tuple({s: SquaredError(ROWS * rms**2, ROWS) for s, rms in fold.items()} for fold in folds)
    )


@pytest.mark.parametrize(
    ("conditions", "folds"),
    [
        (
            [{"payload_kg": kg} for kg in (0.0, 1.0, 0.0, 1.0)],
            {"payloads": [[0, 2], [1, 3]]},
        ),
        (
            [{"payload_kg": kg, "motion": m} for kg, m in ((0.0, "a"), (0.0, "b"), (1.0, "b"))],
            {"payloads": [[0, 1], [2]], "motions": [[0], [1, 2]]},
        ),
        ([{}, {}, {}], {"repetitions": [[0], [1], [2]]}),
    ],
    ids=["payloads", "payloads and motions", "repetitions"],
)
def test_trials_that_share_a_property_are_left_out_together(make_trial, conditions, folds):
    trials = [
        make_trial(np.zeros(50), name=f"trial_{k}", **row) for k, row in enumerate(conditions)
    ]
    found = held_out_folds(trials)
    assert {name: [sorted(fold) for fold in rows] for name, rows in found.items()} == folds
    assert all(
        np.all(rows == 1) for row in found.values() for fold in row for rows in fold.values()
    )


def test_errors_of_folds_are_pooled_by_their_rows():
    folds = HeldOutErrors(({"x": SquaredError(4.0, 1)}, {"x": SquaredError(5.0, 8)}, {}))
    assert folds.rms() == {"x": pytest.approx(1.0)}


def test_models_are_compared_by_the_geometric_mean_over_signals():
    one, other = errors_of({"x": 0.5, "y": 0.02}), errors_of({"x": 1.0, "y": 0.01})
    assert one.ratios(other) == {"x": pytest.approx(0.5), "y": pytest.approx(2.0)}
    assert one.fraction_of(other) == pytest.approx(1.0)
    assert errors_of({"x": np.inf}).fraction_of(other) > 1e3
    nothing = errors_of({"x": 0.0})
    assert nothing.fraction_of(nothing) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("fractions", "is_further", "lowers"),
    [
        ((0.8, 0.8, 0.8), False, True),
        ((1.2, 1.2, 1.2), False, False),
        ((0.98, 0.98, 0.98), False, False),
        ((0.95, 0.96, 0.95), False, True),
        ((0.3, 1.0, 1.05), False, False),  # Mean fall 0.38, standard error 0.41
        ((0.9, 0.7), False, True),  # Mean fall 0.23, standard error 0.13
        ((0.9, 0.7), True, False),  # Student's t of one degree of freedom is 12.7
        ((0.8, 0.79, 0.81, 0.8), True, True),
        ((0.9,), True, True),
    ],
)
def test_an_effect_lowers_the_error_by_more_than_chance(fractions, is_further, lowers):
    """Errors of each fold with the effect, as fractions of those without it."""
    with_ = errors_of(*({"x": f} for f in fractions))
    without = errors_of(*({"x": 1.0} for _ in fractions))
    assert bool(lowers_held_out_error(with_, without, is_further)) is lowers


CLOCK = {"sync_offset_s": 1.0}


@pytest.mark.parametrize(
    ("added", "written"),
    [((), [True, False, False, True]), (("sync_offset",), [True, False, True, True])],
)
def test_a_clock_is_written_with_its_effect_and_variation_never(added, written):
    parameters = [
        FitParameter("link_mass_kg", "nuisance", {"link_mass_kg": 0.6}),
        FitParameter("pressure", "trial", {"link_mass_kg": 0.6}, trial=0),
        FitParameter("synchronisation", "nuisance", CLOCK),
        FitParameter("sync_offset_s", "effect", CLOCK, effect="sync_offset"),
    ]
    residuals = SimpleNamespace(fit_parameters=parameters)
    free = np.array([q.effect in ("", *added) for q in parameters])
    plant = read_plant()
    assert [is_written(plant, residuals, k, free) for k in range(len(parameters))] == written


def test_a_flat_floor_has_the_residuals_own_power_in_each_signal():
    floor = NoiseFloor(
        np.array([0.0, 30.0]), {s: np.array([4.0, 1.0]) for s in "xy"},
        {s: np.zeros(2) for s in "xy"},
    )  # fmt: skip
    group = TrialGroup("motion", (0, 1), ("x", "y"), 3)
    rows = np.stack([np.full((2, 3), 2.0), np.full((2, 3), 5.0)], axis=1)
    noise = flattened(floor, [group], [rows]).noise
    assert {s: list(power) for s, power in noise.items()} == {"x": [4.0, 4.0], "y": [25.0, 25.0]}
