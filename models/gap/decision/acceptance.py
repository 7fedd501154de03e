"""Acceptance of the improved plant: what is refused, and the best plant without it.

The effect search decides by the whitened cost. The plant that is written must also be better in SI
units, on trials that no value was fitted to, by simulation (`models.gap.search.held_out_errors`):

1. No fitted value is at a bound, and no sum is impossible (`models.plant.parameter`). A
   strength at a bound removes its effect; any other such value keeps that of the diagnosed plant.
2. The strength of every effect after the first is the same everywhere: otherwise it only corrects
   the equation of the first.
3. Every named effect lowers the held-out error.
4. No signal's held-out error rises by more than `GapSettings.harm_fraction` over that of the
   diagnosed plant.

An effect that fails is taken out, and the rest is fitted and tested again. Effects that fail only a
test on held-out errors stay named if the noise floor is learned and no single one of them is the
cause: the last one, or several of which each lowers the error. Whether they are missing is a
question of evidence (`models.gap.decision.answers`), and the diagnosed plant may have compensated
for them. The plant is then written unchanged. With `keeps_named` the causes stay named too.

The effects are the cause of the gap; a nuisance refitted beside them may only fit the motion of
these trials. It is written as refitted if the held-out error falls by at least as much as would
count as harm if it rose, and the worst signal does not get worse.

A stand-in for an effect that the catalogue lacks fits the motion that it was fitted to. It is
written only if other motions were left out and it passed there.
"""

from __future__ import annotations

from dataclasses import replace

import msgspec
import numpy as np

from models.gap.decision.accepted_fit import AcceptedFit, refit_is_earned
from models.gap.decision.answers import Answers
from models.gap.decision.evidence import consistencies_of_named
from models.gap.decision.further_effect import with_further_effect
from models.gap.decision.rejected_effects import STAND_IN_BESIDE_OTHERS, refused_by_evidence
from models.gap.estimation.gauss_newton import FitPoint
from models.gap.improved_plant import written_values
from models.gap.residuals.fit_parameters import plant_with_searched_effects
from models.gap.search.bounded_candidate import strength_names
from models.gap.search.candidate import SearchResult
from models.gap.search.effect_search import EffectSearch
from models.gap.search.held_out_errors import HeldOutErrors, is_written, lowers_held_out_error
from models.gap.search.refused_effect import (
    OffendingValue,
    RefusalKind,
    RefusedEffect,
    impossible_values,
    refusal_of_value,
    refusals,
    values_at_bounds,
)
from models.plant.identification.noise_floor import Array


