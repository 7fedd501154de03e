"""Odds and prior of sets of effects: the loss follows what was hidden, the table keeps each set."""

import msgspec
import numpy as np
import pytest

from models.gap.decision.set_weights import MEAN_NUMBER, ODDS_OF_WHOLE_GAP
from models.gap.training import weight_fit
from models.gap.training.weight_fit import (
    ExplainedSets,
    excess_errors,
    explained_sets,
    losses,
    read_explained_sets,
)

IN_USE = weight_fit.TABLE


def explained(missing=("creep",), **scores):
    """Sets of one diagnosis: names joined with "_and_", each with its score."""
    sets = tuple((tuple(text.split("_and_")), score) for text, score in scores.items())
    return ExplainedSets(
        rig="drawn_1", data_set=1, missing=missing, catalogue=1.0, effects=25, sets=sets
    )


def test_where_the_best_set_is_always_right_the_largest_odds_lose_least():
    tried = losses([explained(creep=1000.0, hysteresis=700.0)])
    rows = [tried[odds, 0.05] for odds in weight_fit.ODDS]
    assert rows == sorted(rows, reverse=True)


def test_where_a_useless_effect_is_never_missing_the_least_mean_loses_least():
    tried = losses([explained(creep=1000.0, creep_and_backlash=1010.0)])
    rows = [tried[8.0, mean] for mean in weight_fit.MEANS]
    assert rows == sorted(rows)


def test_the_loss_is_of_the_probability_of_each_effect():
    row = explained(creep=1000.0, hysteresis=1000.0)
    assert row.loss(8.0, 0.05) == pytest.approx(2 * np.log(2))


def test_a_pair_that_loses_alike_on_every_rig_is_told_from_the_least_one():
    """The error is that of the excess: what all rigs share does not count."""
    rows = [
        msgspec.structs.replace(explained(creep=1000.0, hysteresis=700.0), rig=f"drawn_{k}")
        for k in range(1, 5)
    ]
    least = weight_fit.ODDS[-1], 0.05
    error = excess_errors(rows, least)
    assert error[least] == 0.0
    assert error[weight_fit.ODDS[0], 0.05] == pytest.approx(0.0, abs=1e-12)
    differing = [
        *rows[:2],
        *(msgspec.structs.replace(r, missing=("hysteresis",)) for r in rows[2:]),
    ]
    assert excess_errors(differing, least)[weight_fit.ODDS[0], 0.05] > 0.0


def result(**changed):
    return {
        "case": {"kind": "single", "rig": "drawn_1", "seed": 7, "hidden": {"creep": 0.3}},
        "hypotheses": [[[], 0.0, 0.0, 0.1], [["creep"], 900.0, 20.0, 0.9]],
        "tested": [{"answers": {"catalogue": 0.9}}], "effects": 25, "separable": True, **changed,
    }  # fmt: skip


def test_only_what_has_a_true_answer_is_kept():
    (row,) = explained_sets(
        [result(), result(separable=False), {"impossible": "the link folds"}, result(hypotheses=[])]
    )
    assert (row.missing, row.catalogue, row.sets) == (("creep",), 0.9, ((("creep",), 880.0),))
    denied = result(case=result()["case"] | {"kind": "outside"})
    assert explained_sets([denied])[0].missing == ()


def test_runs_are_added_to_the_table_and_rigs_for_tests_are_refused(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(weight_fit, "TABLE", tmp_path / "sets.jsonl")
    rigs = {"A": "drawn_1", "B": "drawn_2", "C": "drawn_900"}
    case = result()["case"]
    runs = {name: {0: result(case=case | {"rig": rig})} for name, rig in rigs.items()}
    monkeypatch.setattr(weight_fit, "case_results", lambda path: runs[path.name])
    for name in ("A", "B", "A"):
        monkeypatch.setattr("sys.argv", ["weight_fit", name])
        weight_fit.main()
    assert [row.rig for row in read_explained_sets()] == ["drawn_1", "drawn_2"]
    assert "2 data sets" in capsys.readouterr().out
    monkeypatch.setattr("sys.argv", ["weight_fit", "C"])
    with pytest.raises(SystemExit):
        weight_fit.main()
    assert len(read_explained_sets()) == 2


def test_the_numbers_in_use_are_near_the_least_loss_on_the_table(monkeypatch):
    rows = msgspec.json.Decoder(ExplainedSets).decode_lines(IN_USE.read_bytes())
    tried = losses(rows)
    assert tried[ODDS_OF_WHOLE_GAP, MEAN_NUMBER] < 1.12 * min(tried.values())
