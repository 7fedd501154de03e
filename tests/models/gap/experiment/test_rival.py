"""Rival hypotheses: nested sets count as one, and the least likely are left out."""

import pytest

from firmware_py.core.errors import InputError
from models.gap.experiment.rival import Rival, credible_set, fitted_values_of, rivals_of
from models.gap.report.gap_json import HypothesisRecord
from models.gap.residuals.fit_parameters import effect_candidates
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


@pytest.mark.parametrize(
    ("effects", "changes", "values"),
    [
        (("coulomb_friction",), (2.0, 2.0), {"coulomb_friction": 2.0}),
        (("coulomb_friction:2",), (0.0, 3.0), {"coulomb_friction:2": 3.0}),
        (
            ("coulomb_friction", "coulomb_friction:1"), (5.0, 2.0),
            {"coulomb_friction": 2.0, "coulomb_friction:1": 3.0},
        ),
    ],
)  # fmt: skip
def test_the_values_of_a_hypothesis_become_those_of_its_candidates(effects, changes, values):
    plant = read_plant()
    fit_parameters = [
        q for own in effect_candidates(plant, "coulomb_friction", 2).values() for q in own
    ]
    names = ("coulomb_friction_1_nm", "coulomb_friction_2_nm")
    parameters = {n: plant.parameters[n].value + c for n, c in zip(names, changes, strict=True)}
    fitted = fitted_values_of(Rival(effects, 1.0, parameters), plant, fit_parameters)
    named = {q.effect: v for q, v in zip(fit_parameters, fitted, strict=True) if v}
    assert named == pytest.approx(values)


def test_a_document_without_probabilities_is_refused():
    with pytest.raises(InputError, match="no hypothesis a probability"):
        rivals_of([hypothesis(0.0, "creep"), hypothesis(0.0, "cogging")])
