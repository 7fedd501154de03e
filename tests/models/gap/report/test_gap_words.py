"""Sentences about probabilities and the next step."""

from types import SimpleNamespace

import pytest

from models.gap.report.gap_words import next_step_in_words, probabilities_in_words


def document(verdict, *named, **probabilities):
    return SimpleNamespace(
        verdict=verdict,
        named=[SimpleNamespace(kept=True, effect=effect) for effect in named],
        effect_probabilities=probabilities,
        refused=[],
    )


@pytest.mark.parametrize(
    ("found", "words"),
    [
        (document("no floor", "creep", creep=0.99), "Repeat at least one trial"),
        (document("not in the catalogue", creep=0.99), "Record another motion"),
        (document("closed", "creep", creep=0.6, hysteresis=0.4), "creep, hysteresis: python -m"),
        (document("closed", "creep", creep=0.97, hysteresis=0.03), "Use the improved plant"),
        (document("no gap"), "Nothing"),
        (document("no gap", hysteresis=0.6), "Nothing"),
        (document("no gap", hysteresis=0.95), "motion or payload: hysteresis would explain"),
    ],
)
def test_the_next_step_follows_from_what_is_undecided(found, words):
    assert words in next_step_in_words(found)


def test_only_effects_that_may_be_missing_are_listed():
    found = document("closed", "dead_time", dead_time=0.97, creep=0.2, prebend=0.05)
    said = probabilities_in_words(found)
    assert "dead time 97%" in said and "creep 20%" in said and "prebend" not in said
    assert probabilities_in_words(document("no gap", creep=0.95)) == "", "the verdict decides"
