"""Gap document from the results of a diagnosis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import msgspec
import numpy as np

from models.gap.decision.certainty import Answers
from models.gap.decision.look_alikes import Hypothesis, effect_probabilities
from models.gap.diagnosis import Diagnosis
from models.gap.report.gap_json import (
    FittedValue,
    GapDocument,
    HeldOutSummary,
    HypothesisRecord,
    MappedRegion,
    NamedEffect,
    NamingEvidence,
    NoiseFloorSummary,
    RefusedEffects,
    RejectedEffect,
    SignalFloor,
    SignalGap,
    SimilarEffects,
    WrittenPlant,
)
from models.gap.report.gap_words import headline, in_percent, joined
from models.gap.report.separating_motion import separating_motion
from models.gap.report.trial_notes import changed_conditions
from models.gap.residuals.fit_parameters import plant_with_searched_effects, written_values
from models.gap.residuals.localisation import GapRegion, location_sentence
from models.gap.search.effect_search import SetFit
from models.plant.identification.evaluation import compare_with_trials, signal_errors
from models.plant.parameter import Parameter
from models.plant.plant import Plant
from models.plant.step_model import Array
from models.shared.catalogue import effect_and_joint
from models.trials.trial import Trial

MOST_LOCATED: Final = 40
"""Most significant regions that are listed; `map` holds all."""
LISTED_PROBABILITY: Final = 0.01
"""Least probability of an effect that is listed."""
UNEXCITED: Final = "these trials hardly excite it"


def gap_document(diagnosis: Diagnosis) -> GapDocument:
    """Results of a diagnosis as the content of `gap.json`.

    Parameters
    ----------
    diagnosis : Diagnosis
        Results of `models.gap.diagnosis.diagnose`.

    Returns
    -------
    GapDocument
        Document without `inputs`, which only the command knows.

    Examples
    --------
    With the `diagnosis` in the example of `diagnose`:

    >>> import dropstitch
    >>> document = dropstitch.gap_document(diagnosis)
    >>> document.verdict, [row.effect for row in document.named]
    ('no floor', ['coulomb_friction'])
    """
    floor = noise_floor_rms(diagnosis)
    residuals = diagnosis.nuisance.estimator.residuals
    unused, held_out = residuals.goal_not_followed(), diagnosis.written.errors.rms()
    left, learned = diagnosis.gap_left_fraction, diagnosis.floor.learned
    before, after = (
        {
            "fitted": errors_in_floors(plant, diagnosis.trials, floor, unused),
            "held_out": _held_out_in_floors(plant, diagnosis.trials, rms, floor),
        }
        for plant, rms in (
            (diagnosis.plant, diagnosis.held_out_baseline.rms()),
            (diagnosis.improved, held_out),
        )
    )
    document = GapDocument(
        schema=GapDocument.VERSION,
        verdict=diagnosis.verdict,
        probabilities=diagnosis.answers,
        separation_of_nothing=round(diagnosis.separation_of_nothing, 2),
        gap_left_fraction=left if left is None else round(left, 4),
        named=tuple(_named(diagnosis)),
        refused=tuple(_refused(diagnosis)),
        rejected=tuple(_rejected(diagnosis)),
        effect_probabilities={
            e: round(p, 4)
            for e, p in effect_probabilities(diagnosis.hypotheses).items()
            if learned and p >= LISTED_PROBABILITY
        },
        hypotheses=tuple(_hypothesis(diagnosis, h) for h in diagnosis.hypotheses),
        written=_written(diagnosis),
        sentence=_place(diagnosis, diagnosis.located),
        located=mapped([c for c in diagnosis.located if c.significant][:MOST_LOCATED]),
        map=mapped(diagnosis.located),
        noise_floor=NoiseFloorSummary(
            learned,
            floor,
            diagnosis.nuisance.measured.knowledge(),
            {f"{kg:g}": round(p**0.5, 2) for kg, p in diagnosis.floor.amplification_power.items()},
        ),
        before=before,
        after=after,
        held_out=HeldOutSummary(diagnosis.left_out, round(diagnosis.unexplained_fraction, 4)),
        odd_trials=diagnosis.outliers,
        changed_conditions=changed_conditions(
            diagnosis.plant.provenance, diagnosis.floor, diagnosis.trials
        ),
        rows_fitted={
            t.name: len(t)
            for t, whole in zip(residuals.trials, diagnosis.trials, strict=True)
            if len(t) < len(whole)
        },
        goal_not_followed_at_row=unused,
        settings=diagnosis.settings,
    )
    return msgspec.structs.replace(document, headline=headline(document))


def mapped(regions: Sequence[GapRegion]) -> tuple[MappedRegion, ...]:
    return tuple(
        MappedRegion(
            c.signal, c.factor, c.level, round(c.floors, 3), round(c.mean, 3), round(c.p, 4),
            c.significant,
        )
        for c in regions
    )  # fmt: skip


def noise_floor_rms(diagnosis: Diagnosis) -> dict[str, SignalFloor]:
    """Noise floor of each signal as root mean squares over the spectrum."""

    def rms(variance: Array) -> float:
        return float(np.sqrt(np.mean(variance)))

    noise, model = diagnosis.floor.noise, diagnosis.floor.model
    return {s: SignalFloor(rms(n), rms(model[s]), rms(n + model[s])) for s, n in noise.items()}


def errors_in_floors(
    plant: Plant,
    trials: Sequence[Trial],
    floor: Mapping[str, SignalFloor],
    goal_not_followed_at_row: Mapping[str, int],
) -> dict[str, SignalGap]:
    """Root mean square of each signal's error, and the same in noise floors."""
    compared = []
    for c in compare_with_trials(plant, trials):
        end = goal_not_followed_at_row.get(c.trial.name, len(c.trial))
        unused = np.where(np.arange(len(c.trial)) < end, 0.0, np.nan)
        compared.append(replace(c, simulated={s: y + unused for s, y in c.simulated.items()}))
    return {
        signal: _in_floors(row.rms, row.unit, floor.get(signal))
        for signal, row in signal_errors(plant, compared).items()
        if np.isfinite(row.rms)  # measured in the rows that are used
    }


