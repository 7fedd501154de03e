"""The gap document, its page and its sentences: they follow from the diagnosis alone."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
from markupsafe import escape
from msgspec.structs import replace

from firmware_py.core.errors import InputError
from models.gap.decision.certainty import Answers
from models.gap.estimation.noise_floor import NoiseFloor
from models.gap.estimation.transfer import motion_of
from models.gap.outliers import OutlierTrial
from models.gap.report import separating_motion as separating_motion_module
from models.gap.report.diagnosis_files import write_results
from models.gap.report.effect_checks import (
    EFFECT_CHECKS,
    GENERAL_CHECK,
    MOST_CHECKS,
    effects_to_check,
)
from models.gap.report.gap_json import (
    ChangedCondition,
    DiagnosisInputs,
    FittedValue,
    GapDocument,
    HeldOutSummary,
    MappedRegion,
    NamedEffect,
    NamingEvidence,
    NoiseFloorSummary,
    RefusedEffects,
    RemainingGap,
    SeparatingMotion,
    SignalFloor,
    SignalGap,
    SimilarEffects,
    WrittenPlant,
    largest_gaps,
    read_gap_document,
)
from models.gap.report.gap_page import localisation_maps
from models.gap.report.gap_words import (
    amount,
    gap_in_words,
    headline,
    look_alikes_in_words,
    most_improved_signal,
    next_step_in_words,
    strength_of,
)
from models.gap.report.separating_motion import NO_MOTION, separating_motion
from models.gap.report.trial_notes import changed_conditions, notes_in_words
from models.gap.residuals.localisation import motion_in_words
from models.gap.settings import DEFAULT_SETTINGS, GapSettings
from models.plant.document import FittedTrial, Provenance
from models.plant.identification.noise_floor import trial_group_key
from models.shared.catalogue import EVERY_EFFECT
from models.trials.trial import Trial, TrialMeta

# The files of a diagnosis

CONTRACT = {
    "verdict", "noise_floor", "located", "named", "before", "after", "rejected", "refused",
    "probabilities", "written", "headline",
}  # fmt: skip


@pytest.fixture(scope="module")
def written(late, tmp_path_factory):
    """Document and directory of a diagnosis."""
    out = tmp_path_factory.mktemp("gap")
    document, _ = write_results(late, DiagnosisInputs("plant.json", "12", ("trials",)), out)
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
    assert read_gap_document(out / "gap.json") == document
    assert document.settings == DEFAULT_SETTINGS
    path = tmp_path / "gap.json"
    data = json.loads((out / "gap.json").read_text())
    path.write_text(json.dumps(data | {"schema": 2, "strained": {}}))
    with pytest.raises(InputError, match=r"gap\.json: has schema version 2.*dropstitch gap"):
        read_gap_document(path)


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


# Documents without a diagnosis

TIP, ANGLE = "tip_x_m", "angle_1_rad"


def effect(name, joint=None, look_alikes=(), parameters=None, **others):
    values = parameters or {f"{name}_1_x": FittedValue(0.03, "s", 0.001, 0.0)}
    return NamedEffect(
        effect=name, joint=joint, parameters=values,
        evidence=NamingEvidence(40.0, 25.0, 0.6, 0.05, 0.2),
        look_alikes=tuple(SimilarEffects((e,), 38.0) for e in look_alikes), **others,
    )  # fmt: skip


def errors(tip_m, angle_rad):
    """Errors by signal; the floor is 1 mm and 1 mrad."""
    signals = {
        TIP: SignalGap(tip_m, "m", tip_m / 1e-3),
        ANGLE: SignalGap(angle_rad, "rad", angle_rad / 1e-3),
    }
    return {"held_out": signals}


def document(verdict="no gap", *rows, answers=(0.0, 0.98, 0.02), learned=True, **changes):
    names = tuple(row.candidate for row in rows)
    parameters = {"dead_time_1_s": FittedValue(0.03, "s", 0.001, 0.0)} if rows else {}
    plain = {
        "probabilities": Answers(*answers) if answers else None,
        "gap_left_fraction": 0.2,
        "separation_of_nothing": 25.0,
        "effect_probabilities": dict.fromkeys(names, 0.97),
        "rejected": (),
        "written": WrittenPlant(names, parameters),
        "sentence": "With link and set-up refitted, the tip (x) differs most.",
        "located": (),
        "map": tuple(
            MappedRegion(signal, "trial", name, size, 0.0, 0.0, True)
            for signal, size in ((ANGLE, 9.0), (TIP, 3.0))
            for name in ("one", "two")
        ),
        "remaining": RemainingGap("", ()),
        "noise_floor": NoiseFloorSummary(
            learned, {s: SignalFloor(1e-3, 0.0, 1e-3) for s in (TIP, ANGLE)}
        ),
        "before": errors(4.41e-3, 12.1e-3),
        "after": errors(4.44e-3, 3.3e-3),
        "held_out": HeldOutSummary(("payloads",), 0.4),
        "settings": DEFAULT_SETTINGS,
    }
    return GapDocument(schema=GapDocument.VERSION, verdict=verdict, named=rows, **plain | changes)


def test_the_headline_has_name_value_probability_and_the_signal_that_shows_it():
    words = headline(document("closed", effect("dead_time")))
    assert words.startswith("Missing: dead time 30 ± 1 ms (") and "97%" in words
    assert words.endswith("angle of joint 1 falls from 12.1 to 3.3\u00a0mrad.")
    assert "tip" not in words


def test_no_signal_is_praised_whose_error_does_not_fall_or_whose_plant_is_not_written():
    worse = document("closed", effect("dead_time"))
    worse = replace(worse, after=worse.before)
    assert most_improved_signal(worse) is None and "falls" not in headline(worse)
    reason = "the held-out error of tip_x_m would be 108% of that as given"
    refused = document(
        "closed", effect("dead_time"), written=WrittenPlant((), {}, reason),
        refused=(RefusedEffects(("dead_time",), "not written", 40.0, reason),),
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
        ("no gap", (0.4, 0.3, 0.3), ["creep"], "explains little", ""),
        ("not in the catalogue", (0.1, 0.1, 0.8), [], "probability 80%", "describe the effect"),
        ("not in the catalogue", None, ["creep"], "Something", ""),
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
    other = {"dead_time_1_s": FittedValue(0.05, "s", 0.001, 0.0)}
    row = document("closed", effect("dead_time", parameters=other))
    assert headline(row).endswith("Fitted for the written plant: dead time 30 ± 1 ms.")
    softer = {"root_stiffness_1_nm_rad": FittedValue(80.0, "N.m/rad", None, 100.0)}
    row = document(answers=(0.95, 0.0, 0.05), written=WrittenPlant((), softer))
    assert "root stiffness 1 −20%" in headline(row)
    assert "Use the refitted plant" in next_step_in_words(row)


def test_look_alikes_come_with_the_motion_that_separates_them():
    motion = SeparatingMotion("slow triangle", {"slow triangle": 8.2, "multisine": 2.0})
    row = effect("creep", look_alikes=["hysteresis", "backlash:2"], separated_by=motion)
    words = look_alikes_in_words(row)
    assert "creep from hysteresis or backlash of joint 2" in words
    assert "'slow triangle' would (d′ 8)" in words
    weak = replace(row, separated_by=SeparatingMotion("multisine", {"multisine": 2.0}))
    assert "no fixed motion" in look_alikes_in_words(weak)
    assert look_alikes_in_words(replace(row, look_alikes=())) == ""


@pytest.mark.parametrize(
    ("first", "second", "joint"),
    [((3.59, 3.22), (3.38, 5.26), 2), ((0.0, 0.02), (0.0, 0.0), 1), ((1.0, 2.0), (1.0, 2.5), None)],
)
def test_the_strength_is_that_of_the_joint_that_changed_most(first, second, joint):
    parameters = {
        f"friction_{j}_nm": FittedValue(after, "N.m", None, before)
        for j, (before, after) in ((1, first), (2, second))
    }
    row = effect("coulomb_friction", parameters=parameters)
    changed, value = strength_of(row)
    assert changed == joint
    assert value.value == max(first, second, key=lambda pair: abs(pair[1] - pair[0]))[1]
    assert strength_of(replace(row, joint=2))[0] == 2


def test_values_are_written_in_display_units():
    assert amount(FittedValue(-0.05, "s", 2e-4, 0.0)) == "−50 ± 0.2 ms"
    assert amount(FittedValue(5.1, "N.m.s/rad", 0.12, 3.2)) == "from 3.2 to 5.1 ± 0.12 N·m·s/rad"
    assert amount(FittedValue(0.15, "1", None, 0.0)) == "15 %"


def test_the_console_shows_a_plain_result_in_about_a_dozen_lines():
    row = document("closed", effect("dead_time"))
    row = replace(row, headline=headline(row))
    lines = gap_in_words(row, "out/gap.json").splitlines()
    assert len(lines) <= 12
    assert lines[:2] == ["verdict: closed", row.headline] and lines[-1].startswith("next: ")
    signals = [line.split()[0] for line in lines if line.startswith("  ")]
    assert signals == ["angle_1_rad", "tip_x_m"], "the largest gap first"


# What a person checks on the robot


def test_every_effect_has_a_check_and_one_outside_the_catalogue_a_general_one():
    assert EFFECT_CHECKS.keys() == EVERY_EFFECT.keys()
    row = document("closed", effect("hose_spring"))
    assert effects_to_check(row) == {"hose_spring": GENERAL_CHECK}
    many = document(effect_probabilities=dict.fromkeys(EVERY_EFFECT, 0.5))
    assert len(effects_to_check(many)) == MOST_CHECKS and effects_to_check(document()) == {}


def test_named_effects_are_checked_first_then_likely_ones_then_look_alikes():
    row = document(
        "closed", effect("creep", look_alikes=["encoder_offset"]), effect("prebend", 2),
        effect_probabilities={"creep": 0.9, "cogging:1": 0.4, "hysteresis": 0.3, "stiction": 0.09},
    )  # fmt: skip
    order = ["creep", "prebend", "cogging", "hysteresis", "encoder_offset"]
    assert list(effects_to_check(row)) == order


@pytest.mark.parametrize(("verdict", "checked"), [("reduced", True), ("closed", False)])
def test_further_effects_are_checked_where_more_than_noise_remains(verdict, checked):
    further = RefusedEffects(("unmodelled_payload",), "further", 17.0, "equations")
    row = document(verdict, effect("backlash"), refused=(further,))
    assert ("unmodelled_payload" in effects_to_check(row)) == checked


@pytest.mark.parametrize(
    ("load", "period_s", "motions"),
    [
        # Free decay begins with 6 rad/s, which a servo without a watchdog may not run.
        ("link", 4.352, {"multisine", "slow triangle", "step and hold"}),
        ("link", 0.5, set()),
        ("pendulum", 4.352, set()),
    ],
)
def test_a_motion_is_recommended_that_the_servo_may_run(
    monkeypatch, make_trial, load, period_s, motions
):
    def fastest(plant, trial, alike):
        return [float(np.abs(np.diff(trial.goal_rad, axis=0)).max())]

    monkeypatch.setattr(separating_motion_module, "_simulated", lambda plant, trial: trial)
    monkeypatch.setattr(separating_motion_module, "_separations", fastest)
    trial = make_trial(np.zeros((80, 1)), amplitude_rad=0.52, period_s=period_s)
    diagnosis = SimpleNamespace(fitted=SimpleNamespace(load=load), trials=[trial])
    result = separating_motion(diagnosis, ["a look-alike"])
    assert motions <= set(result.separation) and "free decay" not in result.separation
    assert result.motion in result.separation if motions else result.motion == NO_MOTION


# Notes on the trials


def notes(error_known="measured", larger=(), keys=("1dof steps",), **changes):
    """Notes of a document whose plant's error is known as stated."""
    floor = NoiseFloorSummary(True, {"di": None}, dict.fromkeys(keys, error_known), dict(larger))
    return notes_in_words(replace(document(), noise_floor=floor, **changes))


