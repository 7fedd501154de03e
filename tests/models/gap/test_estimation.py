"""The noise floor of an estimate, its transfer to other trials, and derivatives along a step."""

from dataclasses import replace
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest

from firmware_py.core.errors import InputError
from models.gap.estimation.fitted_floor import (
    noise_floor_for,
    noise_floor_of,
    with_amplified_scatter,
    with_repeated_trials,
)
from models.gap.estimation.gauss_newton import GaussNewton
from models.gap.estimation.noise_floor import NoiseFloor
from models.gap.estimation.transfer import transfer_weights, transferred, unknown_fraction
from models.gap.residuals.fit_parameters import all_fit_parameters
from models.gap.residuals.residuals import Residuals
from models.plant.document import FloorRecord
from models.plant.identification.noise_floor import floor_from_residuals, with_noise_floor
from models.plant.identification.trial_spectra import (
    TrialGroup,
    coefficient_count,
    cosine_transform,
    inverse_cosine_transform,
    trial_group_key,
)
from models.plant.plant import read_plant

COUNT, STEP_S = 512, 0.017


def group_of(trials, signal="x", count=None):
    """The only group of trials of one motion with one signal."""
    count = count or coefficient_count(len(trials[0]), trials[0].step_s)
    return TrialGroup(trial_group_key(trials[0]), tuple(range(len(trials))), (signal,), count)


def whitened(floor, group, trials, rows):
    return np.einsum("skij,jsk->isk", floor.whitener(group, trials), rows)


def spectra_of_noise(rng, trials, pole):
    """Spectra (trials, 1, K) of autoregressive noise of variance one."""
    rows = np.empty((trials, COUNT))
    rows[:, 0] = rng.standard_normal(trials)
    for k in range(1, COUNT):
        rows[:, k] = pole * rows[:, k - 1] + np.sqrt(1 - pole**2) * rng.standard_normal(trials)
    return cosine_transform(rows.T, coefficient_count(COUNT, STEP_S)).T[:, None]


@pytest.fixture
def trials(make_trial):
    """Four repetitions of one condition and four of another."""
    return [
        make_trial(np.zeros(COUNT), payload_kg=payload, trial=number)
        for payload in (0.0, 1.0)
        for number in range(4)
    ]


@pytest.mark.parametrize("pole", [0.0, 0.98])
def test_whitened_noise_has_unit_variance_however_slow_it_is(trials, pole):
    rng = np.random.default_rng(3)
    group, rows = group_of(trials), spectra_of_noise(rng, 8, pole)
    floor = NoiseFloor.of(floor_from_residuals([group], trials, [rows]))
    fresh = replace(floor, curves={}, model={"x": np.zeros_like(floor.noise["x"])})
    white = whitened(fresh, group, trials, spectra_of_noise(rng, 8, pole))
    assert np.mean(white**2) == pytest.approx(1.0, abs=0.35)


def test_an_error_that_repeats_is_the_models_and_not_noise(trials):
    group = group_of(trials)
    error = 3.0 * np.sin(2 * np.pi * 1.0 * STEP_S * np.arange(COUNT))
    rows = spectra_of_noise(np.random.default_rng(4), 8, 0.0)
    rows = rows + cosine_transform(error, group.coefficients)
    floor = NoiseFloor.of(floor_from_residuals([group], trials, [rows]))
    assert np.max(floor.model["x"]) > 20 * np.max(floor.noise["x"])
    mean = floor.mean(group, trials)[0, 0]
    assert np.std(inverse_cosine_transform(mean, COUNT) - error) < 0.8


def test_repeating_a_trial_does_not_multiply_the_evidence_of_a_shared_error(trials):
    floor = NoiseFloor(np.array([0.0, 30.0]), {"x": np.full(2, 1e-4)}, {"x": np.ones(2)})
    four = group_of(trials[:4])
    one = replace(four, trials=(0,))
    bump = np.ones((4, 1, four.coefficients))
    squares = [
        np.sum(whitened(floor, group, trials, bump[: len(group.trials)]) ** 2)
        for group in (one, four)
    ]
    assert squares[1] == pytest.approx(squares[0], rel=1e-3)


def test_the_plant_file_contains_the_floor_that_was_put_in(plant, tmp_path):
    plant.write(tmp_path / "plant.json")
    floor, again = noise_floor_of(plant, 1), noise_floor_of(read_plant(tmp_path / "plant.json"), 1)
    assert again.noise.keys() == floor.noise.keys() and again.curves.keys() == floor.curves.keys()
    assert np.allclose(again.noise["tip_x_m"], floor.noise["tip_x_m"], rtol=1e-3)
    fast = floor.frequency_hz > 4
    assert np.sqrt(np.mean(floor.noise["tip_z_m"][fast])) == pytest.approx(2e-4, rel=0.25)
    assert np.sqrt(np.mean(floor.noise["current_1_a"][fast])) < 0.025
    assert noise_floor_of(plant, 2) is None
    assert with_noise_floor(read_plant(), []).provenance.noise_floor == {}


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
def test_a_damaged_floor_is_refused(plant, damage):
    record = FloorRecord(frequency_hz="0 1 2", repeats=2, noise={"x": "1 1 1"},
                         model={"x": "1 1 1"}, curves={}, rest_s={},
                         payload_ratio_hz="0", noise_ratio={}, model_ratio={})  # fmt: skip

    def floor_of(record):
        provenance = msgspec.structs.replace(plant.provenance, noise_floor={"1": record})
        return noise_floor_of(replace(plant, provenance=provenance), 1)

    assert floor_of(record).noise["x"].tolist() == [1.0, 1.0, 1.0]
    with pytest.raises(InputError, match=r"noise_floor\.1 is damaged"):
        floor_of(msgspec.structs.replace(record, **damage))