def _held_out_in_floors(
    plant: Plant,
    trials: Sequence[Trial],
    errors: Mapping[str, float],
    floor: Mapping[str, SignalFloor],
) -> dict[str, SignalGap]:
    outputs = plant.step_model(trials[0].meta.dof, "twin").outputs
    units = {v.name: v.unit for v in outputs}
    return {s: _in_floors(rms, units[s], floor.get(s)) for s, rms in errors.items()}


def _in_floors(rms: float, unit: str, floor: SignalFloor | None) -> SignalGap:
    return SignalGap(rms, unit, rms / floor.rms if floor and floor.rms > 0 else None)


def _place(diagnosis: Diagnosis, regions: Sequence[GapRegion]) -> str:
    """Where a gap is, in words; without a learned floor nothing can be called noise."""
    if diagnosis.floor.learned:
        return location_sentence(regions)
    if not any(region.significant for region in regions):
        return "No part of the trials stands out from the spectrum of the residual itself."
    return location_sentence(regions).replace("noise floors", "times its mean")


def _named(diagnosis: Diagnosis) -> list[NamedEffect]:
    """Named effects, each with what it adds to those named before it."""
    gain = _gains(diagnosis)
    rows: list[NamedEffect] = []
    for k, name in enumerate(diagnosis.named):
        first = frozenset(diagnosis.named[:k])
        reached = gain.get(first | {name}, diagnosis.naming.fit.gain)
        separation = _separation(reached - gain.get(first, 0.0))
        alike = diagnosis.look_alikes.get(name, ())
        effect, joint = effect_and_joint(name)
        rows.append(
            NamedEffect(
                effect=effect,
                joint=joint,
                parameters=_values_of(diagnosis, name),
                evidence=NamingEvidence(
                    separation,
                    diagnosis.separation_of_nothing,
                    diagnosis.evidence.difference,
                    diagnosis.evidence.residual,
                ),
                look_alikes=tuple(
                    SimilarEffects(_beside(diagnosis, other), other.separation) for other in alike
                ),
                separated_by=separating_motion(diagnosis, alike) if alike else None,
            )
        )
    return rows


def _values_of(diagnosis: Diagnosis, name: str) -> dict[str, FittedValue]:
    before, fitted = diagnosis.plant.parameters, diagnosis.fitted.parameters
    return {
        p: _fitted(fitted[p], before)
        for direction in diagnosis.nuisance.estimator.residuals.fit_parameters
        if direction.effect == name
        for p in direction.parameters
        if p in fitted
    }


def _fitted(q: Parameter, before: Mapping[str, Parameter]) -> FittedValue:
    return FittedValue(q.value, q.unit, q.error, before[q.name].value if q.name in before else 0.0)


def _beside(diagnosis: Diagnosis, fit: SetFit) -> tuple[str, ...]:
    """Effects of a fit that are not named."""
    return tuple(c for c in fit.candidates if c not in diagnosis.named)


def _gains(diagnosis: Diagnosis) -> dict[frozenset[str], float]:
    """Fall of the cost by set of effects, from the fit of the nuisance.

    A candidate that was not refitted alone has that of its screen.
    """
    naming = diagnosis.naming
    screened = {frozenset({name}): d**2 / 2 for name, d in naming.search.screened.items()}
    refitted = {frozenset(f.candidates): f.gain for f in (*naming.explored, naming.fit)}
    return screened | refitted | {frozenset(): 0.0}


def _separation(gain: float) -> float:
    return float(np.sqrt(max(2 * gain, 0.0)))


def _written(diagnosis: Diagnosis) -> WrittenPlant:
    before = diagnosis.plant.parameters
    changed = {
        name: _fitted(q, before)
        for name, q in diagnosis.improved.parameters.items()
        if name not in before or q.value != before[name].value
    }
    return WrittenPlant(diagnosis.written.candidates, changed, diagnosis.written.refused)


