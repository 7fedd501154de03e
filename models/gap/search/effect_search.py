"""Search over sets of missing effects: each is tried through the simulator, the best are refitted.

A candidate is an effect of the catalogue or, with two joints, one of a single servo
(`EFFECT:JOINT`, `models.gap.residuals.fit_parameters.effect_candidates`). A round adds each
candidate to a set:

1. Screen: one bounded step of all free fit parameters from the fit of the set, and from the plant
   as given, each judged by simulation; then strengths far from zero, which no step leads to
   (`models.gap.search.far_strengths`).
2. Refit the best ones from their screened start, from zero and from the other sign, within bounds
   (`models.gap.search.bounds`).

Two effects may look like a third, so the pairs are refitted too that derivatives predict to explain
most. d′ of a set is the root of twice the fall of the cost from the fit of the nuisance.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from models.gap.estimation.gauss_newton import (
    NUISANCE_FIT_STEPS,
    RELATIVE_FALL,
    FitPoint,
    Mask,
)
from models.gap.estimation.nuisance_fit import NuisanceFit
from models.gap.search.bounds import within_bounds
from models.gap.search.far_strengths import strengths_far_from_zero, unexcited_candidates
from models.shared.catalogue import effect_and_joint

ReportProgress = Callable[[str, int], None]
"""Called after each part of the work with a phrase and the least number of parts to follow."""

REFITTED: Final = 5
"""Candidates that are refitted in a round."""
REFIT_GROWTH: Final = 1.5
"""Factor by which a refit may raise the fall of the cost that a screen or derivatives promise.
Measured on 12 diagnoses of drawn rigs: up to 1.49, 1.3 without a dead zone."""
REFITTED_PAIRS: Final = 3
"""Pairs that are refitted."""
START_STEPS: Final = 2
"""Most steps of a candidate's fit from each start [assumed]."""
FIT_STEPS: Final = 8
"""Most further steps, from the best of its starts [assumed]."""


class _Screened(NamedTuple):
    promised: float  # Cost that a refit promises
    name: str
    point: FitPoint  # Best one without a refit


@dataclass(frozen=True)
class SetFit:
    """Fit of a set of candidates beside nuisance and trial variation."""

    candidates: tuple[str, ...]  # In the order of their adding; empty for the nuisance alone
    point: FitPoint
    free: Mask  # (p,), fit parameters that were fitted
    gain: float  # Fall of the cost from the fit of the nuisance

    @property
    def separation(self) -> float:
        """d′ of the set."""
        return float(np.sqrt(max(2 * self.gain, 0.0)))


