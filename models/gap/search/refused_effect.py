"""Refusals: fitted values at a bound, sums that no real body has, effects that fail a test."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

import msgspec
import numpy as np

from models.gap.estimation.gauss_newton import FitPoint
from models.gap.residuals.fit_parameters import FitParameter, plant_with_every_effect
from models.gap.settings import GapSettings
from models.plant.identification.noise_floor import Array
from models.plant.parameter import impossible_sums
from models.plant.plant import Plant


@dataclass(frozen=True)
class OffendingValue:
    """Fitted value at a bound, or a sum beyond its limit."""

    index: tuple[int, ...]  # Fit parameters that cause it
    name: str  # Parameter of the plant or variation, or the sum in words
    unit: str  # SI unit
    value: float
    limit: float
    said: str  # Reason in one sentence


def values_at_bounds(
    plant: Plant,
    fit_parameters: Sequence[FitParameter],
    point: FitPoint,
    free: Array,
    settings: GapSettings,
) -> list[OffendingValue]:
    """Fitted values of nuisance and effects that ended at a bound and differ from the diagnosed
    plant.

    The strength of an effect that the plant lacks also counts at zero, whether that is its bound or
    not, if it is zero in every plane of the bending.

    Shapes: `free` (p,).
    """
    known = plant_with_every_effect(plant).parameters
    found = []
    nears = [settings.at_bound_fraction * (q.high - q.low) for q in fit_parameters]
    present = {
        q.effect for q, value, near in zip(fit_parameters, point.values, nears, strict=True)
        if _is_strength(q) and abs(value) > near
    }  # fmt: skip
    for k, (q, near) in enumerate(zip(fit_parameters, nears, strict=True)):
        value = float(point.values[k])
        if q.trial is not None or not free[k] or not np.isfinite(q.high - q.low):
            continue
        vanished = _is_strength(q) and q.low <= 0.0 <= q.high and q.effect not in present
        unmoved = abs(value) <= near and not vanished
        if unmoved or (min(value - q.low, q.high - value) > near and not vanished):
            continue
        bound, side = (q.high, "upper") if q.high - value <= near else (q.low, "lower")
        if vanished and q.low < 0.0:
            bound, side = 0.0, ""
        name = next(iter(q.parameters), q.name)
        first = known.get(name) if q.name != "synchronisation" else None
        weight = q.parameters.get(name, 1.0) if first else 1.0
        start, unit = (first.value, first.unit) if first else (0.0, "s")
        limit = start + weight * bound
        place = f"at its {side} bound of" if side else "where it began, at"
        said = f"{q.name} ended {place} {limit:.4g}" + (f" {unit}" if unit != "1" else "")
        found.append(OffendingValue((k,), q.name, unit, start + weight * value, limit, said))
    return found


def _is_strength(q: FitParameter) -> bool:
    """Whether a fit parameter is the strength of an effect: only those have no prior."""
    return bool(q.effect) and np.isinf(q.standard_deviation)


def impossible_values(
    given: Plant,
    written: Plant,
    payloads_kg: Sequence[float],
    fit_parameters: Sequence[FitParameter],
    free: Array,
) -> list[OffendingValue]:
    """Sums whose limits the plant to be written exceeds and the diagnosed plant does not.

    Shapes: `free` (p,).
    """
    before = {
        row.what
        for row in impossible_sums({n: q.value for n, q in given.parameters.items()}, payloads_kg)
    }
    found = []
    values = {n: q.value for n, q in written.parameters.items()}
    for row in impossible_sums(values, payloads_kg):
        index = tuple(
            k for k, q in enumerate(fit_parameters)
            if free[k] and q.trial is None and set(row.parameters) & set(q.parameters)
        )  # fmt: skip
        if row.what in before or not index:
            continue
        parts = " and ".join(row.parameters)
        said = f"{parts} make a {row.what} of {row.value:.4g} {row.unit}, which cannot be"
        found.append(OffendingValue(index, row.what, row.unit, row.value, 0.0, said))
    return found


RefusalKind = Literal[
    "at a bound", "impossible", "inconsistent", "held-out error", "rise of a signal", "not written",
    "stand-in", "improbable",
]  # fmt: skip
"""A value ended at a bound; a sum that no real body has; the strength of a further effect differs;
the effect does not lower the held-out error; some signal's held-out error would rise by more than
`GapSettings.harm_fraction`; one of the last two, but the effect is probable enough to be named,
though not written; the effect more probably stands in for something else; more probably nothing is
missing."""


class RefusedEffect(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Effect that was taken out again, or a refitted value that was undone."""

    # Name, or several joined by " + "; empty for a nuisance value, which then keeps the plant's
    # value
    effect: str
    kind: RefusalKind
    reason: str  # Reason as one sentence without its full stop
    name: str  # Parameter, sum or signal that caused it; empty for all signals together
    # Its value; a held-out error is a fraction of that without the effect or of the diagnosed plant
    value: float
    limit: float  # Limit of this value
    unit: str


def refusal_of_value(effect: str, kind: RefusalKind, found: OffendingValue) -> RefusedEffect:
    return RefusedEffect(
        effect=effect, kind=kind, reason=found.said, name=found.name, value=found.value,
        limit=found.limit, unit=found.unit,
    )  # fmt: skip


def refusals(
    effects: Iterable[str], kind: RefusalKind, reason: str, value: float = 0.0,
    limit: float = 0.0, name: str = "",
) -> list[RefusedEffect]:  # fmt: skip
    return [
        RefusedEffect(
            effect=e, kind=kind, name=name, value=value, limit=limit, unit="1", reason=reason
        )
        for e in effects
    ]
