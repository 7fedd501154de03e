"""Certainty of a name, fitted to records."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from models.gap.decision.certainty import Certainty, Evidence
from models.gap.training.case_runs import DataSetRecord, Strength
from models.gap.training.cases import HiddenCase
from models.gap.training.fit import (
    calibration_table,
    equation_errors,
    fitted_certainty,
    true_answer,
)
from tests.models.gap.training.records import made_record

LEAST = 8.0


@pytest.fixture
def made_records():
    kinds = ("single", "single", "pair", "null", "null", "outside")
    hidden = {"single": {"backlash": 1.0}, "pair": {"cogging": 1.0, "stiction": 1.0}, "null": {},
              "outside": {"prebend": 0.03}}  # fmt: skip
    return [
        made_record(HiddenCase(kind, hidden[kind], {}, n, f"drawn_{600 + rig}"))
        for rig in range(8) for n, kind in enumerate(kinds)
    ]  # fmt: skip


def record(kind="single", hidden=("creep",), best=("creep",), **changes):
    case = HiddenCase(kind, dict.fromkeys(hidden, 1.0), {}, 1, "drawn_600")
    return DataSetRecord(case=case, best=best, named=best, **changes)


def test_probabilities_tell_the_answers_of_the_records(made_records):
    certainty, report = fitted_certainty(made_records, {"numpy": "2"})
    assert certainty.made_with == {"numpy": "2"} and certainty.data_sets == len(made_records)
    for kind, evidence in {
        "nothing": Evidence(3.0, 0.3, 1.0, False),
        "catalogue": Evidence(40.0, 0.07, 0.1, False),
        "outside": Evidence(30.0, 0.6, 0.9, True),
    }.items():
        assert getattr(certainty.answers_for(evidence), kind) > 0.8
    assert 3.0 < certainty.separation_of_nothing < 12.0
    assert certainty.residual_of_nothing == pytest.approx(1.0)
    assert "48 data sets of 8 rigs: catalogue 24, nothing 16, outside 8" in report
    assert "0.95 to 1.00" in report
    assert msgspec.json.decode(msgspec.json.encode(certainty), type=Certainty) == certainty


def test_a_larger_separation_counts_no_more_where_nothing_reaches_it_too(made_records):
    """On another motion the plant's own error reaches 24, with consistent strengths."""
    other = [
        msgspec.structs.replace(
            r, case=replace(r.case, motion="slow"), separation=24.0,
            evidence=Evidence(24.0, 0.05, 0.3, False),
        )
        for r in made_records if r.case.kind == "null"
    ]  # fmt: skip
    certainty, _ = fitted_certainty([*made_records, *other], {})
    scale = certainty.separation_scale
    assert scale["identified"] == 1.0 < scale["other motions"]
    scaled = Evidence(24.0 / scale["other motions"], 0.05, 0.3, False)
    assert certainty.answers_for(scaled).catalogue < 0.5


@pytest.mark.parametrize(
    ("row", "answer"),
    [
        (record("null", (), ("creep",)), "nothing"),
        (record(), "catalogue"),
        (record(best=("creep:2",)), "catalogue"),
        (record(best=("backlash",), look_alikes={"backlash": (("creep",),)}), "catalogue"),
        (record("pair", ("creep", "backlash")), "catalogue"),
        (
            record("pair", ("creep", "backlash"), ("creep", "cogging"), separation=LEAST + 1),
            "outside",
        ),
        (record(best=("backlash",), separation=LEAST + 1), "outside"),
        (record(best=("backlash",), separation=LEAST - 1), None),
        (record("outside", best=("backlash",)), "outside"),
        (record("outside", best=("backlash",), separable=False), None),
    ],
)
def test_what_would_have_been_the_right_answer(row, answer):
    assert true_answer(row, LEAST) == answer


@pytest.mark.parametrize("equation", [0.05, 0.2])
def test_the_error_of_an_equation_is_what_exceeds_chance(equation):
    rng = np.random.default_rng(0)

    def strengths(effect, count, error):
        return [
            Strength(effect, 1.0 + error * rng.standard_normal(), equation / 3, 1.0)
            for _ in range(count)
        ]

    errors = equation_errors(strengths("creep", 2000, np.hypot(equation, equation / 3)))
    assert equation < errors["creep"] < 1.5 * equation
    few = equation_errors(strengths("creep", 100, equation) + strengths("backlash", 1, 0.0))
    assert few["creep"] / 5 < few["backlash"] < few["creep"]


def test_an_effect_that_was_never_named_has_the_largest_error(made_records):
    certainty, _ = fitted_certainty(made_records, {})
    assert certainty.error_of_strength("new") == max(certainty.equation_error.values())


def test_a_calibration_table_has_the_fraction_that_is_right_in_each_bin():
    table = calibration_table(np.array([0.9, 0.85, 0.1, 1.0]), [True, False, False, True])
    assert [line.split(": ")[1] for line in table.splitlines()[1:]] == [
        "0.10 0.00 of 1", "0.88 0.50 of 2", "1.00 1.00 of 1",
    ]  # fmt: skip
