"""What is written to the improved plant: the best fit that also errs less on what was left out.

Naming is a question of evidence. The plant that is written must in addition be better in SI units
on trials that no value was fitted to: its held-out error is lower than that of the plant as given,
and no signal's rises by more than a limit. Where the named effects together fail that, the last one
is left out, and so on; the plant as given passes always. A failed check takes back no name.

The effects are the cause of the gap; a nuisance refitted beside them may only fit the motion of
these trials. It is written as refitted if the held-out error falls by as much as would count as
harm if it rose, and the worst signal does not get worse.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from models.gap.estimation.gauss_newton import NUISANCE_FIT_STEPS, RELATIVE_FALL, FitPoint, Mask
from models.gap.search.bounds import is_at_bound
from models.gap.search.effect_search import EffectSearch, SetFit
from models.gap.search.held_out import HeldOut, HeldOutErrors, is_written
from models.plant.step_model import Array


@dataclass(frozen=True)
class WrittenFit:
    """Fit that the improved plant is written from."""

    candidates: tuple[str, ...]  # Effects that it adds
    point: FitPoint
    free: Mask  # (p,), fit parameters that were fitted; none for the plant as given
    errors: HeldOutErrors
    refused: str = ""  # Why something named is not among the candidates; empty if all is


class PlantWriter:
    """Fits of a search that may be written, judged on what was left out.

    `harm_fraction`: rise of a signal's held-out error above which a plant is refused. `same_link`:
    whether the link is known not to have changed, so its refitted parameters are not written.
    """

    def __init__(self, search: EffectSearch, harm_fraction: float, same_link: bool = False) -> None:
        self.search, self.harm_fraction, self.same_link = search, harm_fraction, same_link
        self.estimator = search.estimator
        self.held_out = HeldOut(search.estimator)
        parameters = search.estimator.residuals.fit_parameters
        self.nuisance = np.array([q.kind == "nuisance" for q in parameters])

    def unchanged(self, refused: str = "") -> WrittenFit:
        nothing = np.zeros_like(self.nuisance)
        return WrittenFit((), self.estimator.start(), nothing, self.held_out.baseline, refused)

    def best(self, fit: SetFit) -> WrittenFit:
        """The named set, or as much of it as passes: the last name is left out first."""
        refused, names = "", fit.candidates
        for names_written in (names[:count] for count in range(len(names), 0, -1)):
            for tried in self._variants(names_written, fit):
                if not (failure := self._failure(tried)):
                    return replace(tried, refused=refused if names_written != names else "")
                refused = refused or failure
        unchanged = self.unchanged(refused)
        if self.same_link:
            return unchanged
        refitted = self._fit((), fit, refits=True)
        is_better = self._is_earned(unchanged, refitted) and not self._failure(refitted)
        return replace(refitted, refused=refused) if is_better else unchanged

    def _variants(self, candidates: Sequence[str], fit: SetFit) -> list[WrittenFit]:
        """Fits with the nuisance as given and as refitted, the one to prefer first."""
        as_given = self._fit(candidates, fit, refits=False)
        if self.same_link:
            return [as_given]
        refitted = self._fit(candidates, fit, refits=True)
        is_earned = self._is_earned(as_given, refitted)
        return [refitted, as_given] if is_earned else [as_given, refitted]

    def _failure(self, fit: WrittenFit) -> str:
        """Why a fit may not be written, as a clause; empty if it may."""
        unchanged = self.held_out.baseline
        if (fraction := fit.errors.fraction_of(unchanged)) >= 1:
            return f"the error on what was left out would be {fraction:.1%} of that as given"
        for signal, ratio in fit.errors.ratios(unchanged).items():
            if ratio > 1 + self.harm_fraction:
                return f"the held-out error of {signal} would be {ratio:.1%} of that as given"
        return ""

    def _is_earned(self, unchanged: WrittenFit, refitted: WrittenFit) -> bool:
        """Whether a refitted nuisance is better than that of the plant as given."""
        before, after = (
            max(fit.errors.ratios(self.held_out.baseline).values()) for fit in (unchanged, refitted)
        )
        falls = refitted.errors.fraction_of(unchanged.errors) < 1 - self.harm_fraction
        return falls and after <= max(before, 1.0)

    def _fit(self, candidates: Sequence[str], fit: SetFit, refits: bool) -> WrittenFit:
        """Fit of some candidates, with the nuisance refitted or as given.

        A nuisance that ended at a bound keeps the plant's value. What belongs to the trials stays
        free: a shift of the mocap frame, and the clock.
        """
        added = np.logical_or.reduce([self.search.base, *(self.search.of[c] for c in candidates)])
        free: Mask = added & (fit.free | self.search.base)
        if not refits:
            residuals = self.estimator.residuals
            written = [is_written(residuals.plant, residuals, k, free) for k in range(len(free))]
            free &= ~(self.nuisance & np.array(written))
        point = self._refitted(fit.point.values, free)
        bounds = [is_at_bound(self.estimator, point, k) for k in range(len(free))]
        if np.any(stuck := self.nuisance & free & bounds):
            free &= ~stuck
            point = self._refitted(point.values, free)
        errors = self.held_out.errors(point, free)
        return WrittenFit(tuple(candidates), point, free, errors)

    def _refitted(self, values: Array, free: Mask) -> FitPoint:
        """Fit in which all common parameters that are not free are zero.

        Removing an effect leaves the rest where it compensated for that effect, so the fit starts
        from the better of these values and the same without nuisance.
        """
        parameters = self.estimator.residuals.fit_parameters
        fixed = np.array([q.trial is None for q in parameters]) & ~free
        rows = [values, np.where(self.nuisance, 0.0, values)]
        starts = [self.estimator.at(np.where(fixed, 0.0, row)) for row in rows]
        best = min(starts, key=lambda p: p.cost)
        return self.estimator.fit(best, free, NUISANCE_FIT_STEPS, RELATIVE_FALL)
