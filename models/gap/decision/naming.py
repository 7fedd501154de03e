"""Naming: the set of effects that explains the trials, from the rounds of the search.

With a learned noise floor the set begins with the candidate of the largest d′ after its refit. A
larger set takes its place if the d′ that it adds exceeds the root of the sum of two squares, what
is reached where nothing is missing and a fraction of the d′ so far, the error of an equation, and
if every strength is the same in all parts of the trials. Beside sets that add one candidate pairs
are tried, since two effects may look like a third. The largest of these sets that is more probably
what is missing than not is named (`models.gap.decision.certainty`). A set of several must also
leave nothing of the gap, or what it adds to the one before must itself be more probable than not.

Without one the spectrum of the residual takes its place, which holds the gap itself. Then every
effect that stands out from it competes by the error on what was left out
(`models.gap.search.held_out`), and further ones are fitted in SI units.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

from models.gap.decision.certainty import Answers, Certainty, Evidence, Knowledge, knowledge_of
from models.gap.estimation.gauss_newton import GaussNewton
from models.gap.estimation.nuisance_fit import LEAST_GAP, NuisanceFit
from models.gap.search.effect_search import EffectSearch, SetFit
from models.gap.search.held_out import HeldOut, flattened, lowers_held_out_error
from models.gap.search.strength_consistency import strength_difference

MOST_NAMED: Final = 3
"""Most effects of one diagnosis [assumed]."""
NAMED_PROBABILITY: Final = 0.5
"""Probability from which an effect is named."""
LARGEST_DIFFERENCE: Final = 0.2
"""Fraction by which the strengths of several effects may differ between parts of the trials. Of 31
right names on rigs for tuning 29 stayed below 0.13, encoder ripple reached 0.21."""
LEAST_WITHOUT_FLOOR: Final = 5.0
"""Least d′ of a named effect where the residual's own spectrum is the floor [assumed]."""


