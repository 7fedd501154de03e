"""Page of plans on the rig, from runs made by hand: figures, targets, what is missing."""

import json

import numpy as np
import pytest

from firmware_py.errors import InputError
from firmware_py.goals.tip_plan import PayloadPlan, TipPlan
from hil.__main__ import main
from hil.report.plans.planned_runs import PlannedRun, plan_figures, read_planned_runs
from hil.report.plans.plans_page import write_plans_page

ROWS = 60
PATH = tuple(np.sin(np.linspace(0.0, 2.0 * np.pi, ROWS)).tolist())


def plan_of(dof):
    columns = (PATH,) * dof
    own = PayloadPlan(
        payload_kg=1.0, goals_rad=columns, tip_m=columns, current_a=columns, residual_rms_m=0.0,
        rigid_rms_m=0.05, expected_rms_m=0.0,
    )  # fmt: skip
    return TipPlan(
        schema=1, path="circle", method="inverse", dof=dof, period_s=0.017, rest_s=0.017,
        start_row=5, end_row=50, drawn=((5, 50),), desired_m=columns, payloads=(own,),
        payload_rate_kg_s=0.5, plant_error_rms_m=None, plant_sha256="", bundle_sha256="",
    )  # fmt: skip


def run_of(dof, knowledge, payload_kg, error_m):
    plan = plan_of(dof)
    tip = plan.desired_tip_m() + error_m / np.sqrt(dof)
    return PlannedRun(dof, knowledge, payload_kg, plan, tip, error_m, error_m)


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


def test_the_page_draws_every_case_and_says_what_is_not_there(runs, tmp_path):
    write_plans_page(runs, tmp_path / "plans.html")
    page = (tmp_path / "plans.html").read_text(encoding="utf-8")
    assert page.count("<figure") >= 4 and page.count("<svg") >= 8
    for text in ("1DOF, 0 kg", "50.0", "12.5", "no feedback of the estimated tip"):
        assert text in page
    assert "http" not in page.replace("http://www.w3.org", "")


def test_a_directory_without_runs_is_refused(tmp_path, capsys):
    with pytest.raises(InputError, match="holds no run of a plan; run 'make tip-demo'"):
        read_planned_runs(tmp_path)
    assert main(["plans", str(tmp_path)]) == 2
    assert "make tip-demo" in capsys.readouterr().err


def test_the_figures_are_written_as_numbers(runs):
    assert json.loads(json.dumps(plan_figures(runs)))["cases"][0]["dof"] == 1
