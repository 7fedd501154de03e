"""Decision on a search: what is accepted, its verdict, and what is named in place of what fails.

Several effects often explain a gap almost equally well. Where the best one is refused, because its
value ends at a bound, because it does not lower the held-out error, or because its strength is not
the same everywhere, another may pass every test: the search goes on from its first round without
what was refused. Where none passes, the decision on the first one stands. Nothing is named where
the posterior says that more probably nothing is missing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from models.gap.decision.acceptance import Acceptance
from models.gap.decision.accepted_fit import AcceptedFit
from models.gap.decision.gap_verdict import (
    GapVerdict,
    certain_effects,
    consistencies_of_named,
    gap_verdict,
)
from models.gap.decision.posterior import Hypothesis
from models.gap.search.candidate import SearchResult
from models.gap.search.effect_search import EffectSearch
from models.gap.search.refused_effect import RefusalKind
from models.gap.search.strength_consistency import StrengthConsistency

OF_THE_EFFECT: Final[frozenset[RefusalKind]] = frozenset(
    {"at a bound", "impossible", "held-out error", "rise of a signal"}
)
"""Refusals that speak against one effect, not against every effect of the catalogue."""


@dataclass(frozen=True)
class Decision:
    """Outcome of the tests of one search.

    Attributes
    ----------
    result : SearchResult
        Of the search; `named` holds what was accepted.
    accepted : AcceptedFit
        Fit that the improved plant is written from.
    consistencies : dict of str to StrengthConsistency
        Of the effects that the tests left.
    verdict : str
        See `models.gap.decision.gap_verdict.GapVerdict`.
    gap_left_fraction : float
        Fraction of the gap's amplitude that is left.
    """

    result: SearchResult
    accepted: AcceptedFit
    consistencies: Mapping[str, StrengthConsistency]
    verdict: GapVerdict
    gap_left_fraction: float


def decide(
    search: EffectSearch, result: SearchResult, hypotheses: Sequence[Hypothesis]
) -> Decision:
    """Decision on a search and, where its first choice was refused, on its alternatives.

    Parameters
    ----------
    search : EffectSearch
        After its run.
    result : SearchResult
        Of that run.
    hypotheses : sequence of Hypothesis
        Of that run: no effect is named where "nothing is missing" is likelier than all others.
    """
    nothing = sum(h.probability for h in hypotheses if not h.effects)
    first = decision = _decision(search, result, nothing)
    excluded: set[str] = set()
    for _ in range(search.settings.most_alternatives):
        if not search.learned or not _first_choice_refused(decision):
            break
        excluded |= set(decision.result.chosen[0].effects)
        decision = _decision(search, search.search_without(result, excluded), nothing)
        refused = [*first.result.refused, *decision.result.refused]
        if decision.result.named:
            decision.result.refused = refused
            return decision
        first.result.refused = refused
    return first


def _decision(search: EffectSearch, result: SearchResult, nothing: float) -> Decision:
    acceptance = Acceptance(search, result)
    tested = _tested(search, result, acceptance, acceptance.accepted())
    if tested.verdict == "not in the catalogue":
        certain = certain_effects(search, result, tested.consistencies)
        if certain and len(certain) < len(result.named):
            tested = _tested(search, result, acceptance, acceptance.with_certain_only(certain))
    accepted, verdict, left = tested.accepted, tested.verdict, tested.gap_left_fraction
    if verdict in ("not in the catalogue", "no gap"):
        accepted = acceptance.without_stand_ins(accepted, verdict)
        left = left if result.named else float(verdict != "no gap")
    if result.named and nothing > search.settings.nothing_limit_probability:
        accepted = acceptance.without_improbable(nothing)
        verdict, left = gap_verdict(search, result, {})
    return Decision(result, accepted, tested.consistencies, verdict, left)


def _tested(
    search: EffectSearch, result: SearchResult, acceptance: Acceptance, accepted: AcceptedFit
) -> Decision:
    """Decision on what was accepted, by its strengths and by what is left."""
    consistencies = consistencies_of_named(search, result)
    held_out_left = acceptance.held_out_left(accepted)
    verdict, left = gap_verdict(search, result, consistencies, held_out_left)
    return Decision(result, accepted, consistencies, verdict, left)


def _first_choice_refused(decision: Decision) -> bool:
    """Whether the tests speak against the first choice itself, and nothing else is named."""
    result = decision.result
    if result.named or not result.chosen:
        return False
    effects = set(result.chosen[0].effects)
    if any(not c.holds for e, c in decision.consistencies.items() if e in effects):
        return True
    return any(
        r.kind in OF_THE_EFFECT and set(r.effect.split(" + ")) & effects for r in result.refused
    )
