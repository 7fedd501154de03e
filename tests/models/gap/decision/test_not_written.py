"""Effects whose plant makes one signal worse are named, and the plant as given is written."""

import msgspec
import numpy as np
import pytest

from models.gap.decision.acceptance import Acceptance
from models.gap.report.gap_results import gap_document
from models.gap.report.gap_words import gap_in_words, next_step_in_words
from models.gap.search.refused_effect import RefusedEffect

HIDDEN_S = 0.02
HIDDEN_BIAS_A = 0.3

RISE = RefusedEffect(
    effect="", kind="rise of a signal", name="current_1_a", value=1.5, limit=1.05, unit="1",
    reason="the held-out error of current_1_a would be 150.0% of that of the plant as given",
)  # fmt: skip


BLAMED = "current_bias"
REFUSED = RefusedEffect(
    effect=BLAMED, kind="held-out error", name="", value=1.2, limit=1.0, unit="1",
    reason="it does not lower the error on what was left out beside dead time: 120.0% of the error",
)  # fmt: skip


@pytest.fixture(scope="module")
def with_a_rise(plant, hidden, diagnosed):
    """Diagnosis of hidden effects with which the current's held-out error would rise, trials."""

    def diagnosis(**effects):
        trials = hidden(**effects)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(Acceptance, "_failing", lambda self, fit: [RISE])
            return diagnosed(plant, trials), trials

    return diagnosis


@pytest.fixture(scope="module")
def withheld(with_a_rise):
    """Of a dead time alone."""
    return with_a_rise(dead_time_1_s=HIDDEN_S)


def test_of_two_effects_none_is_to_blame_for_a_rise_that_both_cause(with_a_rise):
    found, trials = with_a_rise(dead_time_1_s=HIDDEN_S, current_bias_1_a=HIDDEN_BIAS_A)
    assert set(found.named) == {"dead_time", "current_bias"}
    assert found.improved.parameters == found.plant.parameters
    text = gap_in_words(gap_document(found, trials))
    assert "not written" in text and "held-out error of current_1_a" in text


def test_of_two_effects_that_which_held_out_errors_refuse_is_named_and_the_other_written(
    monkeypatch, plant, hidden, diagnosed
):
    trials = hidden(dead_time_1_s=HIDDEN_S, current_bias_1_a=HIDDEN_BIAS_A)
    monkeypatch.setattr(
        Acceptance, "_failing", lambda self, fit: [REFUSED] * (BLAMED in self.result.named)
    )
    found = diagnosed(plant, trials)
    assert set(found.named) == {"dead_time", BLAMED}
    assert found.improved.provenance.named == ("dead_time",)
    assert BLAMED not in found.improved.effects
    assert [(r.effect, r.kind) for r in found.refused] == [(BLAMED, "not written")]
    document = gap_document(found, trials)
    text = gap_in_words(document)
    assert "Current bias is named, but its plant is not written" in text
    decided = msgspec.structs.replace(document, effect_probabilities={})
    assert "lacks current bias" in next_step_in_words(decided)


def test_the_effect_is_named_with_its_strength(withheld):
    found, trials = withheld
    assert found.named == ("dead_time",) and found.verdict == "closed"
    (row,) = gap_document(found, trials).named
    assert row.parameters["dead_time_1_s"].value == pytest.approx(HIDDEN_S, rel=0.1)


def test_the_plant_that_is_written_is_the_one_as_given(withheld):
    found, _ = withheld
    assert found.improved.parameters == found.plant.parameters
    assert found.improved.effects == found.plant.effects
    assert found.improved.provenance.named == ()
    assert found.held_out_improved == found.held_out_given


def test_it_is_said_why(withheld):
    found, trials = withheld
    document = gap_document(found, trials)
    text = gap_in_words(document)
    assert "Dead time is named, but its plant is not written" in text
    assert "Identify the plant again" in next_step_in_words(document)


def test_the_fit_that_names_is_no_worse_than_that_without_the_effect(withheld):
    found, _ = withheld
    assert found.residual_after < found.residual_before
    assert np.isfinite(found.gap_left_fraction) and found.gap_left_fraction < 0.5
