"""Fit of the answers: it finds in which direction evidence speaks, and refuses rigs for testing."""

import json

import msgspec
import numpy as np
import pytest

from models.gap.decision.answers import read_answer_model
from models.gap.decision.evidence import Evidence
from models.gap.training import answer_model, answer_tests
from models.gap.training.answer_model import (
    OF_A_GAP_ASKED,
    OF_NAMES_ASKED,
    Regularisation,
    bounds,
    fitted_regression,
    left_out,
    loss,
)
from models.gap.training.answer_tests import labelled, read_answer_tests, weights, with_left

KINDS = ("single", "null", "outside")
IN_USE = answer_tests.PATH
RIGS = ("drawn_1", "drawn_2", "drawn_3")


def evidence(kind, rng):
    """Evidence as in a data set of a kind, with scatter."""
    clear, differs, gap = {"single": (2, 0.05, 0.5), "null": (-1, 0, -0.5)}.get(
        kind, (1.5, 0.5, 0.5)
    )
    return Evidence(
        named=float(kind != "null"), gap=gap + 0.1 * rng.standard_normal(),
        clearness=clear + 0.3 * rng.standard_normal(), difference=abs(differs),
        rise=0.0, further=-1.0, rival=-1.5,
        left=-0.5, servo=gap, tip=gap,
    )  # fmt: skip


def result(kind, rig, rng, hidden="creep", named="creep", separable=True, alike=()):
    effects = [] if kind == "null" else [named]
    return {
        "case": {
            "kind": kind, "hidden": {} if kind == "null" else {hidden: 0.3}, "rig": rig,
            "nuisance": {}, "seed": int(rng.integers(2**31)),
        },
        "named": effects,
        "look_alikes": [[[e] for e in alike]],
        "separable": separable,
        "tested": [
            {"effects": effects, "evidence": msgspec.structs.asdict(evidence(kind, rng))},
        ],
    }  # fmt: skip


@pytest.fixture(scope="module")
def results():
    rng = np.random.default_rng(0)
    return [result(kind, rig, rng) for rig in RIGS for kind in KINDS for _ in range(8)]


def test_each_regression_tells_what_it_is_asked(results):
    rows, rng = labelled(results), np.random.default_rng(1)
    names = fitted_regression(rows, OF_NAMES_ASKED, Regularisation())
    gap = fitted_regression(rows, OF_A_GAP_ASKED, Regularisation())
    of = {kind: evidence(kind, rng) for kind in KINDS}
    assert names.probability(of["single"], ["creep"]) > 0.5
    assert max(names.probability(of[kind], []) for kind in ("null", "outside")) < 0.5
    assert gap.probability(of["null"], []) < 0.5 < gap.probability(of["outside"], [])


def test_an_effect_that_often_stands_in_for_others_is_believed_less():
    rng, rows = np.random.default_rng(2), []
    for hidden, named in 8 * (("creep", "creep"), ("stiction", "backlash"), ("drag", "drag")):
        rows += labelled([result("single", "drawn_1", rng, hidden=hidden, named=named)])
    fitted = fitted_regression(rows, OF_NAMES_ASKED, Regularisation())
    same = rows[0].evidence
    creep, backlash, pair, new = (
        fitted.probability(same, e)
        for e in (["creep"], ["backlash"], ["backlash", "creep"], ["cogging"])
    )
    assert backlash < new < creep and backlash < pair < creep


def test_evidence_but_the_size_counts_within_what_most_tests_reach():
    rows = with_left(read_answer_tests())
    within = bounds(rows, OF_NAMES_ASKED, 0.2)
    assert bounds(rows, OF_NAMES_ASKED, 0.0) == {}
    assert set(within) == {"gap", "difference", "rise", "further", "rival"}
    for name, (low, high) in within.items():
        told = np.array([v for t in rows if (v := getattr(t.evidence, name))])
        assert [np.mean(told < low), np.mean(told > high)] == pytest.approx([0.2, 0.2], abs=0.02)


@pytest.mark.parametrize("question", [OF_NAMES_ASKED, OF_A_GAP_ASKED])
def test_a_rig_that_is_left_out_is_predicted_better_than_by_chance(results, question):
    tests = labelled(results)
    assert loss(tests, question, left_out(tests, question, Regularisation())) < np.log(2)


def test_a_gap_is_asked_only_where_its_evidence_was_measured(results):
    rows = labelled(results)
    bare = msgspec.structs.replace(
        rows[0], kind="null", evidence=msgspec.structs.replace(rows[0].evidence, servo=None)
    )
    assert OF_A_GAP_ASKED.rows([bare]) == [] and OF_NAMES_ASKED.rows([bare]) == [bare]
    assert {test.kind for test in OF_A_GAP_ASKED.rows(rows)} == {"null", "outside"}


