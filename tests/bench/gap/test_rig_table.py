"""Figures of the gap benchmark by rig: groups of effects, harm and bounds."""

import json
import os

import pytest

from bench.gap.bench_kind import bench_configuration, bench_results, cases_of_run
from bench.gap.calibration import plant_error
from bench.gap.cases import BenchCase, draw_cases, mixed_cases
from bench.gap.scores.result_predicates import is_link_effect
from bench.gap.scores.rig_table import figures_by_rig, rig_figures, rig_table_text
from hil.campaign.result_store import ResultStore


def result(
    hidden, named=(), verdict="closed", rms=(1.0, 0.5), kind="single", rig="default", own=1.0
):
    """Result of one case with one sealed trial of one signal."""
    return {
        "case": {"kind": kind, "hidden": hidden, "nuisance": {}, "seed": 1, "rig": rig},
        "named": list(named),
        "chosen": [[n] for n in named],
        "look_alikes": [[] for _ in named],
        "verdict": verdict,
        "sealed_rms": {"motion": {"tip_x_m": list(rms)}},
        "unsaid_bounds": [],
        "separable": True,
        "estimates": {n: [[0.3, 0.05, 0.0]] for n in named},
        "true": hidden,
        "own": dict.fromkeys(hidden, own),
        "null_standard_deviation": dict.fromkeys(hidden, 0.5),
    }


def right_of(figure):
    """Counts of a fraction."""
    return round(figure["fraction"] * figure["of"]), figure["of"]


def test_of_a_case_that_ran_with_other_code_the_latest_result_counts(tmp_path):
    """Each version of the code keeps a result of its own; figures hold every case once."""
    store, case = ResultStore(tmp_path), BenchCase("single", {"creep": 0.3}, {}, 1)
    config = bench_configuration(case, tmp_path / "plant.json")
    for age, (key, named) in enumerate([("ff", "prebend"), ("aa", "creep"), ("cc", "backlash")]):
        store.write(key, "gap benchmark", key, config, json.dumps({"named": [named]}))
        os.utime(store.path(key), ns=(0, [1, 3, 2][age]))
    assert [r["named"] for r in bench_results(tmp_path).values()] == [["creep"]]
    assert cases_of_run(tmp_path) == [case]


def test_link_and_servo_effects_are_counted_apart():
    rows = [
        result({"creep": 0.3}, ["creep"]),
        result({"creep": 0.3}, ["hysteresis"]),
        result({"dead_time": 0.3}, ["dead_time"]),
    ]
    figures = rig_figures(rows)
    assert figures["first_link_payload_play"]["of"] == 2
    assert figures["first_link_payload_play"]["fraction"] == 0.5
    assert figures["first_servo_sensor"]["fraction"] == 1.0
    assert figures["wrong_and_closed"]["fraction"] == pytest.approx(1 / 3)
    assert is_link_effect("backlash") and not is_link_effect("sync_offset")


def test_clear_cases_are_those_from_fifteen_standard_deviations_on():
    """The screen's d′ is in units of its deviation without an effect, here a half."""
    rows = [
        result({"creep": 0.3}, ["creep"], own=7.5),
        result({"creep": 0.3}, ["hysteresis"], own=7.6),
        result({"dead_time": 0.03}, [], own=60.0),
        result({"creep": 0.3}, ["hysteresis"], own=7.49),
        result({"creep": 0.3}, ["creep"], own=None),
        result({"creep": 0.3, "prebend": 0.02}, ["creep"], own=60.0, kind="pair"),
    ]
    rows[1]["look_alikes"] = [[["creep"]]]
    figures = rig_figures(rows)
    assert right_of(figures["first_clear"]) == (1, 3)
    assert right_of(figures["class_clear"]) == (2, 3)
    assert right_of(figures["class"]) == (3, 5)
    assert right_of(figures["class_link"]) == (3, 4)


@pytest.mark.parametrize(
    ("named", "verdict", "both", "larger"),
    [
        (["prebend", "creep"], "closed", 1, 1),
        (["backlash", "prebend", "creep"], "closed", 1, 1),
        (["creep"], "reduced", 0, 1),
        (["creep"], "not in the catalogue", 0, 1),
        (["creep"], "no floor", 0, 1),
        (["creep"], "closed", 0, 0),  # nobody would look for the other
        (["creep", "backlash"], "closed", 0, 0),
        (["prebend"], "reduced", 0, 0),
        ([], "not in the catalogue", 0, 0),
    ],
)
def test_of_a_pair_the_larger_effect_is_named_and_the_rest_is_said(named, verdict, both, larger):
    pair = result({"prebend": 0.02, "creep": 0.3}, named, verdict, kind="pair")
    # Creep is the larger one: d′ counts in its own deviation.
    pair |= {"own": {"prebend": 30.0, "creep": 20.0}}
    pair |= {"null_standard_deviation": {"prebend": 2.0, "creep": 1.0}}
    figures = rig_figures([pair, result({"creep": 0.3}, ["creep"])])
    assert right_of(figures["pairs_both"]) == (both, 1)
    assert right_of(figures["pairs_larger"]) == (larger, 1)


