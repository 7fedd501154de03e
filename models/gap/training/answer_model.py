"""Probabilities of the answers to what is missing, fitted to diagnoses of rigs for tuning.

    python -m models.gap.training cases --rigs drawn_118 … --same-link --out build/tuning_same
    python -m models.gap.training answers build/tuning_same …

Each result tells what its diagnosis judged and with which evidence
(`models.gap.decision.evidence`), and what was hidden. The tests of the runs are added to those in
`answer_tests.jsonl`; of a data set that is there already the new ones count. Two logistic
regressions of the truth on the evidence give the probabilities. Extreme evidence is rare and proves
no more than usual one: all but d′ and residuals counts within bounds. Effects that often stand
in for others are believed less. Printed is how the coefficients in use do on the tests, how new
ones do on each rig when that rig is left out, and what is decided on whole data sets then
(`models.gap.training.whole_decisions`). With --write the new ones replace those in use
(`models/gap/decision/answers.json`). No rig for testing may be among them.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, get_args

import msgspec
import numpy as np
from sklearn.linear_model import LogisticRegression
from sklearn.preprocessing import StandardScaler

from models.gap.decision.answers import (
    OF_A_GAP,
    OF_NAMES,
    PATH,
    Answer,
    AnswerModel,
    Regression,
    read_answer_model,
)
from models.gap.training.answer_tests import (
    AnswerTest,
    labelled,
    read_answer_tests,
    weights,
    with_left,
    with_new,
    write_answer_tests,
)
from models.gap.training.case_runs import case_results
from models.gap.training.cases import Kind
from models.gap.training.whole_decisions import (
    decisions_table,
    mean_cost,
    whole_decisions,
)
from models.rig.drawn import rig_purpose

INVERSE_PENALTIES: Final = (0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0)
"""Of a regression's coefficients; the one with the least loss on rigs left out is taken."""

TAILS: Final = (0.0, 0.1, 0.2)
"""Fractions of the tests on either side whose evidence counts as no more extreme than that of the
rest; the one with the least loss on rigs left out is taken."""

EVEN: Final = 0.5
"""Probability beyond which an answer counts as said in the table that is printed."""

WITHOUT_BOUNDS: Final = ("named", "beyond_one", "left", "clearness", "servo", "tip")
"""Evidence that counts in full: however large d′ or the residual of a signal is, a larger one is
less likely noise, and the more a stand-in leaves, the less it is what is missing."""


@dataclass(frozen=True)
class Question:
    """What one regression answers."""

    answer: Answer  # Its probability is fitted
    names: tuple[str, ...]  # Evidence that it is fitted to
    kinds: tuple[Kind, ...]  # Data sets that count

    def rows(self, tests: Sequence[AnswerTest]) -> list[AnswerTest]:
        """Tests that count, where all evidence was measured."""
        return [
            test
            for test in tests
            if test.kind in self.kinds
            and all(getattr(test.evidence, name) is not None for name in self.names)
        ]


OF_NAMES_ASKED: Final = Question("catalogue", OF_NAMES, get_args(Kind))
OF_A_GAP_ASKED: Final = Question("outside", OF_A_GAP, ("null", "outside"))
"""Something outside is told from nothing by the data sets that hide nothing, or an effect that the
catalogue lacks: a wrong name for one that it has tells nothing of these."""


@dataclass(frozen=True)
class Regularisation:
    """What holds a regression back where tests are few."""

    inverse_penalty: float = 1.0  # Of the coefficients of standardised evidence
    # Fraction of the tests beyond either bound of an evidence; without bounds where it is 0
    tail: float = 0.0


REGULARISATIONS: Final = [Regularisation(c, tail) for c in INVERSE_PENALTIES for tail in TAILS]


def bounds(
    rows: Sequence[AnswerTest], question: Question, tail: float
) -> dict[str, tuple[float, float]]:
    """Least and largest value of each evidence that counts.

    They are quantiles of the tests in which the evidence is not 0, which is said where there is
    nothing to tell.
    """
    found = {}
    for name in question.names if tail else ():
        values = [value for test in rows if (value := getattr(test.evidence, name))]
        if name not in WITHOUT_BOUNDS and values:
            low, high = np.quantile(values, [tail, 1 - tail])
            found[name] = (round(float(low), 4), round(float(high), 4))
    return found


