"""Training of the certainty: hidden data sets, the fit to their records, and the command.

No rig runs here where it would take hours.
"""

import zlib
from dataclasses import replace
from typing import get_args

import msgspec
import numpy as np
import pytest

from firmware_py.core.errors import InputError
from models.gap.decision import certainty
from models.gap.decision.certainty import Certainty, Evidence
from models.gap.training import __main__ as command
from models.gap.training.case_runs import (
    Addition,
    DataSetRecord,
    Strength,
    record_path,
    records_of,
    rig_of,
    run_cases,
)
from models.gap.training.cases import (
    HiddenCase,
    hidden_cases,
    tuning_cases,
)
from models.gap.training.fit import (
    equation_errors,
    fitted_certainty,
    is_added,
    true_answer,
)
from models.rig.drawn import rig_named

# Cases


@pytest.mark.parametrize("same_link", [False, True])
def test_the_link_of_a_case_differs_unless_it_is_the_same(same_link):
    nominal = rig_named("default")
    (case,) = hidden_cases("default", 1, 0, 0, 0, 0, seed=3, same_link=same_link)
    assert any(rig_of(case)[n] != nominal[n] for n in case.nuisance) is not same_link
    assert rig_of(case)["sensor.frame_tilt_rad"] != 0.0


def test_rigs_for_tuning_have_each_kind_of_trials_with_and_without_another_link():
    for number in (600, 601):
        cases = tuning_cases(number)
        assert len(set(map(repr, cases))) == len(cases)
        assert {case.kind for case in cases} == {"single", "null", "pair", "outside"}
        assert all(bool(case.nuisance) is (number == 600) for case in cases)
        nulls = [case for case in cases if case.kind == "null"]
        assert {"study", "between"} == {case.payloads for case in nulls}
        assert len({case.motion for case in nulls}) == 2
        assert any(case.joints == 2 for case in nulls) is (number == 600)


@pytest.mark.slow
def test_a_case_with_a_record_is_not_run_again_and_a_failure_is_reported(tmp_path):
    done, fails = (HiddenCase("null", {}, {}, seed, "drawn_1") for seed in (1, 2))
    (tmp_path / "plants").mkdir()
    (tmp_path / "plants" / "drawn_1.json").write_text("damaged")
    path = record_path(tmp_path, done)
    path.parent.mkdir()
    path.write_bytes(msgspec.json.encode(DataSetRecord(case=done)))
    assert run_cases([done, fails], tmp_path) == 1
    (trace,) = (tmp_path / "failures").glob("*.txt")
    assert "drawn_1.json" in trace.read_text()
    assert records_of([done, fails], tmp_path) == [DataSetRecord(case=done)]


# Fit


def made_record(case):
    """Record without a diagnosis: a clear effect is named rightly, a denied one explains little."""
    rng = np.random.default_rng(zlib.crc32(repr(case).encode()))
    separation, difference, residual = {
        "null": (3.0, 0.3, 1.0), "outside": (30.0, 0.6, 3.0),
    }.get(case.kind, (40.0, 0.05, 1.0))  # fmt: skip
    knowledge = "identified"
    if case.motion != "study":
        knowledge = "other motions"
        separation *= 8
    separation *= float(np.exp(0.3 * rng.standard_normal()))
    difference += 0.05 * rng.random()
    best = "creep" if case.kind in ("null", "outside") else next(iter(case.hidden))
    strengths = [
        Strength(e, 1.0 + 0.2 * rng.standard_normal(), 0.01, 1.0)
        for e in case.hidden if case.kind != "outside"
    ]  # fmt: skip
    return DataSetRecord(
        case=case, best=(best,), knowledge=knowledge,
        evidence=Evidence(separation, difference, residual),
        named=() if case.kind == "null" else (best,), strengths=tuple(strengths),
    )  # fmt: skip


@pytest.fixture(scope="module")
def made_records():
    kinds = ("single", "single", "pair", "null", "null", "outside")
    hidden = {"single": {"backlash": 1.0}, "pair": {"cogging": 1.0, "stiction": 1.0}, "null": {},
              "outside": {"prebend": 0.03}}  # fmt: skip
    return [
        made_record(HiddenCase(kind, hidden[kind], {}, n, f"drawn_{600 + rig}"))
        for rig in range(8) for n, kind in enumerate(kinds)
    ]  # fmt: skip


def test_the_fitted_probabilities_answer_as_the_records_do(made_records):
    fitted, report = fitted_certainty(made_records, {"numpy": "2"})
    assert fitted.made_with == {"numpy": "2"} and fitted.data_sets == len(made_records)
    for kind, evidence in {
        "nothing": Evidence(3.0, 0.3, 1.0),
        "catalogue": Evidence(40.0, 0.07, 1.0),
        "outside": Evidence(30.0, 0.6, 3.0),
    }.items():
        assert getattr(fitted.answers_for(evidence, "identified"), kind) > 0.8
    assert 3.0 < fitted.separation_of_nothing["identified"] < 12.0
    assert fitted.residual_of_nothing["identified"] == pytest.approx(1.0)
    assert "catalogue 24, nothing 16, outside 8" in report
    assert msgspec.json.decode(msgspec.json.encode(fitted), type=Certainty) == fitted
    assert fitted.error_of_strength("new") == max(fitted.equation_error.values())


