"""The noise floor: slow noise whitened, repeated errors weighed once, written and read."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from firmware_py.core.errors import InputError
from models.gap.estimation import noise_floor
from models.gap.estimation.fitted_floor import noise_floor_of
from models.plant.document import FloorRecord
from models.plant.identification.noise_floor import (
    TrialGroup,
    coefficient_count,
    cosine_transform,
    floor_from_residuals,
    inverse_cosine_transform,
    trial_group_key,
    with_noise_floor,
)

COUNT, STEP_S = 512, 0.017


def ar_noise(rng, trials, pole):
    """Autoregressive noise of variance one, (trials, COUNT)."""
    rows = np.empty((trials, COUNT))
    rows[:, 0] = rng.standard_normal(trials)
    for k in range(1, COUNT):
        rows[:, k] = pole * rows[:, k - 1] + np.sqrt(1 - pole**2) * rng.standard_normal(trials)
    return rows


def group_of(trials):
    """The only group of trials of one motion with a signal x."""
    size = coefficient_count(COUNT, STEP_S)
    return TrialGroup(trial_group_key(trials[0]), tuple(range(len(trials))), ("x",), size)


def spectra(rows):
    """(trials, 1, K)."""
    size = coefficient_count(COUNT, STEP_S)
    return cosine_transform(rows.T, size).T[:, None]


@pytest.fixture
def trials(make_trial):
    """Four repetitions of one condition and four of another."""
    rest = np.zeros(COUNT)
    return [
        make_trial(rest, payload_kg=payload, trial=number)
        for payload in (0.0, 1.0)
        for number in range(4)
    ]


@pytest.mark.parametrize("pole", [0.0, 0.9, 0.98])
def test_whitened_noise_has_unit_variance_however_slow_it_is(trials, pole):
    rng = np.random.default_rng(3)
    group = group_of(trials)
    rows = spectra(ar_noise(rng, 8, pole))
    floor = noise_floor.NoiseFloor.of(floor_from_residuals([group], trials, [rows]))
    fresh = replace(floor, curves={}, model={"x": np.zeros_like(floor.noise["x"])})
    whitener = fresh.whitener(group, trials)
    white = np.einsum("skij,jsk->isk", whitener, spectra(ar_noise(rng, 8, pole)))
    assert np.mean(white**2) == pytest.approx(1.0, abs=0.35)


def test_an_error_that_repeats_is_found_as_the_models(trials):
    rng = np.random.default_rng(4)
    group = group_of(trials)
    error = 3.0 * np.sin(2 * np.pi * 1.0 * STEP_S * np.arange(COUNT))
    rows = spectra(ar_noise(rng, 8, 0.0) + error)
    floor = noise_floor.NoiseFloor.of(floor_from_residuals([group], trials, [rows]))
    assert np.max(floor.model["x"]) > 20 * np.max(floor.noise["x"])
    mean = floor.mean(group, trials)[0, 0]
    assert np.std(inverse_cosine_transform(mean, COUNT) - error) < 0.8


def test_repeating_a_trial_does_not_multiply_the_evidence_of_a_shared_error(trials):
    hz = np.array([0.0, 30.0])
    floor = noise_floor.NoiseFloor(hz, {"x": np.full(2, 1e-4)}, {"x": np.ones(2)})
    four = group_of(trials[:4])
    one = replace(four, trials=(0,))
    bump = np.ones((4, 1, four.coefficients))
    squares = [
        np.sum(np.einsum("skij,jsk->isk", floor.whitener(g, trials), bump[: len(g.trials)]) ** 2)
        for g in (one, four)
    ]
    assert squares[1] == pytest.approx(squares[0], rel=1e-3)


def test_the_plant_file_carries_the_floor(plant, tmp_path):
    from models.plant.plant import read_plant

    plant.write(tmp_path / "plant.json")
    again = noise_floor_of(read_plant(tmp_path / "plant.json"), 1)
    first = noise_floor_of(plant, 1)
    assert again.noise.keys() == first.noise.keys()
    assert np.allclose(again.noise["tip_x_m"], first.noise["tip_x_m"], rtol=1e-3)
    assert again.curves.keys() == first.curves.keys()
    assert noise_floor_of(plant, 2) is None


def test_the_learned_noise_is_that_which_was_put_in(plant):
    floor = noise_floor_of(plant, 1)
    fast = floor.frequency_hz > 4
    assert np.sqrt(np.mean(floor.noise["tip_z_m"][fast])) == pytest.approx(2e-4, rel=0.25)
    assert np.sqrt(np.mean(floor.noise["current_1_a"][fast])) < 0.025


@pytest.mark.parametrize(
    "damage",
    [
        {"repeats": -1},
        {"frequency_hz": "0 1"},
        {"noise": {"x": "0 one"}},
        {"noise": {}},
        {"model": {"x": "-1 -1"}},
    ],
)
def test_a_damaged_floor_is_refused_in_one_sentence(plant, damage):
    record = FloorRecord(frequency_hz="0 1 2", repeats=2, noise={"x": "1 1 1"},
                         model={"x": "1 1 1"}, curves={}, rest_s={},
                         payload_ratio_hz="0", noise_ratio={}, model_ratio={})  # fmt: skip
    good, bad = (
        replace(plant, provenance=msgspec.structs.replace(plant.provenance, noise_floor={"1": own}))
        for own in (record, msgspec.structs.replace(record, **damage))
    )
    assert noise_floor_of(good, 1).noise["x"].tolist() == [1.0, 1.0, 1.0]
    with pytest.raises(InputError, match=r"noise_floor\.1 is damaged"):
        noise_floor_of(bad, 1)


def test_trials_without_repetition_leave_no_floor(plant):
    from models.plant.plant import read_plant

    single = with_noise_floor(read_plant(), [])
    assert single.provenance.noise_floor == {}
