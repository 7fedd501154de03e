"""A campaign of faults that is ended early: its verdicts are kept, the signal is not a case's."""

from __future__ import annotations

import os
import signal
from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree as ET

import pytest

from dropstitch.__main__ import main
from firmware_py.core.console import Terminated
from firmware_py.inference.bundle import ModelBundle
from firmware_py.inference.manifest import Manifest
from firmware_py.system.stop_signals import signals_to
from hil.faults import campaign
from hil.faults.campaign import cases_of, run_campaign
from hil.faults.faults_document import read_faults
from hil.faults.observation import CaseObservation

MANIFEST = {
    "dof": 1, "period_s": 0.017, "degree": 1, "estimator": "none", "features": (),
    "outputs": (), "lag_ticks": (0,), "training_data_sha256": "", "plant_sha256": "",
    "libraries": {}, "metrics": {}, "coefficients": {}, "files": {},
}  # fmt: skip
BUNDLE = SimpleNamespace(manifest=Manifest(**MANIFEST), directory=Path("bundle"))
CASES = cases_of(1, ["virtual"], [1])


def passing(row):
    """What the row asks for, as far as the verdict looks at it."""
    return CaseObservation(row.must.ended.split(" or ")[0], row.must.reason.split("|")[0])


def ended_at(which, number, error=None):
    """Runner of cases of which one gets a signal, in a loop that takes it for its stop."""
    ran = []

    def run(robot, row, model, seed):
        ran.append(row)
        if len(ran) == which:
            with signals_to(lambda name: None):
                os.kill(os.getpid(), number)
            if error:
                raise error
        return passing(row)

    return run


@pytest.mark.parametrize(
    ("number", "raised"), [(signal.SIGTERM, Terminated), (signal.SIGINT, KeyboardInterrupt)]
)
@pytest.mark.parametrize("error", [None, BrokenPipeError()], ids=["stopped", "broken"])
def test_a_signal_in_a_case_ends_the_campaign_and_not_the_case(monkeypatch, number, raised, error):
    monkeypatch.setitem(campaign.RUNNERS, "virtual", ended_at(3, number, error))
    kept = []
    with pytest.raises(KeyboardInterrupt) as caught:
        run_campaign(SimpleNamespace(bundle=BUNDLE), CASES, lambda judged: kept.append(len(judged)))
    assert caught.type is raised
    assert kept == [1, 2]


def test_a_campaign_that_is_ended_leaves_its_verdicts_and_says_so(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(ModelBundle, "load", lambda path: BUNDLE)
    monkeypatch.setattr("hil.faults.cases.case_robot.CaseRobot", lambda bundle, fmu:
                        SimpleNamespace(bundle=bundle))  # fmt: skip
    monkeypatch.setitem(campaign.RUNNERS, "virtual", ended_at(3, signal.SIGTERM))
    code = main(["faults", "--bundle", "b", "--fmu", "f", "--line", "virtual", "--out",
                 str(tmp_path)])  # fmt: skip
    assert code == 128 + signal.SIGTERM
    assert f"2 of {len(CASES)}" in capsys.readouterr().err
    document = read_faults(tmp_path / "faults.json")
    assert (len(document.cases), document.not_run) == (2, len(CASES) - 2)
    assert document.verdict != "pass"
    suite = ET.parse(tmp_path / "faults.xml").getroot()
    assert suite.find("testcase[last()]/skipped").get("message").startswith("incomplete")
    page = (tmp_path / "report.html").read_text()
    assert "incomplete" in page and f"2 of {len(CASES)}" in page


def test_a_campaign_that_is_killed_leaves_its_verdicts(monkeypatch, tmp_path):
    """What is written after a case does not wait for the end."""
    monkeypatch.setattr(ModelBundle, "load", lambda path: BUNDLE)
    monkeypatch.setattr("hil.faults.cases.case_robot.CaseRobot", lambda bundle, fmu:
                        SimpleNamespace(bundle=bundle))  # fmt: skip
    found = []

    def run(robot, row, model, seed):
        path = tmp_path / "faults.json"
        found.append(len(read_faults(path).cases) if path.exists() else 0)
        return passing(row)

    monkeypatch.setitem(campaign.RUNNERS, "virtual", run)
    main(["faults", "--bundle", "b", "--fmu", "f", "--line", "virtual", "--only", "lost reply",
          "--out", str(tmp_path)])  # fmt: skip
    assert found == list(range(len(found)))
    assert read_faults(tmp_path / "faults.json").not_run == 0
