"""Sentences about probabilities and the next step."""

from types import SimpleNamespace

import pytest
from msgspec.structs import replace

from models.gap.decision.answers import Answers
from models.gap.decision.further_effect import FurtherEffect
from models.gap.decision.rejected_effects import STAND_IN_BESIDE_OTHERS
from models.gap.report.gap_json import FittedValue
from models.gap.report.gap_words import (
    joint_of,
    probabilities_in_words,
    refusals_in_words,
    verdict_in_words,
)
from models.gap.report.next_step import SHOWS_AS, is_plant_as_given, next_step_in_words
from models.gap.search.refused_effect import RefusedEffect
from models.gap.settings import DEFAULT_SETTINGS


def document(verdict, *named, answers=None, further=None, refitted=(), **probabilities):
    return SimpleNamespace(
        verdict=verdict,
        named=[
            SimpleNamespace(kept=True, effect=effect, parameters={}, look_alikes=())
            for effect in named
        ],
        effect_probabilities=probabilities,
        answers=answers,
        refused=[],
        settings=SimpleNamespace(same_link=False),
        refitted=dict(refitted),
        tested=[SimpleNamespace(further=further)],
        nuisance_bias={},
        odd_trials=(),
        before={"fitted": {"angle_1_rad": None}},
        after={"fitted": {"tip_z_m": SimpleNamespace(floors=3.4)}},
    )


@pytest.mark.parametrize(
    ("found", "words"),
    [
        (document("no floor", "creep", creep=0.99), "Repeat at least one trial"),
        (document("not in the catalogue", creep=0.99), "Record another motion"),
        (document("not in the catalogue", answers=Answers(0.0, 0.1, 0.9)), "describe the effect"),
        (document("not in the catalogue", answers=Answers(0.3, 0.0, 0.7)), "identify the plant"),
        (
            document("closed", "creep", creep=0.6, hysteresis=0.4),
            "creep, hysteresis: 'python -m models experiment --gap OUT/gap.json",
        ),
        (document("closed", "creep", creep=0.97, hysteresis=0.03), "Use the improved plant"),
        (
            document("reduced", "creep", further=FurtherEffect("backlash", 40.0, 20.0), creep=0.97),
            "whether backlash is missing too",
        ),
        (document("no gap"), "Nothing"),
        (document("no gap", answers=Answers(0.95, 0.04, 0.01)), "Nothing"),
        (document("no gap", answers=Answers(0.7, 0.2, 0.1)), "a probability of 30% something"),
    ],
)
def test_the_next_step_follows_from_what_is_undecided(found, words):
    assert words in next_step_in_words(found)


def test_an_odd_trial_is_mended_first_and_a_refitted_link_is_the_better_plant():
    found = document("no gap", answers=Answers(0.7, 0.2, 0.1), refitted={"link_mass_kg": None})
    found.odd_trials = (SimpleNamespace(name="load2_trial1"),)
    said = next_step_in_words(found)
    assert said.startswith("Check") and "load2_trial1" in said and "refitted link" in said


@pytest.mark.parametrize("kind", [None, "held-out error", "stand-in"])
def test_where_more_is_left_the_next_step_is_to_look_for_it(kind):
    further = FurtherEffect("unmodelled_payload", separation=57.0, least=16.0)
    found = document("reduced", "backlash", further=further, backlash=0.98)
    found.refused = [SimpleNamespace(effect=further.effect, kind=kind)] if kind else []
    said = next_step_in_words(found)
    assert "whether unmodelled payload is missing too" in said and "Weigh" in said
    nothing_further = next_step_in_words(document("reduced", "backlash", backlash=0.98))
    assert "more than noise is left" in nothing_further and "Weigh" not in nothing_further


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("friction", "alike in their friction. Turn the joint by hand"),
        ("frame_m tip_x_m", "alike in their mocap frame along x. Calibrate the frame"),
    ],
)
def test_what_all_trials_share_is_what_a_person_looks_at(kind, words):
    found = document("reduced", "dead_time", dead_time=0.98)
    found.nuisance_bias = {"pressure": 11.0, kind: -14.0}
    assert words in next_step_in_words(found)
    assert set(SHOWS_AS) == set(DEFAULT_SETTINGS.nuisance_bias_kinds), "each has its check"


def test_the_next_command_has_the_path_of_the_diagnosis_and_tells_of_both_servos():
    found = document("closed", "creep", creep=0.6)
    assert "--gap 'my gap/gap.json'" in next_step_in_words(found, "my gap/gap.json")
    assert "both servos" not in next_step_in_words(found)
    found.before = {"fitted": {"angle_2_rad": None}}
    assert "both servos" in next_step_in_words(found)


@pytest.mark.parametrize(
    ("first", "second", "joint"),
    [((3.59, 3.22), (3.38, 5.26), 2), ((0.0, 0.02), (0.0, 0.0), 1), ((1.0, 2.0), (1.0, 2.5), None)],
)
def test_an_effect_is_told_with_the_joint_that_it_changed_in(first, second, joint):
    values = [FittedValue(after, "N.m", 0.1, before) for before, after in (first, second)]
    row = SimpleNamespace(
        kept=True, effect="coulomb_friction",
        parameters={f"coulomb_friction_{j}_nm": q for j, q in zip((1, 2), values, strict=True)},
    )  # fmt: skip
    found = document("closed")
    found.named = [row]
    assert joint_of(row) == joint
    of_joint = f" of joint {joint}" if joint else ""
    assert f"coulomb friction{of_joint}." in verdict_in_words(found)