# Repetitions among the diagnosed trials: their noise is 10 at 2 kg, and 1 in those of the floor

DEVIATION = {0.0: 1.0, 2.0: 10.0}
AS_EXPECTED = dict.fromkeys(DEVIATION, 1.0)
HZ = np.linspace(0.5, 7.5, 50)
SIZE = 155


@pytest.fixture
def repeated(make_trial):
    """Two repetitions without and two with a payload."""
    return [
        make_trial(np.zeros(600), payload_kg=payload, trial=number)
        for payload in DEVIATION
        for number in (1, 2)
    ]


def residual_rows(rng, trials, deviation):
    """Residual spectra, (trials, 1, K): noise by payload on an error that repeats."""
    standing = {p: 5.0 * rng.standard_normal(SIZE) for p in deviation}
    return np.array([
        [standing[t.meta.payload_kg] + deviation[t.meta.payload_kg] * rng.standard_normal(SIZE)]
        for t in trials
    ])  # fmt: skip


def floor_and_residuals(rng, trials, used=(0, 1, 2, 3)):
    """Floor of noise of one, and the residuals of some of the trials."""
    rows = residual_rows(rng, trials, AS_EXPECTED)
    group = group_of(trials, count=SIZE)
    floor = NoiseFloor.of(floor_from_residuals([group], trials, [rows]))
    some = [trials[k] for k in used]
    return floor, SimpleNamespace(groups=[group_of(some, count=SIZE)], trials=some)


def noise_power(floor, payload_kg, hz=HZ):
    noise = np.interp(hz, floor.frequency_hz, floor.noise["x"])
    return float(np.mean(noise * floor.ratios.noise_at("x", payload_kg, hz)))


def test_noise_is_the_mean_of_both_estimates_where_each_has_two_trials(repeated):
    rng = np.random.default_rng(0)
    floor, residuals = floor_and_residuals(rng, repeated)
    rows = residual_rows(rng, repeated, DEVIATION)
    pooled = with_repeated_trials(floor, residuals, [rows])
    assert noise_power(pooled, 0.0) == pytest.approx(1.0, rel=0.5)
    assert noise_power(pooled, 2.0) == pytest.approx((1.0 + 100.0) / 2, rel=0.5)
    shifted = rows + 100 * rng.standard_normal(SIZE)
    with_error = with_repeated_trials(floor, residuals, [shifted])
    assert noise_power(with_error, 2.0) == pytest.approx(noise_power(pooled, 2.0))


def test_a_floor_is_not_pooled_with_single_trials_or_with_its_own(repeated):
    rng = np.random.default_rng(0)
    floor, residuals = floor_and_residuals(rng, repeated, (0, 2))
    pooled = with_repeated_trials(
        floor, residuals, [residual_rows(rng, residuals.trials, DEVIATION)]
    )
    hz = floor.ratios.frequency_hz
    for payload_kg in DEVIATION:
        before = noise_power(floor, payload_kg, hz)
        assert noise_power(pooled, payload_kg, hz) == pytest.approx(before, rel=0.02)
    floor, residuals = floor_and_residuals(rng, repeated)
    floor = replace(floor, learned=False)
    rows = [residual_rows(rng, repeated, DEVIATION)]
    assert with_repeated_trials(floor, residuals, rows) is floor


def test_the_floor_grows_at_the_payload_whose_repetitions_scatter(repeated):
    rng = np.random.default_rng(0)
    floor, residuals = floor_and_residuals(rng, repeated)
    rows = residual_rows(rng, repeated, DEVIATION)
    grown = with_amplified_scatter(floor, residuals, [rows])
    assert set(grown.amplification_power) == {2.0}
    assert grown.amplification_power[2.0] == pytest.approx((1.0 + 100.0) / 2, rel=0.5)
    (group,) = residuals.groups
    larger = rows.copy()
    larger[2:] *= np.sqrt(grown.amplification_power[2.0])
    before, after = (whitened(f, group, repeated, r) for f, r in ((floor, rows), (grown, larger)))
    assert after == pytest.approx(before, rel=1e-6, abs=1e-9)


# Transfer of the plant's own error to other payloads, and to other trials of the same motion

REACH_KG = 1.0


