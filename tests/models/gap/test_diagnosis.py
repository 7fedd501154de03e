"""Diagnosis of trials of a plant of our own: a hidden effect is named, and nothing else."""

import numpy as np
import pytest

from models.gap.diagnosis import diagnose
from models.gap.residuals.fit_parameters import candidate_effects
from models.gap.settings import GapSettings
from models.plant.identification.evaluation import compare_with_trials
from models.plant.plant import read_plant


@pytest.fixture(scope="module")
def nothing(plant, hidden, diagnosed):
    return diagnosed(plant, hidden(), dead_zones=True)


def test_without_a_hidden_effect_nothing_is_named(nothing):
    assert nothing.verdict == "no gap"
    assert nothing.named == ()
    assert nothing.improved.parameters == nothing.plant.parameters


def test_a_dead_time_is_named_with_its_value_and_added(late):
    found, _ = late
    assert found.named[0] == "dead_time"
    assert found.verdict == "closed"
    q = found.improved.parameters["dead_time_1_s"]
    assert abs(q.value - 0.02) < max(4 * q.error, 5e-4)
    assert found.improved.provenance.parent_sha256 == found.plant.sha256()
    assert "dead_time" in found.improved.effects


@pytest.mark.slow
def test_an_effect_that_the_plant_holds_is_named_by_its_change(plant, hidden, diagnosed):
    found = diagnosed(plant, hidden(viscous_friction_1_nm_s_rad=4.0))
    assert found.named == ("viscous_friction",)
    q = found.improved.parameters["viscous_friction_1_nm_s_rad"]
    before = plant.parameters["viscous_friction_1_nm_s_rad"].value
    assert q.value - before == pytest.approx(4.0, rel=0.2)


@pytest.mark.slow
def test_play_in_the_mount_is_named_as_backlash_and_told_from_that_in_the_gear(
    plant, hidden, diagnosed
):
    mounted = hidden(backlash_1_rad=0.008, backlash_mount_fraction=1.0)
    found = diagnosed(plant, mounted, dead_zones=True)
    assert found.named == ("backlash",) and found.verdict == "closed"
    known = found.improved.parameters
    assert known["backlash_1_rad"].value == pytest.approx(0.008, rel=0.1)
    assert known["backlash_mount_fraction"].value == pytest.approx(1.0, abs=0.2)
    geared = diagnosed(plant, hidden(backlash_1_rad=0.008), dead_zones=True)
    assert geared.improved.parameters["backlash_mount_fraction"].value == pytest.approx(0, abs=0.2)


@pytest.mark.slow
def test_a_link_that_is_said_to_be_the_same_is_not_written_as_changed(plant, hidden, diagnosed):
    trials = hidden(link_mass_kg=0.03, root_stiffness_1_nm_rad=12.0)
    found = diagnosed(plant, trials, GapSettings(same_link=True))
    assert found.verdict == "no gap"
    assert found.improved.parameters == found.plant.parameters


@pytest.mark.slow
def test_nuisance_alone_is_refitted_and_never_called_missing(plant, hidden, diagnosed):
    found = diagnosed(
        plant,
        hidden(link_mass_kg=0.06, root_stiffness_1_nm_rad=40.0, root_damping_1_nm_s_rad=0.3),
    )
    assert found.verdict == "no gap"
    before, after = (p.parameters["root_stiffness_1_nm_rad"] for p in (plant, found.improved))
    assert after.value - before.value == pytest.approx(40.0, rel=0.3), "plant.json has it"
    assert found.unexplained_fraction < 0.9


def test_the_improved_plant_is_read_and_simulates_the_trials(late, tmp_path):
    """Its angle is off by the sensor's noise and what varies between trials: 2 ms of the clock."""
    found, trials = late
    found.improved.write(tmp_path / "plant.json")
    again = read_plant(tmp_path / "plant.json")
    before, after = (
        [c.error("angle_1_rad") for c in compare_with_trials(of, trials)]
        for of in (found.plant, again)
    )
    rate_rad_s = max(np.abs(np.gradient(t.goal_rad[:, 0], t.time_s)).max() for t in trials)
    assert np.std(before) > 5 * np.std(after)
    assert np.std(after) < 0.002 * rate_rad_s


