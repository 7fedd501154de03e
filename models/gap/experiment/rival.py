"""Rival hypotheses: sets of effects that a diagnosis could not tell apart."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from firmware_py.errors import InputError
from models.gap.decision.look_alikes import HELD_PROBABILITY
from models.gap.report.gap_json import HypothesisRecord
from models.gap.residuals.fit_parameters import FitParameter, plant_with_every_effect
from models.plant.effects import EFFECTS
from models.plant.identification.noise_floor import Array
from models.plant.plant import Plant

MOST_RIVALS: Final = 6
"""Most hypotheses that a motion is designed for, the most probable first; 15 pairs [assumed]."""
RIVAL_PROBABILITY: Final = 0.02
"""Least probability of a hypothesis that counts; the two most probable always do. With 0.95 at the
first, the others together would be less than what a set that holds 0.95 leaves out [assumed]."""
BOUND_SLACK: Final = 1e-6
"""Fraction of a bound by which a value may exceed it [numerical]."""


@dataclass(frozen=True)
class Rival:
    """Hypothesis of a diagnosis."""

    effects: tuple[str, ...]  # Effects that would be missing; empty if nothing is
    probability: float  # Posterior probability, including that of its supersets
    parameters: Mapping[str, float]  # Fitted values by name of the plant's parameter

    @property
    def label(self) -> str:
        return " + ".join(self.effects) or "nothing missing"


def rivals_of(hypotheses: Sequence[HypothesisRecord]) -> tuple[Rival, ...]:
    """Hypotheses worth separating, the most probable first.

    A set that contains another listed one adds an effect too small to show: no motion separates the
    two, so its probability is shared equally among the sets that it contains.
    """
    listed = [h for h in hypotheses if h.effects]
    sets = [frozenset(h.effects) for h in listed]
    least = [k for k, own in enumerate(sets) if not any(other < own for other in sets)]
    gained = {k: 0.0 for k in least}
    for own, hypothesis in zip(sets, listed, strict=True):
        held = [k for k in least if sets[k] <= own]
        for k in held:
            gained[k] += hypothesis.probability / len(held)
    rivals = [Rival(listed[k].effects, p, listed[k].parameters) for k, p in gained.items()]
    rivals += [Rival((), h.probability, h.parameters) for h in hypotheses if not h.effects]
    total = sum(r.probability for r in rivals)
    unknown = {e for r in rivals for e in r.effects} - EFFECTS.keys()
    if unknown or (rivals and not total):
        what = f"names {min(unknown)!r}" if unknown else "gives no hypothesis a probability"
        raise InputError("gap.json", what, "diagnose again")
    ranked = sorted(rivals, key=lambda r: (-r.probability, r.effects))
    ranked = [replace(r, probability=r.probability / total) for r in ranked]
    kept = [r for k, r in enumerate(ranked) if k < 2 or r.probability >= RIVAL_PROBABILITY]
    return tuple(kept[:MOST_RIVALS])


def fitted_values_of(rival: Rival, plant: Plant, fit_parameters: Sequence[FitParameter]) -> Array:
    """Values of the fit parameters at a hypothesis, shape (p,); variations of trials are zero."""
    full = plant_with_every_effect(plant).parameters
    values = np.zeros(len(fit_parameters))
    taken: set[str] = set()
    order = sorted(range(len(values)), key=lambda k: fit_parameters[k].kind != "effect")
    for k in order:  # an effect first: the synchronisation is a nuisance with the same parameter
        q = fit_parameters[k]
        first = next(iter(q.parameters), "")
        if q.trial is not None or first in taken or first not in rival.parameters:
            continue
        if q.effect and q.effect not in rival.effects:
            continue
        taken.update(q.parameters)
        values[k] = (rival.parameters[first] - full[first].value) / q.parameters[first]
        slack = BOUND_SLACK * max(abs(q.low), abs(q.high))
        if not q.low - slack <= values[k] <= q.high + slack:
            what = f"hypothesis {rival.label!r}: {first} is {rival.parameters[first]:g}"
            raise InputError("gap.json", f"{what}, beyond its bounds", "diagnose again")
    return values


def credible_set(rivals: Sequence[Rival], held: float = HELD_PROBABILITY) -> tuple[Rival, ...]:
    """Fewest hypotheses that together reach a probability, the most probable first."""
    total, kept = 0.0, []
    for rival in rivals:
        kept.append(rival)
        total += rival.probability
        if total >= held:
            break
    return tuple(kept)
