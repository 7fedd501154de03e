"""Rival hypotheses: nested sets count as one, and the least likely are left out."""

import pytest

from firmware_py.errors import InputError
from models.gap.experiment.rival import credible_set, fitted_values_of, rivals_of
from models.gap.report.gap_json import HypothesisRecord
from models.gap.residuals.fit_parameters import effect_fit_parameters
from models.plant.plant import read_plant


def hypothesis(probability, *effects):
    return HypothesisRecord(effects, probability, {})


def test_a_set_that_holds_another_gives_it_its_probability():
    rivals = rivals_of(
        [
            hypothesis(0.4, "creep"),
            hypothesis(0.3, "hysteresis"),
            hypothesis(0.2, "creep", "cogging"),
            hypothesis(0.1, "creep", "hysteresis"),
        ]
    )
    assert [r.effects for r in rivals] == [("creep",), ("hysteresis",)]
    assert [r.probability for r in rivals] == pytest.approx([0.65, 0.35])


def test_nothing_missing_is_a_rival_and_takes_no_other_set():
    rivals = rivals_of([hypothesis(0.6, "creep"), hypothesis(0.4)])
    assert [r.label for r in rivals] == ["creep", "nothing missing"]


def test_unlikely_hypotheses_are_left_out_but_for_two():
    rivals = rivals_of([hypothesis(0.98, "creep"), hypothesis(0.015, "cogging"),
                        hypothesis(0.005, "stiction")])  # fmt: skip
    assert [r.effects for r in rivals] == [("creep",), ("cogging",)]


def test_the_set_that_holds_95_percent_is_the_smallest():
    rivals = rivals_of([hypothesis(0.7, "creep"), hypothesis(0.26, "cogging"),
                        hypothesis(0.04, "stiction")])  # fmt: skip
    assert [r.effects for r in credible_set(rivals)] == [("creep",), ("cogging",)]


def test_the_values_of_a_hypothesis_become_fit_parameters():
    plant = read_plant()
    own = effect_fit_parameters(plant, "encoder_offset", 1)
    record = HypothesisRecord(("encoder_offset",), 1.0, {own[0].name: 0.02})
    (rival,) = rivals_of([record])
    assert fitted_values_of(rival, plant, own)[0] == pytest.approx(0.02)


def test_a_value_beyond_its_bounds_is_refused():
    plant = read_plant()
    own = effect_fit_parameters(plant, "encoder_offset", 1)
    (rival,) = rivals_of([HypothesisRecord(("encoder_offset",), 1.0, {own[0].name: 1.1e3})])
    with pytest.raises(InputError, match="beyond its bounds"):
        fitted_values_of(rival, plant, own)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ([hypothesis(0.6, "creep"), hypothesis(0.4, "slip")], "'slip'"),
        ([hypothesis(0.0, "creep"), hypothesis(0.0, "cogging")], "no hypothesis a probability"),
    ],
)
def test_an_edited_document_is_refused(wrong, said):
    with pytest.raises(InputError, match=said):
        rivals_of(wrong)