def test_an_effect_with_one_strength_is_of_no_joint():
    row = SimpleNamespace(parameters={"unmodelled_payload_kg": FittedValue(0.3, "kg", 0.1, 0.0)})
    assert joint_of(row) is None


def test_every_answer_has_its_probability_and_likely_effects_are_listed():
    answers = Answers(nothing=0.003, catalogue=0.96, outside=0.037)
    found = document(
        "closed", "dead_time", answers=answers, dead_time=0.8, creep=0.15, prebend=0.01
    )
    said = probabilities_in_words(found)
    assert "nothing is missing <1%" in said and "something else is 4%" in said
    assert "96% (dead time 80%, creep 15%)" in said and "prebend" not in said
    assert probabilities_in_words(document("no floor", creep=0.95)) == ""


def test_no_probability_is_said_to_be_certain():
    said = probabilities_in_words(document("closed", answers=Answers(0.0, 1.0, 0.0)))
    assert "99%" in said and "100%" not in said


@pytest.mark.parametrize(
    ("separation", "words"),
    [
        (
            40.0,
            "backlash would take up most of it (by d′ 40, noise and these errors by 20)",
        ),
        (19.0, "more than noise is left, in tip_z_m 3.4 noise floors"),
    ],
)
def test_what_is_left_is_told_where_a_further_effect_would_explain_it(separation, words):
    further = FurtherEffect("backlash", separation, 20.0)
    assert words in verdict_in_words(document("reduced", "creep", further=further))


@pytest.mark.parametrize(
    ("catalogue", "words"),
    [(0.95, "Closed by creep."), (0.41, "Closed by creep (probability 41%).")],
)
def test_a_name_that_is_not_sure_is_told_with_its_probability(catalogue, words):
    answers = Answers(0.95 - catalogue, catalogue, 0.05)
    assert verdict_in_words(document("closed", "creep", answers=answers)) == words


@pytest.mark.parametrize(
    ("nothing", "words"),
    [
        (0.95, "These trials show nothing that is missing."),
        (0.03, "No effect can be named; that one is missing has a probability of 97%."),
    ],
)
def test_no_gap_is_not_said_where_something_is_missing_that_has_no_name(nothing, words):
    answers = Answers(nothing, 0.9 * (1 - nothing), 0.1 * (1 - nothing))
    assert verdict_in_words(document("no gap", answers=answers)) == words


def test_a_link_that_has_changed_is_told_with_what_changed_most():
    values = {"root_stiffness_1_nm_rad": (229.0, 190.0), "link_mass_kg": (0.9, 0.901)}
    refitted = {n: FittedValue(after, "", None, before) for n, (before, after) in values.items()}
    found = document("no gap", answers=Answers(0.95, 0.04, 0.01), refitted=refitted)
    said = verdict_in_words(found)
    assert "the link has changed" in said and "root stiffness 1 −17%" in said
    assert "link mass" not in said
    assert "Use the refitted plant" in next_step_in_words(found)
    assert not is_plant_as_given(found)


@pytest.mark.parametrize(
    ("likely", "words"),
    [
        (0.04, "The missing effect is not in the catalogue."),
        (0.3, "not in the catalogue is missing with a probability of 69%, nothing with 1%."),
        (0.6, "missing with a probability of 60% (creep 60%), something outside of it with 39%"),
    ],
)
def test_an_effect_that_is_likelier_than_anything_outside_is_told_with_the_verdict(likely, words):
    answers = Answers(0.01, likely, 0.99 - likely)
    found = document("not in the catalogue", answers=answers, creep=likely, backlash=0.02)
    assert words in verdict_in_words(found)


def refused(effect, kind, reason):
    return RefusedEffect(
        effect=effect, kind=kind, reason=reason, name="", value=0.0, limit=0.0, unit="1"
    )


def judged(probability, *effects):
    return SimpleNamespace(effects=effects, answers=Answers(0.0, probability, 1 - probability))


def test_where_several_sets_were_judged_in_vain_one_sentence_has_their_probabilities():
    found = document("not in the catalogue")
    found.tested = [
        judged(0.02, "hysteresis"), judged(0.28, "creep"), judged(0.43, "creep", "current_bias"),
        judged(0.61, "current_bias"), judged(0.63, "current_bias"),
    ]  # fmt: skip
    found.refused = [
        refused("creep", "stand-in", STAND_IN_BESIDE_OTHERS),
        refused("current_bias", "stand-in", "its probability is 63% only"),
        refused("marker_scale", "inconsistent", "its strength would have to differ"),
    ]
    sets, scale = refusals_in_words(found)
    assert "current bias 63%, creep + current bias 43%, creep 28%" in sets and "4" in sets
    assert scale.startswith("Marker scale was refused")
    found.named = [SimpleNamespace(kept=True, effect="current_bias")]
    assert refusals_in_words(found)[0].startswith("Creep was refused")


def test_a_sentence_keeps_the_name_of_a_value_as_it_is_spelled():
    found = document("closed", "creep")
    found.refused = [refused("", "at a bound", "root_damping_1_nm_s_rad ended at its upper bound")]
    (said,) = refusals_in_words(found)
    assert said.startswith("Refitted, root_damping_1_nm_s_rad ended")


def test_a_value_of_a_named_effect_at_its_bound_is_told_with_what_is_written():
    found = document("reduced", "backlash")
    found.named[0].parameters = {"backlash_mount_fraction": FittedValue(0.5, "1", None, 0.0)}
    row = refused("", "at a bound", "backlash_mount_fraction ended at its lower bound of -0.5")
    found.refused = [replace(row, name="backlash_mount_fraction")]
    assert "plant.json holds 0.5" in refusals_in_words(found)[0]
