"""The benchmark of hidden effects: what counts as right, its rates, and a slice of it."""

from dataclasses import asdict

import pytest

from bench.gap import figures_by_link, is_class_right
from models.gap.training import rig_plants
from models.gap.training.case_run import run_hidden_case
from models.gap.training.cases import PAYLOAD_SETS, hidden_cases
from models.plant.plant import read_plant

FEW_KG = (0.0, 2.0)


@pytest.mark.parametrize(
    ("named", "chosen", "look_alikes", "right"),
    [
        (["creep"], [["creep"]], [[]], True),
        (["prebend"], [["prebend"]], [[["creep"]]], True),
        (["creep"], [["joint_elasticity"], ["creep"]], [[], []], True),
        (["prebend"], [["creep"], ["prebend"]], [[], []], False),
        (["prebend"], [["backlash"], ["prebend"]], [[["creep"]], []], False),
        (["prebend", "creep"], [["prebend"], ["creep"]], [[], []], False),
        (["prebend", "creep"], [["prebend", "creep"]], [[]], True),
        ([], [["creep"]], [[]], False),
    ],
)
def test_class_is_that_of_the_first_name_that_stands(named, chosen, look_alikes, right):
    result = {"case": {"hidden": {"creep": 0.3}}, "named": named, "chosen": chosen}
    assert is_class_right(result | {"look_alikes": look_alikes}) is right


def test_rates_are_counted_by_kind_and_link():
    def result(kind, hidden, named, nuisance, verdict):
        case = {"kind": kind, "hidden": hidden, "nuisance": nuisance}
        return {"case": case, "named": named, "chosen": [[n] for n in named], "separable": True,
                "look_alikes": [[] for _ in named], "verdict": verdict}  # fmt: skip

    creep = {"creep": 0.3}
    found = figures_by_link([
        result("single", creep, ["creep"], {}, "closed"),
        result("single", creep, ["prebend"], {}, "closed"),
        result("null", {}, [], {}, "no gap"),
        result("pair", creep | {"prebend": 0.1}, ["creep"], {"m": 1.1}, "reduced"),
        {"impossible": "the link folds", "case": {"kind": "single", "nuisance": {}}},
    ])  # fmt: skip
    same, changed = found["same link"], found["link changed"]
    assert (same["class_right"]["fraction"], same["class_right"]["of"]) == (0.5, 2)
    assert same["wrong_and_closed"]["fraction"] == 0.5
    assert same["false_alarms"]["fraction"] == 0.0 and same["false_alarms"]["interval"][1] > 0.9
    assert changed["pairs_both"]["fraction"] == 0.0 and changed["class_right"] == {"of": 0}


def test_a_case_runs_from_the_rig_to_its_rates(tmp_path, monkeypatch):
    """One case says nothing of accuracy. Two payloads instead of three, for the tests' time."""
    monkeypatch.setattr(rig_plants, "PAYLOADS_KG", FEW_KG)
    monkeypatch.setitem(PAYLOAD_SETS, "study", FEW_KG)
    (case,) = hidden_cases("default", 1, 0, 0, 0, 0, 8, False)
    plant = read_plant(rig_plants.plant_of_rig("default", tmp_path))
    result = {"case": asdict(case), **run_hidden_case(case, plant)}
    assert result["verdict"] in ("closed", "reduced", "no gap", "not in the catalogue")
    assert set(result["named"]) <= {effect for chosen in result["chosen"] for effect in chosen}
    rates = figures_by_link([result])["link changed" if case.nuisance else "same link"]
    assert rates["class_right"]["of"] == 1