@pytest.mark.slow
def test_a_limit_of_the_current_is_named_though_it_shows_nothing_at_first(plant, hidden, diagnosed):
    current_a = max(np.abs(t.current_a).max() for t in hidden())
    limit_a = plant.parameters["current_limit_1_a"].value
    trials = hidden(current_saturation_1_a=limit_a - 0.9 * current_a)
    found = diagnosed(plant, trials, dead_zones=True)
    assert found.named[:1] == ("current_saturation",)
    cut = found.improved.parameters["current_saturation_1_a"]
    assert limit_a - cut.value == pytest.approx(0.9 * current_a, rel=0.05)


def test_a_limit_that_is_never_met_is_not_excited(nothing):
    assert "current_saturation" in nothing.naming.search.unexcited


def test_no_nested_model_costs_more(late):
    found, _ = late
    naming, nothing = found.naming, found.naming.search.nothing
    assert all(f.gain > 0 for own in naming.rounds for f in own)
    assert naming.fit.point.cost <= nothing.point.cost
    (alone,) = (f for f in naming.rounds[0] if f.candidates == ("dead_time",))
    assert alone.separation >= naming.search.screened["dead_time"]


@pytest.mark.slow
def test_a_limit_that_lets_the_arm_fall_is_named(plant, hidden, diagnosed):
    """Its twin follows the rows before the fall; the rows after it are not used."""
    current_a = max(np.abs(t.current_a).max() for t in hidden())
    limit_a = plant.parameters["current_limit_1_a"].value
    trials = hidden(current_saturation_1_a=limit_a - 0.7 * current_a)
    found = diagnosed(plant, trials, dead_zones=True)
    unused = found.nuisance.measured.residuals.goal_not_followed()
    assert set(unused) == {"payload1_1", "payload1_2"}
    assert found.named[:1] == ("current_saturation",)
    cut = found.improved.parameters["current_saturation_1_a"]
    assert limit_a - cut.value == pytest.approx(0.7 * current_a, rel=0.03)


@pytest.mark.slow
def test_friction_is_named_beside_a_dead_time(plant, hidden):
    trials = hidden(dead_time_1_s=0.05, coulomb_friction_1_nm=6.0)
    named = ("dead_time", "coulomb_friction")
    considered = (*named, "viscous_friction", "creep")
    others = [e for e in candidate_effects(plant) if e not in considered]
    found = diagnose(plant, trials, leave_out=others)
    assert found.named == named
    larger = found.improved.parameters["coulomb_friction_1_nm"].value
    assert larger == pytest.approx(plant.parameters["coulomb_friction_1_nm"].value + 6.0, rel=0.1)


@pytest.mark.slow
def test_a_stand_in_is_neither_believed_nor_written(plant, hidden, diagnosed):
    """The encoder's ripple is not in this catalogue."""
    found = diagnosed(plant, hidden(encoder_ripple_1_rad=0.004))
    assert found.verdict == "not in the catalogue"
    assert found.answers.catalogue < 0.5
    assert found.improved.parameters == plant.parameters


def test_probabilities_add_up_and_hypotheses_share_them(late, nothing):
    for found in (late[0], nothing):
        answers = found.answers
        assert answers.nothing + answers.catalogue + answers.outside == pytest.approx(1)
        shares = sum(h.probability for h in found.hypotheses)
        assert shares == pytest.approx(answers.nothing + answers.catalogue, abs=0.02)


def test_the_plant_that_is_written_is_no_worse_on_what_was_left_out(late, nothing):
    for found in (late[0], nothing):
        errors = found.written.errors.rms()
        assert all(errors[s] <= 1.05 * rms for s, rms in found.held_out_baseline.items())
