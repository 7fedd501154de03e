"""Gap document: its keys, its page, and the refusal of another version."""

import json

import pytest
from markupsafe import escape

from firmware_py.core.errors import InputError
from models.gap.report.diagnosis_files import write_results
from models.gap.report.gap_json import DiagnosisInputs, read_gap_document
from models.gap.report.gap_results import gap_document
from models.gap.settings import DEFAULT_SETTINGS

CONTRACT = {
    "verdict", "noise_floor", "located", "named", "before", "after", "rejected", "refused",
    "probabilities", "written", "headline",
}  # fmt: skip


@pytest.fixture(scope="module")
def written(late, tmp_path_factory):
    """Document, directory and page of a diagnosis."""
    out = tmp_path_factory.mktemp("gap")
    inputs = DiagnosisInputs("plant.json", "12", ("trials",))
    document, page = write_results(late[0], inputs, out)
    return document, out, page


def test_it_has_the_keys_of_the_contract(written, late):
    data = json.loads((written[1] / "gap.json").read_text())
    assert data.keys() >= CONTRACT
    (entry,) = data["named"]
    assert (entry["effect"], entry["joint"]) == ("dead_time", None)
    value = entry["parameters"]["dead_time_1_s"]
    assert value["value"] == pytest.approx(0.02, abs=3 * value["error"] + 1e-3)
    assert entry["evidence"]["separation"] > entry["evidence"]["separation_of_nothing"]
    angle = [data[k]["held_out"]["angle_1_rad"]["floors"] for k in ("before", "after")]
    assert angle[1] < 0.2 * angle[0]
    assert all({"signal", "size"} <= set(row) for row in data["located"])
    assert data["written"]["effects"] == ["dead_time"]
    assert sum(data["probabilities"].values()) == pytest.approx(1.0)


def test_every_effect_that_was_considered_is_named_or_rejected(written, late):
    search = late[0].naming.search
    rejected = {row.effect: row for row in written[0].rejected}
    assert rejected.keys() | {"dead_time"} == {name.partition(":")[0] for name in search.of}
    assert "dead_time" not in rejected and all(row.reason for row in rejected.values())


def test_it_is_read_as_it_was_written(written):
    document, out, _ = written
    assert read_gap_document(out / "gap.json") == document
    assert document.settings == DEFAULT_SETTINGS


def test_an_old_document_is_refused_in_one_sentence(written, tmp_path):
    data = json.loads((written[1] / "gap.json").read_text())
    path = tmp_path / "gap.json"
    path.write_text(json.dumps(data | {"schema": 2, "strained": {}}))
    with pytest.raises(InputError, match="has schema version 2") as refusal:
        read_gap_document(path)
    assert str(refusal.value).endswith("write it anew with dropstitch gap.")
    assert "\n" not in str(refusal.value)


def test_console_and_page_begin_with_the_same_sentence(written, late):
    document, _, path = written
    page = path.read_text()
    assert str(escape(document.headline)) in page and document.headline in late[0].summary()
    assert document.headline.startswith("Missing: dead time 20")
    parts = ["What to check", "Next:", "payloads left out", "<svg", "Where the"]
    places = [page.index(part) for part in (escape(document.headline), *parts)]
    assert places == sorted(places)
    assert "http" not in page.replace("http://www.w3.org/2000/svg", "")


def test_the_signals_are_drawn_for_a_notebook(late):
    figure = late[0].plot()
    assert len(figure.axes) % 2 == 0
    measured, before, after = figure.axes[0].lines
    assert [line.get_label() for line in (measured, before, after)] == [
        "measured", "before", "after",
    ]  # fmt: skip


def test_a_document_needs_the_diagnosis_alone(late, written):
    assert gap_document(late[0]).headline == written[0].headline
