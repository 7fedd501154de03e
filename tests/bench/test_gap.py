"""The benchmark of hidden effects: what counts as right, its rates, and a slice of it."""

import pytest

from bench.gap import calibration, figures_by_link, is_class_right, main
from models.gap.decision.certainty import Answers
from models.gap.training import case_runs
from models.gap.training.case_runs import (
    DataSetRecord,
    identify_on_rig,
    plant_path,
    run_hidden_case,
)
from models.gap.training.cases import PAYLOAD_SETS, HiddenCase, hidden_cases
from models.plant.plant import read_plant

pytestmark = pytest.mark.slow

FEW_KG = (0.0, 2.0)


def record(kind, hidden, named, verdict, nuisance=None, look_alikes=None):
    case = HiddenCase(kind, dict.fromkeys(hidden, 0.3), nuisance or {}, 1, "drawn_1200")
    alike = dict.fromkeys(named, ()) | (look_alikes or {})
    return DataSetRecord(
        case=case, named=tuple(named), best=tuple(named), verdict=verdict, look_alikes=alike,
        answers=Answers(0.1, 0.9, 0.0),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("named", "look_alikes", "right"),
    [
        (["creep"], {}, True),
        (["creep:2"], {}, True),
        (["prebend"], {"prebend": (("creep",),)}, True),
        (["prebend", "creep"], {}, False),
        (["prebend", "backlash"], {"backlash": (("creep", "prebend"),)}, False),
        ([], {}, False),
    ],
)
def test_class_is_that_of_the_first_name_or_a_look_alike_of_it(named, look_alikes, right):
    found = record("single", ["creep"], named, "closed", look_alikes=look_alikes)
    assert is_class_right(found) is right


def test_rates_are_counted_by_kind_and_link():
    impossible = HiddenCase("single", {}, {}, 1, "drawn_1200")
    records = [
        record("single", ["creep"], ["creep"], "closed"),
        record("single", ["creep"], ["prebend"], "closed"),
        record("null", [], [], "no gap"),
        record("outside", ["creep"], ["prebend"], "closed"),
        record("outside", ["creep"], [], "not in the catalogue"),
        record("outside", ["creep"], [], "not in the catalogue"),
        record("pair", ["creep", "prebend"], ["creep"], "reduced", {"link.mass_kg": 1.1}),
        DataSetRecord(case=impossible, impossible="the link folds"),
    ]
    rates = figures_by_link(records)
    same, changed = rates["same link"], rates["link changed"]
    assert (same["class_right"]["fraction"], same["class_right"]["of"]) == (0.5, 2)
    assert same["wrong_and_closed"]["fraction"] == 0.5
    assert same["false_alarms"]["fraction"] == 0.0 and same["false_alarms"]["interval"][1] > 0.9
    assert same["outside_said"]["fraction"] == pytest.approx(2 / 3)
    assert changed["pairs_both"]["fraction"] == 0.0 and changed["class_right"] == {"of": 0}
    assert "0.80 to 0.95: 0.90 0.50 of 4" in calibration(records)


def test_an_unknown_rig_is_refused(capsys, tmp_path):
    with pytest.raises(SystemExit):
        main(["--rigs", "drawn_x", "--out", str(tmp_path)])
    assert "drawn_x" in capsys.readouterr().err


def test_a_case_runs_from_the_rig_to_its_rates(tmp_path, monkeypatch):
    """One case says nothing of accuracy. Two payloads instead of three, for the tests' time."""
    monkeypatch.setattr(case_runs, "PAYLOADS_KG", FEW_KG)
    monkeypatch.setitem(PAYLOAD_SETS, "study", FEW_KG)
    (case,) = hidden_cases("default", 1, 0, 0, 0, 0, 8, False)
    path = plant_path(tmp_path, "default")
    identify_on_rig(path, "default")
    found = run_hidden_case(case, read_plant(path))
    assert found.verdict in ("closed", "reduced", "no gap", "not in the catalogue")
    assert found.best and found.evidence.separation > 0 and found.evidence.residual > 0
    assert figures_by_link([found])["link changed"]["class_right"]["of"] == 1
