"""Rival hypotheses: sets of effects that a diagnosis could not tell apart."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Final

import msgspec
import numpy as np

from firmware_py.core.errors import InputError
from models.gap.decision.look_alikes import HELD_PROBABILITY
from models.gap.residuals.fit_parameters import plant_with_every_effect
from models.plant.identification.residual_spectra import FitParameter
from models.plant.plant import Plant
from models.plant.step_model import Array

MOST_RIVALS: Final = 6
"""Most hypotheses that motions are ranked for, the most probable first; 15 pairs [assumed]."""
RIVAL_PROBABILITY: Final = 0.02
"""Least probability of a hypothesis that counts; the two most probable always do. With 0.95 at the
first, the others together would be less than what a set that holds 0.95 leaves out [assumed]."""


class HypothesisRecord(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Set of effects that may be missing, and its probability; an empty set means nothing.

    `parameters` holds the fitted values by the name of the plant's parameter, nuisance included.
    """

    effects: tuple[str, ...]
    probability: Annotated[float, msgspec.Meta(ge=0, le=1)]
    parameters: dict[str, float]

    @property
    def label(self) -> str:
        return " + ".join(self.effects) or "nothing missing"


def rivals_of(hypotheses: Sequence[HypothesisRecord]) -> tuple[HypothesisRecord, ...]:
    """Hypotheses worth separating, the most probable first.

    A set that contains another listed one adds an effect too small to show: no motion separates the
    two, so its probability is shared equally among the sets that it contains.
    """
    sets = [frozenset(h.effects) for h in hypotheses]
    least = [
        k for k, effects in enumerate(sets) if not any(other and other < effects for other in sets)
    ]
    shared = dict.fromkeys(least, 0.0)
    for effects, hypothesis in zip(sets, hypotheses, strict=True):
        within = [k for k in least if sets[k] == effects or (sets[k] and sets[k] < effects)]
        for k in within:
            shared[k] += hypothesis.probability / len(within)
    total = sum(shared.values())
    if hypotheses and not total:
        raise InputError("gap.json", "gives no hypothesis a probability", "diagnose again")
    merged = [
        msgspec.structs.replace(hypotheses[k], probability=p / total) for k, p in shared.items()
    ]
    ranked = sorted(merged, key=lambda r: (-r.probability, r.effects))
    counted = [r for k, r in enumerate(ranked) if k < 2 or r.probability >= RIVAL_PROBABILITY]
    return tuple(counted[:MOST_RIVALS])


def credible_set(rivals: Sequence[HypothesisRecord]) -> tuple[HypothesisRecord, ...]:
    """Fewest hypotheses that hold 95 % together, the most probable first."""
    before = np.cumsum([0.0, *(r.probability for r in rivals)])
    return tuple(
        r for r, reached in zip(rivals, before, strict=False) if reached < HELD_PROBABILITY
    )


def fitted_values_of(
    hypothesis: HypothesisRecord, plant: Plant, fit_parameters: Sequence[FitParameter]
) -> Array:
    """Values of the fit parameters at a hypothesis, shape (p,); variations of trials are zero.

    An effect goes first: a nuisance may move the same parameter, as the synchronisation does. The
    effect of all servos and that of one may move the same parameters too.
    """
    full = plant_with_every_effect(plant).parameters
    names = [n for n in hypothesis.parameters if n in full]
    change = np.array([hypothesis.parameters[n] - full[n].value for n in names])
    values = np.zeros(len(fit_parameters))
    for kind, candidates in (("effect", hypothesis.effects), ("nuisance", ("",))):
        columns = [
            k for k, q in enumerate(fit_parameters) if q.kind == kind and q.effect in candidates
        ]
        weights = np.array(
            [[fit_parameters[k].parameters.get(n, 0.0) for k in columns] for n in names]
        )
        if weights.size:
            values[columns] = np.linalg.lstsq(weights, change, rcond=None)[0]
            change = change - weights @ values[columns]
    low, high = ([getattr(q, end) for q in fit_parameters] for end in ("low", "high"))
    return np.clip(values, low, high)