@pytest.mark.parametrize(
    ("named", "alike", "answer"),
    [
        ("creep", (), "catalogue"),
        ("backlash", (), "outside"),
        ("backlash", ("creep",), "catalogue"),
    ],
)
def test_a_declared_look_alike_is_a_right_name_and_any_other_stands_in(named, alike, answer):
    rng = np.random.default_rng(0)
    (row,) = labelled([result("single", "drawn_1", rng, named=named, alike=alike)])
    assert row.answer == answer


def test_a_denied_effect_that_no_trial_tells_from_its_stand_in_has_no_true_answer():
    rng = np.random.default_rng(0)
    assert labelled([result("outside", "drawn_1", rng, separable=False)]) == []
    impossible = {"case": {"kind": "single", "hidden": {}, "rig": "drawn_1"}, "impossible": ""}
    assert labelled([impossible]) == []


def test_what_was_left_counts_as_the_mean_where_it_was_not_recorded(results):
    found, bare, *rest = (t for t in labelled(results) if t.effects)
    replace = msgspec.structs.replace
    with_values = [
        replace(t, evidence=replace(t.evidence, left=value))
        for t, value in zip([found, *rest], [-1.0, *([-0.2] * len(rest))], strict=True)
    ]
    bare = replace(bare, evidence=replace(bare.evidence, left=None))
    filled = with_left([bare, *with_values])
    mean = -(1.0 + 0.2 * len(rest)) / (1 + len(rest))
    assert filled[0].evidence.left == pytest.approx(mean)
    assert filled[1:] == with_values
    (unnamed, *_) = (t for t in labelled(results) if not t.effects)
    unnamed = replace(unnamed, evidence=replace(unnamed.evidence, left=None))
    assert with_left([unnamed])[0].evidence.left == unnamed.evidence.gap


def test_tests_of_one_data_set_weigh_as_much_as_one_of_another():
    rng = np.random.default_rng(0)
    twice, once = (result("single", "drawn_1", rng) for _ in range(2))
    twice["tested"] *= 2
    first, second, third = weights(labelled([twice, once]))
    assert first + second == pytest.approx(third) == pytest.approx(0.5)


@pytest.fixture
def files(monkeypatch, tmp_path):
    """Files that the command writes, in place of the project's."""
    monkeypatch.setattr(answer_model, "PATH", tmp_path / "answers.json")
    monkeypatch.setattr(answer_tests, "PATH", tmp_path / "answer_tests.jsonl")
    (tmp_path / "answer_tests.jsonl").touch()
    return tmp_path


def calibrate(monkeypatch, results, *options):
    monkeypatch.setattr(answer_model, "case_results", lambda run: dict(enumerate(results)))
    monkeypatch.setattr("sys.argv", ["answer_model", *options])
    answer_model.main()


def test_rigs_for_tests_are_refused_and_nothing_is_written(monkeypatch, files, capsys):
    rng = np.random.default_rng(0)
    with pytest.raises(SystemExit):
        calibrate(monkeypatch, [result("single", "drawn_900", rng)], "run")
    assert "drawn_900 is for testing" in capsys.readouterr().err
    assert not (files / "answers.json").exists() and read_answer_tests() == []


def test_what_was_fitted_is_written_where_that_is_asked_for(monkeypatch, files, capsys, results):
    calibrate(monkeypatch, results, "run")
    assert not (files / "answers.json").exists()
    assert len(read_answer_tests()) == len(results)
    calibrate(monkeypatch, results[:5], "run")
    assert len(read_answer_tests()) == len(results), "those of a data set are replaced"
    calibrate(monkeypatch, [], "--write")
    written = json.loads((files / "answers.json").read_text())
    assert written["sets"] == len(results)
    printed = capsys.readouterr().out
    assert "null 24 of 24, outside 24 of 24" in printed
    assert "link unchanged, outside, 24: outside 24" in printed.split("whole decisions")[-1]


def test_the_coefficients_in_use_tell_the_tests_of_the_table(monkeypatch):
    monkeypatch.setattr(answer_tests, "PATH", IN_USE)
    tests, model = read_answer_tests(), read_answer_model()
    for question, regression in (
        (OF_NAMES_ASKED, model.catalogue), (OF_A_GAP_ASKED, model.outside),
    ):  # fmt: skip
        rows = question.rows(tests)
        said = [regression.probability(test.evidence, test.effects) for test in rows]
        sure = [(p > 0.5) == (test.answer == question.answer)
                for p, test in zip(said, rows, strict=True) if abs(p - 0.5) > 0.4]  # fmt: skip
        assert len(sure) > 50 and np.mean(sure) > 0.9
        assert loss(tests, question, said) < np.log(2) / 1.5