class EffectSearch:
    """Rounds of the search.

    The fit parameters are nuisance, trial variation and those of every candidate. With
    `refits_all` every candidate of a round is refitted.
    """

    def __init__(
        self,
        nuisance: NuisanceFit,
        refits_all: bool = False,
        report: ReportProgress = lambda text, further: None,
    ) -> None:
        self.nuisance, self.report = nuisance, report
        estimator = self.estimator = nuisance.estimator
        parameters = estimator.residuals.fit_parameters
        # Details that only a learned floor separates from noise stay as assumed.
        can_fit = [estimator.floor.learned or not q.fitted_last for q in parameters]
        self.base = np.array([not q.effect for q in parameters])
        self.last = np.array([q.fitted_last for q in parameters])
        self.of = {
            name: np.array([q.effect == name for q in parameters]) & can_fit
            for name in dict.fromkeys(q.effect for q in parameters if q.effect)
        }
        self.refitted = len(self.of) if refits_all else REFITTED
        self.nothing = SetFit((), nuisance.point, self.base, 0.0)
        self.unexcited = unexcited_candidates(estimator, nuisance.point, self.base, self.of)
        self.screened: dict[str, float] = {}  # d′ of every candidate alone, before its refit
        self._unfitted = estimator.linearise(estimator.at(0.0 * nuisance.point.values))

    def free(self, candidates: Sequence[str]) -> Mask:
        """Fit parameters of some candidates with nuisance and variation, ndarray of bool."""
        return np.asarray(np.logical_or.reduce([self.base, *(self.of[c] for c in candidates)]))

    def beside(self, fit: SetFit, least: float = 0.0) -> list[SetFit]:
        """Best fits of a set with one candidate more, the largest d′ first.

        `least`: d′ that the candidate must add; those that cannot by what derivatives promise are
        left out. Effects of a single servo are tried where the effect of all is among the best.
        """
        self.estimator.linearise(fit.point)
        taken = {effect_and_joint(c)[0] for c in fit.candidates}
        names = [n for n in self.of if effect_and_joint(n)[0] not in taken]
        rows = self._screened(fit, [n for n in names if ":" not in n], least)
        best = [row.name for row in rows[: self.refitted]]
        rows += self._screened(
            fit, [n for n in names if n.partition(":")[0] in best and ":" in n], least
        )
        rows.sort(key=lambda row: row.promised)
        if not fit.candidates:
            gains = {row.name: fit.point.cost - row.point.cost for row in rows}
            self.screened = {n: float(np.sqrt(max(2 * gain, 0))) for n, gain in gains.items()}
        self.report(f"{len(rows)} effects screened", self.refitted)
        return self._refitted(
            fit, [((*fit.candidates, r.name), r.point) for r in rows], self.refitted
        )

    def pairs(self, least_gain: float) -> list[SetFit]:
        """Best fits of two candidates, by the fall of the cost that derivatives predict.

        Of a pair the one that explains more alone comes first.
        `least_gain`: fall of the cost that a pair must reach; those that cannot are left out.
        """
        here = self.nothing.point
        names = [name for name in self.of if ":" not in name]
        names.sort(key=lambda name: -self.screened.get(name, 0.0))
        rows = [
            (*self.estimator.step(here, self.free(pair)), pair)
            for pair in itertools.combinations(names, 2)
        ]
        rows.sort(key=lambda row: -row[1])
        moved = [
            (pair, self.estimator.line_search(here, step) or here)
            for step, promised, pair in rows[:REFITTED_PAIRS]
            if REFIT_GROWTH * promised >= least_gain
        ]
        return self._refitted(self.nothing, moved, REFITTED_PAIRS, both_signs=False)

    def settled(self, fit: SetFit, beyond: SetFit | None = None) -> SetFit:
        """The same set, fitted by this search's estimator until it converges.

        `beyond`: fit of more candidates. Its values are a further start, because the cost has
        several minima, and parameters of this set that it fits are fitted here too.
        """
        free, starts = fit.free, [self.estimator.at(fit.point.values)]
        if beyond is not None:
            free = free | (beyond.free & self.free(fit.candidates))
            starts.append(self.estimator.at(np.where(free, beyond.point.values, 0.0)))
        start = min(starts, key=lambda p: p.cost)
        point = self.estimator.fit(start, free, NUISANCE_FIT_STEPS)
        if point.cost > fit.point.cost:
            point, free = fit.point, fit.free
        return SetFit(fit.candidates, point, free, self.nothing.point.cost - point.cost)

    def _screened(self, fit: SetFit, names: Sequence[str], least: float) -> list[_Screened]:
        """Candidates after one step, and at strengths far from zero; the best first."""
        here = fit.point
        starts = [here] if fit.candidates else [here, self._unfitted]
        rows = []
        for name in names:
            free, is_flat = fit.free | self.of[name], name in self.unexcited
            steps = [self.estimator.step(start, free) for start in starts]
            promised = [s.cost - fall for s, (_, fall) in zip(starts, steps, strict=True)]
            reach = 2 * REFIT_GROWTH * (here.cost - min(promised))
            if reach < least**2 and not is_flat:
                continue
            tried = [here]
            for start, (step, _), cost in zip(starts, steps, promised, strict=True):
                if cost < here.cost:
                    tried.append(self.estimator.line_search(start, step) or start)
            tried += strengths_far_from_zero(
                self.estimator, starts, min(p.cost for p in tried), effect_and_joint(name)[0],
                self.of[name], free, is_flat,
            )  # fmt: skip
            point = min(tried, key=lambda p: p.cost)
            if 2 * REFIT_GROWTH * (here.cost - min(*promised, point.cost)) >= least**2:
                rows.append(_Screened((point.cost + min(*promised, point.cost)) / 2, name, point))
        return sorted(rows, key=lambda row: row.promised)

    def _refitted(
        self,
        fit: SetFit,
        screened: Sequence[tuple[tuple[str, ...], FitPoint]],
        most: int,
        both_signs: bool = True,
    ) -> list[SetFit]:
        """The first sets whose strengths are not at a bound, refitted, the largest d′ first."""
        fits: list[SetFit] = []
        for candidates, point in screened:
            if len(fits) == most:
                break
            added = [c for c in candidates if c not in fit.candidates]
            free = np.logical_or.reduce([fit.free, *(self.of[c] for c in added)])
            if both_signs:
                point = self._from_both_signs(fit.point, point, free, added)
            point = self._from_start(point, free)
            bounded = within_bounds(self.estimator, fit.point, point, free, added)
            if bounded is not None:
                gain = self.nothing.point.cost - bounded[0].cost
                fits.append(SetFit(candidates, *bounded, gain))
            self.report(" + ".join(candidates), max(most - len(fits), 0))
        return sorted(fits, key=lambda f: -f.gain)

    def _from_both_signs(
        self, here: FitPoint, screened: FitPoint, free: Mask, added: Sequence[str]
    ) -> FitPoint:
        """Best short fit from a screened start, from zero and from the other sign.

        The fit without the candidate is among the starts, so the cost of a nested model never
        rises.
        """
        estimator, of_effects = self.estimator, np.logical_or.reduce([self.of[c] for c in added])
        starts, mirrored = [screened], screened.values.copy()
        mirrored[of_effects] = np.clip(
            -mirrored[of_effects], estimator.low[of_effects], estimator.high[of_effects]
        )
        if np.any(mirrored != screened.values):
            starts.append(estimator.carry(here, estimator.at(mirrored)))
        first = free & ~self.last
        ends = [estimator.fit(s, first, START_STEPS) for s in starts if s.cost < np.inf]
        return min([here, *ends], key=lambda p: p.cost)

    def _from_start(self, start: FitPoint, free: Mask) -> FitPoint:
        """Fit from a start; parameters that are `fitted_last` are freed where the others ended."""
        point = self.estimator.fit(start, free & ~self.last, FIT_STEPS, RELATIVE_FALL)
        if np.any(free & self.last):
            point = self.estimator.fit(point, free, FIT_STEPS, RELATIVE_FALL)
        return point
