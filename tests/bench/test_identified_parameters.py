"""Table of identified parameters beside the truth of a rig."""

import json

import pytest

from bench import identified_parameters
from bench.identified_parameters import (
    coverage_summary,
    coverage_table,
    draw_result,
    option_summary,
    shared_truth,
    summary_table,
)
from models.plant.plant import read_plant
from models.rig.rig_parameters import read_rig


def test_the_truth_is_that_of_the_rigs_equations():
    truth = shared_truth(read_rig("default"))
    assert truth["viscous_friction_1_nm_s_rad"] == 2.0
    assert truth["goal_interpolation_1"] == 0.0
    # The velocity loop's bandwidth is k_t k_v / J.
    loop = truth["velocity_gain_1_a_s_rad"] * 6.83 / truth["rotor_inertia_1_kg_m2"]
    assert loop == pytest.approx(150.0)
    assert shared_truth(read_rig("drive"))["goal_interpolation_1"] == 1.0
    assert "goal_interpolation_1" not in shared_truth(read_rig("profile"))
    assert truth.keys() <= read_plant().parameters.keys()


def test_the_table_counts_covered_near_and_bound():
    def result(value, error, bound):
        row = {"value": value, "error": error, "truth": 2.0, "bound": bound}
        return {"rig": "x", "parameters": {"viscous": row}}

    text = coverage_table([result(2.1, 0.1, None), result(5.0, 1.0, "upper")])
    assert "1/2" in text.splitlines()[1]
    assert text.splitlines()[1].endswith("1")
    assert "50% of 2" in text


def test_the_summary_has_the_relative_errors_of_each_rig_and_of_all():
    def result(rig, mass):
        row = {"value": mass, "error": 0.1, "truth": 1.0, "bound": None}
        return {"rig": rig, "parameters": {"link_mass_kg": row}}

    summary = coverage_summary([result("x", 1.1), result("x", 1.5), result("y", 0.9)])
    assert summary["x"]["inside"] == 0.5 and summary["all"]["draws"] == 3
    assert summary["x"]["link_mass_kg worst"] == pytest.approx(0.5)
    assert summary["all"]["link_mass_kg within 25 %"] == pytest.approx(2 / 3)
    row = summary_table(summary).splitlines()[2]
    assert row == "| x | 2 | 50% | – | – | 30%, 46%, 50% | 50% |"


def test_options_are_counted_where_servos_have_them_and_where_they_have_none():
    def result(feedforward, value, gain):
        rows = {"position_gain_1_per_s": {"value": gain, "truth": 10.0}}
        if value is not None:
            rows["velocity_feedforward_1"] = {"value": value, "truth": feedforward}
        return {"feedforward": feedforward, "feedforward_found": value is not None,
                "parameters": rows}  # fmt: skip

    summary = option_summary(
        [result(0.3, 0.35, 10.5), result(0.3, None, 14.0), result(0.0, None, 30.0)]
    )
    assert (summary["with"], summary["without"]) == (2, 1)
    assert (summary["found"], summary["invented"]) == (0.5, 0.0)
    assert summary["position gain worst"] == pytest.approx(0.4)
    assert summary["feedforward worst"] == pytest.approx(0.05)


def test_a_result_of_other_code_is_computed_again(tmp_path, monkeypatch):
    ran = []

    def identify_draw(rig, draw):
        ran.append((rig, draw))
        return {"rig": rig, "draw": draw, "parameters": {}}

    monkeypatch.setattr(identified_parameters, "identify_draw", identify_draw)
    (tmp_path / "default_3.json").write_text(json.dumps({"code": "0", "rig": "stale"}))
    first, again = (draw_result(tmp_path, "default", 3) for _ in range(2))
    assert first == again and first["rig"] == "default"
    assert ran == [("default", 3)]