@pytest.mark.parametrize(
    ("after", "worse"), [(0.5, False), (1.0, False), (1.049, False), (1.06, True)]
)
def test_a_plant_is_worse_from_five_percent_in_any_signal(after, worse):
    figures = rig_figures([result({"creep": 0.3}, ["creep"], rms=(1.0, after))])
    assert bool(figures["worse"]["fraction"]) is worse
    assert figures["worst_rise"] == pytest.approx(after - 1.0)


def test_a_plant_that_no_sealed_trial_tested_is_not_counted_as_no_worse():
    rows = [result({"creep": 0.3}, ["creep"], rms=(1.0, 2.0)) for _ in range(2)]
    figures = rig_figures([rows[0], rows[1] | {"sealed_tested": False, "sealed_rms": {}}])
    assert right_of(figures["worse"]) == (1, 1)


@pytest.mark.parametrize(
    ("plain", "worse"), [((), True), ((1.0,), True), ((1.1,), False), ((0.5,), True)]
)
def test_the_plants_own_error_where_nothing_is_hidden_may_be_the_larger_one(plain, worse):
    """It had made up for the hidden effect."""
    figures = rig_figures([result({"creep": 0.3}, ["creep"], rms=(1.0, 1.1, *plain))])
    assert figures["worse"]["fraction"] == 1.0
    assert bool(figures["worse_than_plain"]["fraction"]) is worse


def test_of_denied_effects_those_count_that_the_whole_catalogue_tells_from_stand_ins():
    said = result({"creep": 0.3}, verdict="not in the catalogue", kind="outside")
    alike = result({"prebend": 0.02}, ["encoder_offset"], kind="outside") | {"separable": False}
    figures = rig_figures([said, alike])
    assert right_of(figures["outside_said"]) == (1, 1)
    assert right_of(figures["outside_said_all"]) == (1, 2)


def test_probabilities_are_scored_against_what_was_hidden():
    right = result({"creep": 0.3}, ["creep"]) | {"hypotheses": [[["creep"], 900.0, 20.0, 1.0]]}
    wrong = result({"creep": 0.3}) | {"hypotheses": [[["prebend"], 900.0, 20.0, 1.0]]}
    denied = result({"creep": 0.3}, kind="outside") | {"hypotheses": right["hypotheses"]}
    figures = rig_figures([right, wrong])
    assert figures["probable_right"] == {**figures["probable_right"], "fraction": 0.5, "of": 2}
    assert figures["brier"] == pytest.approx((0.0 + 2.0) / 2)
    assert rig_figures([denied])["probable_right"]["fraction"] == 0.0
    assert rig_figures([denied])["brier"] == pytest.approx(1.0)


def test_effects_that_have_a_true_answer_count_as_reliable():
    right = result({"creep": 0.3}, ["creep"]) | {"hypotheses": [[["creep"], 900.0, 20.0, 1.0]]}
    null = result({}, kind="null") | {"hypotheses": right["hypotheses"]}
    denied = result({"creep": 0.3}, kind="outside") | {"hypotheses": right["hypotheses"]}
    alike = denied | {"separable": False}
    impossible = {"case": right["case"], "impossible": "the link folds"}
    figures = rig_figures([right, right, null, denied, alike, impossible, result({"creep": 0.3})])
    *lower, highest = figures["reliability"]
    assert right_of(highest) == (2, 4)
    assert highest["mean_probability"] == pytest.approx(1.0)
    assert not any(b["of"] for b in lower)
    table = rig_table_text({"default": figures})
    assert table.count("| reliability |") == 0
    assert table.splitlines()[-1] == "| 0.97 to 1 | 2 of 4 |"


def test_rigs_for_tests_are_not_mixed_with_those_for_tuning(tmp_path):
    rigs = ("default", "drawn_899", "drawn_900", "drive", "test_a")
    store = ResultStore(tmp_path)
    for k, rig in enumerate(rigs):
        row = result({"creep": 0.3}, ["creep"], rig=rig)
        config = bench_configuration(BenchCase(**row.pop("case")), tmp_path / "plant.json")
        store.write(f"{k:02d}", "gap benchmark", rig, config, json.dumps(row))
    figures = figures_by_rig(tmp_path)
    assert figures["all for test"]["cases"] == 2
    assert figures["all for tuning"]["cases"] == 3
    header = rig_table_text(figures).splitlines()[0]
    assert all(name in header for name in rigs)
    assert {c.rig for c in cases_of_run(tmp_path)} == set(rigs)


def test_nothing_is_calibrated_on_a_rig_for_tests(tmp_path, monkeypatch, capsys):
    command = ["plant_error", "--out", str(tmp_path / "out"), "--rigs", "880", "--null", "21"]
    monkeypatch.setattr("sys.argv", command)
    with pytest.raises(SystemExit):
        plant_error.main()
    assert "drawn_900" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_shortened_draw_keeps_every_kind():
    drawn = list(draw_cases(1, 9, 9, 9, seed=3, rig="drive"))
    kept = mixed_cases(drawn, 9)
    assert [c.kind for c in kept].count("single") == 6
    assert {c.kind for c in kept} == {"single", "null", "pair", "outside"}
    assert len(mixed_cases(drawn, 10**6)) == len(drawn)


def test_each_rig_has_cases_of_its_own():
    drawn = {rig: list(draw_cases(1, 0, 0, 0, 0, rig)) for rig in ("default", "drive", "test_a")}
    assert len({tuple(c.seed for c in cases) for cases in drawn.values()}) == 3
