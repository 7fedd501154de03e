"""Effect search on trials of our own plant: a hidden effect is named, and nothing else."""

from dataclasses import replace

import numpy as np
import pytest

from models.gap.decision.rejected_effects import UNEXCITED
from models.gap.diagnosis import diagnose
from models.gap.estimation.gauss_newton import FitPoint
from models.gap.report.gap_results import errors_in_floors, gap_document
from models.gap.report.gap_words import gap_in_words
from models.gap.residuals.fit_parameters import candidate_effects
from models.gap.search.candidate import Candidate, SearchResult, may_pass
from models.gap.settings import DEFAULT_SETTINGS, GapSettings
from models.plant.identification.evaluation import compare_with_trials
from models.plant.identification.noise_floor import (
    ECCENTRICITY_M,
    NOT_FOLLOWED_RAD,
    rows_that_follow,
)
from models.plant.plant import read_plant


@pytest.fixture(scope="module")
def nothing(plant, hidden, diagnosed):
    return diagnosed(plant, hidden(), dead_zones=True)


def test_without_a_hidden_effect_nothing_is_named(nothing):
    assert nothing.verdict == "no gap"
    assert nothing.named == ()
    assert nothing.improved.parameters == nothing.plant.parameters


def test_a_limit_that_is_never_met_and_a_plane_that_never_moves_are_not_excited(nothing):
    assert "current_saturation" in {r.effect for r in nothing.rejected if r.reason == UNEXCITED}


def test_a_dead_time_is_named_with_its_value_and_added(late):
    found, _ = late
    assert found.named[0] == "dead_time"
    assert found.verdict == "closed"
    q = found.improved.parameters["dead_time_1_s"]
    assert abs(q.value - 0.02) < max(4 * q.error, 5e-4)
    assert found.improved.provenance.parent_sha256 == found.plant.sha256()
    assert "dead_time" in found.improved.effects


def test_an_effect_that_the_plant_holds_is_named_by_its_change(plant, hidden, diagnosed):
    found = diagnosed(plant, hidden(viscous_friction_1_nm_s_rad=4.0))
    assert found.named == ("viscous_friction",)
    q = found.improved.parameters["viscous_friction_1_nm_s_rad"]
    before = plant.parameters["viscous_friction_1_nm_s_rad"].value
    assert q.value - before == pytest.approx(4.0, rel=0.2)


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


@pytest.fixture(scope="module")
def crept(plant, hidden, diagnosed):
    """Diagnosis of a creep."""
    return diagnosed(plant, hidden(creep_share_1=0.4))


def test_an_effect_needs_the_separation_of_the_link_that_it_leaves(crept):
    """Creep looks like a softer link; the fit that holds the creep leaves the link as it was."""
    found = crept
    assert found.named == ("creep",)
    assert found.link_change == 1.0
    alone = found.null_distribution.for_link_change(0.0).least(["creep"])
    assert alone < found.inclusions[0].least < found.null_distribution.least(["creep"]) / 2


def test_on_a_link_that_is_said_to_be_the_same_creep_needs_less(crept, plant, hidden, diagnosed):
    told = diagnosed(plant, hidden(creep_share_1=0.4), GapSettings(same_link=True))
    free = crept
    assert told.named == free.named == ("creep",)
    assert told.link_change == told.settings.least_link_change and told.settings.same_link
    assert told.inclusions[0].least < 0.7 * free.inclusions[0].least
    catalogue = [d.tested[-1].answers.catalogue for d in (free, told)]
    assert catalogue[1] > catalogue[0]


def test_a_link_that_is_said_to_be_the_same_is_not_written_as_changed(plant, hidden, diagnosed):
    trials = hidden(link_mass_kg=0.03, root_stiffness_1_nm_rad=12.0)
    found = diagnosed(plant, trials, GapSettings(same_link=True))
    assert found.verdict == "no gap"
    assert found.improved.parameters == found.plant.parameters


def test_nuisance_alone_is_refitted_and_never_called_missing(plant, hidden, diagnosed):
    found = diagnosed(
        plant,
        hidden(link_mass_kg=0.06, root_stiffness_1_nm_rad=40.0, root_damping_1_nm_s_rad=0.3),
    )
    assert found.verdict == "no gap"
    before, after = (p.parameters["root_stiffness_1_nm_rad"] for p in (plant, found.improved))
    assert after.value - before.value == pytest.approx(40.0, rel=0.3), "plant.json has it"
    assert found.unexplained_fraction < 0.9


def test_no_nested_model_costs_more(late):
    found, _ = late
    assert found.residual_after <= found.residual_before
    assert all(c.separation > c.least for c in found.inclusions)
    assert found.refitted.keys() <= found.screened.keys()
    assert found.refitted["dead_time"] >= found.screened["dead_time"]


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


def test_a_trial_counts_until_its_joint_no_longer_follows_the_goal(trials_of, plant):
    """An arm that falls does so differently each time; what came before still counts."""
    trial = trials_of(plant, 3, (1.0,), 1)[0]
    follows_rad = np.abs(trial.goal_rad - trial.angle_rad).max(axis=0)
    assert rows_that_follow(trial, follows_rad).all()
    late = {name: column.copy() for name, column in trial.columns.items()}
    late["angle_1_rad"][150:170] += 2 * (follows_rad[0] + NOT_FOLLOWED_RAD)
    late["current_1_a"][150:170] = 0.0
    assert rows_that_follow(replace(trial, columns=late), follows_rad).all(), "it does not even try"
    late["current_1_a"][150:170] = -np.abs(trial.current_a).max()
    rows = rows_that_follow(replace(trial, columns=late), follows_rad)
    assert rows[:150].all() and not rows[150:].any()


