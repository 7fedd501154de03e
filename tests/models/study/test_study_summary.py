"""Summary of a study: figures of one predictor stand together."""

from pathlib import Path
from types import SimpleNamespace

from models.study.study import study_summary


def document(names):
    table = {"estimated_di": {"3": 0.366}, "with_di": {"3": 0.2}, "without_di": {"3": 0.4}}
    kept = SimpleNamespace(
        mean_euclidean_distance_m=0.109, in_range_fraction=0.37, interval_coverage_mean=0.306
    )
    return SimpleNamespace(
        chosen_degree=3,
        tests=names,
        mean_euclidean_distance_m={name: {"pooled": table} for name in names},
        estimators={name: {"observer": SimpleNamespace(r2_di=0.5)} for name in names},
        deployed=dict.fromkeys(names, kept),
    )


def test_coverage_stands_beside_the_distance_of_the_predictor_that_it_is_of():
    _, line, *_ = study_summary(Path("b"), document(["unseen_20deg"])).splitlines()
    plain, kept = line.split("; with inputs kept within the training range ")
    assert "366.00 mm with estimated DI" in plain and "%" not in plain
    told = " ".join(kept.split()).replace(" %", "%")
    assert all(word in told for word in ("109.00 mm", "37%", "31%"))


def test_what_a_study_lacks_is_said():
    lines = study_summary(Path("b"), document([])).splitlines()
    assert [("trial 2" in line, "unseen" in line) for line in lines[1:]] == [
        (True, False),
        (False, True),
    ]
