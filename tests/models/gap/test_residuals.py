"""Residuals and their fit parameters: priors, blocks of time, candidates, and where a gap lies."""

from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from models.gap.residuals.fit_parameters import (
    KNOWN_VALUE_FRACTION,
    candidate_effects,
    effect_candidates,
    is_known_elsewhere,
    nuisance_fit_parameters,
    plant_with_every_effect,
)
from models.gap.residuals.localisation import GapRegion, locate_gap, location_sentence
from models.gap.residuals.time_blocks import BLOCKS, in_time_blocks, is_time_block
from models.gap.search.held_out import held_out_folds
from models.plant import examples
from models.plant.identification.trial_spectra import (
    TrialGroup,
    coefficient_count,
    cosine_transform,
    trial_group_key,
)
from models.plant.plant import read_plant
from models.trials.trial import Trial, TrialMeta, TrialSet
from tests.models.made_trials import with_conditions

EXAMPLES = Path(examples.__path__[0])
SYSTEMS = [p for p in sorted(EXAMPLES.glob("*.toml")) if ".map" not in p.suffixes]


@pytest.mark.parametrize("path", SYSTEMS, ids=lambda p: p.stem)
def test_a_plant_of_a_measured_system_has_every_effect_of_its_catalogue(path):
    plant = read_plant(path)
    full = plant_with_every_effect(plant)
    known = {v.name for v in full.step_model(1, "twin").parameters}
    assert all(set(full.strengths(e, 1)) <= known for e in candidate_effects(plant))


@pytest.mark.parametrize(("dof", "strengths"), [(1, ["tilt"]), (2, ["tilt", "roll"])])
def test_a_turn_about_a_joints_axis_is_an_effect(plant, dof, strengths):
    """It looks like an offset of the joint's encoder, so the session's turn is small there."""
    effect = effect_candidates(plant, "marker_frame_tilt", dof)["marker_frame_tilt"]
    assert [q.name for q in effect] == [f"marker_frame_{n}_rad" for n in strengths]
    turns = {
        name: q.standard_deviation
        for q in nuisance_fit_parameters(plant, dof)
        for name in q.parameters if name.startswith("marker_frame_")
    }  # fmt: skip
    assert len(turns) == 3
    small = {name for name, deviation in turns.items() if deviation < 0.001}
    assert small == {q.name for q in effect}
    assert turns["marker_frame_yaw_rad"] == pytest.approx(0.005)


# Nuisance of a plant that was identified on other trials


def trial_of(mass_kg):
    meta = TrialMeta(
        dof=1, payload_kg=0.0, trial=1, motion="steps", source="measured", period_s=1.0,
        rest_samples=1, conditions={"mass_kg": mass_kg},
    )  # fmt: skip
    return Trial(f"{mass_kg}", meta, {"time_s": 0.01 * np.arange(100)})


def identified_on(plant, *trials):
    fitted = plant.provenance.fitted_with(trials)
    provenance = msgspec.structs.replace(plant.provenance, fitted_trials=fitted)
    return replace(plant, provenance=provenance)


@pytest.fixture
def pendulum():
    return read_plant(EXAMPLES / "xl330_pendulum.toml")


def test_only_a_plant_of_other_trials_is_known(pendulum):
    one, other = trial_of(0.5), trial_of(0.6)
    assert not is_known_elsewhere(pendulum, TrialSet((one,)))
    identified = identified_on(pendulum, one)
    assert is_known_elsewhere(identified, TrialSet((other,)))
    assert not is_known_elsewhere(identified, TrialSet((one, other)))
    link = identified_on(read_plant(), one)
    assert not is_known_elsewhere(link, TrialSet((other,))), "a link changes from day to day"


def test_values_of_a_known_plant_stay_within_some_per_cent(pendulum):
    free = {q.name: q for q in nuisance_fit_parameters(pendulum, 1)}
    known = {q.name: q for q in nuisance_fit_parameters(pendulum, 1, True)}
    assert free.keys() == known.keys() and len(known) > 3
    for name, q in known.items():
        value = abs(pendulum.parameters[name].value)
        assert q.standard_deviation == pytest.approx(KNOWN_VALUE_FRACTION * value)
        assert q.standard_deviation < free[name].standard_deviation
        assert (q.low, q.high) == (free[name].low, free[name].high)


# Blocks of time of a single trial

