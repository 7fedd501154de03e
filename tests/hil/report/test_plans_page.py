"""Page of plans on the rig, from runs made by hand: figures, targets, feedback, lost trust."""

import json

import numpy as np
import pytest

from dropstitch.__main__ import main
from firmware_py.core.errors import InputError
from firmware_py.goals.tip_plan import FeedbackDesign, LoopMargins, PayloadPlan, RateFilter, TipPlan
from firmware_py.link.link_facts import STUDY_FACTS
from hil.report.plans.planned_runs import PlannedRun, plan_figures, read_planned_runs
from hil.report.plans.plans_page import write_plans_page
from models.plant.plant import read_plant

ROWS = 60
PATH = tuple(np.sin(np.linspace(0.0, 2.0 * np.pi, ROWS)).tolist())


def plan_of(dof, feedback=None):
    columns = (PATH,) * dof
    own = PayloadPlan(
        payload_kg=1.0, goals_rad=columns, tip_m=columns, current_a=columns, residual_rms_m=0.0,
        rigid_rms_m=0.05, expected_rms_m=0.0,
    )  # fmt: skip
    return TipPlan(
        schema=1, path="circle", method="inverse", dof=dof, period_s=0.017, rest_s=0.017,
        start_row=5, end_row=50, drawn=((5, 50),), desired_m=columns, payloads=(own,),
        payload_rate_kg_s=0.5, plant_error_rms_m=None, plant_sha256="", bundle_sha256="",
        link=STUDY_FACTS,
        feedback=feedback,
    )  # fmt: skip


def run_of(dof, knowledge, payload_kg, error_m, plan=None, trust=0):
    plan = plan or plan_of(dof)
    tip = plan.desired_tip_m() + error_m / np.sqrt(dof)
    goals, trust = plan.goals_rad()[0], np.zeros(ROWS, int) + trust
    return PlannedRun(dof, knowledge, payload_kg, plan, tip, error_m, error_m, goals, trust, 1.3)


@pytest.fixture
def runs():
    return [
        run_of(dof, knowledge, payload_kg, error_m * (1 + payload_kg))
        for dof in (1, 2)
        for payload_kg in (0.0, 1.0)
        for knowledge, error_m in (("rigid", 0.05), ("known", 0.001), ("unknown", 0.004))
    ]


def test_errors_are_compared_with_rigid_kinematics_case_by_case(runs):
    figures = plan_figures(runs)
    assert len(figures["cases"]) == 4
    assert figures["known_ratio"] == pytest.approx(1 / 50)
    assert figures["unknown_times_2dof"] == pytest.approx(50 / 4)
    worse = [*runs[:-1], run_of(2, "unknown", 1.0, 0.05)]
    assert plan_figures(worse)["unknown_ratio"] == pytest.approx(0.5)
    assert runs[1].away_m == pytest.approx(0.001)


def test_the_page_draws_every_case(runs, tmp_path):
    write_plans_page(runs, tmp_path / "plans.html")
    page = (tmp_path / "plans.html").read_text(encoding="utf-8")
    assert page.count("<figure") >= 4 and page.count("<svg") >= 8
    for text in ("1DOF, 0 kg", "50.0", "12.5"):
        assert text in page
    assert "When the estimate is not trusted" not in page and "Nyquist" not in page
    assert "http" not in page.replace("http://www.w3.org", "")


def test_margins_loops_and_lost_trust_are_shown(runs, tmp_path):
    plant = read_plant()
    own = RateFilter(a=((0.0,),), b=((0.0,),), c=((0.0,),), d=((1.0,),))
    margins = ((LoopMargins(payload_kg=1.0, gain_db=6.4, phase_rad=0.7, crossover_rad_s=2.0),),)
    design = FeedbackDesign(
        filters=((own,),), margins=margins, size_rad=0.03, rate_rad_s=0.16, innovation_a=0.25
    )
    plan, trust = plan_of(1, design), np.repeat([1, 2, 3, 1], ROWS // 4)
    guided = [run_of(1, kind, 1.0, 0.01, plan, trust) for kind in ("known", "misled")]
    assert plan_figures(guided) == plan_figures(guided[:1]), "the misled robot is no case"
    write_plans_page([*runs[6:], *guided], tmp_path / "plans.html", plant)
    page = (tmp_path / "plans.html").read_text(encoding="utf-8")
    for text in ("told 1 kg, 2.3 kg at the tip", "Nyquist", "Bode, phase", "6.4", "40.1"):
        assert text in page
    assert f"{0.017 * ROWS / 4:.1f}" in page


def test_a_directory_without_runs_is_refused(tmp_path, capsys):
    with pytest.raises(InputError, match="holds no run of a plan; run 'make tip-demo'"):
        read_planned_runs(tmp_path)
    assert main(["report", "plans", str(tmp_path)]) == 2
    assert "make tip-demo" in capsys.readouterr().err


def test_the_figures_are_written_as_numbers(runs):
    assert json.loads(json.dumps(plan_figures(runs)))["cases"][0]["dof"] == 1
