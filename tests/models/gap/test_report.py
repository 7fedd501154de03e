"""The gap document, its page and its sentences: they follow from the diagnosis alone."""

import json
from dataclasses import replace as changed_field

import numpy as np
import pytest
from markupsafe import escape
from msgspec.structs import replace

from firmware_py.core.errors import InputError
from models.gap.estimation.noise_floor import NoiseFloor
from models.gap.outliers import OutlierTrial
from models.gap.report import gap_json as gap
from models.gap.report.gap_page import localisation_maps, write_results
from models.gap.report.gap_results import changed_conditions
from models.gap.report.gap_words import (
    GENERAL_CHECK,
    MOST_CHECKS,
    amount,
    effects_to_check,
    headline,
    most_improved_signal,
    next_step_in_words,
    notes_in_words,
    strength_of,
)
from models.gap.residuals.localisation import GapRegion
from models.gap.settings import DEFAULT_SETTINGS, GapSettings
from models.plant.document import FittedTrial, Provenance
from tests.models.gap.made_documents import document, effect

# The files of a diagnosis

CONTRACT = {
    "verdict", "noise_floor", "located", "named", "before", "after", "rejected", "refused",
    "probabilities", "written", "headline",
}  # fmt: skip


@pytest.fixture(scope="module")
def written(late, tmp_path_factory):
    """Document and directory of a diagnosis."""
    out = tmp_path_factory.mktemp("gap")
    document, _ = write_results(late, gap.DiagnosisInputs("plant.json", "12", ("trials",)), out)
    return document, out


def test_the_document_has_the_keys_of_the_contract(written):
    data = json.loads((written[1] / "gap.json").read_text())
    assert data.keys() >= CONTRACT
    (entry,) = data["named"]
    assert (entry["effect"], entry["joint"]) == ("dead_time", None)
    value = entry["parameters"]["dead_time_1_s"]
    assert value["value"] == pytest.approx(0.02, abs=3 * value["error"] + 1e-3)
    assert entry["evidence"]["separation"] > entry["evidence"]["separation_of_nothing"]
    angle = [data[k]["held_out"]["angle_1_rad"]["floors"] for k in ("before", "after")]
    assert angle[1] < 0.2 * angle[0]
    assert all({"signal", "size"} <= set(row) for row in data["located"])
    assert data["written"]["effects"] == ["dead_time"]
    assert sum(data["probabilities"].values()) == pytest.approx(1.0)


def test_every_considered_effect_is_named_or_rejected(written, late):
    rejected = {row.effect: row for row in written[0].rejected}
    considered = {name.partition(":")[0] for name in late.naming.search.of}
    assert rejected.keys() | {"dead_time"} == considered
    assert "dead_time" not in rejected and all(row.reason for row in rejected.values())


def test_the_document_is_read_as_it_was_written_and_an_older_one_is_refused(written, tmp_path):
    document, out = written
    assert gap.read_gap_document(out / "gap.json") == document
    assert document.settings == DEFAULT_SETTINGS
    path = tmp_path / "gap.json"
    data = json.loads((out / "gap.json").read_text())
    path.write_text(json.dumps(data | {"schema": 2, "strained": {}}))
    with pytest.raises(InputError, match=r"gap\.json: has schema version 2.*dropstitch gap"):
        gap.read_gap_document(path)


def test_console_and_page_begin_with_the_same_sentence(written, late):
    document, out = written
    (path,) = out.glob("*.html")
    page = path.read_text()
    assert document.headline in late.summary() and "dead time" in document.headline
    parts = [str(escape(document.headline)), "What to check", "Next:", "<svg", "Where the"]
    places = [page.index(part) for part in parts]
    assert places == sorted(places)
    assert "http" not in page.replace("http://www.w3.org/2000/svg", "")


def test_the_signals_are_drawn_for_a_notebook(late):
    measured, before, after = late.plot().axes[0].lines
    labels = [line.get_label() for line in (measured, before, after)]
    assert labels == ["measured", "before", "after"]


def test_a_motion_is_recommended_that_tells_look_alikes_apart_within_the_limits(late):
    other = next(f for f in late.naming.explored if f.candidates == ("creep",))
    alike = changed_field(late, look_alikes={"dead_time": (other,)})
    (named,) = alike.document.named
    motion, added = named.separated_by.motion, named.separated_by.separation
    assert [row.effects for row in named.look_alikes] == [("creep",)]
    assert added[motion] == max(added.values()) > 0.0
    # With creep and 2 kg the multisine would fold the link.
    assert added.keys() == {"multisine with 1 kg", "triangle with 1 kg", "triangle with 2 kg"}
    assert f"from creep; {motion} would add most" in alike.summary()


# Documents without a diagnosis