ROWS = 2401


@pytest.fixture
def recording():
    """Trial of a car whose position is a sinusoid."""
    time_s = 0.01 * np.arange(ROWS)
    columns = {"time_s": time_s, "command_1_v": np.cos(time_s), "position_1_m": np.sin(time_s)}
    meta = TrialMeta(dof=1, payload_kg=0.0, trial=1, motion="reference", source="measured",
                     period_s=24.0, rest_samples=1)  # fmt: skip
    return Trial("run", meta, columns)


def test_blocks_are_the_recording_in_order_and_each_is_held_out_once(recording):
    blocks = in_time_blocks(read_plant(EXAMPLES / "emps.toml"), TrialSet((recording,)))
    assert len(blocks) == BLOCKS
    for name, column in recording.columns.items():
        assert np.array_equal(np.concatenate([b.columns[name] for b in blocks]), column)
    assert all(is_time_block(b) for b in blocks) and not is_time_block(recording)
    assert len({b.meta.motion for b in blocks}) == len({b.name for b in blocks}) == len(blocks)
    ((what, folds),) = held_out_folds(blocks.trials).items()
    assert what == "blocks of time"
    assert [sorted(fold) for fold in folds] == [[k] for k in range(len(blocks))]


def test_a_recording_is_not_cut_where_it_need_not_or_cannot_be(recording, pendulum):
    car = read_plant(EXAMPLES / "emps.toml")
    other = with_conditions(recording, motion="other")
    short = {name: column[:900] for name, column in recording.columns.items()}
    single = TrialSet((recording,))
    for plant, trials in (
        (car, TrialSet((recording, other))),
        (car, TrialSet((replace(recording, columns=short),))),
        (pendulum, single),
    ):
        assert in_time_blocks(plant, trials) is trials


def test_rows_are_held_out_where_a_single_trial_is_not_cut(recording):
    ((what, folds),) = held_out_folds((recording,)).items()
    assert what == "blocks of time"
    assert np.array_equal(sum(fold[0] for fold in folds), np.ones(ROWS))


# Localisation

COUNT, STEP_S = 512, 0.017


@pytest.fixture
def trials(make_trial):
    angle = 0.5 * np.sin(2 * np.pi * STEP_S * np.arange(COUNT) / 4.352)
    return [
        make_trial(angle, payload_kg=payload, trial=n, name=f"{payload:g}_{n}")
        for payload in (0.0, 2.0)
        for n in (1, 2)
    ]


@pytest.fixture
def group(trials):
    signals, count = ("angle_1_rad", "tip_x_m"), coefficient_count(COUNT, STEP_S)
    return TrialGroup(trial_group_key(trials[0]), tuple(range(len(trials))), signals, count)


def noise(seed, group):
    shape = len(group.trials), len(group.signals), group.coefficients
    return np.random.default_rng(seed).standard_normal(shape)


@pytest.mark.slow
def test_noise_alone_is_seldom_located(trials, group):
    located = [
        any(region.significant for region in locate_gap([group], trials, [noise(seed, group)]))
        for seed in range(20)
    ]
    assert sum(located) <= 4  # one in twenty is expected; five or more have a chance below 0.3 %


def test_a_lag_on_the_return_is_located_there(trials, group):
    angle = trials[0].angle_rad[:, 0]
    back = (angle > 0.05) & (np.gradient(angle) < 0)
    rows = noise(1, group)
    for a, trial in enumerate(trials):
        rows[a, 1] += cosine_transform(6.0 * trial.meta.payload_kg * back, group.coefficients)
    regions = locate_gap([group], trials, [rows])
    top = next(r for r in regions if r.factor == "stroke")
    assert top.significant
    assert (top.signal, top.level) == ("tip_x_m", "return from positive angles")
    sentence = location_sentence(regions)
    assert top.level in sentence and "growing with payload" in sentence


def test_a_trend_with_payload_needs_two_payloads():
    """Each motion has a region of its own, all of them for one payload."""

    def sentence(*payloads):
        return location_sentence(
            [
                GapRegion("tip_x_m", "payload", f"{p} kg", floors, 0.0, 0.001, significant=True)
                for p, floors in zip(payloads, (9.0, 3.0), strict=True)
            ]
        )

    assert "falling with payload" in sentence(0, 2)
    assert "with payload" not in sentence(0, 0)
