"""The guide's example, run as it is printed: an effect from outside of the package."""

import re
from pathlib import Path

import numpy as np
import pytest

from models.plant.effects import EFFECTS
from models.plant.plant import read_plant
from models.plant.simulation.runner import CompiledModel
from models.plant.step_model import names

ROOT = Path(__file__).parents[4]


@pytest.fixture
def hose_spring(monkeypatch):
    """What the guide's code leaves behind; the effect is forgotten afterwards."""
    monkeypatch.chdir(ROOT)
    known = dict(EFFECTS)
    blocks = re.findall(
        r"```python\n(.*?)```", Path("docs/plant/add-an-effect.md").read_text(), re.S
    )
    space = {}
    for block in blocks:
        exec(block, space)
    yield space
    EFFECTS.clear()
    EFFECTS.update(known)


def run(plant, **changes):
    model = plant.step_model(1)
    compiled = CompiledModel(model)
    u = np.zeros((200, len(model.inputs)))
    u[:, 0] = 0.3 * np.sin(2 * 0.017 * np.arange(200))
    return compiled.simulate(u, 0.017, model.parameter_values(changes))


def test_it_simulates_and_is_absent_at_zero(hose_spring):
    plain = run(read_plant())
    assert np.array_equal(run(hose_spring["plant"]), plain)
    assert np.abs(run(hose_spring["plant"], hose_spring_1_nm=2.0) - plain).max() > 1e-2


def test_it_has_an_exact_derivative(hose_spring):
    model = CompiledModel(hose_spring["model"], ["hose_spring_1_nm"])
    u = np.zeros((60, len(model.model.inputs)))
    u[:, 0] = np.linspace(0, 0.3, 60)
    _, slope = model.derivatives(u, 0.017)
    ends = [
        CompiledModel(hose_spring["model"]).simulate(
            u, 0.017, hose_spring["model"].parameter_values({"hose_spring_1_nm": c})
        )
        for c in (1e-5, -1e-5)
    ]
    assert slope[:, :, 0] == pytest.approx((ends[0] - ends[1]) / 2e-5, rel=1e-4, abs=1e-6)


def test_it_is_a_parameter_of_units_and_documents(hose_spring, tmp_path):
    variables = {v.name: v for v in hose_spring["model"].parameters}
    assert (
        variables["hose_spring_1_nm"].unit == "N.m" and variables["hose_spring_1_nm"].maximum == 5.0
    )
    assert "hose_rest_2_rad" not in names(hose_spring["model"].parameters)
    path = tmp_path / "plant.json"
    hose_spring["plant"].with_values({"hose_spring_1_nm": 0.8}).write(path)
    again = read_plant(path)
    assert "hose_spring" in again.effects and again.parameters["hose_spring_1_nm"].value == 0.8
