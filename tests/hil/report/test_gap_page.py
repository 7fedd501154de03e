"""The page of a gap: what it reads, what it concludes, and that it says when a name was wrong."""

from __future__ import annotations

import json
import shutil

import pytest

from dropstitch.__main__ import main
from hil.report.gap_page import fraction_removed, gap_figures, read_gap
from models.plant.plant import NOMINAL

pytestmark = pytest.mark.slow

HIDDEN = {"stiffness_softening": 0.2}


@pytest.fixture
def copy(gap_build, tmp_path):
    """A copy of the directory, to damage."""
    return shutil.copytree(gap_build, tmp_path / "gap")


def edited(path, change):
    document = json.loads(path.read_text())
    change(document)
    path.write_text(json.dumps(document))


def test_fmu_and_diagnosis_are_judged_by_the_files(gap_build):
    figures = gap_figures(read_gap(gap_build, NOMINAL), HIDDEN)
    # The trials are the improved plant's own: nothing is left but that they are stored in a file.
    error_m = figures.errors["fmu"].error_m
    assert error_m["before"] > 1e-3
    assert error_m["after"] < 1e-6
    row = figures.hidden["stiffness_softening"]
    assert row.estimate == pytest.approx(0.19)
    assert row.text == "stiffness softening: 20\u00a0% hidden, 19 ± 1 % estimated"


def test_names_are_compared_with_what_was_hidden(copy):
    def change(document):
        (row,) = document["named"]
        row["parameters"]["softening_share"]["before"] = 0.05
        row["look_alikes"] = [{"effects": ["creep", "backlash"], "separation": 9.0}]

    edited(copy / "found" / "gap.json", change)
    inputs = read_gap(copy, NOMINAL)
    strength = gap_figures(inputs, HIDDEN).hidden["stiffness_softening"].estimate
    assert strength == pytest.approx(0.14), "a strength that was there before does not count"
    alike = gap_figures(inputs, {"creep": 0.3})
    assert "look-alike stiffness softening" in alike.hidden["creep"].text
    joint = gap_figures(inputs, {"dead_time:2": 0.01})
    assert joint.hidden["dead_time:2"].text == "dead time of joint 2 was hidden and not named"
    assert joint.also_named == ["stiffness_softening"]


def test_the_fraction_removed_needs_a_gap():
    assert fraction_removed({"before": 5.0, "after": 2.0, "without": 1.0}) == pytest.approx(0.75)
    assert fraction_removed({"before": 5.0, "after": 6.0, "without": 1.0}) == pytest.approx(-0.25)
    assert fraction_removed({"before": 1.05, "after": 1.0, "without": 1.0}) is None
    assert fraction_removed({"before": 5.0, "after": 2.0}) is None


def test_a_run_without_motion_has_no_figure_and_plans_have_theirs(copy, capsys):
    def stop(timing):
        nothing = dict.fromkeys(timing["prediction_error"])
        timing["prediction_error"] = nothing | {"n": 0, "parts": {}}

    for timing in copy.glob("sil_after_*/timing.json"):
        edited(timing, stop)
    errors_m = {"rigid": 0.05, "before": 0.01, "after": 0.002, "without": 0.001}
    for variant, rms_m in errors_m.items():
        shutil.copytree(copy / "sil_before_2", copy / f"plan_{variant}")
        path_error = {"rms_m": rms_m, "max_m": 0.1, "path_rms_m": 0.1, "rows": 9}
        edited(
            copy / f"plan_{variant}" / "timing.json",
            lambda timing, row=path_error: timing.update(path_errors=[row]),
        )
    command = ["report", "gap", str(copy), "--plant", str(NOMINAL), "--hide", "creep=0.3"]
    assert main([*command, "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["verdict"] == "closed"
    assert data["errors"]["robot"]["error_m"]["after"] is None
    assert data["errors"]["robot"]["error_m"]["before"] > 0
    path = data["errors"]["path"]
    assert path["error_m"] == errors_m
    assert path["fraction_removed"] == pytest.approx(8 / 9)
    page = (copy / "report.html").read_text(encoding="utf-8")
    assert "50.0\u00a0mm" in page and "89\u00a0%" in page
    assert main(command) == 0
    out = capsys.readouterr().out
    assert "50.0\u00a0mm" in out and "89\u00a0%" in out, "page and console have the same figures"
    assert "Creep was hidden and not named" in page
    assert "http://" not in page.replace("http://www.w3.org", "")


@pytest.mark.parametrize("missing", ["found/gap.json", "fmpy_after_2.json", "sil_before_2"])
def test_a_missing_file_is_named_with_its_remedy(copy, capsys, missing):
    path = copy / missing
    shutil.rmtree(path) if path.is_dir() else path.unlink()
    assert main(["report", "gap", str(copy), "--plant", str(NOMINAL)]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1 and missing in err and "make gap-demo" in err
