"""Probabilities of the answers to what is missing, fitted to diagnoses of rigs for tuning.

    python -m bench.gap --rigs drawn_118 … --same-link --no-sealed --out build/tuning_same
    python -m bench.gap.calibrate_answers build/tuning_same …

Each result of `bench.gap` tells what its diagnosis judged and with which evidence
(`models.gap.decision.evidence`), and what was hidden. Logistic regressions of the truth on the
evidence give `models/gap/decision/answers.json`. Printed is how they do on each rig when that rig
is left out. No rig for tests may be among them.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
from sklearn.linear_model import LogisticRegression
from sklearn.preprocessing import StandardScaler

from bench.gap.bench_kind import bench_results
from models.gap.decision.answers import (
    ANSWERS,
    OF_A_GAP,
    PATH,
    Answer,
    AnswerModel,
    Regression,
)
from models.gap.decision.evidence import FEATURES, Evidence
from models.rig.drawn_rig import rig_purpose

INVERSE_PENALTIES: Final = (0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0)
"""Of the regression's coefficients; the one with the least loss on rigs left out is taken."""

KIND_WEIGHT: Final = {"single": 0.6, "pair": 0.1, "null": 0.2, "outside": 0.1}
"""Fraction of each kind of data set: what a user brings [assumed]."""


class LabelledEvidence(msgspec.Struct, frozen=True):
    """Evidence of one test, the true answer, its weight and the rig."""

    evidence: Evidence
    answer: Answer
    weight: float
    rig: str


def labelled(results: Sequence[dict[str, Any]]) -> list[LabelledEvidence]:
    """Evidence of every test of some results with the true answer.

    Names that are wrong stand in for something else: to these the answer is "outside". Where
    nothing was left to name, an effect of the catalogue may be there all the same. A denied effect
    that the whole catalogue does not tell from its stand-in has no true answer.

    Parameters
    ----------
    results : sequence of dict
        Of `bench.gap.case_run`, with their cases.
    """
    possible = [r for r in results if r.get("tested") and r["separable"]]
    kinds = [r["case"]["kind"] for r in possible]
    found = []
    for result in possible:
        case = result["case"]
        for test in result["tested"]:
            if case["kind"] in ("null", "outside"):
                answer: Answer = "nothing" if case["kind"] == "null" else "outside"
            elif set(test["effects"]) <= set(case["hidden"]) | _alike(result):
                answer = "catalogue"
            else:
                answer = "outside"
            share = KIND_WEIGHT[case["kind"]] / kinds.count(case["kind"])
            weight = share / len(result["tested"])
            evidence = Evidence(**test["evidence"])
            found.append(LabelledEvidence(evidence, answer, weight, case["rig"]))
    return found


def fitted_model(rows: Sequence[LabelledEvidence], inverse_penalty: float) -> AnswerModel:
    """Regressions of the answers on the evidence.

    Parameters
    ----------
    rows : sequence of LabelledEvidence
        From `labelled`.
    inverse_penalty : float
        Of the coefficients of standardised evidence.
    """
    others = [row for row in rows if row.answer != "catalogue"]
    return AnswerModel(
        sets=len(rows),
        catalogue=_regression(rows, "catalogue", FEATURES, inverse_penalty),
        outside=_regression(others, "outside", OF_A_GAP, inverse_penalty),
    )


def _regression(
    rows: Sequence[LabelledEvidence], answer: Answer, names: Sequence[str], inverse_penalty: float
) -> Regression:
    """Regression of one answer on some evidence; its coefficients are not standardised."""
    features = np.array([[getattr(row.evidence, name) for name in names] for row in rows])
    weight = np.array([row.weight for row in rows])
    scaler, fit = StandardScaler(), LogisticRegression(C=inverse_penalty, max_iter=2000)
    scaled = scaler.fit_transform(features)
    fit.fit(scaled, [row.answer == answer for row in rows], weight / weight.mean())
    slope = fit.coef_[0] / scaler.scale_
    return Regression(
        intercept=round(float(fit.intercept_[0] - slope @ scaler.mean_), 4),
        coefficient={n: round(float(c), 4) for n, c in zip(names, slope, strict=True)},
    )


def loss_left_out(rows: Sequence[LabelledEvidence], inverse_penalty: float) -> float:
    """Mean negative logarithm of the true answer's probability, each rig left out in turn.

    Parameters
    ----------
    rows : sequence of LabelledEvidence
        From `labelled`.
    inverse_penalty : float
        See `fitted_model`.
    """
    return float(np.sum([-w * np.log(p[a]) for p, a, w in _left_out(rows, inverse_penalty)]))


def main() -> None:
    """Fit, say how good it is, write."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("runs", type=Path, nargs="+", help="directories of bench.gap --out")
    args = parser.parse_args()
    results = [r for run in args.runs for r in bench_results(run).values()]
    rows = labelled(results)
    for rig in sorted({row.rig for row in rows}):
        if rig_purpose(rig) == "test":
            parser.error(f"{rig} is for tests: nothing is set on it")
    losses = {c: loss_left_out(rows, c) for c in INVERSE_PENALTIES}
    best = min(losses, key=lambda c: losses[c])
    print(f"{len(results)} data sets, {len(rows)} tests; penalty 1 / {best:g}")
    print(_confusion(rows, best))
    PATH.write_bytes(msgspec.json.format(msgspec.json.encode(fitted_model(rows, best)), indent=1))


def _confusion(rows: Sequence[LabelledEvidence], inverse_penalty: float) -> str:
    """Table of the true answer by the likeliest one, each rig left out in turn."""
    count = {(true, said): 0 for true in ANSWERS for said in ANSWERS}
    for probability, true, _ in _left_out(rows, inverse_penalty):
        count[true, max(ANSWERS, key=lambda a: probability[a])] += 1
    lines = [f"loss on rigs left out {loss_left_out(rows, inverse_penalty):.3f}"]
    lines += [
        f"{true:10s} said to be " + ", ".join(f"{said} {count[true, said]}" for said in ANSWERS)
        for true in ANSWERS
    ]
    return "\n".join(lines)


def _left_out(
    rows: Sequence[LabelledEvidence], inverse_penalty: float
) -> list[tuple[dict[Answer, float], Answer, float]]:
    """Probabilities of each row by a model without its rig, its true answer and its weight."""
    found = []
    for rig in sorted({row.rig for row in rows}):
        model = fitted_model([row for row in rows if row.rig != rig], inverse_penalty)
        for row in rows:
            if row.rig == rig:
                answers = model.answers(row.evidence)
                probability = {a: float(getattr(answers, a)) for a in ANSWERS}
                found.append((probability, row.answer, row.weight))
    return found


def _alike(result: dict[str, Any]) -> set[str]:
    """Hidden effects that a result declares to be look-alikes of what it names, and those names.

    A declared look-alike of a hidden effect is a right name.
    """
    declared = {e for turn in result["look_alikes"] for names in turn for e in names}
    return set(result["named"]) if declared & set(result["case"]["hidden"]) else set()


if __name__ == "__main__":
    main()
