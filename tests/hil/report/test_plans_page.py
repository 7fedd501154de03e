"""Page of plans on the rig, from runs made by hand: figures, targets, feedback, lost trust."""

import json

import pytest

from dropstitch.__main__ import main
from hil.report.plans_page import plan_figures, plans_page
from tests.hil.report.conftest import ROWS, run_of


def test_errors_are_compared_with_rigid_kinematics_case_by_case(runs, guided):
    figures = plan_figures(runs)
    assert json.loads(json.dumps(figures)) == figures
    assert len(figures["cases"]) == 4
    assert figures["known_ratio"] == pytest.approx(1 / 50)
    assert figures["unknown_times_2dof"] == pytest.approx(50 / 4)
    worse = [*runs[:-1], run_of(2, "unknown", 1.0, 0.05)]
    assert plan_figures(worse)["unknown_ratio"] == pytest.approx(0.5)
    assert runs[1].away_m == pytest.approx(0.001)
    assert plan_figures(guided) == plan_figures(guided[:1]), "the misled robot is no case"


def test_the_page_draws_every_case(runs):
    page = plans_page(runs)
    assert page.count("<figure>") == 8
    for text in ("1DOF, 0 kg", "50.0", "12.5"):
        assert text in page
    assert "When the estimate is not trusted" not in page and "Phase" not in page


def test_margins_loops_and_lost_trust_are_shown(plans_html):
    page = plans_html.read_text(encoding="utf-8")
    for text in ("1 kg configured, 2.3 kg at the tip", "Gain", "Phase", "6.4", "40.1"):
        assert text in page
    assert f"{0.017 * ROWS / 4:.1f}" in page


def test_a_directory_without_runs_is_refused(tmp_path, capsys):
    assert main(["report", "plans", str(tmp_path)]) == 2
    assert "holds no run of a plan; run 'make tip-demo'" in capsys.readouterr().err
