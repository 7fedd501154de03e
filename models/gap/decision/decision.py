"""Decision on a search: the named effects, the verdict, and the alternatives to a failed choice.

The evidence for the effects that pass the tests gives the probability that they are what is
missing, that nothing is, or that something outside of the catalogue is
(`models.gap.decision.answers`); a set is accepted if it is probable enough to be named. If the
tests on held-out errors take out one of several effects, the whole set is judged as well. If no set
is accepted, each effect is left out in turn; if one is and a further effect would explain more, so
are both together. The largest accepted set is named. Several effects often explain a gap almost
equally well: if a test refuses the first choice, or its strength is not the same everywhere, or it
is not accepted and has look-alikes, the search is repeated from its first round without it. If no
alternative is accepted either, the decision on the first choice stands.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import msgspec

from models.gap.decision.acceptance import Acceptance
from models.gap.decision.accepted_fit import AcceptedFit
from models.gap.decision.answers import (
    CATALOGUE_ONLY,
    AnswerModel,
    Answers,
    read_answer_model,
    set_order,
)
from models.gap.decision.evidence import Evidence, consistencies_of_named, evidence_of
from models.gap.decision.further_effect import FurtherEffect, further_effect_of
from models.gap.decision.gap_verdict import GapVerdict, gap_left_fraction, gap_verdict
from models.gap.decision.look_alikes import look_alikes_of
from models.gap.search.candidate import SearchResult
from models.gap.search.effect_search import EffectSearch
from models.gap.search.refused_effect import RefusalKind, RefusedEffect
from models.gap.search.strength_consistency import StrengthConsistency

OF_THE_EFFECT: Final[frozenset[RefusalKind]] = frozenset(
    {"at a bound", "impossible", "held-out error", "rise of a signal"}
)
"""Refusals that are evidence against one effect, not against every effect of the catalogue."""


@dataclass(frozen=True)
class JudgedNames:
    """Effects that passed the tests together, their evidence and the probabilities from it."""

    effects: tuple[str, ...]  # Names; empty if none passed
    evidence: Evidence
    answers: Answers  # Probabilities of the answers
    further: FurtherEffect | None = None  # Effect that would explain most beside them


@dataclass(frozen=True)
class JudgedAcceptance:
    """Tests of a result, with their outcome and its evidence."""

    acceptance: Acceptance
    accepted: AcceptedFit  # Best fit that may be written
    consistencies: Mapping[str, StrengthConsistency]  # Of the effects that passed the tests
    tested: JudgedNames
    believed: bool  # Whether these effects are probable enough to be named

    @property
    def is_biased(self) -> bool:
        """Whether all trials share a nuisance bias beside these effects."""
        return bool(self.acceptance.search.nuisance_bias(self.acceptance.result.after))

    @property
    def order(self) -> tuple[int, float]:
        return set_order(len(self.tested.effects), self.believed, self.tested.answers.catalogue)


@dataclass(frozen=True)
class Decision:
    """Outcome of the tests of one search."""

    result: SearchResult  # Result of the search; `named` holds what was accepted
    accepted: AcceptedFit  # Fit that the improved plant is written from
    failed: RefusedEffect | None  # Test on held-out errors that the last effect failed
    consistencies: Mapping[str, StrengthConsistency]  # Of the effects that passed the tests
    # Sets of effects that were judged, refused alternatives first; the last one led to the verdict
    tested: tuple[JudgedNames, ...]
    verdict: GapVerdict
    gap_left_fraction: float  # Fraction of the gap's amplitude that remains

    @property
    def answers(self) -> Answers:
        """Probabilities that led to the verdict."""
        return self.tested[-1].answers

    def withheld(self) -> list[RefusedEffect]:
        """Refusal of the effect that failed, or of its plant alone if the effect is still named."""
        if self.failed is None:
            return []
        kind = "not written" if self.result.named else self.failed.kind
        return [msgspec.structs.replace(self.failed, kind=kind)]


def decide(search: EffectSearch, result: SearchResult) -> Decision:
    """Decision on a search and, if its first choice was refused, on its alternatives."""
    model = read_answer_model()
    decisions = [_decision(search, result, model)]
    excluded: set[str] = set()
    for _ in range(search.settings.most_alternatives):
        if not search.learned or not _leaves_room(decisions[-1], excluded):
            break
        excluded |= set(decisions[-1].result.chosen[0].effects)
        decisions.append(_decision(search, search.search_without(result, excluded), model))
    kept = decisions[-1] if decisions[-1].result.named else decisions[0]
    others = [d for d in decisions if d is not kept]
    named = set(kept.result.named)
    kept.result.refused = [
        row
        for d in decisions
        for row in (*d.result.refused, *d.withheld())
        if d is kept or not set(row.effect.split(" + ")) <= named  # refused alone, named beside
    ]
    return replace(kept, tested=(*(t for d in others for t in d.tested), *kept.tested))


def _decision(search: EffectSearch, result: SearchResult, model: AnswerModel) -> Decision:
    judged = _judged_sets(Acceptance(search, result), model)
    kept, tested = judged[-1], tuple(j.tested for j in judged)
    result, answers, accepted = kept.acceptance.result, kept.tested.answers, kept.accepted
    own = kept.consistencies, answers, kept.tested.further, kept.believed
    verdict, left = gap_verdict(search, result, *own), 1.0
    if result.named:
        left = gap_left_fraction(search, result)
        if search.learned and not kept.believed:
            accepted = kept.acceptance.without_named(accepted, answers)
    if not result.named:
        left = float(verdict != "no gap")
        if search.learned and verdict == "no gap" and not search.settings.same_link:
            accepted = kept.acceptance.changed_link()
    failed, consistencies = kept.acceptance.withheld, kept.consistencies
    return Decision(result, accepted, failed, consistencies, tested, verdict, left)


def _judged_sets(acceptance: Acceptance, model: AnswerModel) -> list[JudgedAcceptance]:
    """Sets of the effects of a search with their outcome; the largest accepted one is last.

    All effects together come first. If that set is not accepted, each effect is left out in turn,
    then again from the most probable rest. Of the accepted sets the largest counts, because fewer
    effects are always more probable. If none is accepted, the tests may have taken out the right
    effect: the same begins with all effects, and a rest with one that was taken out counts if it
    fits the trials better than the effects that passed. If a further effect would explain more
    beside the accepted ones, both together are judged last; without a learned noise floor no
    evidence would separate them from the rest.
    """
    found = _judged_both(acceptance, model)
    first = found[0].acceptance.copy()
    left = set(first.result.named)
    for whole in (first, acceptance):
        while len(whole.result.named) > 1 and not any(j.believed for j in found):
            rests = [whole.without(e) for e in whole.result.named]
            judged = [_judged_both(rest, model) for rest in rests]
            orders = [max(row.order for row in rows) for rows in judged]
            whole = max(zip(orders, rests, strict=True), key=lambda row: row[0])[1]
            for row in (row for rows in judged for row in rows):
                result = row.acceptance.result
                if set(result.named) <= left or result.after.cost < first.result.after.cost:
                    found += _unknown(found, [row])
    found = [_with_bias_explained(row, found) for row in found]
    best = max(found, key=lambda j: j.order)
    further = best.tested.further if acceptance.search.learned and best.believed else None
    if further is not None and further.is_missing:
        more = best.acceptance.with_further(further.effect)
        found += _unknown(found, _judged_both(more, model))
        best = max(found, key=lambda j: j.order)
    return [*(j for j in found if j is not best), best]


def _with_bias_explained(
    row: JudgedAcceptance, found: Sequence[JudgedAcceptance]
) -> JudgedAcceptance:
    """Outcome for a set of effects that removes a nuisance bias which it has without one of them.

    Then something is certainly missing beside the rest, so the set gets the probability of the rest
    if its own evidence is weaker.
    """
    if row.is_biased:
        return row
    names = set(row.tested.effects)
    rests = [
        j for j in found
        if j.is_biased and 0 < len(j.tested.effects) == len(names) - 1
        and set(j.tested.effects) < names
    ]  # fmt: skip
    best = max([row, *rests], key=lambda j: j.tested.answers.catalogue)
    tested = replace(row.tested, answers=best.tested.answers)
    return replace(row, tested=tested, believed=bool(names) and tested.answers.is_believed)


def _unknown(
    found: Sequence[JudgedAcceptance], rows: Sequence[JudgedAcceptance]
) -> list[JudgedAcceptance]:
    """Rows whose effects were not judged together before."""
    known = {j.tested.effects for j in found}
    return [row for row in rows if row.tested.effects not in known]


def _judged_both(acceptance: Acceptance, model: AnswerModel) -> list[JudgedAcceptance]:
    """Outcome of a result as tested, and with the effects that only held-out errors refuse.

    The diagnosed plant may have compensated for such an effect, so the evidence decides on it. The
    effects that passed all tests are written.
    """
    passed, whole = _judged(acceptance.copy(), model), acceptance.copy()
    left = passed.tested.effects
    if len(left) == len(whole.result.named) or not whole.search.learned:
        return [passed]
    whole.keeps_named = True
    judged = _judged(whole, model)
    if whole.withheld is None or judged.tested.effects == left:
        return [passed]
    names = " + ".join(e for e in judged.tested.effects if e not in left)
    whole.withheld = msgspec.structs.replace(whole.withheld, effect=names)
    return [passed, replace(judged, accepted=passed.accepted)]


def _judged(acceptance: Acceptance, model: AnswerModel) -> JudgedAcceptance:
    """Test a result, and judge the effects that pass by their evidence.

    A nuisance bias beyond its limit excludes the answer "nothing": no set that the regressions were
    fitted to has one with an ordinary residual.
    """
    accepted, search, result = acceptance.accepted(), acceptance.search, acceptance.result
    consistencies = consistencies_of_named(search, result)
    further = further_effect_of(search, result)
    evidence = evidence_of(search, result, consistencies, acceptance.judged.errors, further)
    answers = model.answers(evidence, result.named) if search.learned else CATALOGUE_ONLY
    if search.nuisance_bias(result.after):
        answers = answers.without_nothing()
    tested = JudgedNames(tuple(result.named), evidence, answers, further)
    believed = bool(result.named) and answers.is_believed
    return JudgedAcceptance(acceptance, accepted, consistencies, tested, believed)


def _leaves_room(decision: Decision, excluded: set[str]) -> bool:
    """Whether another first choice may be accepted.

    It may if the tests are evidence against this choice itself, or if these trials do not separate
    it from one that was not chosen yet.
    """
    result = decision.result
    if result.named or not result.chosen:
        return False
    if any(not set(alike.effects) & excluded for alike in look_alikes_of(result, 0)):
        return True
    if any(not c.holds for c in decision.consistencies.values()):
        return True
    effects = set(result.chosen[0].effects)
    rows = [r for r in (*result.refused, *decision.withheld()) if r.kind in OF_THE_EFFECT]
    return any(set(r.effect.split(" + ")) & effects for r in rows)