def _refused(diagnosis: Diagnosis) -> list[RefusedEffects]:
    """Named effects that are not written, and the best ones that are not named."""
    naming, rows = diagnosis.naming, []
    if lacking := tuple(n for n in diagnosis.named if n not in diagnosis.written.candidates):
        reason = diagnosis.written.refused
        rows.append(RefusedEffects(lacking, "not written", naming.fit.separation, reason))
    best = naming.best
    if not diagnosis.named and best.separation > diagnosis.separation_of_nothing:
        if diagnosis.answers is None:
            reason = _fails_held_out(diagnosis)
            rows.append(RefusedEffects(best.candidates, "held-out error", best.separation, reason))
        else:
            reason = _improbable(diagnosis.answers)
            rows.append(RefusedEffects(best.candidates, "improbable", best.separation, reason))
    if diagnosis.named:
        rows += _further(diagnosis)
    return rows


def _improbable(answers: Answers) -> str:
    """Why the best candidate is not named, as a clause."""
    return (
        f"its probability is {in_percent(answers.catalogue)}, that of nothing missing "
        f"{in_percent(answers.nothing)}, that of something outside of the catalogue "
        f"{in_percent(answers.outside)}"
    )


def _fails_held_out(diagnosis: Diagnosis) -> str:
    return (
        f"the error on the {joined(diagnosis.left_out)} left out does not fall enough, or the "
        "strength differs between parts of the trials"
    )


def _further(diagnosis: Diagnosis) -> list[RefusedEffects]:
    """Best effect beside the named ones that noise does not explain, but their equations may."""
    naming, fit = diagnosis.naming, diagnosis.naming.fit
    tried = [f for f in naming.grown if len(f.candidates) > len(fit.candidates)]
    best = next(iter(tried or naming.rounds[-1]), fit)
    added = _separation(best.gain - fit.gain)
    error = diagnosis.settings.equation_error_fraction * fit.separation
    alike = [_beside(diagnosis, f) for fits in diagnosis.look_alikes.values() for f in fits]
    effects = _beside(diagnosis, best)
    if added <= diagnosis.separation_of_nothing or not effects or effects in alike:
        return []
    if not naming.is_learned:
        return [RefusedEffects(effects, "held-out error", added, _fails_held_out(diagnosis))]
    if tried:
        reason = "that it is missing too is less probable than not"
    elif added > np.hypot(diagnosis.separation_of_nothing, error):
        reason = "its strength would have to differ between payloads, signals and frequencies"
    else:
        reason = "errors of the plant and of the named effects' equations may look like it"
    return [RefusedEffects(effects, "further", added, reason)]


def _rejected(diagnosis: Diagnosis) -> list[RejectedEffect]:
    """All effects that are not named, the largest d′ first."""
    naming, search = diagnosis.naming, diagnosis.naming.search
    named = {effect_and_joint(n)[0] for n in diagnosis.named}
    alike = {
        c for fits in diagnosis.look_alikes.values() for f in fits for c in _beside(diagnosis, f)
    }
    alone, beside = _separations(diagnosis)
    rows: dict[str, RejectedEffect] = {}
    for candidate in search.of:
        effect = effect_and_joint(candidate)[0]
        if effect in named:
            continue
        refitted = alone.get(candidate)
        separation = refitted or search.screened.get(candidate) or beside.get(candidate, 0.0)
        if candidate in search.unexcited and separation < diagnosis.separation_of_nothing:
            reason = UNEXCITED
        elif candidate in alike:
            reason = "these trials cannot tell it from what is named"
        elif separation < diagnosis.separation_of_nothing:
            reason = "it explains no more than is reached where nothing is missing"
        elif not diagnosis.named and naming.best.candidates == (candidate,):
            reason = "it stands out, but is refused"
        elif refitted is None:
            reason = "others promise to explain more"
        else:
            reason = "others explain more"
        row = RejectedEffect(effect, separation, reason)
        rows[effect] = max(rows.get(effect, row), row, key=lambda r: r.separation)
    return sorted(rows.values(), key=lambda r: -r.separation)


def _separations(diagnosis: Diagnosis) -> tuple[dict[str, float], dict[str, float]]:
    """d′ of refitted candidates: alone, and beside named ones."""
    gain, alone, beside = _gains(diagnosis), {}, {}
    for fit in diagnosis.naming.explored:
        for candidate in fit.candidates:
            rest = frozenset(fit.candidates) - {candidate}
            if not rest:
                alone[candidate] = fit.separation
            elif rest <= set(diagnosis.named) and rest in gain:
                beside[candidate] = _separation(fit.gain - gain[rest])
    return alone, beside


def _hypothesis(diagnosis: Diagnosis, hypothesis: Hypothesis) -> HypothesisRecord:
    fit = hypothesis.fit
    full = plant_with_searched_effects(diagnosis.plant, hypothesis.effects)
    parameters = diagnosis.nuisance.estimator.residuals.fit_parameters
    values = written_values(full, parameters, fit.point.values, fit.free)
    return HypothesisRecord(hypothesis.effects, round(hypothesis.probability, 4), values)
