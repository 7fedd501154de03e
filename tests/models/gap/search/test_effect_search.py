"""What is hidden in trials of our own plant is named; nothing is where nothing is."""

import json
from dataclasses import replace

import numpy as np
import pytest

from models.gap.diagnosis import diagnose
from models.gap.report.gap_json import errors_in_floors, gap_document, gap_in_words
from models.gap.report.gap_page import write_gap_page
from models.gap.residuals.fit_parameters import candidate_effects
from models.gap.residuals.residuals import LOST_RAD, rows_that_follow
from models.gap.search.effect_search import NEXT
from models.plant.plant import read_plant
from models.plant.simulation.compiled_model import CompiledModel

CONSIDERED = (
    "dead_time", "current_bias", "current_scale", "viscous_friction", "creep",
    "unmodelled_payload", "marker_frame_tilt", "current_saturation",
)  # fmt: skip


@pytest.fixture(scope="module")
def hidden(plant, trials_of):
    """Two payloads of the plant with something hidden, never from the floor's own seed."""

    def hide(**strengths):
        full = plant.with_effects(*candidate_effects(plant))
        values = {name: full.parameters[name].value + s for name, s in strengths.items()}
        return trials_of(full.with_values(values), 7, (0.0, 1.0))

    return hide


def diagnosed(plant, trials):
    others = [e for e in candidate_effects(plant) if e not in CONSIDERED]
    return diagnose(plant, trials, leave_out=others)


@pytest.fixture(scope="module")
def nothing(plant, hidden):
    return diagnosed(plant, hidden())


@pytest.fixture(scope="module")
def late(plant, hidden):
    trials = hidden(dead_time_1_s=0.02)
    return diagnosed(plant, trials), trials


def test_without_a_hidden_effect_nothing_is_named(nothing):
    assert nothing.verdict == "no gap"
    assert nothing.naming.named == []
    assert nothing.improved.parameters == nothing.plant.parameters


def test_a_limit_that_is_never_met_and_a_plane_that_never_moves_are_not_excited(nothing):
    assert "current_saturation" in nothing.naming.unexcited


def test_a_dead_time_is_named_with_its_value_and_added(late):
    found, _ = late
    assert found.naming.named[0] == "dead_time"
    assert found.verdict == "closed"
    q = found.improved.parameters["dead_time_1_s"]
    assert abs(q.value - 0.02) < max(4 * q.error, 5e-4)
    assert found.improved.provenance.parent_sha256 == found.plant.sha256()
    assert "dead_time" in found.improved.effects


def test_an_effect_that_the_plant_holds_is_named_by_its_change(plant, hidden):
    found = diagnosed(plant, hidden(viscous_friction_1_nm_s_rad=4.0))
    assert found.naming.named == ["viscous_friction"]
    q = found.improved.parameters["viscous_friction_1_nm_s_rad"]
    before = plant.parameters["viscous_friction_1_nm_s_rad"].value
    assert q.value - before == pytest.approx(4.0, rel=0.2)


def test_nuisance_alone_is_refitted_and_never_called_missing(plant, hidden):
    found = diagnosed(
        plant,
        hidden(link_mass_kg=0.06, root_stiffness_1_nm_rad=25.0, root_damping_1_nm_s_rad=0.3),
    )
    assert found.verdict == "no gap"


def test_no_nested_model_costs_more(late):
    found, _ = late
    naming = found.naming
    assert naming.after.cost <= naming.before.cost
    assert all(c.gain >= 0 for turn in naming.rounds for c in turn)


def test_gap_json_holds_what_the_contract_names(late, tmp_path):
    found, trials = late
    data = json.loads(json.dumps(gap_document(found, trials)))
    assert {"verdict", "noise_floor", "located", "named", "before", "after", "rejected"} <= set(
        data
    )
    entry = data["named"][0]
    assert entry["effect"] == "dead_time"
    assert {"value", "unit", "error"} <= set(entry["parameters"]["dead_time_1_s"])
    assert {"evidence", "look_alikes"} <= set(entry)
    angle = [data[k]["held_out"]["angle_1_rad"]["floors"] for k in ("before", "after")]
    assert angle[1] < 0.2 * angle[0]
    assert all({"signal", "size"} <= set(row) for row in data["located"])
    assert {row["effect"] for row in data["rejected"]} == set(CONSIDERED) - {"dead_time"}
    assert all(row["reason"] for row in data["rejected"])
    assert "dead_time" in gap_in_words(data)
    page = write_gap_page(
        data, found.plant, found.improved, trials, tmp_path / "report.html"
    ).read_text()
    assert page.count("<svg") >= 4
    assert "http" not in page.replace("http://www.w3.org/2000/svg", "")


