"""Decisions on whole data sets, from the probabilities of their tests.

In one data set several sets of effects are judged, and the largest that is believed is named
(`models.gap.decision.decision`). A name that is wrong costs more than one that is not given
(`models.gap.decision.answers.WRONG_NAME_COST`).
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from typing import Final, Literal

from models.gap.decision.answers import WRONG_NAME_COST, Answers, set_order
from models.gap.training.answer_tests import KIND_WEIGHT, AnswerTest
from models.gap.training.cases import Kind

Outcome = Literal["right name", "wrong name", "nothing", "outside"]

WANTED: Final[dict[Kind, Outcome]] = {
    "single": "right name", "pair": "right name", "null": "nothing", "outside": "outside",
}  # fmt: skip

Decisions = Sequence[tuple[AnswerTest, Outcome]]
"""Of each data set its first test, for its kind, and what was decided."""


def whole_decisions(
    names: Mapping[AnswerTest, float], outside: Mapping[AnswerTest, float]
) -> Decisions:
    """Decision on each data set.

    `outside`: probability of something outside of the catalogue where these are wrong; 0 for a test
    that is missing here.
    """
    tests: dict[tuple[str, int], list[AnswerTest]] = defaultdict(list)
    for test in names:
        tests[test.rig, test.data_set].append(test)
    found: list[tuple[AnswerTest, Outcome]] = []
    for own in tests.values():
        answers = {test: _answers(names[test], outside.get(test, 0.0)) for test in own}
        believed = {test: bool(test.effects) and answers[test].is_believed for test in own}
        best = max(own, key=lambda t: set_order(len(t.effects), believed[t], names[t]))
        if believed[best]:
            found.append((own[0], "right name" if best.answer == "catalogue" else "wrong name"))
        else:
            found.append((own[0], "outside" if answers[best].is_outside else "nothing"))
    return found


def _answers(names: float, outside: float) -> Answers:
    """From the probability of the names, and that of something outside where they are wrong."""
    return Answers((1 - names) * (1 - outside), names, (1 - names) * outside)


def mean_cost(decisions: Decisions) -> float:
    """Mean cost of the decisions, where each kind has the weight of what users bring."""
    of = Counter(test.kind for test, _ in decisions)
    cost: dict[Kind, float] = defaultdict(float)
    for test, outcome in decisions:
        if outcome != WANTED[test.kind]:
            cost[test.kind] += WRONG_NAME_COST if outcome == "wrong name" else 1.0
    whole = sum(KIND_WEIGHT[kind] for kind in of)
    return sum(KIND_WEIGHT[kind] * cost[kind] / count / whole for kind, count in of.items())


def decisions_table(decisions: Decisions) -> str:
    """Outcomes by kind of data set and link, one kind a line."""
    counts: dict[tuple[str, str], Counter[Outcome]] = defaultdict(Counter)
    for test, outcome in decisions:
        counts["link unchanged" if test.same_link else "link changed", test.kind][outcome] += 1
    return "\n".join(
        f"  {link}, {kind}, {own.total()}: "
        + ", ".join(f"{outcome} {count}" for outcome, count in sorted(own.items()))
        for (link, kind), own in sorted(counts.items())
    )
