"""Notebooks: every cell is run as it stands, and none is committed with outputs."""

from __future__ import annotations

import ast
import json

import numpy as np
import pytest
from matplotlib import pyplot

from tests.house.sources import ROOT

pytestmark = pytest.mark.slow

FOLDER = ROOT / "docs" / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))


def code_cells(notebook):
    document = json.loads(notebook.read_text(encoding="utf-8"))
    return [cell for cell in document["cells"] if cell["cell_type"] == "code"]


def run(name, monkeypatch):
    """Names that a notebook leaves behind, its last expressions shown as a notebook shows them."""
    monkeypatch.chdir(FOLDER)
    pyplot.switch_backend("Agg")
    space: dict[str, object] = {}
    for number, cell in enumerate(code_cells(FOLDER / f"{name}.ipynb")):
        tree = ast.parse("".join(cell["source"]))
        where = f"{name}.ipynb, cell {number}"
        last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
        exec(compile(tree, where, "exec"), space)
        if last is not None:
            str(eval(compile(ast.Expression(last.value), where, "eval"), space))
    pyplot.close("all")
    return space


def test_every_notebook_is_run_below_and_committed_without_outputs():
    assert [n.stem for n in NOTEBOOKS] == ["compare", "diagnose", "predict"]
    for cell in (cell for notebook in NOTEBOOKS for cell in code_cells(notebook)):
        assert not cell["outputs"] and cell["execution_count"] is None, (
            "clear the outputs: jupyter nbconvert --clear-output --inplace FILE"
        )


def test_predict_for_arrays(monkeypatch, capsys):
    space = run("predict", monkeypatch)
    predictions = space["predictions"]
    assert len(np.unique(predictions.tip_m[:, 0])) > 0.8 * np.count_nonzero(space["goal_rad"])
    rigid_m = 1.01 * np.sin(space["angle_rad"])  # 0.06 + 0.95 m, unbent
    error_m = predictions.tip_m[:, 0] - space["run"]["tip_x_m"]
    assert np.std(error_m) < 0.3 * np.std(rigid_m - space["run"]["tip_x_m"])
    half_m = predictions.half_width_m[:, 0]
    assert np.mean(np.abs(error_m) <= half_m) >= 0.95
    assert "root mean square distance" in capsys.readouterr().out


def test_simulate_a_plant_and_compare_trials(monkeypatch):
    space = run("compare", monkeypatch)
    assert len(space["frame"]) == sum(len(t) for t in space["trials"])
    assert space["result"].tip_rms_m < 0.25 * space["result"].rigid_tip_rms_m


def test_diagnose_a_gap(monkeypatch, capsys):
    space = run("diagnose", monkeypatch)
    friction = space["friction"]
    assert space["found"].named == ("coulomb_friction",)
    assert abs(friction.value - 0.05) < 1.96 * friction.error
    assert space["after"].rms == pytest.approx(1e-3, rel=0.2)  # the noise that was added
    assert "coulomb_friction" in capsys.readouterr().out
