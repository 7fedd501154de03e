"""Page of plans on the rig, from runs made by hand: errors, their ratios, and drawings."""

import json

import pytest

from dropstitch.__main__ import main
from hil.report.plans_page import plan_figures, plans_page


def test_errors_are_compared_with_rigid_kinematics_case_by_case(runs):
    figures = plan_figures(runs)
    assert json.loads(json.dumps(figures)) == figures
    assert len(figures["cases"]) == 4
    for case in figures["cases"]:
        assert case["known_ratio"] == pytest.approx(1 / 50)
        assert case["unknown_ratio"] == pytest.approx(4 / 50)
    assert figures["cases"][1]["rigid_rms_m"] == pytest.approx(0.1)
    assert runs[1].away_m == pytest.approx(0.001)
    (alone,) = plan_figures(runs[1:2])["cases"]
    assert "known_ratio" not in alone, "nothing to compare with"


def test_the_page_draws_every_case(runs):
    page = plans_page(runs)
    assert page.count("<figure>") == 8
    for text in ("1DOF, 0 kg", "50.0", "12.5"):
        assert text in page


def test_a_directory_without_runs_is_refused(tmp_path, capsys):
    assert main(["report", "plans", str(tmp_path)]) == 2
    assert "holds no run of a plan; run 'make tip-demo'" in capsys.readouterr().err
