"""Odds and prior of the sets of effects, fitted to diagnoses of rigs for tuning.

    python -m models.gap.training cases --rigs drawn_118 … --out build/tuning
    python -m models.gap.training sets build/tuning …

The posterior shares the probability of the catalogue among sets of effects
(`models.gap.decision.set_weights`). Tried are some values of its two numbers; each is judged by the
negative logarithm of the probability that it gives to what was hidden in the rig, over all effects.
The sets of the runs are added to those in `explained_sets.jsonl`. Printed is the loss of each
pair of values, marked where it is within a standard error of the least one (one-standard-error
rule, Hastie, Tibshirani and Friedman 2009, section 7.10). Of those the pair of the least odds, then
the largest mean, is the least sure: what is fitted to few rigs is too sure of others. The pair in
use stands in `models/gap/decision/set_weights.py`. No rig for testing may be among the runs.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np

from models.gap.decision.set_weights import MEAN_NUMBER, ODDS_OF_WHOLE_GAP, set_weights
from models.gap.training.case_runs import case_results
from models.rig.drawn import rig_purpose

TABLE: Final = Path(__file__).with_name("explained_sets.jsonl")

ODDS: Final = (6.0, 8.0, 10.0, 12.0, 14.0, 16.0, 18.0, 20.0, 24.0)
MEANS: Final = (0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5)
"""Values that are tried."""

LOGARITHM_FLOOR: Final = 0.01
"""Least probability whose logarithm is taken: one wrong name in a hundred is not the rule."""


class ExplainedSets(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Sets of effects that one diagnosis held to be possible."""

    rig: str
    data_set: int  # Seed of the data set's noise
    missing: tuple[str, ...]  # Effects that were hidden, and are in the catalogue
    catalogue: float  # Probability that the effects that were named, or any, are missing
    effects: int
    sets: tuple[tuple[tuple[str, ...], float], ...]  # Effects of each set, and its score

    def loss(self, odds: float, mean: float) -> float:
        """Negative logarithm of the probability of what was hidden, summed over the effects."""
        probability: dict[str, float] = defaultdict(float)
        size = np.array([len(effects) for effects, _ in self.sets])
        score = np.array([score for _, score in self.sets])
        weight = set_weights(size, score, self.effects, odds, mean)
        for (effects, _), own in zip(self.sets, weight / weight.sum(), strict=True):
            for effect in effects:
                probability[effect] += self.catalogue * float(own)
        rows = [
            probability[e] if e in self.missing else 1 - probability[e]
            for e in {*probability, *self.missing}
        ]
        return float(-np.sum(np.log(np.maximum(rows, LOGARITHM_FLOOR))))


def explained_sets(results: Iterable[dict[str, Any]]) -> list[ExplainedSets]:
    """Sets of every diagnosis that held any to be possible.

    A denied effect that the whole catalogue does not tell from its stand-in has no true answer.
    """
    found = []
    for result in results:
        sets = [(tuple(e), gain - least) for e, gain, least, _ in result.get("hypotheses", ()) if e]
        if not sets or not result["separable"]:
            continue
        case = result["case"]
        row = ExplainedSets(
            rig=case["rig"], data_set=case["seed"],
            missing=() if case["kind"] == "outside" else tuple(case["hidden"]),
            catalogue=result["tested"][-1]["answers"]["catalogue"],
            effects=result["effects"], sets=tuple(sets),
        )  # fmt: skip
        found.append(row)
    return found


def losses(found: Sequence[ExplainedSets]) -> dict[tuple[float, float], float]:
    """Mean loss of each pair of values."""
    pairs = [(odds, mean) for odds in ODDS for mean in MEANS]
    return {pair: float(np.mean([row.loss(*pair) for row in found])) for pair in pairs}


def excess_errors(
    found: Sequence[ExplainedSets], least: tuple[float, float]
) -> dict[tuple[float, float], float]:
    """Standard error of each pair's mean loss beyond that of the least one; rigs are
    independent.
    """
    result = {}
    for pair in ((odds, mean) for odds in ODDS for mean in MEANS):
        by_rig: dict[str, float] = defaultdict(float)
        for row in found:
            by_rig[row.rig] += row.loss(*pair) - row.loss(*least)
        spread = float(np.std(list(by_rig.values())))
        result[pair] = spread * float(np.sqrt(len(by_rig))) / len(found)
    return result


def read_explained_sets() -> list[ExplainedSets]:
    """Sets of the table."""
    return msgspec.json.Decoder(ExplainedSets).decode_lines(TABLE.read_bytes())


def main(argv: Sequence[str] | None = None) -> int:
    """Add the sets of some runs, and print the losses."""
    parser = argparse.ArgumentParser(
        prog="python -m models.gap.training sets",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("runs", type=Path, nargs="*", help="directories of `cases --out`")
    args = parser.parse_args(argv)
    new = explained_sets(r for run in args.runs for r in case_results(run).values())
    again = {(row.rig, row.data_set) for row in new}
    known = read_explained_sets() if TABLE.exists() else []
    found = [*(row for row in known if (row.rig, row.data_set) not in again), *new]
    for rig in sorted({row.rig for row in found}):
        if rig_purpose(rig) == "test":
            parser.error(f"{rig} is for testing: nothing is set on it")
    ordered = sorted(found, key=lambda row: (row.rig, row.data_set))
    TABLE.write_bytes(msgspec.json.Encoder().encode_lines(ordered))
    print(f"{len(found)} data sets; in use: odds {ODDS_OF_WHOLE_GAP:g}, mean {MEAN_NUMBER:g}")
    tried = losses(found)
    print("odds, mean: " + "".join(f"{mean:8g}" for mean in MEANS))
    least = min(tried, key=lambda pair: tried[pair])
    error = excess_errors(found, least)
    near = {pair for pair, own in tried.items() if own - tried[least] <= error[pair]}
    for odds in ODDS:
        cells = [(f"{tried[odds, m]:.3f}", "*" if (odds, m) in near else " ") for m in MEANS]
        print(f"{odds:10g}: " + "".join(f"{value:>7s}{mark}" for value, mark in cells))
    print("* within a standard error of the least loss")
    return 0
