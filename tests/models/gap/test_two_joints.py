"""Two joints: a noise floor of their own, and verdicts that need one."""

import pytest

from models.gap.diagnosis import diagnose
from models.gap.residuals.fit_parameters import candidate_effects, effect_candidates
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


@pytest.mark.parametrize(
    "effect, strength, staircase",
    [
        ("sensor_lag", "sensor_lag_{}_s", "sensor_lag_jump_{}"),
        ("dead_time", "dead_time_{}_s", "dead_time_phase_{}"),
    ],
)
def test_one_strength_for_both_servos_but_each_goal_has_its_staircase(effect, strength, staircase):
    fitted = effect_candidates(read_plant(), effect, 2)[effect]
    moved = [set(q.parameters) for q in fitted]
    assert moved[0] == {strength.format(j) for j in (1, 2)}
    assert all({staircase.format(j)} in moved for j in (1, 2))


@pytest.mark.parametrize(
    "effect, alike", [("coulomb_friction", True), ("position_gain_change", False)]
)
def test_an_effect_that_servos_share_is_a_candidate_of_each_too(effect, alike):
    plant = read_plant()
    candidates = effect_candidates(plant, effect, 2)
    both = set(EFFECTS[effect]().strengths(scope_of(plant.drive, plant.load, 2)))
    moved = {
        name: {n for q in own if q.is_strength for n in q.parameters}
        for name, own in candidates.items()
    }
    assert moved[effect] == both
    single = {f"{effect}:{j}": {n for n in both if f"_{j}" in n} for j in (1, 2)}
    assert {n: m for n, m in moved.items() if n != effect} == (single if alike else {})


@pytest.mark.slow
def test_a_fault_of_one_servo_is_named_in_its_joint(two_joints, trials_of):
    name = "viscous_friction_2_nm_s_rad"
    value = two_joints.parameters[name].value
    trials = trials_of(two_joints.with_values({name: value + FRICTION_NM_S_RAD}), 7, (1.0,), dof=2)
    left_out = [e for e in candidate_effects(two_joints) if e not in ("viscous_friction", "creep")]
    found = diagnose(two_joints, trials, leave_out=left_out)
    assert (found.verdict, found.named) == ("closed", ("viscous_friction:2",))
    after = found.improved.parameters
    assert after[name].value - value == pytest.approx(FRICTION_NM_S_RAD, rel=0.1)
    other = name.replace("_2_", "_1_")
    assert abs(after[other].value - two_joints.parameters[other].value) < 0.3
    assert "viscous_friction" in found.improved.effects


@pytest.mark.slow
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
    if named:
        after = found.improved.parameters["viscous_friction_2_nm_s_rad"]
        assert after.value - q.value == pytest.approx(hidden, rel=0.1)
