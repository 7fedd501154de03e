"""Certainty: probabilities that follow the evidence, and caution where nothing was measured."""

import pytest

from models.gap.decision.certainty import Evidence, read_certainty

CLEAR = Evidence(separation=60.0, difference=0.05, left=0.2, is_open=False)
FAINT = Evidence(separation=2.0, difference=0.2, left=1.0, is_open=False)
OWN_ERROR = Evidence(separation=12.0, difference=0.5, left=0.9, is_open=False)
STAND_IN = Evidence(separation=40.0, difference=0.8, left=0.9, is_open=True)
USELESS = Evidence(separation=36.0, difference=0.05, left=1.0, is_open=True)


@pytest.mark.parametrize(
    "evidence, answer",
    [
        (CLEAR, "catalogue"),
        (FAINT, "nothing"),
        (OWN_ERROR, "nothing"),
        (STAND_IN, "outside"),
        (USELESS, "outside"),
    ],
)
def test_the_most_probable_answer_follows_the_evidence(evidence, answer):
    answers = read_certainty().answers_for(evidence)
    probabilities = {n: getattr(answers, n) for n in ("nothing", "catalogue", "outside")}
    assert sum(probabilities.values()) == pytest.approx(1.0)
    assert max(probabilities, key=probabilities.get) == answer


def test_an_effect_that_was_never_measured_is_as_uncertain_as_the_worst():
    certainty = read_certainty()
    assert certainty.error_of_strength("new") == max(certainty.equation_error.values())
