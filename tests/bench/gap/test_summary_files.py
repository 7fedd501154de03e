"""Files of the summary: which there are, and whose results each of them holds."""

import json

import pytest

from bench.gap.scores import rig_table, score_summary, summary_files
from bench.gap.scores.confusion_matrix import confusion_counts, confusion_matrix_svg
from bench.gap.scores.summary_files import write_bench_summary

ALWAYS = {"figures.json", "by_rig.json", "by_rig.md", "confusion.svg", "reliability.svg"}


def result(rig, hidden, named, kind="single"):
    """Result of one case, as the summary reads it."""
    return {
        "case": {"kind": kind, "hidden": dict.fromkeys(hidden, 0.3), "nuisance": {}, "seed": 1}
        | {"rig": rig},
        "named": named, "chosen": [[n] for n in named], "look_alikes": [[] for _ in named],
        "verdict": "closed" if named else "no gap", "largest": 1.0, "separable": True,
        "own": dict.fromkeys(hidden, 20.0), "null_standard_deviation": dict.fromkeys(hidden, 1.0),
        "hypotheses": [[named, 900.0, 20.0, 1.0]] if named else [],
        "estimates": {n: [[0.3, 0.05, 0.0]] for n in named}, "true": dict.fromkeys(hidden, 0.3),
        "sealed": None, "sealed_rms": None, "unsaid_bounds": [],
    }  # fmt: skip


@pytest.fixture
def written(tmp_path, monkeypatch):
    """Function that writes results and their summary."""

    def write(*results):
        known = dict(enumerate(results))
        for module in (rig_table, score_summary, summary_files):
            monkeypatch.setattr(module, "bench_results", lambda directory: known)
        figures, by_rig = write_bench_summary(tmp_path)
        folder = tmp_path / "summary"
        assert json.loads((folder / "figures.json").read_text()) == figures
        assert json.loads((folder / "by_rig.json").read_text()) == by_rig
        return {p.name: p.read_text(encoding="utf-8") for p in folder.iterdir()}

    return write


def test_each_purpose_has_a_confusion_matrix_and_a_colour_of_its_own(written):
    files = written(
        result("default", ["creep"], ["creep"]),
        result("drawn_900", ["backlash"], ["prebend"]),
        result("test_a", [], [], "null"),
    )
    assert files.keys() == ALWAYS | {"confusion_test.svg", "confusion_tuning.svg"}
    assert "creep" in files["confusion_tuning.svg"]
    assert "backlash" not in files["confusion_tuning.svg"]
    assert "backlash" in files["confusion_test.svg"] and "(none)" in files["confusion_test.svg"]
    assert "creep" not in files["confusion_test.svg"]
    assert all(name in files["confusion.svg"] for name in ("creep", "backlash", "(none)"))
    assert all(f"rigs for {p}" in files["reliability.svg"] for p in ("tuning", "testing"))


def test_a_purpose_without_a_case_has_no_files(written):
    files = written(
        result("drive", ["creep"], []), result("test_a", ["creep"], ["creep"], "outside")
    )
    assert files.keys() == ALWAYS | {"confusion_tuning.svg"}


def test_the_confusion_matrix_counts_cases_with_one_effect_or_none():
    counts = confusion_counts(
        [
            result("default", ["creep"], ["creep", "prebend"]),
            result("default", ["creep"], ["creep"]),
            result("default", ["creep"], []),
            result("default", [], [], "null"),
            result("default", ["creep", "prebend"], ["creep"], "pair"),
            result("default", ["creep"], ["prebend"], "outside"),
            {"case": {"kind": "single", "hidden": {"creep": 1.0}}, "impossible": "folds"},
        ]
    )
    assert counts == {
        ("creep", "creep"): 2, ("creep", "(nothing)"): 1, ("(none)", "(nothing)"): 1,
    }  # fmt: skip
    assert "rigs for testing" in confusion_matrix_svg(counts, "rigs for testing")
