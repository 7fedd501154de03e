"""Ranking of motions: d′ is that of a refit, limits hold, and what was run is not offered again."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from firmware_py.core.errors import InputError
from firmware_py.core.motion import Motion, MotionConfig
from firmware_py.safety.limits import Limits
from models.gap.estimation.gauss_newton import GaussNewton
from models.gap.experiment.experiment import (
    SEPARATED,
    default_payloads_kg,
    experiment_in_words,
    planned_motions,
    rank_motions,
    twin_keeps,
    write_motion,
)
from models.gap.experiment.experiment_page import write_experiment_page
from models.gap.experiment.rival import Rival, fitted_values_of
from models.gap.experiment.separation import SeparationModel
from models.gap.fixed_motions import planned_trial
from models.gap.residuals.residuals import Residuals
from models.gap.settings import DEFAULT_SETTINGS
from models.plant.simulation.runner import CompiledModel, run_trial
from models.plant.step_model import names
from models.trials.trial import TrialSet

LIMITS = Limits(rate_rad_s=1.0, current_a=6.0)
RIVALS = (
    Rival(("encoder_offset",), 0.6, {"encoder_offset_1_rad": 0.02}),
    Rival(("marker_frame_tilt",), 0.4, {"marker_frame_tilt_rad": -0.02}),
)


@pytest.fixture(scope="module")
def truth(plant):
    rich = plant.with_effects("encoder_offset", "marker_frame_tilt")
    return rich.with_values({"encoder_offset_1_rad": 0.02})


@pytest.fixture(scope="module")
def at_hand(truth, trials_of):
    """Trial of the truth without noise and variation."""
    return TrialSet((as_measured(truth, trials_of(truth, 3, (1.0,), 1)[0]),))


@pytest.fixture(scope="module")
def model(plant, at_hand):
    return SeparationModel(plant, at_hand.trials, RIVALS, DEFAULT_SETTINGS)


@pytest.fixture(scope="module")
def experiment(plant, at_hand):
    return rank_motions(RIVALS, plant, at_hand, LIMITS, (1.0,))


def as_measured(plant, trial):
    compiled = CompiledModel(plant.step_model(1, "twin"))
    columns = dict(zip(names(compiled.model.outputs), run_trial(compiled, trial).T, strict=True))
    return replace(trial, columns=trial.columns | columns)


def refitted(plant, trials, fit_parameters, floor):
    """d′ that remains after every parameter of the second rival was fitted to trials."""
    estimator = GaussNewton(Residuals(plant, trials, fit_parameters), floor)
    estimator.means = [np.zeros_like(mean) for mean in estimator.means]
    start = estimator.at(fitted_values_of(RIVALS[1], plant, fit_parameters))
    return np.sqrt(2 * estimator.fit(start, np.ones(len(start.values), dtype=bool)).cost)


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "payload_kg"), [("triangle", 0.0), ("multisine", 2.0)])
def test_the_separation_is_what_a_refit_to_all_trials_leaves(
    plant, truth, at_hand, model, kind, payload_kg
):
    meta = at_hand[0].meta
    motion = Motion(kind, meta.amplitude_rad, 2 * meta.period_s)
    run = model.planned_run(motion, payload_kg)
    (before,), (separation,) = model.before, model.separations(run)

    planned = as_measured(truth, planned_trial(at_hand[0], motion, payload_kg, 60))
    every = [q for q in model.estimator.residuals.fit_parameters if q.effect != "encoder_offset"]
    both = every + [replace(q, trial=1) for q in every if q.trial == 0]
    floor, further = model.estimator.floor, model.planned_floor(run).formulation
    assert before == pytest.approx(refitted(plant, at_hand.trials, every, floor), rel=0.05)
    floor = replace(floor, formulation=floor.formulation | further)
    exact = refitted(plant, [at_hand[0], planned], both, floor)
    assert separation == pytest.approx(exact, rel=0.05)


def test_what_was_run_with_a_payload_is_not_offered_with_it_again(at_hand):
    size = at_hand[0].meta.amplitude_rad, at_hand[0].meta.period_s

    def sinusoids(limits):
        planned = planned_motions(at_hand, (1.0, 2.0), limits)
        rows = [((m.amplitude_rad, m.period_s), p) for m, p in planned if m.kind == "sinusoid"]
        return {p for own, p in rows if own == size}, len(planned)

    wide = msgspec.structs.replace(LIMITS, rate_rad_s=2.0, acceleration_rad_s2=1e3)
    offered, count = sinusoids(wide)
    refused, fewer = sinusoids(LIMITS)  # too fast
    assert offered == {2.0} and not refused
    assert fewer < count


def test_the_payload_is_swapped(at_hand):
    assert default_payloads_kg(at_hand) == (1.0, 2.0)


@pytest.mark.parametrize(
    ("signal", "values", "keeps"),
    [
        ("current_1_a", (0.0, 5.0), True),
        ("current_1_a", (0.0, -5.2), False),
        ("angle_1_rad", (0.0, 0.18), False),
        ("tip_z_m", (1.010, 1.0105), True),  # rests within the margin: half of the rest is allowed
        ("tip_z_m", (1.010, 1.0115), False),
        ("tip_z_m", (1.013, 1.013), False),
    ],
)
def test_a_twin_keeps_its_limits_with_a_margin(make_trial, signal, values, keeps):
    limits = Limits(current_a=6.0, tip_min_m=(-1.0, -1.0, 0.5), tip_max_m=(1.0, 1.0, 1.012))
    rest = {"current_1_a": 0.0, "angle_1_rad": 0.0, "tip_x_m": 0.0, "tip_y_m": 0.0, "tip_z_m": 0.9}
    outputs = {name: np.full(80, value) for name, value in rest.items()}
    outputs[signal] = np.repeat(values, 40)
    assert twin_keeps(limits, outputs, make_trial(np.zeros((80, 1)))) is keeps


def test_motions_are_ranked_by_what_they_separate(experiment):
    (before,) = experiment.before
    found = [r.separations[0] for r in experiment.ranked]
    assert found == sorted(found, reverse=True) and found[-1] >= before
    assert bool(experiment.together) == (found[0] < SEPARATED)


def test_a_motion_with_which_the_twin_leaves_its_limits_is_not_offered(experiment, plant, at_hand):
    weak = msgspec.structs.replace(LIMITS, current_a=1.5)
    with pytest.raises(InputError, match="none of the motions in simulation"):
        rank_motions(RIVALS, plant, at_hand, weak, (2.0,))


def test_the_best_motion_is_a_file_for_the_robot(experiment, tmp_path):
    path = tmp_path / "motion.toml"
    write_motion(experiment.best, path)
    assert MotionConfig().with_motion(str(path)).motion(1) == experiment.best.motion
    words = experiment_in_words(experiment, path)
    assert "encoder_offset or marker_frame_tilt" in words and words.count("\n") < 12
    page = write_experiment_page(experiment, tmp_path / "motion.html").read_text()
    assert page.count(experiment.best.label) >= 3 and "All motions" in page


@pytest.mark.parametrize(
    ("rivals", "payloads_kg", "limits", "sentence"),
    [
        (RIVALS[:1], (), LIMITS, "no two hypotheses"),
        (RIVALS, (50.0,), LIMITS, "choose 0 to 2 kg"),
        (RIVALS, (np.nan,), LIMITS, "--payloads nan"),
        (RIVALS, (), msgspec.structs.replace(LIMITS, angle_rad=(0.2, 0.6)), "no motion to try"),
        (RIVALS, (), msgspec.structs.replace(LIMITS, rate_rad_s=0.01), "no motion to try"),
        ((replace(RIVALS[0], effects=("slip",)), RIVALS[1]), (), LIMITS, "'slip'"),
    ],
)
def test_what_nothing_can_be_ranked_for_gives_one_sentence(
    plant, at_hand, rivals, payloads_kg, limits, sentence
):
    with pytest.raises(InputError, match=sentence):
        rank_motions(rivals, plant, at_hand, limits, payloads_kg)