def test_a_limit_that_lets_the_arm_fall_is_named(plant, hidden, diagnosed):
    """Its twin follows the rows before the fall; the rows after it are left out and reported."""
    before = hidden()
    current_a = max(np.abs(t.current_a).max() for t in before)
    limit_a = plant.parameters["current_limit_1_a"].value
    trials = hidden(current_saturation_1_a=limit_a - 0.7 * current_a)
    found = diagnosed(plant, trials, dead_zones=True)
    last = found.goal_not_followed_at_row
    trial = next(t for t in trials if t.name in last)
    other = {name: column.copy() for name, column in trial.columns.items()}
    other["angle_1_rad"][last[trial.name] :] += 1.0
    rms = [
        errors_in_floors(plant, [t], {}, last)["angle_1_rad"].rms
        for t in (trial, replace(trial, columns=other))
    ]
    assert rms[0] == rms[1], "the fall itself, where no simulation follows, is left out"
    assert set(last) == {"payload1_1", "payload1_2"}
    assert found.named[:1] == ("current_saturation",)
    cut = found.improved.parameters["current_saturation_1_a"]
    assert limit_a - cut.value == pytest.approx(0.7 * current_a, rel=0.03)


def test_a_limit_of_the_current_is_named_though_it_shows_nothing_at_first(plant, hidden, diagnosed):
    current_a = max(np.abs(t.current_a).max() for t in hidden())
    limit_a = plant.parameters["current_limit_1_a"].value
    trials = hidden(current_saturation_1_a=limit_a - 0.9 * current_a)
    found = diagnosed(plant, trials, dead_zones=True)
    assert found.named[:1] == ("current_saturation",)
    cut = found.improved.parameters["current_saturation_1_a"]
    assert limit_a - cut.value == pytest.approx(0.9 * current_a, rel=0.05)


def test_an_effect_that_hides_in_the_variation_of_the_trials_is_missed(plant, hidden, diagnosed):
    """An offset of the payload that may not be named appears as eccentricity in every trial.

    Each trial with a payload then has the eccentricity of the offset, and those without show none:
    z = Σ θ_t / √n follows, less what the prior takes back and other nuisance takes over.
    """
    offset = 0.06
    trials = hidden(payload_offset_share=offset)
    found = diagnosed(plant, trials)
    assert found.verdict == "not in the catalogue"
    assert found.named == ()
    assert found.improved.parameters == plant.parameters, "a stand-in seen on one motion only"
    loaded = [t for t in trials if t.meta.payload_kg > 0]
    each = offset * trials[0].meta.link_length_m / ECCENTRICITY_M
    expected = each * len(loaded) / np.sqrt(len(trials))
    assert found.nuisance_bias["eccentricity_m"] == pytest.approx(expected, rel=0.25)
    assert "place of the payload by" in gap_in_words(gap_document(found, trials))


def test_an_effect_that_removes_a_nuisance_bias_need_not_stand_out_beside_the_first(two_cycles):
    plant, hidden = two_cycles
    trials = hidden(hardening_share=1.5, payload_offset_share=0.04)
    kept = ("stiffness_hardening", "payload_offset")
    others = [e for e in candidate_effects(plant) if e not in kept]
    found = diagnose(plant, trials, leave_out=others)
    assert found.named == kept
    first, second = found.inclusions
    least = DEFAULT_SETTINGS.further_effect_fraction_by_port["stiffness"]
    assert second.separation < least * first.separation


def test_friction_that_hides_in_the_variation_of_all_trials_is_named_beside_a_dead_time(
    plant, hidden
):
    """The error of the dead time's equation would excuse it: it explains a tenth of that one."""
    trials = hidden(dead_time_1_s=0.05, coulomb_friction_1_nm=2.0)
    kept = ("dead_time", "coulomb_friction", "viscous_friction", "creep")
    others = [e for e in candidate_effects(plant) if e not in kept]
    found = diagnose(plant, trials, leave_out=others)
    assert found.named == kept[:2]
    first, second = found.inclusions
    assert second.separation < DEFAULT_SETTINGS.further_effect_fraction * first.separation
    larger = found.improved.parameters["coulomb_friction_1_nm"].value
    assert larger == pytest.approx(plant.parameters["coulomb_friction_1_nm"].value + 2.0, rel=0.1)


def test_progress_tells_how_many_parts_follow_at_least(plant, hidden):
    told = []
    others = [e for e in candidate_effects(plant) if e not in ("dead_time", "creep")]
    diagnose(plant, hidden(), lambda text, further: told.append((text, further)), others)
    parts = ["nuisance fitted", "2 effects screened", None, None, "tested on what was left out"]
    assert len(told) == len(parts)
    assert all(p is None or p == text for p, (text, _) in zip(parts, told, strict=True))
    assert [further for _, further in told[1:]] == [3, 2, 1, 1]


@pytest.mark.parametrize(
    ("separation", "predicted", "refitted"),
    [(12.0, 0.0, True), (8.0, 0.0, False), (8.0, 12.0, True), (40.0, 40.0, True)],
)
def test_a_further_candidate_is_refitted_where_it_may_pass_its_limits(
    separation, predicted, refitted
):
    """Least d′ 4.5, and 10 % of the first one's 100: together 11."""
    point = FitPoint(np.zeros(1), 0.0, [])
    first = Candidate(("coulomb_friction",), point, 100.0**2 / 2, 4.5, 4.5)
    found = SearchResult(point, point, named=["coulomb_friction"], chosen=[first])
    further = Candidate(("dead_time",), point, separation**2 / 2, 4.5, 4.5, predicted**2 / 2)
    assert may_pass(further, found, DEFAULT_SETTINGS) is refitted
