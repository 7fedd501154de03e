"""Name what is missing: every effect is tried through the simulator, the best are refitted.

One round of the search, repeated after each inclusion with everything tried again:

1. Screen: from the present fit, and from the plant as given, one step of all free knobs together
   with those of a candidate, its cost measured by simulation. Effects whose derivative vanishes
   where they are absent (a limit that is never met) are tried at a ladder of strengths.
2. Refit the best five from several starts; the cost of a nested model never rises (asserted).
3. Include the best where its gain passes what it shows without a gap
   (`models.gap.search.null_distribution`) and, over
   payloads left out in turn, its held-out gain exceeds its standard error. A further effect must
   also stand out beside what the equations of those before may miss. Where none does, pairs are
   tried.
4. Try to delete what was included before.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np

from models.gap.estimation.gauss_newton import FitPoint, GaussNewton
from models.gap.estimation.nuisance_bias import excessive_nuisance_bias
from models.gap.residuals.spectrum import Array
from models.gap.search.candidate import Candidate, SearchResult
from models.gap.search.cross_validation import held_out_gains
from models.gap.search.dead_zone_effects import strength_ladder, unexcited_effects
from models.gap.search.null_distribution import null_distribution_of
from models.gap.search.strength_consistency import strength_consistency_of
from models.plant.effects import EFFECTS

ROUNDS: Final = 2
REFITTED: Final = 5
MOST: Final = 3
"""Effects that one diagnosis may include."""

NEXT: Final = {"stiffness": 0.2, "bend_torque": 0.2}
"""Share of the d′ already named that a further effect must have beyond its own least, by the port
of what was named, 0.1 elsewhere: what an equation misses of the first looks like another."""

DOUBTED: Final = 0.35
"""The same share where the further effect's strength differs from place to place, as that of a
stand-in for an equation's error does (`models.gap.search.strength_consistency`): on single hidden
effects such errors were up to 0.25 of the first."""

AFAR: Final = (-0.5, -0.25, -0.1, 0.1, 0.25, 0.5)
"""Shares of its bounds from which what was chosen is fitted again where much is left."""

ReportProgress = Callable[[str], None]


class EffectSearch:
    """Searches over the effects of a problem.

    Parameters
    ----------
    estimator : GaussNewton
        Of the problem whose knobs are nuisance, trial variation and effects.
    catalogue : sequence of str
        Effects that may be named.
    report : callable
        Called with one phrase after each part of the work.
    """

    def __init__(
        self,
        estimator: GaussNewton,
        catalogue: Sequence[str],
        report: ReportProgress = lambda text: None,
    ) -> None:
        self.estimator = self.first = estimator
        self.null = null_distribution_of(estimator.problem.plant)
        self.report = report
        self.knobs = estimator.problem.knobs
        self.base = np.array([k.kind != "effect" for k in self.knobs])
        self.of = {
            e: np.array([k.effect == e for k in self.knobs])
            for e in catalogue
            if any(k.effect == e for k in self.knobs)
        }
        self.absent = [e for e in catalogue if e not in self.of]

    def search(self) -> SearchResult:
        """Run the whole search."""
        before = zero = self.estimator.at(np.zeros(len(self.knobs)))
        for _ in range(ROUNDS):  # the floor allows for a share of the gap, which depends on it
            self._widen(before)
            before = self.estimator.fit(self.estimator.at(before.values), self.base, 20)
        zero = self.estimator.linearise(self.estimator.at(zero.values))
        self.estimator.linearise(before)
        self.report("nuisance fitted")
        found = SearchResult(before, before)
        found.unexcited = self.absent + unexcited_effects(
            self.estimator, before, self.base, self.of
        )
        while len(found.named) < MOST:
            here = found.after
            screen = self._screen(here, [zero] if not found.named else [], found)
            if not found.named:
                found.screened = {e: t.separation for (e,), t in screen.items()}
            best = sorted(screen.values(), key=self._hope, reverse=True)[:REFITTED]
            refitted = [self._refit(t, here, found.named) for t in best]
            refitted.sort(key=lambda t: t.score, reverse=True)
            found.rounds.append(refitted)
            choice = self._accept(refitted, here, found)
            if choice is None and self.has_gap(here):
                choice = self._pairs(here, found)
            if choice is None:
                break
            found.named += list(choice.effects)
            found.chosen.append(choice)
            found.after = self._settled(choice, here, self.free(found.named))
            choice.gain = here.cost - found.after.cost
            self._delete(found)
        return found

    def _hope(self, trial: Candidate) -> float:
        """Score that a screened candidate may reach, halfway to what its derivatives promise."""
        return trial.score + max(trial.promised - trial.gain, 0.0)

    def _candidate(
        self, effects: tuple[str, ...], point: FitPoint, here: FitPoint, promised: float = 0.0
    ) -> Candidate:
        gain = here.cost - point.cost
        return Candidate(effects, point, gain, self.null.least(effects), promised)

    def free(self, effects: Sequence[str]) -> Array:
        """Knobs that are fitted when these effects are named."""
        free = self.base.copy()
        for effect in effects:
            free |= self.of[effect]
        return free

    def _screen(
        self, here: FitPoint, others: Sequence[FitPoint], found: SearchResult
    ) -> dict[tuple[str, ...], Candidate]:
        """One simulated step of each effect that is not yet named."""
        result: dict[tuple[str, ...], Candidate] = {}
        for effect in (e for e in self.of if e not in found.named):
            free = self.free([*found.named, effect])
            tried, most = [here], 0.0
            for start in [here, *others]:
                step, promised = self.estimator.step(start, free)
                most = max(most, here.cost - start.cost + promised)
                if start.cost - promised < here.cost:
                    tried.append(self.estimator.search(start, step) or start)
            if effect in found.unexcited and effect not in self.absent:
                tried += strength_ladder(self.estimator, here, effect, self.of[effect])
            point = min(tried, key=lambda p: p.cost)
            result[effect,] = self._candidate((effect,), point, here, most)
        self.report(f"{len(result)} effects screened")
        return result

    def _refit(self, trial: Candidate, here: FitPoint, named: Sequence[str]) -> Candidate:
        """Fit a candidate from its screened start, from zero and from the other sign."""
        free = self.free([*named, *trial.effects])
        starts = [trial.point]
        mirrored = trial.point.values.copy()
        own = self.free(trial.effects) & ~self.base
        mirrored[own] = np.clip(-mirrored[own], self.estimator.low[own], self.estimator.high[own])
        if np.any(mirrored != trial.point.values):
            starts.append(self.estimator.carry(here, self.estimator.at(mirrored)))
        first = [self.estimator.fit(start, free, 2) for start in starts if start.cost < np.inf]
        point = self.estimator.fit(min([here, *first], key=lambda p: p.cost), free, 8, 1e-3)
        assert point.cost <= here.cost, "the cost of a nested model rose"
        self.report(" + ".join(trial.effects))
        return self._candidate(trial.effects, point, here)

    def _settled(self, choice: Candidate, here: FitPoint, free: Array) -> FitPoint:
        """Fit of what was chosen; where much is left, also from strengths far from the search's.

        A delay and friction that make up for each other are valleys beside each other, and no step
        leads from one into the next.
        """
        best = self.estimator.fit(choice.point, free, 20)
        if not self.has_gap(best):
            return best
        ends = [best]
        for effect, share in itertools.product(choice.effects, AFAR):
            knob = int(np.flatnonzero(self.of[effect])[0])
            values = best.values.copy()
            values[knob] = share * (self.knobs[knob].high if share > 0 else -self.knobs[knob].low)
            start = self.estimator.at(values)
            if start.cost < np.inf:
                ends.append(self.estimator.fit(self.estimator.carry(here, start), free, 3))
        nearest = min(ends, key=lambda p: p.cost)
        return best if nearest is best else self.estimator.fit(nearest, free, 20)

    def _accept(
        self, refitted: Sequence[Candidate], here: FitPoint, found: SearchResult
    ) -> Candidate | None:
        """Best candidate that passes threshold and cross-validation.

        The threshold grows with what is left beside a candidate, as in an F-test.

        What the equations of those before may miss does not make every trial be set up off in one
        way: a candidate that eases such a strain need not stand out beside it.
        """
        missed = sum((self._missed(c) * c.separation) ** 2 for c in found.chosen)
        linear = [c for c in found.chosen if not set(c.effects) & set(found.unexcited)]
        doubted = max(missed, sum((DOUBTED * c.separation) ** 2 for c in linear))
        hides = excessive_nuisance_bias(self.knobs, here)
        for trial in (t for t in refitted if t.score >= refitted[0].score / 2):
            beyond = 2 * trial.gain - max(self.left(trial.point), 1.0) * trial.least**2
            eases = hides and not excessive_nuisance_bias(self.knobs, trial.point)
            free = self.free([*found.named, *trial.effects])
            if beyond <= (0.0 if eases else missed):
                continue
            if beyond <= doubted and not eases and not self._holds(trial, free):
                continue
            gains = held_out_gains(
                self.estimator, (here, self.free(found.named)), (trial.point, free)
            )
            trial.held_out_gain = float(gains.sum())
            spread = float(np.std(gains, ddof=1)) if len(gains) > 1 else 0.0
            trial.held_out_error = float(np.sqrt(len(gains))) * spread
            if trial.held_out_gain > trial.held_out_error:
                return trial
        return None

    def _holds(self, trial: Candidate, free: Array) -> bool:
        """Whether each strength of a candidate is the same everywhere."""
        return all(
            strength_consistency_of(
                self.estimator, trial.point, free, self.of[e], EFFECTS[e].port
            ).holds
            for e in trial.effects
        )

    @staticmethod
    def _missed(chosen: Candidate) -> float:
        return max(NEXT.get(EFFECTS[e].port, 0.1) for e in chosen.effects)

    def left(self, point: FitPoint) -> float:
        """Mean squared residual, in noise floors."""
        rows = self.estimator.whitened(point.rows)
        return sum(float(np.sum(w**2)) for w in rows) / sum(w.size for w in rows)

    def dispersion(self, point: FitPoint) -> float:
        """The same, at least 1, at most what counts as explained."""
        return float(np.clip(self.left(point), 1.0, self.null.explained))

    def has_gap(self, point: FitPoint) -> bool:
        """Whether more is left than noise explains."""
        return self.left(point) > self.null.explained

    def _pairs(self, here: FitPoint, found: SearchResult) -> Candidate | None:
        """Best pair of effects, by the linear promise, then refitted."""
        if len(found.named) + 2 > MOST:
            return None
        promised = []
        for pair in itertools.combinations([e for e in self.of if e not in found.named], 2):
            step, gain = self.estimator.step(here, self.free([*found.named, *pair]))
            promised.append((gain, pair, step))
        promised.sort(key=lambda row: -row[0])
        refitted = []
        for _, pair, step in promised[:3]:
            point = self.estimator.search(here, step) or here
            trial = self._candidate(pair, point, here)
            refitted.append(self._refit(trial, here, found.named))
        refitted.sort(key=lambda t: t.score, reverse=True)
        return self._accept(refitted, here, found)

    def _widen(self, point: FitPoint) -> None:
        """Allow for an error of a share of the gap that a fit of the nuisance leaves."""
        problem = self.estimator.problem
        gap = [r - m for r, m in zip(point.rows, self.first.means, strict=True)]
        self.estimator = GaussNewton(
            problem, self.first.floor.widened(problem.groups, problem.trials, gap)
        )

    def _delete(self, found: SearchResult) -> None:
        """Drop what is no longer needed beside what came later."""
        for effect in found.named[:-1]:
            rest = [e for e in found.named if e != effect]
            values = found.after.values.copy()
            values[self.of[effect]] = 0.0
            without = self.estimator.fit(self.estimator.at(values), self.free(rest), 5)
            if 2 * (without.cost - found.after.cost) < self.null.least([effect]) ** 2:
                found.named, found.after = rest, without