def test_no_signal_is_praised_whose_error_does_not_fall_or_whose_plant_is_not_written():
    worse = document("closed", effect("dead_time"))
    worse = replace(worse, after=worse.before)
    assert most_improved_signal(worse) is None and "falls" not in headline(worse)
    reason = "the held-out error of tip_x_m would be 108% of that as given"
    refused = document(
        "closed", effect("dead_time"), written=gap.WrittenPlant((), {}, reason),
        refused=(gap.RefusedEffects(("dead_time",), "not written", 40.0, reason),),
    )  # fmt: skip
    assert "falls" not in headline(refused) and reason in headline(refused)
    assert "Identify the plant again" in next_step_in_words(refused)


@pytest.mark.parametrize(
    ("verdict", "answers", "names", "headline_words", "next_words"),
    [
        ("closed", (0.0, 0.98, 0.02), ["creep"], "It explains the gap", "improved plant"),
        ("reduced", (0.0, 0.9, 0.1), ["creep", "backlash"], "explain a part", "noise is left"),
        ("no gap", (0.93, 0.04, 0.03), [], "probability 93%", "Nothing"),
        ("no gap", (0.4, 0.3, 0.3), [], "probability of 60%", "too faintly"),
        ("not in the catalogue", (0.1, 0.1, 0.8), [], "probability 80%", "describe the effect"),
        ("not in the catalogue", None, [], "Something", "Identify the plant"),
        ("no floor", None, [], "Nothing is named", "Identify the plant on repeated trials"),
        ("no floor", None, ["creep"], "falls to 40%", ""),
    ],
)
def test_every_verdict_has_its_words_and_its_next_step(
    verdict, answers, names, headline_words, next_words
):
    row = document(verdict, *map(effect, names), answers=answers, learned=bool(answers))
    assert headline_words in headline(row)
    assert ("probability" in headline(row)) == bool(answers)
    assert next_words in next_step_in_words(row)


def test_an_undecided_name_leads_to_an_experiment():
    undecided = {"creep": 0.6, "hysteresis:2": 0.4}
    row = document("closed", effect("creep"), effect_probabilities=undecided)
    words = next_step_in_words(row, "my gap.json")
    assert "creep and hysteresis of joint 2" in words
    assert "dropstitch experiment --gap 'my gap.json'" in words


def test_what_the_written_plant_changes_is_reported():
    other = {"dead_time_1_s": gap.FittedValue(0.05, "s", 0.001, 0.0)}
    row = document("closed", effect("dead_time", parameters=other))
    assert "dead time 30 ± 1 ms" in headline(row)
    softer = {"root_stiffness_1_nm_rad": gap.FittedValue(80.0, "N.m/rad", None, 100.0)}
    row = document(answers=(0.95, 0.0, 0.05), written=gap.WrittenPlant((), softer))
    assert "root stiffness 1 −20%" in headline(row)
    assert "Use the refitted plant" in next_step_in_words(row)


@pytest.mark.parametrize(
    ("first", "second", "joint"),
    [((3.59, 3.22), (3.38, 5.26), 2), ((0.0, 0.02), (0.0, 0.0), 1), ((1.0, 2.0), (1.0, 2.5), None)],
)
def test_the_strength_is_that_of_the_joint_that_changed_most(first, second, joint):
    parameters = {
        f"friction_{j}_nm": gap.FittedValue(after, "N.m", None, before)
        for j, (before, after) in ((1, first), (2, second))
    }
    row = effect("coulomb_friction", parameters=parameters)
    changed, strength = strength_of(row)
    assert changed == joint
    assert (
        parameters[strength].value == max(first, second, key=lambda pair: abs(pair[1] - pair[0]))[1]
    )
    assert strength_of(replace(row, joint=2))[0] == 2


def test_values_are_written_in_display_units():
    assert amount(gap.FittedValue(-0.05, "s", 2e-4, 0.0)) == "−50 ± 0.2 ms"
    assert (
        amount(gap.FittedValue(5.1, "N.m.s/rad", 0.12, 3.2)) == "from 3.2 to 5.1 ± 0.12 N·m·s/rad"
    )
    assert amount(gap.FittedValue(0.15, "1", None, 0.0)) == "15 %"


# What a person checks on the robot


@pytest.mark.parametrize(("verdict", "last"), [("reduced", ["unmodelled_payload"]), ("closed", [])])
def test_named_effects_are_checked_first_and_further_ones_where_more_than_noise_remains(
    verdict, last
):
    further = gap.RefusedEffects(("unmodelled_payload",), "further", 17.0, "equations")
    row = document(
        verdict, effect("creep", look_alikes=["encoder_offset"]), effect("hose_spring", 2),
        effect_probabilities={"creep": 0.9, "cogging:1": 0.4, "stiction": 0.09},
        refused=(further,),
    )  # fmt: skip
    checks = effects_to_check(row)
    order = ["creep", "hose_spring", "cogging", "encoder_offset"]
    assert list(checks) == [*order, *last]
    assert checks["hose_spring"] == GENERAL_CHECK, "it is of no catalogue"
    many = document(effect_probabilities=dict.fromkeys("abcdefgh", 0.5))
    assert len(effects_to_check(many)) == MOST_CHECKS and effects_to_check(document()) == {}


