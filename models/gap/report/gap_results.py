"""Gap document from the results of a diagnosis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import msgspec
import numpy as np

from models.gap.decision.posterior import Hypothesis, effect_probabilities
from models.gap.diagnosis import Diagnosis
from models.gap.improved_plant import written_values
from models.gap.inclusion import Inclusion
from models.gap.report.changed_conditions import changed_conditions
from models.gap.report.gap_json import (
    FittedValue,
    GapDocument,
    HeldOutSignal,
    HeldOutSummary,
    HypothesisRecord,
    LocatedRegion,
    MappedRegion,
    NamedEffect,
    NamingEvidence,
    NoiseFloorSummary,
    OwnError,
    RemainingGap,
    SeparatingMotion,
    SignalFloor,
    SignalGap,
    SimilarEffect,
    WaterfallStep,
)
from models.gap.report.separating_motion import separating_motion
from models.gap.residuals.fit_parameters import plant_with_searched_effects
from models.gap.residuals.localisation import GapRegion, location_sentence
from models.plant.identification.evaluation import compare_with_trials, signal_errors
from models.plant.identification.noise_floor import Array
from models.plant.parameter import AT_BOUND, Parameter, bound_reached
from models.plant.plant import Plant
from models.trials.trial import Trial, TrialSet

__all__ = ["errors_in_floors", "gap_document"]

MOST_LOCATED: Final = 40
MOST_REMAINING: Final = 10
"""Most significant regions that are listed before and after; `map` holds all."""
LISTED_PROBABILITY: Final = 0.01
"""Least probability of an effect that is listed."""


def gap_document(
    found: Diagnosis, trials: TrialSet, waterfall: Sequence[tuple[str, float]] = ()
) -> GapDocument:
    """Gap document of a diagnosis.

    Parameters
    ----------
    found : Diagnosis
        Results of the diagnosis.
    trials : TrialSet
        Trials that were diagnosed, without the outliers.
    waterfall : sequence of tuple
        Steps and errors of `models.gap.report.waterfall.waterfall_steps`.

    Returns
    -------
    GapDocument
        Content of `gap.json`, rounded; `inputs` is not set.
    """
    floor = noise_floor_rms(found)
    unused = found.goal_not_followed_at_row
    fit, held_out = trials.split()
    parts = {"fitted": fit, "held_out": held_out} if len(held_out) else {"fitted": fit}
    before, after = (
        {part: errors_in_floors(plant, own, floor, unused) for part, own in parts.items()}
        for plant in (found.plant, found.improved)
    )
    return GapDocument(
        schema=GapDocument.VERSION,
        verdict=found.verdict,
        gap_left_fraction=round(found.gap_left_fraction, 4),
        noise_floor=NoiseFloorSummary(
            found.floor.learned, floor, round(found.dispersion, 4),
            {key: OwnError(*known) for key, known in found.own_error.items()},
            {f"{kg:g}": round(power**0.5, 2) for kg, power in found.amplification_power.items()},
        ),
        nuisance_bias=found.nuisance_bias,
        goal_not_followed_at_row=unused,
        sentence=_place(found, found.located),
        located=_located(found.located, MOST_LOCATED),
        map=tuple(
            MappedRegion(c.signal, c.factor, c.level, round(c.floors, 3), c.significant)
            for c in found.located
        ),
        named=tuple(_named(found, trials, inclusion) for inclusion in found.inclusions),
        before=before,
        after=after,
        remaining=RemainingGap(
            _place(found, found.remaining), _located(found.remaining, MOST_REMAINING)
        ),
        rejected=found.rejected,
        waterfall=tuple(WaterfallStep(step, floors) for step, floors in waterfall),
        settings=found.settings,
        rows_fitted=found.rows_fitted,
        refused=found.refused,
        refitted=_refitted(found),
        held_out=HeldOutSummary(
            found.left_out,
            {
                s: HeldOutSignal(given, found.held_out_improved[s])
                for s, given in found.held_out_given.items()
            },
        ),
        changed_conditions=changed_conditions(found.plant.provenance, found.floor, trials),
        unexplained_fraction=round(found.unexplained_fraction, 4),
        hypotheses=tuple(_hypothesis(found, h) for h in found.hypotheses),
        effect_probabilities=_listed(effect_probabilities(found.hypotheses)),
        tested=found.tested if found.floor.learned else (),
        odd_trials=found.odd,
    )  # fmt: skip


def _refitted(found: Diagnosis) -> dict[str, FittedValue]:
    """Parameters of the link that were refitted and written, where nothing is named."""
    before = found.plant.parameters
    return {
        name: _fitted(q, before)
        for name, q in found.improved.parameters.items()
        if not found.named and name in before and q.value != before[name].value
    }


def _fitted(q: Parameter, before: Mapping[str, Parameter]) -> FittedValue:
    known = before[q.name].value if q.name in before else 0.0
    none_of_it = q.name not in before and abs(q.value) <= AT_BOUND * (q.high - q.low)
    return FittedValue(q.value, q.unit, q.error, known, None if none_of_it else bound_reached(q))


def _listed(probabilities: Mapping[str, float]) -> dict[str, float]:
    return {e: round(p, 4) for e, p in probabilities.items() if p >= LISTED_PROBABILITY}


def _hypothesis(found: Diagnosis, hypothesis: Hypothesis) -> HypothesisRecord:
    full = plant_with_searched_effects(found.plant, hypothesis.effects)
    values = written_values(full, found.fit_parameters, hypothesis.values, hypothesis.free)
    return HypothesisRecord(hypothesis.effects, round(hypothesis.probability, 4), values)


def _place(found: Diagnosis, regions: Sequence[GapRegion]) -> str:
    """Where a gap is, in words; without a learned floor nothing can be called noise."""
    if not found.floor.learned and not any(region.significant for region in regions):
        return "No part of the trials stands out from the spectrum of the residual itself."
    return location_sentence(regions, found.settings)


def noise_floor_rms(found: Diagnosis) -> dict[str, SignalFloor]:
    """Noise floor of each signal as root mean squares over the spectrum."""
    floor = found.floor
    return {
        s: SignalFloor(
            _rms(floor.noise[s]), _rms(floor.model[s]), _rms(floor.noise[s] + floor.model[s])
        )
        for s in floor.noise
    }


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
    result = {}
    for signal, row in signal_errors(plant, compared).items():
        if not np.isfinite(row.rms):  # not measured in the rows that are used
            continue
        size = floor[signal].rms if signal in floor else np.nan
        result[signal] = SignalGap(row.rms, row.unit, _number(row.rms / size) if size > 0 else None)
    return result


def _named(found: Diagnosis, trials: TrialSet, inclusion: Inclusion) -> NamedEffect:
    """Inclusion with its effects, values, evidence and look-alikes."""
    consistencies = [
        found.strength_consistency[e] for e in inclusion.effects if e in found.strength_consistency
    ]
    before, separated_by = found.plant.parameters, None
    if inclusion.look_alikes:
        motion, sizes = separating_motion(found, trials, inclusion.look_alikes)
        separated_by = SeparatingMotion(motion, {k: round(v, 2) for k, v in sizes.items()})
    return NamedEffect(
        effect=" + ".join(inclusion.effects),
        kept=inclusion.kept,
        parameters={
            name: _fitted(q, before)
            for direction in found.fit_parameters if direction.effect in inclusion.effects
            for name in direction.parameters if (q := found.fitted.parameters.get(name))
        },
        evidence=NamingEvidence(
            separation=inclusion.separation,
            least=inclusion.least,
            held_out_gain=_number(inclusion.held_out_gain),
            held_out_error=_number(inclusion.held_out_error),
            strength_standard_deviation=max(
                (c.standard_deviation for c in consistencies), default=0.0
            ),
            strength_holds=all(c.holds for c in consistencies),
        ),
        look_alikes=tuple(
            SimilarEffect(" + ".join(c.effects), c.separation) for c in inclusion.look_alikes
        ),
        separated_by=separated_by,
    )  # fmt: skip


def _located(regions: Sequence[GapRegion], most: int) -> tuple[LocatedRegion, ...]:
    """Largest significant regions."""
    return tuple(
        msgspec.convert(
            {
                "signal": c.signal, c.factor: c.level, "size": round(c.floors, 3),
                "mean": round(c.mean, 3), "p": round(c.p, 4),
            },
            LocatedRegion,
        )
        for c in [c for c in regions if c.significant][:most]
    )  # fmt: skip


def _rms(variance: Array) -> float:
    return float(np.sqrt(np.mean(variance)))


def _number(value: float) -> float | None:
    """None instead of a float that is not finite."""
    return float(value) if np.isfinite(value) else None
