"""Designed motions: within the limits, better than what is at hand, and right about the truth."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from firmware_py.errors import InputError
from firmware_py.motion import Motion
from firmware_py.motion_document import read_motion_document
from firmware_py.safety.limits import Limits
from firmware_py.safety.supervisor import check_motion
from firmware_py.signals import PERIOD_S
from models.gap.estimation.gauss_newton import GaussNewton
from models.gap.estimation.noise_floor_fit import noise_floor_for, nuisance_and_variation
from models.gap.experiment.experiment import design_experiment, experiment_in_words, write_motion
from models.gap.experiment.experiment_page import write_experiment_page
from models.gap.experiment.motion_design import MotionDesigner
from models.gap.experiment.motion_twin import CoefficientTwin, MotionTwin
from models.gap.experiment.rival import Rival
from models.gap.experiment.separation import SeparationModel
from models.gap.fixed_motions import planned_trial
from models.gap.residuals.fit_parameters import effect_fit_parameters, plant_with_every_effect
from models.gap.residuals.residuals import Residuals
from models.gap.settings import DEFAULT_SETTINGS
from models.plant.step_model import names

LIMITS = Limits(rate_rad_s=1.0, current_a=6.0)
RIVALS = (
    Rival(("encoder_offset",), 0.6, {"encoder_offset_1_rad": 0.02}),
    Rival(("marker_frame_tilt",), 0.4, {"marker_frame_tilt_rad": 0.02}),
)
SECONDS, PAYLOADS_KG = 3.0, (0.0, 2.0)


@pytest.fixture(scope="module")
def truth(plant):
    rich = plant.with_effects("encoder_offset")
    return rich.with_values({"encoder_offset_1_rad": 0.02})


@pytest.fixture(scope="module")
def at_hand(truth, trials_of):
    return trials_of(truth, 3, (1.0,), 1)


@pytest.fixture(scope="module")
def experiment(plant, at_hand):
    return design_experiment(RIVALS, plant, at_hand, LIMITS, SECONDS, PAYLOADS_KG, seed=1)


@pytest.fixture(scope="module")
def every_effect(plant):
    model = plant_with_every_effect(plant).step_model(1, "twin")
    return replace(model, max_substep_s=2.9e-3)


def test_the_motion_stays_within_the_limits_in_simulation(experiment, every_effect, plant):
    design = experiment.design
    rows = Motion.designed(design.document).table_rad(rest_samples=60)
    check_motion(rows, LIMITS, PERIOD_S, "designed")
    for rival in RIVALS:
        own = [q for e in rival.effects for q in effect_fit_parameters(plant, e, 1)]
        values = np.array([rival.parameters.get(q.name, 0.0) for q in own])
        y = MotionTwin(every_effect, own).run(design.trial, values)
        outputs = names(every_effect.outputs)
        assert np.abs(y[:, outputs.index("current_1_a")]).max() <= LIMITS.current_a
        error = y[:, outputs.index("angle_1_rad")] - design.trial.goal_rad[:, 0]
        assert np.abs(error).max() <= LIMITS.following_error_rad
        for k, name in enumerate(("tip_x_m", "tip_y_m", "tip_z_m")):
            tip = y[:, outputs.index(name)]
            assert LIMITS.tip_min_m[k] <= tip.min() <= tip.max() <= LIMITS.tip_max_m[k]


@pytest.mark.parametrize(("rate_rad_s", "seconds"), [(0.1, 2.0), (0.5, 4.0), (2.0, 2.0)])
def test_every_start_keeps_the_limits_of_the_goals(plant, at_hand, rate_rad_s, seconds):
    """Also between the rows that a linear programme sees: a short motion is eased in fast."""
    limits = msgspec.structs.replace(LIMITS, rate_rad_s=rate_rad_s)
    model = SeparationModel(plant, at_hand.trials, RIVALS, DEFAULT_SETTINGS)
    designer = MotionDesigner(model, limits, seconds, 0, lambda text, further: None)
    for x in designer._starts():
        motion = Motion.designed(designer.document(x, 0.0))
        check_motion(motion.table_rad(rest_samples=60), limits, PERIOD_S, "start")


def test_a_fixed_motion_with_which_the_twin_leaves_its_limits_is_not_offered(
    experiment, plant, at_hand
):
    weak = msgspec.structs.replace(LIMITS, current_a=1.5)
    found = design_experiment(RIVALS, plant, at_hand, weak, SECONDS, PAYLOADS_KG)
    few, all_of_them = (
        {(f.motion.kind, f.payload_kg) for f in own.fixed} for own in (found, experiment)
    )
    assert few < all_of_them


@pytest.mark.parametrize(
    ("payloads_kg", "limits", "said"),
    [
        ((50.0,), LIMITS, "choose 0 to 2 kg"),
        ((np.nan,), LIMITS, "--payloads nan"),
        ((), msgspec.structs.replace(LIMITS, angle_rad=(0.2, 0.6)), "without 0"),
    ],
)
def test_what_no_motion_can_be_designed_for_is_refused(plant, at_hand, payloads_kg, limits, said):
    with pytest.raises(InputError, match=said):
        design_experiment(RIVALS, plant, at_hand, limits, SECONDS, payloads_kg)


def test_the_separation_grows(experiment):
    """The fixed motions are no measure here: they last up to four times as long."""
    (pair,) = experiment.design.pairs
    assert pair.separation > pair.before
    assert experiment.fixed


def test_the_same_seed_gives_the_same_motion(experiment, plant, at_hand):
    again = design_experiment(RIVALS, plant, at_hand, LIMITS, SECONDS, PAYLOADS_KG, seed=1)
    assert again.design.document == experiment.design.document


def test_the_trial_of_the_motion_tells_the_truth(experiment, plant, truth, at_hand):
    """Both effects are fitted to both trials; the rest of the rival is what was predicted."""
    document = experiment.design.document
    planned = planned_trial(at_hand[0], Motion.designed(document), document.payload_kg, 60)
    twin = MotionTwin(truth.step_model(1, "twin"), [])
    y, rng = twin.run(planned, np.zeros(0)), np.random.default_rng(0)
    columns = dict(planned.columns)
    for k, name in enumerate(twin.outputs):
        size = {"rad": 1e-5, "a": 0.02, "m": 2e-4}.get(name.rsplit("_", 1)[-1], 1e-4)
        columns[name] = y[:, k] + size * rng.standard_normal(len(y))
    both = [at_hand[0], replace(planned, columns=columns)]
    costs = []
    for rival in RIVALS:
        parameters = nuisance_and_variation(plant, both)
        parameters += effect_fit_parameters(plant, rival.effects[0], 1)
        residuals = Residuals(plant, both, parameters)
        if not costs:  # one floor for both: that of the truth
            floor = noise_floor_for(residuals)
        estimator = GaussNewton(residuals, floor)
        free = np.ones(len(parameters), dtype=bool)
        costs.append(estimator.fit(estimator.start(), free, 8).cost)
    assert costs[1] > costs[0]


def test_the_derivatives_by_coefficients_are_those_of_the_run(every_effect):
    twin = CoefficientTwin(every_effect, 3.0, (1, 4), 1, 10)
    x, step = np.array([0.1, 0.02, -0.05, 0.03]), 1e-6
    p = every_effect.parameter_values()
    y, slopes = twin.slopes(1.0, p, x)
    for k in range(len(x)):
        moved, _ = twin.slopes(1.0, p, x + step * np.eye(len(x))[k])
        numeric, own = (moved - y) / step, slopes[:, :, k]
        np.testing.assert_allclose(numeric, own, atol=2e-3 * max(np.abs(own).max(), 1e-3))


def test_file_page_and_words_name_the_motion(experiment, tmp_path):
    path = tmp_path / "motion.toml"
    write_motion(experiment.design.document, path)
    assert read_motion_document(path).name == experiment.design.document.name
    assert "encoder_offset or marker_frame_tilt" in experiment_in_words(experiment, path)
    page = write_experiment_page(experiment, tmp_path / "motion.html").read_text()
    assert "What it separates" in page


def separating(pair, separation):
    return replace(pair, before=1.0, separation=separation)


@pytest.mark.parametrize(("fixed", "designed"), [(9.0, 4.0), (4.0, 9.0)])
def test_the_motion_that_separates_more_is_recommended(experiment, tmp_path, fixed, designed):
    (pair,) = experiment.design.pairs
    menu = replace(experiment.fixed[0], pairs=(separating(pair, fixed),))
    design = replace(experiment.design, pairs=(separating(pair, designed),))
    found = replace(experiment, fixed=(menu,), design=design)
    motion, payload_kg = found.recommended
    words = experiment_in_words(found, tmp_path / "motion.toml")
    page = write_experiment_page(found, tmp_path / "motion.html").read_text()
    if fixed > designed:
        assert (motion, payload_kg) == (menu.motion, menu.payload_kg)
        assert f'kind = "{motion.kind}"' in words and "it separates more" in page
    else:
        assert motion.name == design.document.name and payload_kg == design.document.payload_kg
        assert "it separates more" not in words and "apart best" in page


def test_a_pair_that_the_fixed_motion_separates_is_not_together(experiment):
    (pair,) = experiment.design.pairs
    menu = replace(experiment.fixed[0], pairs=(separating(pair, 5.0),))
    design = replace(experiment.design, pairs=(separating(pair, 1.0),))
    assert replace(experiment, fixed=(), design=design).together()
    assert not replace(experiment, fixed=(menu,), design=design).together()


@pytest.mark.parametrize(("rivals", "seconds"), [(RIVALS[:1], SECONDS), (RIVALS, 0.5)])
def test_nothing_to_separate_or_no_time_gives_one_sentence(plant, at_hand, rivals, seconds):
    with pytest.raises(InputError):
        design_experiment(rivals, plant, at_hand, LIMITS, seconds)