# Notes on the trials


def notes(error_known="measured", larger=(), keys=("1dof steps",), **changes):
    """Notes of a document whose plant's error is known as stated."""
    floor = gap.NoiseFloorSummary(
        True, {"di": None}, dict.fromkeys(keys, error_known), dict(larger)
    )
    return notes_in_words(replace(document(), noise_floor=floor, **changes))


def test_plain_trials_need_no_note_and_everything_unusual_is_noted():
    assert notes() == []
    text = " ".join(
        notes(
            "unknown", larger={"2": 3.9}, goal_not_followed_at_row={"heavy": 310},
            rows_fitted={"long": 5000}, settings=GapSettings(same_link=True),
            odd_trials=(OutlierTrial("p2_r2", "p2_r2.csv", 1.0, 8.9, 1.6),),
            changed_conditions=(
                gap.ChangedCondition("step_s", "s", (0.017,), (0.02,)),
                gap.ChangedCondition("payload_kg", "kg", (0.0, 1.0), (0.5,)),
                gap.ChangedCondition("pressure_pa", "Pa", (41300.0,), (35e3,)),
            ),
        )
    )  # fmt: skip
    for words in (
        "p2_r2 (1 kg)", "8.9 noise floors", "heavy from row 310", "5000 of long",
        "identify the plant on trials of this motion too: 1dof steps", "3.9 times at 2 kg",
        "The link is taken", "20.0\u00a0ms apart, 17.0\u00a0ms",
        "identified with 0, 1 kg, not with 0.5 kg", "is 35000 Pa, 41300 Pa in the trials",
    ):  # fmt: skip
        assert words in text


def test_conditions_are_compared_with_those_of_the_plant(make_trial):
    def trial(step_s=0.017, **changes):
        return make_trial(np.zeros(50), step_s=step_s, **changes)

    def changed(trials, pressure_pa=41300.0, **unknown):
        spectrum = {"di": np.ones(3)}
        curves = {"1dof sinusoid 0.5236rad 4.352s 0rad 572x0.017s": {0.0: spectrum, 2.0: spectrum}}
        known = {"noise": spectrum, "model": spectrum, "curves": curves} | unknown
        fitted = (FittedTrial("a", "12", "measured", "", pressure_pa),)
        floor = NoiseFloor(np.arange(3.0), **known)
        rows = changed_conditions(Provenance(fitted_trials=fitted), floor, trials)
        return {row.condition: (row.plant, row.trials) for row in rows}

    same = [trial(payload_kg=2.0, pressure_pa=41500.0), trial(payload_kg=0.01)]
    assert changed(same) == {}
    other = [trial(0.02, payload_kg=1.0, pressure_pa=35e3), trial(payload_kg=2.0)]
    rows = changed(other)
    assert rows["step_s"] == ((0.017,), pytest.approx((0.02,)))
    assert rows["payload_kg"] == ((0.0, 2.0), (1.0,))
    assert 35e3 in rows["pressure_pa"][1]
    assert changed(other, 0.0, noise={}, model={}, curves={}, learned=False) == {}


# Charts


def test_signals_are_ranked_by_their_largest_significant_gap_over_a_trial():
    rows = [
        GapRegion("di", "trial", "one", 3.0, 0, 0, True),
        GapRegion("tip_x_m", "trial", "one", 2.0, 0, 0, True),
        GapRegion("tip_x_m", "trial", "two", 5.0, 0, 0, True),
        GapRegion("current_1_a", "trial", "one", 9.0, 0, 0, False),
        GapRegion("di", "band", "0 to 0.3 Hz", 20.0, 0, 0, True),
    ]
    assert gap.largest_gaps(rows) == {"tip_x_m": 5.0, "di": 3.0}
    assert list(gap.largest_gaps(rows[3:])) == ["current_1_a"]


def test_a_map_shows_every_value_and_shades_the_significant_ones():
    regions = [
        GapRegion("tip_x_m", "phase", "1/8", 1.0, 0, 0.5, False),
        GapRegion("tip_x_m", "phase", "2/8", 12.3, 0, 0, True),
        GapRegion("angle_1_rad", "phase", "1/8", 3.21, 0, 0, True),
    ]
    _, table = localisation_maps(regions, learned=True)
    assert table.title == "Phase of the cycle" and list(table.header) == ["", "1/8", "2/8"]
    (angle, missing), (tip, most) = (row[1:] for row in table.rows)
    assert [cell.text for cell in (angle, missing, tip, most)] == ["3.2", "", "1.0", "12"]
    assert tip.shade is None and missing.shade is None
    assert 0.0 < angle.shade < most.shade == 1.0