def test_expected_and_unknown_error_are_those_of_drawn_errors():
    """Errors drawn with the prior correlation: mean and covariance of what the weights miss."""
    at_kg, measured_kg = np.array([0.5, 0.7, 2.5]), np.array([0.0, 1.0, 2.0])
    every = np.concatenate([at_kg, measured_kg])
    prior = np.exp(-np.abs(every[:, None] - every) / REACH_KG)
    drawn = np.linalg.cholesky(prior) @ np.random.default_rng(0).standard_normal((6, 200_000))
    missed = drawn[:3] - transfer_weights(at_kg, measured_kg, REACH_KG) @ drawn[3:]
    assert np.cov(missed) == pytest.approx(unknown_fraction(at_kg, measured_kg, REACH_KG), abs=0.01)
    assert np.corrcoef(missed, drawn[3:])[:3, 3:] == pytest.approx(0.0, abs=0.01)


PERIOD_S, REST = 2.0, 40


@pytest.fixture
def trial_of(make_trial):
    def make(rows=300, step_s=STEP_S, rest=REST, periodic=True):
        time_s = step_s * (np.arange(rows) - rest)
        angle = 0.5 * np.sin(2 * np.pi * np.maximum(time_s, 0) / PERIOD_S)
        if not periodic:
            angle = np.where(time_s > 3.5, 0.0, angle)
        return make_trial(angle, step_s=step_s, rest_samples=rest, period_s=PERIOD_S)

    return make


def error_spectrum(trial):
    """Spectrum of a smooth error that starts with the motion and repeats with it."""
    moving_s = np.maximum(trial.step_s * (np.arange(len(trial)) - trial.meta.rest_samples), 0.0)
    turn = 2 * np.pi * moving_s / PERIOD_S
    error = np.sin(turn) + 0.3 * (1 - np.cos(3 * turn))
    return cosine_transform(error, group_of([trial]).coefficients)


def carried(known, new):
    spectrum, count = error_spectrum(known)[None], group_of([new]).coefficients
    return transferred(spectrum, trial_group_key(known), REST * STEP_S, new, count)


@pytest.mark.parametrize(
    "other",
    [{"rows": 270}, {"rest": 25}, {"step_s": 0.011}, {"rows": 520}, {"rows": 290, "rest": 55}],
    ids=str,
)
def test_an_error_curve_is_carried_to_other_trials_of_its_motion(trial_of, other):
    """Within the frequencies that count; the transform of a cut curve has more."""
    new = trial_of(**other)
    missed = carried(trial_of(), new)[0] - error_spectrum(new)
    assert np.linalg.norm(missed) < 0.05 * np.linalg.norm(error_spectrum(new))


def test_a_motion_that_goes_on_differently_is_unknown(trial_of):
    assert carried(trial_of(), trial_of(rows=520, periodic=False)) is None


def test_the_floor_expects_the_error_of_a_trial_with_fewer_rows(trial_of):
    known, new = trial_of(), trial_of(rows=270)
    key, group = trial_group_key(known), group_of([new], "tip_x_m")

    def floor_with(curves, rest_s):
        noise, model = {"tip_x_m": np.full(2, 1e-4)}, {"tip_x_m": np.ones(2)}
        return NoiseFloor(np.array([0.0, 8.0]), noise, model, curves, repeats=2.0, rest_s=rest_s)

    floor = floor_with({key: {1.0: {"tip_x_m": error_spectrum(known)}}}, {key: REST * STEP_S})
    assert floor.curves_for(group, [new])[1] == "transferred"
    assert floor.curves_for(group_of([known], "tip_x_m"), [known])[1] == "measured"
    missed = floor.mean(group, [new])[0, 0] - error_spectrum(new)
    assert np.linalg.norm(missed) < 0.05 * np.linalg.norm(error_spectrum(new))
    blind = floor_with({}, {})
    assert blind.curves_for(group, [new]) == ({}, "unknown")
    assert (floor.whitener(group, [new]) > 1.5 * blind.whitener(group, [new])).all()


def test_derivatives_follow_a_step(plant, hidden):
    trials = hidden(dead_time_1_s=0.02).trials
    residuals = Residuals(plant, trials, all_fit_parameters(plant, trials, ["dead_time"]))
    estimator = GaussNewton(residuals, noise_floor_for(residuals))
    start = estimator.at(np.zeros(len(estimator.low)))
    free = np.arange(len(start.values)) < 4
    start = estimator.linearise(start, free)
    step, _ = estimator.step(start, free)
    end = estimator.line_search(start, step)
    assert not end.slopes and end.has_derivatives(free) and not end.has_derivatives(~free)
    slopes = [slope.copy() for slope in start.slopes]
    start.slopes = []  # what becomes of the start later does not count
    estimator.step(end, free)
    moved = end.values - start.values
    rows = zip(estimator.whitened(start.rows), estimator.whitened(end.rows), strict=True)
    for after, before, (a, b) in zip(end.slopes, slopes, rows, strict=True):
        np.testing.assert_allclose(after @ moved, (a - b).ravel(), rtol=0, atol=1e-8)
        missed = np.abs(before @ moved - (a - b).ravel()).max()
        assert missed > 1e-5, "the derivatives at the start miss a thousand times as much"
