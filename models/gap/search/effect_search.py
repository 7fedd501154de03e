"""Effect search: every effect is tried through the simulator, the best are refitted.

One round of the search, repeated after each inclusion with everything tried again:

1. Screen: from the present fit, and from the plant that is diagnosed, one step of all free fit
   parameters together with those of a candidate, its cost measured by simulation. Effects with a
   dead zone are tried at several strengths (`models.gap.search.dead_zone_effects`).
2. Refit the best from several starts; in further rounds only those that may pass.
3. Include the best if its gain exceeds its gain where nothing is missing
   (`models.gap.search.null_distribution`), on a link that changed as in its fit, and its gain on
   held-out payloads exceeds the losses. A further effect must also exceed the equation error of
   the effects before it. Where none does, pairs are tried.
4. Delete effects included before that are no longer needed.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from models.gap.estimation.gauss_newton import FitPoint, GaussNewton
from models.gap.estimation.link_change import link_change
from models.gap.estimation.measured_floor import with_amplified_scatter, with_repeated_trials
from models.gap.estimation.normal_equation import mean_square
from models.gap.estimation.nuisance_bias import excessive_nuisance_bias
from models.gap.search.bounded_candidate import bounded_candidate
from models.gap.search.candidate import Candidate, SearchResult, beyond_limits, may_pass
from models.gap.search.cross_validation import held_out_gain
from models.gap.search.dead_zone_effects import strengths_far_from_zero, unexcited_effects
from models.gap.search.effect_pairs import promising_pairs
from models.gap.search.held_out_errors import HeldOut, flattened, lowers_held_out_error
from models.gap.search.null_distribution import known_error, null_distribution_of
from models.gap.search.several_starts import refitted_from_both_signs, refitted_from_far_strengths
from models.gap.search.strength_consistency import strengths_hold
from models.plant.identification.noise_floor import Array

ReportProgress = Callable[[str, int], None]
"""Called after each part of the work with a phrase and the least number of parts to follow."""


class EffectSearch:
    """Search over the effects of a catalogue.

    The fit parameters of `estimator` are nuisance, trial variation and effects.
    """

    def __init__(
        self, estimator: GaussNewton, catalogue: Sequence[str],
        report: ReportProgress = lambda text, further: None,
    ) -> None:  # fmt: skip
        self.estimator = self.first = estimator
        self.settings, self.report = estimator.settings, report
        residuals = estimator.residuals
        given = residuals.plant, residuals.trials[0].meta.dof, known_error(estimator), self.settings
        self.null_distribution = self.unchanged_null = null_distribution_of(*given)
        parameters = self.fit_parameters = residuals.fit_parameters
        self.base = np.array([q.kind != "effect" for q in parameters])
        self.of = {
            e: np.array([q.effect == e and (self.learned or not q.fitted_last) for q in parameters])
            for e in catalogue
            if any(q.effect == e for q in parameters)
        }
        self.absent = [e for e in catalogue if e not in self.of]
        self.held = np.zeros(len(self.fit_parameters), dtype=bool)
        self.excluded: frozenset[str] = frozenset()

    @cached_property
    def nuisance_fit(self) -> FitPoint:
        """Fit of link and set-up; it widens the floor by a fraction of the remaining gap."""
        before = self.estimator.start()
        for _ in range(self.settings.widening_rounds):  # the floor depends on the remaining gap
            self._widen(before)
            before = self.estimator.fit_nuisance(self.estimator.at(before.values))
        return before

    def first_round(self) -> SearchResult:
        """Screen every effect alone and refit the best ones; nothing is named yet."""
        before = self.nuisance_fit
        self.report("nuisance fitted", 2 + self._most_refitted())
        flat = unexcited_effects(self.estimator, before, self.base, self.of)
        found = SearchResult(before, before, unexcited=self.absent + flat)
        self._round(found, [self.estimator.linearise(self.estimator.at(0.0 * before.values))])
        return found

    def search_without(self, earlier: SearchResult, effects: Collection[str]) -> SearchResult:
        """Repeat the search from an earlier first round, without effects that were refused."""
        self.held[:] = False
        self.excluded = frozenset(effects)
        found = replace(earlier, named=[], chosen=[], refused=[], rounds=earlier.rounds[:1])
        found.after = found.before
        return self.include(found)

    def include(self, found: SearchResult) -> SearchResult:
        """Include the best candidates of the last round, and continue with further rounds."""
        while len(found.named) < self.settings.most_named:
            here = found.after
            if found.named:
                self._round(found, [])
            choice = self._accept(found.rounds[-1], found)
            if choice is None and (self._is_open(here) or not (self.learned or found.named)):
                choice = self._pairs(found)
            if choice is None:
                break
            found.named += list(choice.effects)
            self.held[list(choice.held)] = True
            found.chosen.append(choice)
            found.after = self._settled(choice, here, self.free(found.named))
            found.explore(found.named, found.after)
            choice.gain = here.cost - found.after.cost
            if self.learned:
                self._delete(found)
            elif len(found.chosen) == 1:
                self._flatten(found)
        return found

    def _round(self, found: SearchResult, others: Sequence[FitPoint]) -> None:
        """Screen every effect and refit the best candidates."""
        self.estimator.linearise(found.after)
        screen = self._screen(found.after, others, found)
        if not found.named:
            found.screened = {e: c.separation for (e,), c in screen.items()}
        best = sorted(screen.values(), key=lambda c: (self._explains_bias(c, found), c.hope))[::-1]
        best = best[: self._most_refitted()]
        if found.named and self.learned and not self.nuisance_bias(found.after):
            best = [c for c in best if may_pass(c, found, self.settings)]
        self.report(f"{len(screen)} effects screened", len(best) + 1)
        refitted = [self._refit(c, found, len(best) - k) for k, c in enumerate(best)]
        refitted.sort(key=lambda c: (self._explains_bias(c, found), c.score), reverse=True)
        found.rounds.append(refitted)

    @cached_property
    def held_out(self) -> HeldOut:
        """Folds of the trials that are left out in turn; first used after the nuisance fit."""
        return HeldOut(self.estimator)

    @property
    def learned(self) -> bool:
        """Whether the noise floor was measured on repetitions."""
        return self.first.floor.learned

    def _most_refitted(self) -> int:
        """Candidates to refit; all of them for a rigid load, whose simulation is fast."""
        few = self.learned or self.estimator.residuals.plant.load == "link"
        return self.settings.refitted_candidates if few else len(self.of)

    def candidate(
        self, effects: tuple[str, ...], point: FitPoint, here: FitPoint, predicted: float = 0.0
    ) -> Candidate:
        """Candidate of some effects from their fit; `here` is the fit without them."""
        same = self.unchanged_null.for_link_change(self.settings.least_link_change, self.settings)
        least = self.least(effects, point), same.least(effects)
        return Candidate(effects, point, here.cost - point.cost, *least, predicted)

    def least(self, effects: Sequence[str], point: FitPoint) -> float:
        """Least d′ that effects must reach together in a fit that holds them.

        A hidden effect may look like a change of the link, which the fit with the effect does not
        need. So the plant's own error is that of a link changed as in this fit, at most as in the
        nuisance fit.
        """
        fitted = link_change(self.fit_parameters, point.values, self.settings)
        change = 0.0 if self.settings.same_link else min(fitted, self.first.floor.link_change)
        return self.unchanged_null.for_link_change(change, self.settings).least(effects)

    def free(self, effects: Sequence[str]) -> Array:
        """Fit parameters that are fitted when these effects are named, ndarray of bool."""
        free = np.logical_or.reduce([self.base, *(self.of[effect] for effect in effects)])
        return np.asarray(free & ~self.held)

    def _screen(
        self, here: FitPoint, others: Sequence[FitPoint], found: SearchResult
    ) -> dict[tuple[str, ...], Candidate]:
        """One simulated step of each effect that is not yet named."""
        result: dict[tuple[str, ...], Candidate] = {}
        for effect in self._choices(found):
            free, tried, predicted = self.free([*found.named, effect]), [here], 0.0
            for start in [here, *others]:
                step, fall = self.estimator.step(start, free)
                predicted = max(predicted, here.cost - start.cost + fall)
                if start.cost - fall < here.cost:
                    tried.append(self.estimator.line_search(start, step) or start)
            own, flat = self.of[effect], effect in found.unexcited
            given = here, others, min(p.cost for p in tried)
            tried += strengths_far_from_zero(self.estimator, *given, effect, own, free, flat)
            point = min(tried, key=lambda p: p.cost)
            found.explore([*found.named, effect], point)
            result[effect,] = self.candidate((effect,), point, here, predicted)
        return result

    def _choices(self, found: SearchResult) -> list[str]:
        """Effects that may still be named."""
        return [e for e in self.of if e not in found.named and e not in self.excluded]

    def _refit(self, candidate: Candidate, found: SearchResult, further: int) -> Candidate:
        """Fit a candidate from its screened start, from zero and from the other sign."""
        named, own = [*found.named, *candidate.effects], self.free(candidate.effects) & ~self.base
        fit = self.estimator, candidate.point, found.after, self.free(named), own
        found.explore(named, point := refitted_from_both_signs(*fit))
        self.report(" + ".join(candidate.effects), further)
        return self.candidate(candidate.effects, point, found.after)

    def _settled(self, choice: Candidate, here: FitPoint, free: Array) -> FitPoint:
        strengths = [int(np.flatnonzero(self.of[e])[0]) for e in choice.effects]
        fit = self.estimator, choice.point, here, free, strengths
        return refitted_from_far_strengths(*fit, self._is_open)

    def _accept(self, refitted: Sequence[Candidate], found: SearchResult) -> Candidate | None:
        """Best candidate that passes; without a learned floor that of the least held-out error."""
        passed: list[tuple[float, Candidate]] = []
        before = found.after, self.free(found.named)
        without = None if self.learned else self.held_out.errors(*before)
        for candidate in refitted:
            further = bool(found.named) and without is not None
            beyond = candidate.separation >= candidate.least  # held-out error alone fits one fold
            enough = beyond if further else self._stands_out(candidate, found)
            own = self._free_of(candidate, found)
            if not enough or self.excluded & set(candidate.effects):
                continue
            bounded = bounded_candidate(self.estimator, candidate, before[0], own, found.refused)
            if not bounded:
                continue
            fits = before, (bounded.point, self._free_of(bounded, found))
            bounded.held_out_gain, bounded.held_out_error = held_out_gain(self.estimator, *fits)
            gained = bounded.held_out_gain > bounded.held_out_error
            if without is not None:  # by simulation; a linear prediction does not count
                errors = self.held_out.errors(*fits[1])
                if lowers_held_out_error(errors, without, self.learned, self.settings):
                    passed.append((errors.fraction_of(self.held_out.given), bounded))
            elif gained or self._explains_bias(candidate, found):
                return bounded
        return min(passed, key=lambda row: row[0])[1] if passed else None

    def _free_of(self, candidate: Candidate, found: SearchResult) -> Array:
        """Free fit parameters of a candidate together with the named effects."""
        free = self.free([*found.named, *candidate.effects])
        free[list(candidate.held)] = False
        return free

    def _stands_out(self, candidate: Candidate, found: SearchResult) -> bool:
        """Whether a candidate exceeds its limits, including the equation error of earlier effects.

        That error shifts no trials alike, so it does not count against a candidate that removes a
        nuisance bias.
        """
        left = self.mean_residual(candidate.point)
        alone, beside, doubted = beyond_limits(candidate, found, left, self.settings)
        if self._explains_bias(candidate, found):
            return alone > 0
        fit = self.estimator, candidate.point, self._free_of(candidate, found)
        own = [self.of[e] for e in candidate.effects]
        return beside > 0 and (doubted > 0 or strengths_hold(*fit, own))

    def _explains_bias(self, candidate: Candidate, found: SearchResult) -> bool:
        """Whether a further effect removes the nuisance bias of the trials."""
        biased = bool(found.named and self.nuisance_bias(found.after))
        return biased and not self.nuisance_bias(candidate.point)

    def nuisance_bias(self, point: FitPoint) -> dict[str, float]:
        """Kinds of trial variation that are biased, see `models.gap.estimation.nuisance_bias`."""
        return excessive_nuisance_bias(self.fit_parameters, point, self.settings)

    def mean_residual(self, point: FitPoint) -> float:
        """Mean squared residual, in noise floors that allow for the equation error."""
        return mean_square(self.estimator.whitened(point.rows))

    def dispersion(self, point: FitPoint) -> float:
        """Mean squared residual, at least 1 and at most what counts as explained."""
        return float(np.clip(self.mean_residual(point), 1.0, self.null_distribution.explained))

    def has_gap(self, point: FitPoint) -> bool:
        """Whether the residual exceeds what noise explains."""
        return self.mean_residual(point) > self.null_distribution.explained

    def _is_open(self, point: FitPoint) -> bool:
        """Whether the residual is so large that more starts and pairs are tried."""
        least = min(self.null_distribution.explained, self.settings.open_residual)
        return self.mean_residual(point) > least

    def _pairs(self, found: SearchResult) -> Candidate | None:
        """Best pair of effects by the prediction of derivatives, refitted."""
        if len(found.named) + 2 > self.settings.most_named or self.excluded:
            return None
        here, own = found.after, (found.named, self._choices(found), self.free)
        tried = [self.candidate(*r, here) for r in promising_pairs(self.estimator, here, *own)]
        refitted = [self._refit(c, found, len(tried) - k) for k, c in enumerate(tried)]
        return self._accept(sorted(refitted, key=lambda c: c.score, reverse=True), found)

    def _widen(self, point: FitPoint) -> None:
        """Widen the floor by the scatter of repetitions, a part of the gap, and a changed link."""
        residuals = self.estimator.residuals
        change = link_change(self.fit_parameters, point.values, self.settings)
        floor = replace(self.first.floor, link_change=change)
        if point.values.any():  # once fitted
            pooled = self.unchanged_null.repetitions_pooled
            repeated = with_repeated_trials if pooled else with_amplified_scatter
            floor = repeated(floor, residuals, point.rows)
        self.first = GaussNewton(residuals, floor)
        self.null_distribution = self.unchanged_null.for_link_change(change, self.settings)
        gap = [r - m for r, m in zip(point.rows, self.first.means, strict=True)]
        wider = floor.widened(residuals.groups, residuals.trials, gap, self.settings)
        self.estimator = GaussNewton(residuals, wider)

    def _flatten(self, found: SearchResult) -> None:
        """Fit in SI units after the first effect, when no learned floor separates noise."""
        residuals = self.estimator.residuals
        floor = flattened(self.first.floor, residuals.groups, found.after.rows)
        self.estimator = GaussNewton(residuals, floor)
        self.held_out = HeldOut(self.estimator)
        start, steps = self.estimator.at(found.after.values), self.settings.nuisance_fit_steps
        found.after = self.estimator.fit(start, self.free(found.named), steps)
        found.explored = {frozenset(found.named): found.after}

    def _delete(self, found: SearchResult) -> None:
        """Delete effects that are no longer needed beside those included later."""
        for effect in found.named[:-1]:
            rest = [e for e in found.named if e != effect]
            values = found.after.values.copy()
            values[self.of[effect]] = 0.0
            start, steps = self.estimator.at(values), self.settings.deletion_steps
            without = self.estimator.fit(start, self.free(rest), steps)
            if 2 * (without.cost - found.after.cost) < self.least([effect], found.after) ** 2:
                found.named, found.after = rest, without
