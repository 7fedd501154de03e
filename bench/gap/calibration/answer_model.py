"""Probabilities of the answers to what is missing, fitted to diagnoses of rigs for tuning.

    python -m bench.gap --rigs drawn_118 … --same-link --no-sealed --out build/tuning_same
    python -m bench.gap.calibration.answer_model build/tuning_same …

Each result of `bench.gap` tells what its diagnosis judged and with which evidence
(`models.gap.decision.evidence`), and what was hidden. The tests of the runs are added to those in
`answer_tests.jsonl`; of a data set that is there already the new ones count. Logistic regressions
of the truth on the evidence give the probabilities. Printed is how the coefficients in use do on
the tests, and how new ones do on each rig when that rig is left out. With --write the new ones
replace those in use (`models/gap/decision/answers.json`). No rig for tests may be among them.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import msgspec
import numpy as np
from sklearn.linear_model import LogisticRegression
from sklearn.preprocessing import StandardScaler

from bench.gap.bench_kind import bench_results
from bench.gap.calibration.answer_tests import (
    AnswerTest,
    labelled,
    read_answer_tests,
    weights,
    with_new,
    write_answer_tests,
)
from models.gap.decision.answers import (
    ANSWERS,
    OF_A_GAP,
    OF_NAMES,
    PATH,
    Answer,
    AnswerModel,
    Answers,
    Regression,
    read_answer_model,
)
from models.rig.drawn_rig import rig_purpose

INVERSE_PENALTIES: Final = (0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0)
"""Of the regression's coefficients; the one with the least loss on rigs left out is taken."""


def fitted_model(tests: Sequence[AnswerTest], inverse_penalty: float) -> AnswerModel:
    """Regressions of the answers on the evidence.

    That of "outside" is of the data sets that hide nothing, or an effect that the catalogue lacks:
    a wrong name for one that it has tells nothing of these.

    Parameters
    ----------
    tests : sequence of AnswerTest
        To be fitted to.
    inverse_penalty : float
        Of the coefficients of standardised evidence.
    """
    return AnswerModel(
        sets=len(tests),
        catalogue=_regression(tests, "catalogue", OF_NAMES, inverse_penalty),
        outside=_regression(
            [test for test in tests if test.kind in ("null", "outside")],
            "outside", OF_A_GAP, inverse_penalty,
        ),
    )  # fmt: skip


def _regression(
    tests: Sequence[AnswerTest], answer: Answer, names: Sequence[str], inverse_penalty: float
) -> Regression:
    """Regression of one answer on some evidence; its coefficients are not standardised."""
    rows = list(zip(tests, weights(tests), strict=True))
    features = np.array([[getattr(test.evidence, name) for name in names] for test, _ in rows])
    weight = np.array([weight for _, weight in rows])
    scaler, fit = StandardScaler(), LogisticRegression(C=inverse_penalty, max_iter=2000)
    scaled = scaler.fit_transform(features)
    fit.fit(scaled, [test.answer == answer for test, _ in rows], weight / weight.mean())
    slope = fit.coef_[0] / scaler.scale_
    return Regression(
        intercept=round(float(fit.intercept_[0] - slope @ scaler.mean_), 4),
        coefficient={n: round(float(c), 4) for n, c in zip(names, slope, strict=True)},
    )


def left_out(tests: Sequence[AnswerTest], inverse_penalty: float) -> list[Answers]:
    """Answers to each test by a model without its rig.

    Parameters
    ----------
    tests : sequence of AnswerTest
        To be fitted to.
    inverse_penalty : float
        See `fitted_model`.
    """
    rigs = {test.rig for test in tests}
    models = {
        rig: fitted_model([test for test in tests if test.rig != rig], inverse_penalty)
        for rig in rigs
    }
    return [models[test.rig].answers(test.evidence) for test in tests]


def loss(tests: Sequence[AnswerTest], answers: Sequence[Answers]) -> float:
    """Mean negative logarithm of the true answer's probability.

    Parameters
    ----------
    tests : sequence of AnswerTest
        Of any rigs.
    answers : sequence of Answers
        To each of them.
    """
    right = [getattr(own, test.answer) for test, own in zip(tests, answers, strict=True)]
    return float(-np.array(weights(tests)) @ np.log(right))


def main() -> None:
    """Fit, say how good it is and how good what is in use is."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("runs", type=Path, nargs="*", help="directories of bench.gap --out")
    parser.add_argument("--write", action="store_true", help="use the new coefficients")
    args = parser.parse_args()
    new = labelled(r for run in args.runs for r in bench_results(run).values())
    tests = with_new(read_answer_tests(), new)
    for rig in sorted({test.rig for test in tests}):
        if rig_purpose(rig) == "test":
            parser.error(f"{rig} is for tests: nothing is set on it")
    losses = {c: loss(tests, left_out(tests, c)) for c in INVERSE_PENALTIES}
    best = min(losses, key=lambda c: losses[c])
    data_sets = len({(test.rig, test.data_set) for test in tests})
    print(f"{data_sets} data sets, {len(tests)} tests")
    in_use = read_answer_model()
    print(f"coefficients in use, fitted to {in_use.sets} tests")
    print(_confusion(tests, [in_use.answers(test.evidence) for test in tests]))
    print(f"fitted to the other rigs, penalty 1 / {best:g}")
    print(_confusion(tests, left_out(tests, best)))
    write_answer_tests(tests)
    if args.write:
        fitted = msgspec.json.encode(fitted_model(tests, best))
        PATH.write_bytes(msgspec.json.format(fitted, indent=1))


def _confusion(tests: Sequence[AnswerTest], answers: Sequence[Answers]) -> str:
    """Loss, and table of the true answer by the likeliest one."""
    count = {(true, said): 0 for true in ANSWERS for said in ANSWERS}
    for test, own in zip(tests, answers, strict=True):
        count[test.answer, max(ANSWERS, key=lambda a: getattr(own, a))] += 1
    lines = [f"  loss {loss(tests, answers):.3f}"]
    lines += [
        f"  {true:10s} said to be " + ", ".join(f"{said} {count[true, said]}" for said in ANSWERS)
        for true in ANSWERS
    ]
    return "\n".join(lines)


if __name__ == "__main__":
    main()
