"""Sentences of a diagnosis: they follow from the document alone and do not contradict it."""

import pytest
from msgspec.structs import replace

from models.gap.report.gap_json import (
    FittedValue,
    RefusedEffects,
    SeparatingMotion,
    WrittenPlant,
)
from models.gap.report.gap_words import (
    amount,
    gap_in_words,
    headline,
    look_alikes_in_words,
    most_improved_signal,
    next_step_in_words,
    strength_of,
)


def test_the_headline_has_name_value_probability_and_the_signal_that_shows_it(document, effect):
    words = headline(document("closed", effect("dead_time")))
    assert words.startswith("Missing: dead time 30 ± 1 ms (")
    assert "probability 97%" in words and "It explains the gap" in words
    assert words.endswith("The error of the angle of joint 1 falls from 12.1 to 3.3\u00a0mrad.")
    assert "tip" not in words


def test_a_signal_is_only_praised_if_its_error_falls_and_the_plant_changed(document, effect):
    worse = document("closed", effect("dead_time"))
    worse = replace(worse, after=worse.before)
    assert most_improved_signal(worse) is None and "falls" not in headline(worse)
    reason = "the held-out error of tip_x_m would be 108% of that as given"
    refused = RefusedEffects(("dead_time",), "not written", 40.0, reason)
    found = document(
        "closed", effect("dead_time"), refused=(refused,), written=WrittenPlant((), {}, reason)
    )
    words = headline(found)
    assert "falls" not in words
    assert f"Dead time is not written to the plant: {reason}." in words
    assert "Identify the plant again" in next_step_in_words(found)


@pytest.mark.parametrize(
    ("verdict", "answers", "names", "words"),
    [
        ("reduced", (0.0, 0.9, 0.1), ["creep", "backlash"], "They explain a part of what a refit"),
        ("no gap", (0.93, 0.0, 0.07), [], "nothing that is missing (probability 93%)"),
        ("no gap", (0.4, 0.3, 0.3), [], "that one is missing has a probability of 60%"),
        ("no gap", (0.4, 0.3, 0.3), ["creep"], "It explains little of the gap"),
        ("not in the catalogue", (0.1, 0.1, 0.8), [], "not in the catalogue (probability 80%)"),
        ("not in the catalogue", None, ["creep"], "It explains little of the gap. Something"),
        ("no floor", None, [], "Nothing is named. There is no noise floor"),
        ("no floor", None, ["creep"], "falls to 40%, but noise and model error cannot"),
    ],
)
def test_every_verdict_has_its_words(document, effect, verdict, answers, names, words):
    found = document(verdict, *map(effect, names), answers=answers, learned=bool(answers))
    assert words in headline(found)
    assert ("probability" in headline(found)) == bool(answers and (names or "%)" in words)) or (
        "has a probability" in words
    )


def test_a_strength_that_is_written_with_another_value_is_reported(document, effect):
    found = document("closed", effect("dead_time", parameters={
        "dead_time_1_s": FittedValue(0.05, "s", 0.001, 0.0)
    }))  # fmt: skip
    assert headline(found).endswith("Fitted for the written plant: dead time 30 ± 1 ms.")


def test_a_refitted_link_is_reported(document):
    changed = {"root_stiffness_1_nm_rad": FittedValue(80.0, "N.m/rad", None, 100.0)}
    found = document(answers=(0.95, 0.0, 0.05), written=WrittenPlant((), changed))
    assert "as refitted: root stiffness 1 −20%" in headline(found)
    assert "Use the refitted plant" in next_step_in_words(found)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"verdict": "no floor", "answers": None}, "Identify the plant on repeated trials"),
        ({"verdict": "not in the catalogue", "answers": (0.1, 0.1, 0.8)}, "describe the effect"),
        ({"answers": (0.95, 0.04, 0.01)}, "Nothing: the plant explains"),
        ({"answers": (0.6, 0.2, 0.2)}, "too faintly"),
        ({"verdict": "reduced", "names": ["creep"]}, "more than noise is left"),
        ({"verdict": "closed", "names": ["creep"]}, "Use the improved plant"),
        (
            {"verdict": "closed", "names": ["creep"],
             "effect_probabilities": {"creep": 0.6, "hysteresis:2": 0.4}},
            "decide on creep and hysteresis of joint 2: 'dropstitch experiment --gap 'my gap.json'",
        ),
    ],
)  # fmt: skip
def test_the_next_step_follows_from_what_is_known(document, effect, changes, words):
    names = changes.pop("names", [])
    verdict = changes.pop("verdict", "no gap")
    assert words in next_step_in_words(
        document(verdict, *map(effect, names), **changes), "my gap.json"
    )


def test_look_alikes_come_with_the_motion_that_separates_them(document, effect):
    motion = SeparatingMotion("slow triangle", {"slow triangle": 8.2, "multisine": 2.0})
    row = effect("creep", look_alikes=["hysteresis", "backlash:2"], separated_by=motion)
    words = look_alikes_in_words(row)
    assert "cannot tell creep from hysteresis or backlash of joint 2" in words
    assert "'slow triangle' would (d′ 8)" in words
    weak = replace(row, separated_by=SeparatingMotion("multisine", {"multisine": 2.0}))
    assert "no fixed motion" in look_alikes_in_words(weak)
    assert look_alikes_in_words(replace(row, look_alikes=())) == ""


@pytest.mark.parametrize(
    ("first", "second", "joint"),
    [((3.59, 3.22), (3.38, 5.26), 2), ((0.0, 0.02), (0.0, 0.0), 1), ((1.0, 2.0), (1.0, 2.5), None)],
)
def test_the_strength_is_that_of_the_joint_that_changed_most(effect, first, second, joint):
    parameters = {
        f"friction_{j}_nm": FittedValue(after, "N.m", None, before)
        for j, (before, after) in ((1, first), (2, second))
    }
    row = effect("coulomb_friction", parameters=parameters)
    found, value = strength_of(row)
    assert found == joint
    assert value.value == max(first, second, key=lambda own: abs(own[1] - own[0]))[1]
    assert strength_of(replace(row, joint=2))[0] == 2


def test_values_are_written_in_display_units():
    assert amount(FittedValue(-0.05, "s", 2e-4, 0.0)) == "−50 ± 0.2 ms"
    assert amount(FittedValue(5.1, "N.m.s/rad", 0.12, 3.2)) == "from 3.2 to 5.1 ± 0.12 N·m·s/rad"
    assert amount(FittedValue(0.15, "1", None, 0.0)) == "15 %"


def test_the_console_shows_a_plain_result_in_about_a_dozen_lines(document, effect):
    found = document("closed", effect("dead_time"))
    found = replace(found, headline=headline(found))
    lines = gap_in_words(found, "out/gap.json").splitlines()
    assert len(lines) <= 12
    assert lines[:2] == ["verdict: closed", found.headline]
    rows = [line.split() for line in lines if line.startswith("  ")]
    assert [row[0] for row in rows] == ["angle_1_rad", "tip_x_m"], "the largest gap first"
    assert lines[-1].startswith("next: ")