def test_a_larger_separation_counts_no_more_where_nothing_reaches_it_too(made_records):
    """On another motion the plant's error reaches 24, with consistent strengths."""
    other = [
        msgspec.structs.replace(
            r, case=replace(r.case, motion="slow"), knowledge="other motions",
            evidence=Evidence(24.0, 0.05, 1.0),
        )
        for r in made_records if r.case.kind == "null"
    ]  # fmt: skip
    fitted, _ = fitted_certainty([*made_records, *other], {})
    scale = fitted.separation_scale
    assert scale["identified"] == 1.0 < scale["other motions"]
    assert fitted.answers_for(Evidence(24.0, 0.05, 1.0), "other motions").catalogue < 0.5


def test_on_another_link_a_name_needs_more_where_more_is_reached_without_an_effect(made_records):
    """Without an effect 24 is reached there, with consistent strengths; with one 120."""

    def elsewhere(record, separation):
        evidence = Evidence(separation, 0.05, 1.0)
        return msgspec.structs.replace(record, knowledge="other link", evidence=evidence)

    reached = {"null": 24.0, "single": 120.0}
    other = [elsewhere(r, reached[r.case.kind]) for r in made_records if r.case.kind in reached]
    fitted, _ = fitted_certainty([*made_records, *other], {})
    for kind, separation in reached.items():
        answers = fitted.answers_for(Evidence(separation, 0.05, 1.0), "other link")
        assert (answers.catalogue > 0.5) is (kind == "single")


def record(kind="single", hidden=("creep",), best=("creep",), **changes):
    case = HiddenCase(kind, dict.fromkeys(hidden, 1.0), {}, 1, "drawn_600")
    return DataSetRecord(case=case, best=best, named=best, **changes)


@pytest.mark.parametrize(
    ("row", "answer"),
    [
        (record("null", (), ("creep",)), "nothing"),
        (record(), "catalogue"),
        (record(best=("creep:2",)), "catalogue"),
        (record(best=("backlash",), look_alikes={"backlash": (("creep",),)}), "catalogue"),
        (record("pair", ("creep", "backlash")), "catalogue"),
        (record("pair", ("creep", "backlash"), ("creep", "cogging")), "outside"),
        (record(best=("backlash",)), "outside"),
        (record("outside", best=("backlash",)), "outside"),
        (record("outside", best=("backlash",), separable=False), None),
    ],
)
def test_the_right_answer_of_a_record_is_unknown_where_the_trials_do_not_show_it(row, answer):
    assert true_answer(row, shows=True) == answer
    assert true_answer(record(best=("backlash",)), shows=False) is None


@pytest.mark.parametrize(
    ("residual", "is_named"), [(1.2, (False, True)), (1.0, (True, True))],
    ids=["much is left", "nothing is left"],
)  # fmt: skip
def test_a_further_name_adds_more_than_those_that_are_not_hidden(made_records, residual, is_named):
    """Beside the first effect others reach a d′ of 30, a hidden second one 80."""

    def with_addition(record, second, added):
        pair = (*record.best, second)
        evidence = Evidence(added, 0.25, residual)
        addition = Addition(pair, "identified", Evidence(100.0, 0.25, residual), evidence)
        return msgspec.structs.replace(record, additions=(addition,))

    added = {"single": ("creep", 30.0), "pair": ("stiction", 80.0)}
    records = [
        with_addition(r, *added[r.case.kind]) if r.case.kind in added else r for r in made_records
    ]
    fitted, _ = fitted_certainty(records, {})
    scale = fitted.further_scale["identified"]
    rows = {r.case.kind: r.additions[0] for r in records if r.additions}
    assert tuple(is_added(fitted, rows[kind], scale) for kind in added) == is_named
    assert all(fitted.further_scale[k] >= fitted.separation_scale[k] for k in fitted.further_scale)


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


# Command


@pytest.fixture
def shipped(monkeypatch, tmp_path):
    """Place of the fitted file."""
    path = tmp_path / "certainty.json"
    path.write_text("before")
    monkeypatch.setattr(certainty, "PATH", path)
    return path


def test_the_file_is_replaced_and_names_what_made_it(shipped, monkeypatch, tmp_path):
    def diagnose(cases, out):
        for case in cases:
            path = record_path(out, case)
            path.parent.mkdir(exist_ok=True)
            path.write_bytes(msgspec.json.encode(made_record(case)))
        return 0

    monkeypatch.setattr(command, "run_cases", diagnose)
    assert command.main(["--out", str(tmp_path / "out"), "--rigs", "8"]) == 0
    written = certainty.read_certainty()
    kinds = set(get_args(certainty.Knowledge))
    assert set(written.separation_scale) == set(written.further_scale) == kinds
    assert {"python", "mujoco", "models"} <= set(written.made_with)


def test_nothing_is_replaced_if_a_data_set_fails(shipped, monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(command, "run_cases", lambda *_: 1)
    assert command.main(["--out", str(tmp_path / "out"), "--rigs", "8"]) == 2
    assert shipped.read_text() == "before"
    assert "failures: holds the errors" in capsys.readouterr().err


@pytest.mark.parametrize("number", [21, 900])
def test_a_rig_for_tests_or_for_patterns_is_refused(number):
    with pytest.raises(InputError, match=f"drawn_{number}"):
        tuning_cases(number)


def test_work_of_other_versions_is_not_continued(shipped, tmp_path, capsys):
    (tmp_path / "made_with.json").write_text('{"numpy": "1"}')
    assert command.main(["--out", str(tmp_path), "--quick"]) == 2
    assert "made_with.json: names other versions" in capsys.readouterr().err