class Acceptance:
    """Tests of a search's result; an effect that fails is taken out."""

    def __init__(self, search: EffectSearch, result: SearchResult) -> None:
        self.search, self.result, self.settings = search, result, search.settings
        self.held_out, self.residuals = search.held_out, search.estimator.residuals
        self.nuisance = np.array([q.kind == "nuisance" for q in search.fit_parameters])
        self.as_given = np.zeros_like(self.nuisance)
        self.judged = self._as_given()
        self.withheld: RefusedEffect | None = None
        self.keeps_named = False
        self._errors: dict[bytes, HeldOutErrors] = {}
        self._refits: dict[bytes, FitPoint] = {}

    def accepted(self) -> AcceptedFit:
        """Best fit that may be written."""
        self.withheld = None
        while self.result.named:
            if self._refuses_values() or self._refuses_inconsistent():
                continue
            fits = self._by_preference(self._nuisance_undone(), self._as_fitted())
            self.judged, failing = fits[0], self._failing(fits[0])
            if not failing:
                return fits[0]
            further = any(row.effect in self.result.named[1:] for row in failing)
            if not further and not self._failing(fits[1]):
                self.judged = fits[1]
                return fits[1]
            to_blame = any(row.effect for row in failing) and len(self.result.named) > 1
            if self.search.learned and (self.keeps_named or not to_blame):
                together = " + ".join(self.result.named)
                self.withheld = msgspec.structs.replace(failing[0], effect=together)
                return self._as_given()
            self._refuse(fits[0], failing)
        self.judged = self._as_given()
        return self.judged

    def copy(self) -> Acceptance:
        """The same tests on a copy of the result; fits are shared."""
        named, refused = list(self.result.named), list(self.result.refused)
        other = Acceptance(self.search, replace(self.result, named=named, refused=refused))
        other.as_given = self.as_given.copy()
        other._errors, other._refits = self._errors, self._refits
        return other

    def without(self, effect: str) -> Acceptance:
        """Tests of the same result without one effect, which is refused as a stand-in."""
        rest = self.copy()
        rest.result.refused += refusals([effect], "stand-in", STAND_IN_BESIDE_OTHERS)
        rest._take_out([effect])
        return rest

    def with_further(self, effect: str) -> Acceptance:
        """Tests of the same result with one more effect."""
        more, free = self.copy(), self.search.free([*self.result.named, effect])
        point = self._refitted(self.result.after.values, free)
        more.result = with_further_effect(self.search, more.result, effect, point)
        return more

    def without_named(self, accepted: AcceptedFit, answers: Answers) -> AcceptedFit:
        """The unchanged plant instead of a fit whose effects are not probable enough.

        A stand-in that passed on other motions is still written.
        """
        moved = "motions" in self.held_out.folds
        if answers.is_outside and moved and np.any(accepted.free):
            return accepted
        self.result.refused += refused_by_evidence(self.result.named, answers)
        self.result.named, self.result.after = [], self.result.before
        return self._as_given()

    def changed_link(self) -> AcceptedFit:
        """Refitted nuisance, if nothing is named and it lowers the held-out errors.

        Otherwise, or if it raises the error of a signal, the unchanged plant. A value at a bound is
        then no refusal, since nothing would have been written.
        """
        given, refused = self._as_given(), list(self.result.refused)
        while self._refuses_values():
            pass
        refitted = self._as_fitted()
        earned = refit_is_earned(given.errors, refitted.errors, given.errors, self.settings)
        if earned:
            return refitted
        self.result.refused = refused
        return given

    def _as_given(self) -> AcceptedFit:
        given = self.search.first.start()
        return AcceptedFit(given, np.zeros_like(self.nuisance), self.held_out.given)

    def _fraction(self, fit: AcceptedFit) -> float:
        return fit.errors.fraction_of(self.held_out.given)

    def _by_preference(self, undone: AcceptedFit, refitted: AcceptedFit) -> list[AcceptedFit]:
        """Fits with the nuisance undone and refitted, the better one first."""
        if refit_is_earned(undone.errors, refitted.errors, self.held_out.given, self.settings):
            return [refitted, undone]
        return [undone, refitted]

    def _as_fitted(self) -> AcceptedFit:
        return self._fit(*self._point_as_fitted())

    def _point_as_fitted(self) -> tuple[FitPoint, Array]:
        """Fit of the named effects and the nuisance that may be written, and its free
        parameters.
        """
        free = self.search.free(self.result.named) & ~self.as_given
        after = self.result.after
        return (self._refitted(after.values, free) if self.as_given.any() else after), free

    def _nuisance_undone(self) -> AcceptedFit:
        """Fit of effects and variation, with the nuisance of the diagnosed plant.

        Parameters of the trials stay free: a shift of the mocap frame, and the clock.
        """
        free = self.search.free(self.result.named) & ~self.as_given
        free = free & ~(self.nuisance & self._written(free))
        return self._fit(self._refitted(self.result.after.values, free), free)

    def _written(self, free: Array) -> Array:
        """Fit parameters that would change the plant that is written, ndarray of bool."""
        plant, residuals = self.residuals.plant, self.residuals
        return np.array([is_written(plant, residuals, k, free) for k in range(len(free))])

    def _fit(self, point: FitPoint, free: Array) -> AcceptedFit:
        key = point.values.tobytes() + free.tobytes()
        if key not in self._errors:
            self._errors[key] = self.held_out.errors(point, free)
        return AcceptedFit(point, free, self._errors[key])

    def _refitted(self, values: Array, free: Array) -> FitPoint:
        """Fit in which all common parameters that are not free are zero.

        Removing an effect leaves the rest where it compensated for that effect. So the fit starts
        from the best of these values, the same without nuisance, and the search's own fit of the
        same effects.
        """
        key = values.tobytes() + free.tobytes()
        if key in self._refits:
            return self._refits[key]
        parameters, estimator = self.search.fit_parameters, self.search.estimator
        fixed = np.array([q.trial is None for q in parameters]) & (free == 0)
        effects = frozenset(
            q.effect for q, fitted in zip(parameters, free, strict=True) if fitted and q.effect
        )
        found = self.result.explored.get(effects)
        rows = [values, np.where(self.nuisance, 0.0, values)] + ([found.values] if found else [])
        starts = [estimator.at(np.where(fixed, 0.0, row)) for row in rows]
        best = min(starts, key=lambda p: p.cost)
        steps, relative = self.settings.nuisance_fit_steps, self.settings.waterfall_relative_fall
        self._refits[key] = estimator.fit(best, free, steps, relative)
        return self._refits[key]

    def _refuses_values(self) -> bool:
        """Refuse a value or a sum: it is not written, or its effect is not named. Returns whether
        it did.
        """
        point, free = self._point_as_fitted()
        plant, parameters = self.residuals.plant, self.search.fit_parameters
        rows: list[tuple[RefusalKind, OffendingValue]] = [
            ("at a bound", row)
            for row in values_at_bounds(plant, parameters, point, free, self.settings)
        ]
        full = plant_with_searched_effects(plant, self.result.named)
        written = full.with_values(written_values(full, parameters, point.values, free))
        payloads_kg = [t.meta.payload_kg for t in self.residuals.trials]
        rows += [
            ("impossible", row)
            for row in impossible_values(plant, written, payloads_kg, parameters, free)
        ]
        if not rows:
            return False
        kind, first = rows[0]
        effects = [
            e for e in self.result.named
            if any(parameters[k].effect == e for k in first.index)
            and (kind == "impossible" or first.name in strength_names(self.search.estimator, (e,)))
        ]  # fmt: skip
        self.result.refused.append(refusal_of_value(" + ".join(effects), kind, first))
        if effects:
            self._take_out(effects)
        else:
            self.as_given[list(first.index)] = True
        return True

    def _refuses_inconsistent(self) -> bool:
        """Refuse a further effect for its strength, and refit the rest. Returns whether it did."""
        if len(self.result.named) < 2 or not self.search.learned:
            return False
        consistency = consistencies_of_named(self.search, self.result)
        first = self.result.named[0].replace("_", " ")
        for effect in reversed(self.result.named[1:]):
            if effect in consistency and not consistency[effect].holds:
                differs = consistency[effect].standard_deviation
                reason = (
                    f"beside {first} its strength would have to differ by {differs:.0%} "
                    "between payloads, signals and frequencies"
                )
                self.result.refused += refusals([effect], "inconsistent", reason, differs)
                self._take_out([effect])
                return True
        return False

    def _failing(self, fit: AcceptedFit) -> list[RefusedEffect]:
        """Effects that do not lower the held-out error, and signals whose error rises too much."""
        found = []
        for effect in self.result.named:
            without = self._without(effect, fit)
            if not lowers_held_out_error(
                fit.errors, without.errors, self.search.learned, self.settings
            ) or self._fraction(fit) >= min(1.0, self._fraction(without)):
                rest = " + ".join(e for e in self.result.named if e != effect)
                beside = f" beside {rest.replace('_', ' ')}" if rest else ""
                value = fit.errors.fraction_of(without.errors)
                value = value if rest else max(value, self._fraction(fit))
                reason = (
                    f"it does not lower the error on what was left out{beside}: "
                    f"{value:.1%} of the error without it"
                )
                found += refusals([effect], "held-out error", reason, value, 1.0)
        limit = 1 + self.settings.harm_fraction
        for signal, ratio in fit.errors.ratios(self.held_out.given).items():
            if ratio > limit:
                reason = (
                    f"the held-out error of {signal} would be {ratio:.1%} of that of the plant "
                    "as given"
                )
                found += refusals([""], "rise of a signal", reason, ratio, limit, signal)
        return found

    def _without(self, effect: str, fit: AcceptedFit) -> AcceptedFit:
        """Fit of the same kind without one effect."""
        free: Array = fit.free & ~self.search.of[effect]
        if np.any(free & ~self.search.base):
            return self._fit(self._refitted(fit.point.values, free), free)
        if np.any(free & self.nuisance & self._written(free)):
            return self._fit(self.result.before, free)
        return AcceptedFit(fit.point, free, self.held_out.given)

    def _refuse(self, fit: AcceptedFit, failing: list[RefusedEffect]) -> None:
        """Take out the effect without which the held-out error is least."""
        blamed = [row for row in failing if row.effect]
        names = [row.effect for row in blamed] or list(self.result.named)
        worst = min(names, key=lambda e: self._fraction(self._without(e, fit)))
        row = next((r for r in failing if r.effect in ("", worst)), failing[0])
        if not row.effect:
            row = msgspec.structs.replace(row, effect=worst)
        self.result.refused.append(row)
        self._take_out([worst])

    def _take_out(self, effects: list[str]) -> None:
        """Remove effects from the named ones and refit the rest."""
        self.result.named = [e for e in self.result.named if e not in effects]
        free = self.search.free(self.result.named)
        if not self.result.named:
            self.result.after = self.result.before
            return
        self.result.after = self._refitted(self.result.after.values, free)
        self.result.explore(self.result.named, self.result.after)
