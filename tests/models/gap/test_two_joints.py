"""Two joints: a noise floor of their own, and verdicts that need one."""

import numpy as np
import pytest

from models.gap.diagnosis import diagnose
from models.gap.estimation.gauss_newton import GaussNewton
from models.gap.estimation.model_discrepancy import ModelDiscrepancy
from models.gap.estimation.noise_floor_fit import noise_floor_for, nuisance_and_variation
from models.gap.residuals.fit_parameters import candidate_effects, effect_fit_parameters
from models.gap.residuals.residuals import Residuals
from models.gap.search.effect_search import EffectSearch
from models.gap.search.null_distribution import KnownError, null_distribution_of
from models.gap.settings import DEFAULT_SETTINGS, GapSettings
from models.plant.effects import EFFECTS
from models.plant.identification.noise_floor import with_noise_floor
from models.plant.plant import read_plant, scope_of

FRICTION_NM_S_RAD = 4.0


@pytest.fixture(scope="module")
def two_joints(trials_of):
    """Plant with the floor of its own trials of one and of two joints."""
    nominal = read_plant()
    one, two = (trials_of(nominal, 1, dof=dof).trials for dof in (1, 2))
    return with_noise_floor(nominal, [*one, *two])


def test_each_number_of_joints_has_a_floor(two_joints):
    floors = two_joints.provenance.noise_floor
    assert set(floors) == {"1", "2"}
    assert "angle_2_rad" in floors["2"].noise
    assert "angle_2_rad" not in floors["1"].noise
    assert not two_joints.for_robot().provenance.noise_floor


def test_each_number_of_joints_has_a_null_distribution():
    one, two = (null_distribution_of(read_plant(), dof) for dof in (1, 2))
    assert "cross_axis_coupling" not in one.standard_deviation
    assert two.standard_deviation["cross_axis_coupling"] > 1
    assert (one.repetitions_pooled, two.repetitions_pooled) == (False, True)
    for null in (one, two):
        assert null.for_link_change(0.0).explained >= DEFAULT_SETTINGS.noise_residual


@pytest.mark.parametrize(
    "effect, strength, staircase",
    [
        ("sensor_lag", "sensor_lag_{}_s", "sensor_lag_jump_{}"),
        ("dead_time", "dead_time_{}_s", "dead_time_phase_{}"),
    ],
)
def test_one_strength_for_both_servos_but_each_goal_has_its_staircase(effect, strength, staircase):
    moved = [set(q.parameters) for q in effect_fit_parameters(read_plant(), effect, 2)]
    assert moved[0] == {strength.format(j) for j in (1, 2)}
    assert all({staircase.format(j)} in moved for j in (1, 2))


@pytest.mark.parametrize(
    "effect, alike", [("coulomb_friction", True), ("position_gain_change", False)]
)
def test_joints_by_themselves_have_a_strength_each_and_a_larger_null(effect, alike):
    plant, by_joint = read_plant(), GapSettings(separate_joints=True)
    tied, separate = (effect_fit_parameters(plant, effect, 2, own) for own in (False, True))
    strengths = EFFECTS[effect]().strengths(scope_of(plant.drive, plant.load, 2))
    assert [set(q.parameters) for q in separate[: len(strengths)]] == [{s} for s in strengths]
    assert (tied == separate) is not alike
    shared, own = (null_distribution_of(plant, 2, settings=s) for s in (DEFAULT_SETTINGS, by_joint))
    assert own.least([effect]) == pytest.approx(shared.least([effect]) * (2**0.5 if alike else 1))


def test_a_fault_of_one_servo_is_found_in_its_joint(two_joints, trials_of):
    """With one strength for both joints nothing of the catalogue explains it."""
    name = "viscous_friction_2_nm_s_rad"
    value = two_joints.parameters[name].value
    trials = trials_of(two_joints.with_values({name: value + FRICTION_NM_S_RAD}), 7, (1.0,), dof=2)
    left_out = [e for e in candidate_effects(two_joints) if e not in ("viscous_friction", "creep")]
    done: list[str] = []
    found = diagnose(two_joints, trials, lambda part, further: done.append(part), left_out)
    screened = [k for k, part in enumerate(done) if part.endswith("effects screened")]
    second = [k for k, part in enumerate(done) if part == "nuisance fitted"][1]
    assert sum(k < second for k in screened) == 1, "one round tells that the joints differ"
    assert (found.verdict, found.named) == ("closed", ("viscous_friction",))
    assert found.settings.separate_joints
    after = found.improved.parameters
    assert after[name].value - value == pytest.approx(FRICTION_NM_S_RAD, rel=0.1)
    other = name.replace("_2_", "_1_")
    assert abs(after[other].value - two_joints.parameters[other].value) < 0.3


def test_where_no_patterns_are_known_more_counts_as_noise(two_joints, trials_of):
    plant = read_plant()
    known, unknown = (null_distribution_of(plant, 2, KnownError(p)) for p in (True, False))
    assert unknown.explained > known.explained
    assert null_distribution_of(plant, 1, KnownError(False)) == null_distribution_of(plant, 1)
    trials = trials_of(two_joints, 7, dof=2).trials
    residuals = Residuals(two_joints, trials, nuisance_and_variation(two_joints, trials))
    (group,) = residuals.groups
    table = np.zeros((1, 1, len(group.signals), group.coefficients))
    own = ModelDiscrepancy(group.key, np.zeros(1), group.signals, table)
    for patterns, null in (((own,), known), ((), unknown)):
        estimator = GaussNewton(residuals, noise_floor_for(residuals, patterns))
        assert EffectSearch(estimator, []).unchanged_null == null


@pytest.mark.parametrize(
    ("hidden", "named", "verdict"),
    [(0.0, (), "no gap"), (FRICTION_NM_S_RAD, ("viscous_friction",), "closed")],
)
def test_two_joints_are_diagnosed_against_it(
    two_joints, trials_of, diagnosed, hidden, named, verdict
):
    q = two_joints.parameters["viscous_friction_1_nm_s_rad"]
    values = {f"viscous_friction_{j}_nm_s_rad": q.value + hidden for j in (1, 2)}
    trials = trials_of(two_joints.with_values(values), 7, (1.0,), dof=2)
    found = diagnosed(two_joints, trials)
    assert (found.verdict, found.named) == (verdict, named)
    assert not found.settings.separate_joints, "the joints are alike"
    if named:
        after = found.improved.parameters["viscous_friction_2_nm_s_rad"]
        assert after.value - q.value == pytest.approx(hidden, rel=0.1)