@dataclass(frozen=True)
class Naming:
    """Named set, and the sets that it was chosen from."""

    fit: SetFit  # Named set; the fit of the nuisance where none is named
    best: SetFit  # Named set, or the candidate with the largest d′ where none is named
    rounds: tuple[tuple[SetFit, ...], ...]  # Sets of each round, the largest d′ first
    search: EffectSearch  # Search of the last round, with its estimator
    evidence: Evidence  # Of `best`
    answers: Answers | None  # None without a learned noise floor
    # With one: the sets that grew from the first name, whether named or not, the smallest first
    grown: tuple[SetFit, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        return self.fit.candidates

    @property
    def is_learned(self) -> bool:
        """Whether the noise floor was measured on repetitions."""
        return self.search.estimator.floor.learned

    @property
    def explored(self) -> list[SetFit]:
        """Best fit of each set against the floor of the last round, the largest d′ first."""
        best_of: dict[frozenset[str], SetFit] = {}
        fits = [f for r in self.rounds for f in r] + [self.best]
        for fit in sorted(fits, key=lambda f: f.gain):
            best_of[frozenset(fit.candidates)] = fit
        best_of.pop(frozenset(), None)
        return sorted(best_of.values(), key=lambda f: -f.gain)


def name_with_floor(search: EffectSearch, certainty: Certainty, equation_error: float) -> Naming:
    """Set that is named against a learned noise floor.

    `equation_error`: fraction of its d′ that the equation of an effect may miss.
    """
    rounds = [search.beside(search.nothing)]

    def knowledge(fit: SetFit) -> Knowledge:
        return knowledge_of(search.estimator, fit.point)

    def least(fit: SetFit) -> float:
        return certainty.separation_of_nothing[knowledge(fit)]

    def is_probable(fit: SetFit, smaller: SetFit) -> bool:
        evidence = evidence_of(search, fit, smaller, equation_error)
        answers = certainty.answers_for(evidence, knowledge(fit), bool(smaller.candidates))
        return answers.catalogue >= NAMED_PROBABILITY

    def is_supported(fit: SetFit, smaller: SetFit) -> bool:
        if not is_probable(fit, search.nothing):
            return False
        is_first = not smaller.candidates
        leaves_nothing = search.estimator.mean_square(fit.point) < LEAST_GAP
        return is_first or leaves_nothing or is_probable(fit, smaller)

    grown = [search.settled(next(iter(rounds[0]), search.nothing))]
    while least(grown[-1]) < grown[-1].separation and len(grown[-1].candidates) < MOST_NAMED:
        fit = grown[-1]
        error = equation_error * fit.separation
        # The least that can be enough: with a larger set the link may prove to be the same
        added = math.hypot(certainty.separation_of_nothing["identified"], error)
        larger = search.beside(fit, added)
        if len(fit.candidates) == 1:  # two effects may look like a third
            larger = ranked(larger + search.pairs(fit.gain + added**2 / 2))
        rounds.append(larger)
        grown[-1], more = _grown(search, fit, larger, least, error)
        if more is None:
            break
        grown.append(search.settled(more))
    steps = itertools.pairwise([search.nothing, *grown])
    supported = [fit for smaller, fit in steps if is_supported(fit, smaller)]
    named = supported[-1] if supported else search.nothing
    best = named if supported else grown[0]
    of_best = evidence_of(search, best)
    answers = certainty.answers_for(of_best, knowledge(best))
    explored = tuple(map(tuple, rounds))
    return Naming(named, best, explored, search, of_best, answers, tuple(grown))


def name_without_floor(search: EffectSearch) -> Naming:
    """Set that is named by the errors on what was left out."""
    held_out = HeldOut(search.estimator)
    fit, rounds = search.nothing, []
    while len(fit.candidates) < MOST_NAMED:
        larger = search.beside(fit)
        better = _least_held_out(search, held_out, fit, larger)
        rounds.append(tuple(larger))
        if better is None:
            break
        if not fit.candidates:
            search, better = _in_si_units(search, better)
            held_out, rounds = HeldOut(search.estimator), [(better,)]
        fit = better
    best = fit if fit.candidates else next(iter(rounds[0]), fit)
    return Naming(fit, best, tuple(rounds), search, evidence_of(search, best), None)


def evidence_of(
    search: EffectSearch,
    fit: SetFit,
    smaller: SetFit | None = None,
    equation_error: float = 0.0,
) -> Evidence:
    """Numbers that a probability follows from, of a set or of what it adds to a smaller one.

    `equation_error`: fraction of the d′ of the smaller set that its equations may miss.
    """
    smaller = smaller or search.nothing
    added = 2 * (fit.gain - smaller.gain) - (equation_error * smaller.separation) ** 2
    return Evidence(
        separation=math.sqrt(max(added, 0.0)),
        difference=_difference(search, fit),
        residual=search.estimator.mean_square(fit.point),
    )


def ranked(sets: Sequence[SetFit]) -> list[SetFit]:
    return sorted(sets, key=lambda f: -f.gain)


def _grown(
    search: EffectSearch,
    fit: SetFit,
    larger: Sequence[SetFit],
    least: Callable[[SetFit], float],
    error: float,
) -> tuple[SetFit, SetFit | None]:
    """The set, and the first larger one that adds enough d′ at strengths that are the same
    everywhere.

    A larger set may only lead to a better fit of the same candidates, which then takes its place.
    `least`: d′ that a set reaches where nothing is missing. `error`: d′ that the equations of the
    set so far may miss.
    """

    def adds(other: SetFit) -> bool:
        return 2 * (other.gain - fit.gain) > least(other) ** 2 + error**2

    for other in larger:
        if adds(other) and set(fit.candidates) < set(other.candidates):
            fit = search.settled(fit, other)
        if adds(other) and _difference(search, other) <= LARGEST_DIFFERENCE:
            return fit, other
    return fit, None


def _difference(search: EffectSearch, fit: SetFit) -> float:
    """Largest difference of the strength of one of the effects."""
    return max(
        (
            strength_difference(search.estimator, fit.point, fit.free, search.of[name])
            for name in fit.candidates
        ),
        default=0.0,
    )


def _least_held_out(
    search: EffectSearch, held_out: HeldOut, fit: SetFit, sets: Sequence[SetFit]
) -> SetFit | None:
    """Set of the least held-out error, of those that stand out and lower it by more than chance."""
    without = held_out.errors(fit.point, fit.free)
    passed: list[tuple[float, SetFit]] = []
    for larger in sets:
        left = 1.0 if fit.candidates else max(search.estimator.mean_square(larger.point), 1.0)
        if 2 * (larger.gain - fit.gain) > left * LEAST_WITHOUT_FLOOR**2 and (
            not fit.candidates or _difference(search, larger) <= LARGEST_DIFFERENCE
        ):
            errors = held_out.errors(larger.point, larger.free)
            if lowers_held_out_error(errors, without, bool(fit.candidates)):
                passed.append((errors.fraction_of(held_out.baseline), larger))
    return min(passed, key=lambda row: row[0])[1] if passed else None


def _in_si_units(search: EffectSearch, fit: SetFit) -> tuple[EffectSearch, SetFit]:
    """Search and fit against a floor that is equal at all frequencies.

    The spectrum of the residual would discount slow errors, which are the largest. The candidates
    keep the d′ of their screen.
    """
    whitened = search.estimator
    floor = flattened(whitened.floor, whitened.residuals.groups, fit.point.rows)
    estimator = GaussNewton(whitened.residuals, floor)
    nothing = estimator.at(search.nothing.point.values)
    refits_all = len(search.of) == search.refitted
    flat = EffectSearch(NuisanceFit(estimator, estimator, nothing), refits_all, search.report)
    flat.screened = search.screened
    return flat, flat.settled(fit)
