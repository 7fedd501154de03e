"""Fit of the answers: it finds in which direction evidence speaks, and refuses rigs for tests."""

import json

import msgspec
import numpy as np
import pytest

from bench.gap import calibrate_answers
from bench.gap.calibrate_answers import fitted_model, labelled, loss_left_out
from models.gap.decision.answers import Answers
from models.gap.decision.evidence import Evidence

KINDS = ("single", "null", "outside")
RIGS = ("drawn_1", "drawn_2", "drawn_3")


def evidence(kind, rng):
    """Evidence as in a data set of a kind, with scatter."""
    clear, differs, gap = {"single": (2, 0.05, 0.5), "null": (-1, 0, -0.5)}.get(
        kind, (1.5, 0.5, 0.5)
    )
    return Evidence(
        named=float(kind != "null"), gap=gap + 0.1 * rng.standard_normal(), left=-0.4,
        clearness=clear + 0.3 * rng.standard_normal(), difference=abs(differs), contradiction=0.0,
        rise=0.0, bias=0.5,
    )  # fmt: skip


def result(kind, rig, rng, hidden="creep", named="creep", separable=True, alike=()):
    effects = [] if kind == "null" else [named]
    return {
        "case": {"kind": kind, "hidden": {} if kind == "null" else {hidden: 0.3}, "rig": rig},
        "named": effects,
        "look_alikes": [[[e] for e in alike]],
        "separable": separable,
        "tested": [
            {"effects": effects, "evidence": msgspec.structs.asdict(evidence(kind, rng))},
        ],
    }


@pytest.fixture(scope="module")
def results():
    rng = np.random.default_rng(0)
    return [result(kind, rig, rng) for rig in RIGS for kind in KINDS for _ in range(8)]


def test_the_fitted_model_tells_the_kinds_apart(results):
    rows = labelled(results)
    model, rng = fitted_model(rows, 1.0), np.random.default_rng(1)
    likely = {
        kind: max(
            msgspec.structs.asdict(model.answers(evidence(kind, rng))).items(), key=lambda r: r[1]
        )[0]
        for kind in KINDS
    }
    assert likely == {"single": "catalogue", "null": "nothing", "outside": "outside"}
    assert isinstance(model.answers(rows[0].evidence), Answers)


def test_a_rig_that_is_left_out_is_predicted_better_than_by_chance(results):
    assert loss_left_out(labelled(results), 1.0) < np.log(3)


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


def test_tests_of_one_data_set_weigh_as_much_as_one_of_another():
    rng = np.random.default_rng(0)
    twice, once = (result("single", "drawn_1", rng) for _ in range(2))
    twice["tested"] *= 2
    rows = labelled([twice, once])
    assert rows[0].weight + rows[1].weight == pytest.approx(rows[2].weight)


def test_rigs_for_tests_are_refused_and_nothing_is_written(monkeypatch, tmp_path, capsys):
    file, rng = tmp_path / "answers.json", np.random.default_rng(0)
    found = {"a": result("single", "drawn_900", rng)}
    monkeypatch.setattr(calibrate_answers, "bench_results", lambda run: found)
    monkeypatch.setattr(calibrate_answers, "PATH", file)
    monkeypatch.setattr("sys.argv", ["calibrate_answers", str(tmp_path)])
    with pytest.raises(SystemExit):
        calibrate_answers.main()
    assert "drawn_900 is for tests" in capsys.readouterr().err
    assert not file.exists()


def test_what_was_fitted_is_written_and_its_quality_is_told(monkeypatch, tmp_path, capsys, results):
    file = tmp_path / "answers.json"
    monkeypatch.setattr(calibrate_answers, "bench_results", lambda run: dict(enumerate(results)))
    monkeypatch.setattr(calibrate_answers, "PATH", file)
    monkeypatch.setattr("sys.argv", ["calibrate_answers", str(tmp_path)])
    calibrate_answers.main()
    assert json.loads(file.read_text())["sets"] == len(results)
    assert "nothing    said to be nothing 24" in capsys.readouterr().out
