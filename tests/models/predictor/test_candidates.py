"""Candidates: each graph, and its import into CasADi, answers as scikit-learn; one from a file."""

import re
from pathlib import Path

import numpy as np
import pytest

from firmware_py.core.errors import InputError
from models.predictor.candidates import CANDIDATES, BoostedTrees, load_candidate
from models.predictor.onnx_graphs import predictor_function
from models.predictor.training import choose_tip_predictor
from tests.models.predictor.cases import (
    assert_graphs_agree,
    graph_outputs,
    guarded,
    made_up_rows,
    saved_graph,
)


@pytest.mark.parametrize(
    ("candidate", "dof"), [(c, 1 + k % 2) for k, c in enumerate(CANDIDATES)], ids=str
)
def test_graphs_answer_what_scikit_learn_does(candidate, dof, tmp_path):
    rows = made_up_rows(dof)
    model = guarded(rows, candidate(candidate.variants[-1] if dof == 1 else 2).fit(rows))
    points = np.vstack([rows.inputs[:60], 1.4 * rows.inputs[60:120]])  # half of them outside
    usual_m = model.half_width(points)
    points[::3, rows.names.index(f"innovation_{dof}_a")] *= 10.0
    widened = (model.half_width(points) > usual_m + 0.014).all(axis=1)
    assert 5 < widened.sum() < 40
    assert_graphs_agree(model, points, tmp_path / "predictor.onnx", 1e-9)


def test_no_split_of_a_tree_lies_between_values_that_differ_by_rounding():
    """Joints at rest, an encoder's steps: an input shows which half of the rows it is in."""
    rng, rows = np.random.default_rng(4), made_up_rows()
    half = rng.random(len(rows.inputs)) < 0.5
    rate, angle = (rows.names.index(n) for n in ("bend_rate_1_rad_s", "bend_1_rad"))
    rows.inputs[:, rate] = np.where(half, 1e-17, -1e-17)
    rows.inputs[:, angle] = rows.inputs[:, angle].round(3)
    rows.tip_m[half, 1] += 1e-3
    trees = BoostedTrees(2).fit(rows)
    plain = trees.predict(rows.inputs)
    for _ in range(20):
        shaken = rows.inputs + 1e-12 * rng.standard_normal(rows.inputs.shape)
        np.testing.assert_allclose(trees.predict(shaken), plain, rtol=0, atol=1e-9)


def test_a_nan_is_out_of_range(tmp_path):
    rows = made_up_rows()
    path = saved_graph(guarded(rows), rows.inputs, tmp_path / "predictor.onnx")
    usual = 0.1 * rows.inputs[:1]
    assert graph_outputs(path, usual)[1][0, 0] == 1.0
    points = np.repeat(usual, len(rows.names), axis=0)
    np.fill_diagonal(points, np.nan)
    assert not graph_outputs(path, points)[1].any()
    imported = predictor_function(path)
    assert all(float(imported(features=point)["in_range"]) == 0.0 for point in points)


PAGE = Path(__file__).parents[3] / "docs" / "predictor" / "choice.md"
[CODE] = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)


def test_the_class_of_the_documentation_is_compared_chosen_and_exported(tmp_path):
    (tmp_path / "mine.py").write_text(CODE, encoding="utf-8")
    mine = load_candidate(tmp_path / "mine.py", CANDIDATES)
    rows = made_up_rows()
    rows.tip_m[:] += [0.01, 0.0, -0.01]
    chosen, _ = choose_tip_predictor(rows, (CANDIDATES[0], mine))
    assert chosen.candidate.name == "shifted observer" and chosen.variant == 1
    path = saved_graph(chosen.predictor, rows.inputs, tmp_path / "predictor.onnx")
    tip_m, *_ = graph_outputs(path, rows.inputs[:5])
    np.testing.assert_allclose(tip_m, chosen.predictor.predict(rows.inputs[:5]), atol=1e-12)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("class A:\n", "does not run (IndentationError"),
        ("x = 1\n", "has 0 classes with the members name, summary"),
        (CODE + CODE.replace("ShiftedObserver", "Other"), "has 2 classes"),
        (CODE.replace("shifted observer", "observer"), "'observer' as another is"),
        (CODE.replace("(1,)", "()"), "no variant"),
    ],
)
def test_other_files_are_refused_in_one_sentence(text, reason, tmp_path):
    (tmp_path / "mine.py").write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as refusal:
        load_candidate(tmp_path / "mine.py", CANDIDATES)
    assert reason in str(refusal.value) and "\n" not in str(refusal.value)
