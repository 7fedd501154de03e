"""Tests of names on rigs for tuning, each with its evidence and the true answer.

`answer_tests.jsonl` holds some, one a line, to try the coefficients in use on them and to fit new
ones (`models.gap.training.answer_model`): the results themselves are large.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Final

import msgspec
from msgspec.structs import replace

from models.gap.decision.answers import Answer
from models.gap.decision.evidence import Evidence
from models.gap.training.cases import Kind

PATH: Final = Path(__file__).with_name("answer_tests.jsonl")

KIND_WEIGHT: Final[dict[Kind, float]] = {
    "single": 0.6, "pair": 0.1, "null": 0.2, "outside": 0.1,
}  # fmt: skip
"""Fraction of each kind of data set: what a user brings [assumed]."""


class AnswerTest(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One test of names."""

    rig: str
    data_set: int  # Seed of the data set's noise: one data set may have several tests
    kind: Kind  # Of the data set
    same_link: bool  # Whether the plant was identified on this link
    effects: tuple[str, ...]  # What the tests left, judged together
    answer: Answer
    evidence: Evidence


def labelled(results: Iterable[dict[str, Any]]) -> list[AnswerTest]:
    """Every test of some results with the true answer.

    Names that are wrong stand in for something else: to these the answer is "outside". Where
    nothing was left to name, an effect of the catalogue may be there all the same. A denied effect
    that the whole catalogue does not tell from its stand-in has no true answer.
    """
    found = []
    for result in results:
        if not result.get("tested") or not result["separable"]:
            continue
        case = result["case"]
        for test in result["tested"]:
            if case["kind"] in ("null", "outside"):
                answer: Answer = "nothing" if case["kind"] == "null" else "outside"
            elif set(test["effects"]) <= set(case["hidden"]) | _alike(result):
                answer = "catalogue"
            else:
                answer = "outside"
            row = AnswerTest(
                rig=case["rig"], data_set=case["seed"], kind=case["kind"],
                same_link=not case["nuisance"], effects=tuple(test["effects"]), answer=answer,
                evidence=Evidence(**test["evidence"]),
            )  # fmt: skip
            found.append(row)
    return found


def weights(tests: Sequence[AnswerTest]) -> list[float]:
    """Weight of each test; they add up to one.

    Data sets of one kind share the weight of the kind, tests of one data set that of the set.
    """
    of_set = Counter((t.rig, t.data_set) for t in tests)
    sets = Counter(kind for _, kind in {((t.rig, t.data_set), t.kind) for t in tests})
    whole = sum(KIND_WEIGHT[kind] for kind in sets)
    return [KIND_WEIGHT[t.kind] / whole / sets[t.kind] / of_set[t.rig, t.data_set] for t in tests]


def with_new(known: Sequence[AnswerTest], new: Sequence[AnswerTest]) -> list[AnswerTest]:
    """Known tests and new ones; those of a data set that was diagnosed again are replaced."""
    again = {(t.rig, t.data_set) for t in new}
    return [*(t for t in known if (t.rig, t.data_set) not in again), *new]


def with_left(tests: Sequence[AnswerTest]) -> list[AnswerTest]:
    """Tests with what was left beside the names, where it was not recorded the mean of the rest.

    Where nothing was named all of the gap was left.
    """
    known = [t.evidence.left for t in tests if t.effects and t.evidence.left is not None]
    mean = sum(known) / max(len(known), 1)
    found = []
    for test in tests:
        own = test.evidence
        if own.left is None:
            own = replace(own, left=mean if test.effects else own.gap)
        found.append(replace(test, evidence=own))
    return found


def read_answer_tests() -> list[AnswerTest]:
    """Tests of the table."""
    return msgspec.json.Decoder(AnswerTest).decode_lines(PATH.read_bytes())


def write_answer_tests(tests: Sequence[AnswerTest]) -> None:
    """Replace the table."""
    ordered = sorted(tests, key=lambda t: (t.rig, t.data_set))
    PATH.write_bytes(msgspec.json.Encoder().encode_lines(ordered))


def _alike(result: dict[str, Any]) -> set[str]:
    """Hidden effects that a result declares to be look-alikes of what it names, and those names.

    A declared look-alike of a hidden effect is a right name.
    """
    declared = {e for turn in result["look_alikes"] for names in turn for e in names}
    return set(result["named"]) if declared & set(result["case"]["hidden"]) else set()