def fitted_regression(
    tests: Sequence[AnswerTest], question: Question, regularisation: Regularisation
) -> Regression:
    """Regression of one answer on its evidence; its coefficients are not standardised."""
    rows = question.rows(tests)
    within = bounds(rows, question, regularisation.tail)
    columns = [
        np.clip([getattr(t.evidence, name) for t in rows], *within.get(name, (-np.inf, np.inf)))
        for name in question.names
    ]
    effects = sorted({e for t in rows for e in t.effects})
    share = np.array([[(e in t.effects) / max(len(t.effects), 1) for e in effects] for t in rows])
    weight = np.array(weights(rows))
    scaler, fit = (
        StandardScaler(),
        LogisticRegression(C=regularisation.inverse_penalty, max_iter=2000),
    )
    features = np.hstack([scaler.fit_transform(np.column_stack(columns)), share])
    fit.fit(features, [test.answer == question.answer for test in rows], weight / weight.mean())
    slope, of_effect = np.split(fit.coef_[0], [len(question.names)])
    slope = slope / scaler.scale_
    return Regression(
        intercept=round(float(fit.intercept_[0] - slope @ scaler.mean_), 4),
        coefficient={n: round(float(c), 4) for n, c in zip(question.names, slope, strict=True)},
        bounds=within,
        of_effect={e: round(float(c), 4) for e, c in zip(effects, of_effect, strict=True)},
    )


def left_out(
    tests: Sequence[AnswerTest], question: Question, regularisation: Regularisation
) -> list[float]:
    """Probability of the answer in each test that counts, by a regression without its rig."""
    models = _without_each_rig(tests, question, regularisation)
    return [
        models[test.rig].probability(test.evidence, test.effects) for test in question.rows(tests)
    ]


def _without_each_rig(
    tests: Sequence[AnswerTest], question: Question, regularisation: Regularisation
) -> dict[str, Regression]:
    return {
        rig: fitted_regression([t for t in tests if t.rig != rig], question, regularisation)
        for rig in {test.rig for test in tests}
    }


def loss(tests: Sequence[AnswerTest], question: Question, probabilities: Sequence[float]) -> float:
    """Mean negative logarithm of the probability of what is true."""
    rows = question.rows(tests)
    right = [
        p if test.answer == question.answer else 1 - p
        for test, p in zip(rows, probabilities, strict=True)
    ]
    return float(-np.array(weights(rows)) @ np.log(right))


def fitted(
    tests: Sequence[AnswerTest], question: Question
) -> tuple[Regression, dict[AnswerTest, float]]:
    """Regression with the least loss, and what it says of each test when its rig is left out.

    It says so of data sets of every kind, where the evidence was measured.
    """
    best = min(
        REGULARISATIONS,
        key=lambda r: loss(tests, question, left_out(tests, question, r)),
    )
    models = _without_each_rig(tests, question, best)
    every = replace(question, kinds=get_args(Kind)).rows(tests)
    said = {test: models[test.rig].probability(test.evidence, test.effects) for test in every}
    return fitted_regression(tests, question, best), said


def main(argv: Sequence[str] | None = None) -> int:
    """Fit, say how good it is and how good what is in use is."""
    parser = argparse.ArgumentParser(
        prog="python -m models.gap.training answers",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("runs", type=Path, nargs="*", help="directories of `cases --out`")
    parser.add_argument("--write", action="store_true", help="use the new coefficients")
    args = parser.parse_args(argv)
    table = read_answer_tests()
    for run in args.runs:  # of a data set in several runs the last one counts
        table = with_new(table, labelled(case_results(run).values()))
    tests = with_left(table)
    for rig in sorted({test.rig for test in tests}):
        if rig_purpose(rig) == "test":
            parser.error(f"{rig} is for testing: nothing is set on it")
    data_sets = len({(test.rig, test.data_set) for test in tests})
    print(f"{data_sets} data sets, {len(tests)} tests")
    in_use = read_answer_model()
    names, said_of_names = fitted(tests, OF_NAMES_ASKED)
    gap, said_of_gaps = fitted(tests, OF_A_GAP_ASKED)
    print(_told(tests, OF_NAMES_ASKED, in_use.catalogue, said_of_names))
    print(_told(tests, OF_A_GAP_ASKED, in_use.outside, said_of_gaps))
    decisions = whole_decisions(said_of_names, said_of_gaps)
    print(f"whole decisions on rigs left out: mean cost of a decision {mean_cost(decisions):.3f}")
    print(decisions_table(decisions))
    write_answer_tests(table)
    if args.write:
        model = AnswerModel(sets=len(tests), catalogue=names, outside=gap)
        PATH.write_bytes(msgspec.json.format(msgspec.json.encode(model), indent=1))
    return 0


def _told(
    tests: Sequence[AnswerTest], question: Question, in_use: Regression,
    said: Mapping[AnswerTest, float],
) -> str:  # fmt: skip
    """How the coefficients in use do on a question, and new ones on rigs that are left out."""
    rows = question.rows(tests)
    lines = [f"{question.answer}, {len(rows)} tests"]
    known = [in_use.probability(test.evidence, test.effects) for test in rows]
    for title, own in (("in use", known), ("left out", [said[test] for test in rows])):
        right = [
            test.kind
            for test, p in zip(rows, own, strict=True)
            if (p > EVEN) == (test.answer == question.answer)
        ]
        counts = [
            f"{kind} {right.count(kind)} of {sum(test.kind == kind for test in rows)}"
            for kind in question.kinds
        ]
        lines.append(
            f"  {title:8s} loss {loss(tests, question, own):.3f}, right: {', '.join(counts)}"
        )
    return "\n".join(lines)
