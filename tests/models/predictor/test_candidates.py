"""Candidates: each graph, and its import into CasADi, answers as scikit-learn; your own one."""

import re
from pathlib import Path

import numpy as np
import onnx
import pytest

from firmware_py.errors import InputError
from models.predictor.candidates import CANDIDATES, BoostedTrees, TipPredictor, own_candidate
from models.predictor.onnx_graphs import predictor_function, to_onnx
from models.predictor.training import choose_tip_predictor
from tests.models.predictor.cases import graph_outputs, guarded, made_up_rows


@pytest.mark.parametrize("dof", [1, 2])
@pytest.mark.parametrize("candidate", CANDIDATES, ids=lambda c: c.__name__)
def test_graph_and_fmu_answer_what_scikit_learn_does(candidate, dof, tmp_path):
    rows = made_up_rows(dof)
    model = guarded(rows, candidate(candidate.variants[-1] if dof == 1 else 2).fit(rows))
    path = tmp_path / "predictor.onnx"
    onnx.save(to_onnx(model, len(rows.names)), path)
    points = np.vstack([rows.inputs[:60], 1.4 * rows.inputs[60:120]])  # half of them outside
    points[::3, rows.names.index(f"innovation_{dof}_a")] *= 10.0
    assert 5 < model.innovation_exceeded(points).sum() < 40
    tip_m, in_range, half_width_m = graph_outputs(path, points)
    np.testing.assert_allclose(tip_m, model.predict(points), rtol=0, atol=1e-9)
    np.testing.assert_allclose(half_width_m, model.half_width(points), rtol=0, atol=1e-9)
    assert in_range[:, 0].astype(bool).tolist() == model.in_range(points).tolist()
    symbolic = predictor_function(path)
    for point, *expected in zip(points, tip_m, in_range, half_width_m, strict=True):
        for name, value in zip(("tip_m", "in_range", "half_width_m"), expected, strict=True):
            found = np.ravel(symbolic(features=point)[name])
            np.testing.assert_allclose(found, value, rtol=0, atol=1e-9)


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
    model = guarded(rows, CANDIDATES[0](0).fit(rows))
    path = tmp_path / "predictor.onnx"
    onnx.save(to_onnx(model, len(rows.names)), path)
    for column in range(len(rows.names)):
        point = 0.1 * rows.inputs[:1].copy()
        assert graph_outputs(path, point)[1][0, 0] == 1.0
        point[0, column] = np.nan
        assert graph_outputs(path, point)[1][0, 0] == 0.0


PAGE = Path(__file__).parents[3] / "docs" / "predictor" / "choice.md"
[CODE] = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)


def test_the_class_of_the_documentation_is_compared_chosen_and_exported(tmp_path):
    (tmp_path / "mine.py").write_text(CODE, encoding="utf-8")
    mine = own_candidate(tmp_path / "mine.py", CANDIDATES)
    rows = made_up_rows()
    rows.tip_m[:] += [0.01, 0.0, -0.01]
    assert isinstance(mine(1), TipPredictor)
    chosen, _ = choose_tip_predictor(rows, [], (CANDIDATES[0], mine))
    assert chosen.candidate.name == "shifted observer" and chosen.variant == 1
    onnx.save(to_onnx(chosen.predictor, len(rows.names)), tmp_path / "predictor.onnx")
    tip_m, *_ = graph_outputs(tmp_path / "predictor.onnx", rows.inputs[:5])
    np.testing.assert_allclose(tip_m, chosen.predictor.predict(rows.inputs[:5]), atol=1e-12)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("class A:\n", "does not run (IndentationError"),
        ("1 / 0\n", "does not run (ZeroDivisionError"),
        ("x = 1\n", "has 0 candidates, no class at all"),
        (CODE.replace("def write", "def save"), "ShiftedObserver lacks write"),
        (CODE + CODE.replace("ShiftedObserver", "Other"), "has 2 candidates, not one"),
        (CODE.replace("shifted observer", "observer"), "'observer' as another is"),
        (CODE.replace("(1,)", "()"), "no variant"),
    ],
)
def test_other_files_are_refused_in_one_sentence(text, said, tmp_path):
    (tmp_path / "mine.py").write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as refusal:
        own_candidate(tmp_path / "mine.py", CANDIDATES)
    assert said in str(refusal.value) and "\n" not in str(refusal.value)