def test_the_improved_plant_is_read_and_runs(late, tmp_path):
    found, trials = late
    found.improved.write(tmp_path / "plant.json")
    again = read_plant(tmp_path / "plant.json")
    model = CompiledModel(again.step_model(1, "twin"))
    y = model.simulate(np.zeros((5, 2)), 0.017)
    assert np.isfinite(y).all()
    assert trials


def test_a_trial_counts_until_its_joint_has_lost_the_goal(trials_of, plant):
    """An arm that falls does so differently each time; what came before still counts."""
    trial = trials_of(plant, 3, (1.0,), 1)[0]
    follows_rad = np.abs(trial.goal_rad - trial.angle_rad).max(axis=0)
    assert rows_that_follow(trial, follows_rad).all()
    late = {name: column.copy() for name, column in trial.columns.items()}
    late["angle_1_rad"][150:170] += 2 * (follows_rad[0] + LOST_RAD)
    late["current_1_a"][150:170] = 0.0
    assert rows_that_follow(replace(trial, columns=late), follows_rad).all(), "it does not even try"
    late["current_1_a"][150:170] = -np.abs(trial.current_a).max()
    rows = rows_that_follow(replace(trial, columns=late), follows_rad)
    assert rows[:150].all() and not rows[150:].any()


def test_a_limit_that_lets_the_arm_fall_is_named(plant, hidden):
    """Its twin follows what came before the fall, which is left out and told of."""
    before = hidden()
    current_a = max(np.abs(t.current_a).max() for t in before)
    limit_a = plant.parameters["current_limit_1_a"].value
    trials = hidden(current_saturation_1_a=limit_a - 0.7 * current_a)
    found = diagnosed(plant, trials)
    data = gap_document(found, trials)
    lost = data["lost_at_row"]
    trial = next(t for t in trials if t.name in lost)
    other = {name: column.copy() for name, column in trial.columns.items()}
    other["angle_1_rad"][lost[trial.name] :] += 1.0
    rms = [
        errors_in_floors(plant, [t], {}, lost)["angle_1_rad"]["rms"]
        for t in (trial, replace(trial, columns=other))
    ]
    assert rms[0] == rms[1], "the fall itself, where no simulation follows, is left out"
    assert set(lost) == {"payload1_1", "payload1_2"}
    assert found.naming.named[:1] == ["current_saturation"]
    cut = found.improved.parameters["current_saturation_1_a"]
    assert limit_a - cut.value == pytest.approx(0.7 * current_a, rel=0.03)


def test_a_limit_of_the_current_is_named_though_it_shows_nothing_at_first(plant, hidden):
    current_a = max(np.abs(t.current_a).max() for t in hidden())
    limit_a = plant.parameters["current_limit_1_a"].value
    found = diagnosed(plant, hidden(current_saturation_1_a=limit_a - 0.9 * current_a))
    assert found.naming.named[:1] == ["current_saturation"]
    cut = found.improved.parameters["current_saturation_1_a"]
    assert limit_a - cut.value == pytest.approx(0.9 * current_a, rel=0.05)


def test_what_hides_in_the_variation_of_the_trials_is_missed(plant, hidden):
    """An offset of the payload that may not be named looks like eccentricity in every trial."""
    trials = hidden(payload_offset_share=0.06)
    found = diagnosed(plant, trials)
    assert found.verdict == "not in the catalogue"
    data = gap_document(found, trials)
    assert abs(data["strained"]["eccentricity_m"]) > 8
    assert "eccentricity_m" in gap_in_words(data)


def test_what_eases_such_a_strain_need_not_stand_out_beside_the_first(plant, hidden):
    trials = hidden(hardening_share=1.0, payload_offset_share=0.03)
    others = [
        e for e in candidate_effects(plant) if e not in ("stiffness_hardening", "payload_offset")
    ]
    naming = diagnose(plant, trials, leave_out=others).naming
    assert naming.named == ["stiffness_hardening", "payload_offset"]
    first, second = naming.chosen
    assert second.separation < NEXT["stiffness"] * first.separation
