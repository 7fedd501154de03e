"""The page of a gap: what it reads, what it concludes, and that it says when a name was wrong."""

from __future__ import annotations

import json
import shutil

import pytest

from firmware_py.core.errors import InputError
from hil.report import write_gap_report
from hil.report.gap.before_after import before_after, fraction_removed
from hil.report.gap.gap_inputs import read_gap

HIDDEN = {"stiffness_softening": 0.2}


@pytest.fixture
def copy(gap_build, tmp_path):
    """A copy of the directory, to spoil."""
    return shutil.copytree(gap_build, tmp_path / "gap")


def edited(path, change):
    document = json.loads(path.read_text())
    change(document)
    path.write_text(json.dumps(document))


def test_the_fmu_in_fmpy_is_the_plant_and_removes_its_gap(gap_build, plant_before):
    fmu = before_after(read_gap(gap_build, plant_before), HIDDEN).fmu
    assert fmu.worst_difference < 1e-9
    assert fmu.passed is True
    # The trials are the improved plant's own: nothing is left but that they are stored in a file.
    assert fmu.tip_rms_m["before"] > 1e-3
    assert fmu.tip_rms_m["after"] < 1e-6


def test_an_fmu_of_another_plant_is_detected(copy, plant_before):
    for before in copy.glob("fmpy_before_*/result.csv"):
        shutil.copy(before, before.parent.parent / before.parent.name.replace("before", "after"))
    fmu = before_after(read_gap(copy, plant_before), HIDDEN).fmu
    assert fmu.worst_difference > 1e-3


def test_what_was_found_stands_beside_what_was_hidden(gap_build, plant_before):
    row = before_after(read_gap(gap_build, plant_before), HIDDEN).hidden["stiffness_softening"]
    assert row.found == pytest.approx(0.19 - 0.0)
    assert "0.2 hidden" in row.said and "0.19 ± 0.01 found" in row.said


def test_a_strength_that_was_there_before_is_not_counted_as_found(copy, plant_before):
    def shift(found):
        found["named"][0]["parameters"]["softening_share"]["before"] = 0.05

    edited(copy / "found" / "gap.json", shift)
    row = before_after(read_gap(copy, plant_before), HIDDEN).hidden["stiffness_softening"]
    assert row.found == pytest.approx(0.14)


def test_a_wrong_name_is_said(gap_build, plant_before, tmp_path):
    out = tmp_path / "page.html"
    data, text = write_gap_report(gap_build, plant_before, {"creep": 0.3}, out)
    assert data["also_named"] == ["stiffness_softening"]
    assert "creep was hidden and not named" in text
    assert "Creep was hidden and not named" in out.read_text(encoding="utf-8")


def test_a_look_alike_is_told_from_a_wrong_name(copy, plant_before):
    def add(found):
        found["named"][0]["look_alikes"] = [{"effects": ["creep", "backlash"], "separation": 9.0}]

    edited(copy / "found" / "gap.json", add)
    row = before_after(read_gap(copy, plant_before), {"creep": 0.3}).hidden["creep"]
    assert "look-alike stiffness softening" in row.said


def test_an_effect_of_one_joint_is_told_with_the_joint(gap_build, plant_before):
    data = before_after(read_gap(gap_build, plant_before), {"backlash:2": 0.01})
    assert data.hidden["backlash:2"].said.startswith("backlash of joint 2")
    assert data.also_named == ["stiffness_softening"]


def test_a_fraction_is_given_only_of_a_gap():
    assert fraction_removed({"before": 5.0, "after": 2.0, "without": 1.0}) == pytest.approx(0.75)
    assert fraction_removed({"before": 5.0, "after": 6.0, "without": 1.0}) == pytest.approx(-0.25)
    assert fraction_removed({"before": 1.05, "after": 1.0, "without": 1.0}) is None
    assert fraction_removed({"before": 5.0, "after": 2.0}) is None


def test_a_run_without_motion_has_no_figure(copy, plant_before, tmp_path):
    def stop(timing):
        nothing = dict.fromkeys(timing["prediction_error"])
        timing["prediction_error"] = nothing | {"n": 0, "parts": {}}

    for timing in copy.glob("sil_after_*/timing.json"):
        edited(timing, stop)
    errors_m = {"rigid": 0.05, "before": 0.01, "after": 0.002}
    for variant, rms_m in errors_m.items():
        shutil.copytree(copy / "sil_before_2", copy / f"plan_{variant}")
        path_error = {"rms_m": rms_m, "max_m": 0.1, "path_rms_m": 0.1, "rows": 9}
        edited(
            copy / f"plan_{variant}" / "timing.json",
            lambda timing, own=path_error: timing.update(path_errors=[own]),
        )
    data, text = write_gap_report(copy, plant_before, HIDDEN, tmp_path / "page.html")
    assert data["robot"]["tip_mean_m"]["after"] is None
    assert data["robot"]["tip_mean_m"]["before"] > 0
    assert data["path_rms_m"] == errors_m and "tip off its path" in text
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "The tip on its path" in page and "25.0" in page


@pytest.mark.parametrize(
    "gone", ["found/gap.json", "fmpy_after_2.json", "sil_before_2", "check_twin_1dof.json"]
)
def test_what_is_missing_is_named(copy, plant_before, gone):
    path = copy / gone
    shutil.rmtree(path) if path.is_dir() else path.unlink()
    with pytest.raises(InputError, match="make gap-demo"):
        read_gap(copy, plant_before)


def test_the_command_writes_the_page_and_names_it(gap_command):
    out, said = gap_command
    assert said.splitlines()[-1] == str(out)
    assert "http://" not in out.read_text(encoding="utf-8").replace("http://www.w3.org", "")
