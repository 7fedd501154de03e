"""Odds that trials of two joints add to the answers, all else held.

    python -m bench.gap.calibration.two_joint_odds build/tuning_two_joints --write

Few tests are of two joints, so the regressions of `bench.gap.calibration.answer_model` are fitted
to those of one joint and of two alike. Where the noise floor has no patterns of the plant's own
error the same evidence may say more or less: one number for each question, by largest likelihood
and drawn towards 0. Printed is how the odds in use and the new ones do, the latter on each rig when
that rig is left out. Run it again after `answer_model --write`. No rig for tests may be among them.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import msgspec
import numpy as np
from scipy.optimize import minimize_scalar
from scipy.special import expit, logit

from bench.gap.bench_kind import bench_results
from bench.gap.calibration.answer_model import (
    OF_A_GAP_ASKED,
    OF_NAMES_ASKED,
    Question,
    loss,
)
from bench.gap.calibration.answer_tests import (
    AnswerTest,
    labelled,
    read_answer_tests,
    weights,
    with_new,
    write_answer_tests,
)
from models.gap.decision.answers import PATH, Regression, read_answer_model
from models.rig.drawn_rig import rig_purpose

NAME: Final = "two_joints"
"""Evidence whose coefficient is fitted."""

PRIOR_DEVIATION: Final = 1.0
"""Standard deviation of the number that is fitted, before any test [assumed]."""


def fitted_odds(
    tests: Sequence[AnswerTest], question: Question, regression: Regression
) -> Regression:
    """Regression with what two joints add to the odds.

    Parameters
    ----------
    tests : sequence of AnswerTest
        Of two joints, of any kinds.
    question : Question
        What is asked.
    regression : Regression
        Of all other evidence.
    """
    rows = question.rows(tests)
    base = _with_added(regression, 0.0)
    log_odds = logit([base.probability(t.evidence, t.effects) for t in rows])
    true = np.array([t.answer == question.answer for t in rows])
    count = len(rows) * np.array(weights(rows))

    def cost(added: float) -> float:
        right = np.where(true, expit(log_odds + added), expit(-log_odds - added))
        return float(-count @ np.log(right)) + (added / PRIOR_DEVIATION) ** 2 / 2

    found = minimize_scalar(cost, bounds=(-5.0, 5.0), method="bounded")
    return _with_added(regression, round(float(found.x), 4))


def left_out_odds(
    tests: Sequence[AnswerTest], question: Question, regression: Regression
) -> list[float]:
    """Probability of the answer in each test that counts, by odds fitted without its rig.

    The parameters are those of `fitted_odds`.
    """
    rows = question.rows(tests)
    models = {
        rig: fitted_odds([t for t in rows if t.rig != rig], question, regression)
        for rig in {t.rig for t in rows}
    }
    return [models[t.rig].probability(t.evidence, t.effects) for t in rows]


def main() -> None:
    """Fit, and say how good it is."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("runs", type=Path, nargs="*", help="directories of bench.gap --out")
    parser.add_argument("--write", action="store_true", help="use the new odds")
    args = parser.parse_args()
    new = labelled(r for run in args.runs for r in bench_results(run).values())
    tests = with_new(read_answer_tests(), new)
    for rig in sorted({test.rig for test in tests}):
        if rig_purpose(rig) == "test":
            parser.error(f"{rig} is for tests: nothing is set on it")
    two = [t for t in tests if t.evidence.two_joints]
    model = read_answer_model()
    found = {}
    for question, regression in (
        (OF_NAMES_ASKED, model.catalogue), (OF_A_GAP_ASKED, model.outside),
    ):  # fmt: skip
        found[question.answer] = fitted_odds(two, question, regression)
        print(_told(two, question, regression, found[question.answer]))
    write_answer_tests(tests)
    if args.write:
        model = msgspec.structs.replace(model, **found)
        PATH.write_bytes(msgspec.json.format(msgspec.json.encode(model), indent=1))


def _with_added(regression: Regression, added: float) -> Regression:
    """Regression with another number for two joints."""
    coefficient = {**regression.coefficient, NAME: added}
    return msgspec.structs.replace(regression, coefficient=coefficient)


def _told(
    tests: Sequence[AnswerTest], question: Question, in_use: Regression, new: Regression
) -> str:
    """Losses of the odds in use and of new ones on rigs left out, in words."""
    rows = question.rows(tests)
    known = [in_use.probability(t.evidence, t.effects) for t in rows]
    said = left_out_odds(tests, question, in_use)
    sets = len({(t.rig, t.data_set) for t in rows})
    return (
        f"{question.answer}, {len(rows)} tests in {sets} data sets of "
        f"{len({t.rig for t in rows})} rigs: two joints add {new.coefficient[NAME]:+.2f} to the "
        f"log odds; loss {loss(tests, question, known):.3f} in use, "
        f"{loss(tests, question, said):.3f} each rig left out"
    )


if __name__ == "__main__":
    main()
