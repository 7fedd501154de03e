"""Gap document: its keys, its page, and the refusal of another version."""

import json
from dataclasses import replace

import msgspec
import pytest

from firmware_py.errors import InputError
from models.gap.report.gap_json import FittedValue, read_gap_document, write_gap_document
from models.gap.report.gap_page import write_gap_page
from models.gap.report.gap_results import gap_document
from models.gap.report.gap_words import gap_in_words
from models.gap.settings import DEFAULT_SETTINGS, GapSettings

CONTRACT = {"verdict", "noise_floor", "located", "named", "before", "after", "rejected"}


@pytest.fixture(scope="module")
def document(late):
    return gap_document(*late)


@pytest.fixture
def path(document, tmp_path):
    write_gap_document(tmp_path / "gap.json", document)
    return tmp_path / "gap.json"


def test_it_holds_the_keys_of_the_contract(path):
    data = json.loads(path.read_text())
    assert data.keys() >= CONTRACT
    entry = data["named"][0]
    assert entry["effect"] == "dead_time"
    assert {"value", "unit", "error"} <= set(entry["parameters"]["dead_time_1_s"])
    assert {"evidence", "look_alikes"} <= set(entry)
    angle = [data[k]["held_out"]["angle_1_rad"]["floors"] for k in ("before", "after")]
    assert angle[1] < 0.2 * angle[0]
    assert all({"signal", "size"} <= set(row) for row in data["located"])
    assert all(row["reason"] for row in data["rejected"])


def test_every_effect_that_was_considered_is_named_or_rejected(document, late):
    considered = {q.effect for q in late[0].fit_parameters if q.effect}
    assert {row.effect for row in document.rejected} | {"dead_time"} >= considered
    assert "dead_time" not in {row.effect for row in document.rejected}


def test_it_is_read_as_it_was_written(path, document):
    assert read_gap_document(path) == document
    assert read_gap_document(path).settings == DEFAULT_SETTINGS


def test_the_settings_of_the_run_are_recorded(late):
    found, trials = late
    changed = msgspec.structs.replace(found.settings, payload_trend_ratio=9.0)
    assert isinstance(changed, GapSettings)
    other = type(found)(**{**vars(found), "settings": changed})
    assert gap_document(other, trials).settings.payload_trend_ratio == 9.0


def test_an_old_document_is_refused_in_one_sentence(path):
    data = json.loads(path.read_text())
    path.write_text(json.dumps(data | {"schema": 1, "strained": {}}))
    with pytest.raises(InputError, match="has schema version 1") as refusal:
        read_gap_document(path)
    assert str(refusal.value).endswith("write it anew with dropstitch gap.")
    assert "\n" not in str(refusal.value)


def test_console_and_page_name_the_effect(document, late, tmp_path):
    found, trials = late
    assert "named: dead_time" in gap_in_words(document)
    out = tmp_path / "report.html"
    page = write_gap_page(document, found.plant, found.improved, trials, out).read_text()
    assert page.count("<svg") >= 4
    assert "Closed by dead time." in page
    assert "http" not in page.replace("http://www.w3.org/2000/svg", "")


def test_a_value_without_an_error_is_told_as_not_fitted():
    assert str(FittedValue(0.04, "s", None, 0.0)) == "0.04"
    assert FittedValue(0.04, "s", None, 0.0).bound_in_words == " (not fitted)"
    assert str(FittedValue(0.04, "s", 0.001, 0.0)) == "0.04 ± 0.001"


def test_a_value_at_its_bound_is_said(document, late, tmp_path):
    found, trials = late
    (row,) = document.named
    name, phase = row.parameters  # of the dead time: its strength, and where it meets the sampling
    assert row.parameters[phase].unit_in_words == "" and row.parameters[name].unit_in_words == " s"
    assert row.parameters[name].bound is None and "bound)" not in gap_in_words(document)
    high = found.fitted.parameters[name].high
    ended = found.fitted.with_values({name: high})
    said = gap_document(replace(found, fitted=ended), trials)
    assert said.named[0].parameters[name].bound == "upper"
    assert f"{high:.4g}" in gap_in_words(said) and "(at its upper bound)" in gap_in_words(said)
    write_gap_page(said, found.plant, found.improved, trials, tmp_path / "report.html")
    assert "at its upper bound" in (tmp_path / "report.html").read_text()