def test_plain_trials_need_no_note_and_everything_unusual_is_noted():
    assert notes() == []
    text = " ".join(
        notes(
            "unknown", larger={"2": 3.9}, goal_not_followed_at_row={"heavy": 310},
            rows_fitted={"long": 5000}, settings=GapSettings(same_link=True),
            odd_trials=(OutlierTrial("p2_r2", "p2_r2.csv", 1.0, 8.9, 1.6),),
            changed_conditions=(
                ChangedCondition("step_s", "s", (0.017,), (0.02,)),
                ChangedCondition("payload_kg", "kg", (0.0, 1.0), (0.5,)),
                ChangedCondition("pressure_pa", "Pa", (41300.0,), (35e3,)),
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


def test_groups_of_trials_are_named_in_words():
    def noted(*keys):
        (note,) = notes("unknown", keys=keys)
        return note.replace("\u00a0", " ").split("too: ")[1]

    meta = TrialMeta(
        dof=2, payload_kg=1.0, trial=1, motion="sinusoid", source="rig", period_s=4.352,
        amplitude_rad=np.radians(30), phase_2_rad=np.pi / 2, rest_samples=60,
        conditions={"load_mass_kg": 0.5},
    )  # fmt: skip
    whole, short = (
        trial_group_key(Trial("run", meta, {"time_s": 0.017 * np.arange(rows)}))
        for rows in (572, 300)
    )
    words = "sinusoid of ±30°, period 4.352 s, joint 2 leads by 90°, two joints, load mass 0.5 kg"
    assert noted(whole) == f"{motion_in_words(motion_of(whole))}." == f"{words}."
    assert noted(whole, short) == f"{words}, 572 rows of 17.0 ms; {words}, 300 rows of 17.0 ms."
    assert noted("1dof steps 0.3491rad 0s 0rad 572x0.017s") == "steps of ±20°, one joint."
    assert noted("of another form") == "of another form."


# Charts


def test_signals_are_ranked_by_their_largest_significant_gap_over_a_trial():
    rows = [
        MappedRegion("di", "trial", "one", 3.0, 0, 0, True),
        MappedRegion("tip_x_m", "trial", "one", 2.0, 0, 0, True),
        MappedRegion("tip_x_m", "trial", "two", 5.0, 0, 0, True),
        MappedRegion("current_1_a", "trial", "one", 9.0, 0, 0, False),
        MappedRegion("di", "band", "0 to 0.3 Hz", 20.0, 0, 0, True),
    ]
    assert largest_gaps(rows) == {"tip_x_m": 5.0, "di": 3.0}
    assert list(largest_gaps(rows[3:])) == ["current_1_a"]


def test_a_map_shows_every_value_and_shades_the_significant_ones():
    regions = [
        MappedRegion("tip_x_m", "phase", "1/8", 1.0, 0, 0.5, False),
        MappedRegion("tip_x_m", "phase", "2/8", 12.3, 0, 0, True),
        MappedRegion("angle_1_rad", "phase", "1/8", 3.21, 0, 0, True),
    ]
    _, table = localisation_maps(regions)
    assert table.title == "Phase of the cycle" and list(table.header) == ["", "1/8", "2/8"]
    (angle, missing), (tip, most) = (row[1:] for row in table.rows)
    assert [cell.text for cell in (angle, missing, tip, most)] == ["3.2", "", "1.0", "12"]
    assert tip.shade is None and missing.shade is None
    assert 0.0 < angle.shade < most.shade == 1.0
