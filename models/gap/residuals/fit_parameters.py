"""Fit parameters of a diagnosis: nuisance, variation between trials, and possible effects.

By chance a nuisance goes only so far, see `models.plant.identification.trial_variation`. A clock
error common to all trials is the nuisance `synchronisation`, up to what counts as synchronised
(`CLOCK_LIMIT_S`).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from models.plant.components import DRIVES, LOADS
from models.plant.document import CLOCK_LIMIT_S
from models.plant.effects import EFFECTS, applicable
from models.plant.identification.evaluation import TIP
from models.plant.identification.residual_spectra import FitParameter
from models.plant.identification.trial_variation import trial_variation
from models.plant.parameter import Parameter
from models.plant.plant import Plant, scope_of
from models.plant.step_model import Array
from models.shared.catalogue import effect_and_joint
from models.trials.trial import Trial

NUISANCE_PRIOR_FRACTION: Final = {
    "_stiffness_": 0.02,
    "root_limit_moment_nm": 0.008,
    "_damping_": 0.04,
    "link_mass_kg": 0.02,
}
"""Standard deviation of a nuisance parameter of the link, as a fraction of its value, by a part of
its name: a fifth of 10 % for stiffness and mass, 20 % for damping [assumed] and 4 % for the limit
moment, which stayed within 5 % on links of drawn rigs that changed. A fifth, since errors of
equations make the cost of a large gap some 25 times too certain (docs/decisions.md, "Gap
workflow"). The limit moment changes with the pressure, as the stiffness does: fixed, a change of
the link went into the variation of pressure between trials."""
SAME_LINK_FRACTION: Final = 0.3
"""Factor on these where the link is the one that the plant was identified on: what its estimates
miss, and what a day changes [assumed]."""
BOUND_PRIOR_FRACTION: Final = 0.25
"""Standard deviation of a nuisance parameter of other loads, as a fraction of the distance between
its bounds [assumed]."""
KNOWN_VALUE_FRACTION: Final = 0.05
"""Standard deviation of a nuisance parameter of such a plant, as a fraction of its value
[assumed]."""
FRAME_SHIFT_PRIOR_M: Final = 0.005
"""Standard deviation of the mocap frame's shift that is common to all trials [assumed]."""
FRAME_TURN_PRIOR_RAD: Final = {"joint": 0.0005, "other": 0.005}
"""Standard deviation of the mocap frame's turn, common to all trials, about a joint's axis and
about another one [assumed]: 5 mrad as the shift over a metre; about a joint's axis 0.1 mm over the
0.2 m of a calibration square, since a larger turn there looks like an encoder's offset."""

FRAME_TURNS: Final = {
    "marker_frame_roll_rad": "x", "marker_frame_tilt_rad": "y", "marker_frame_yaw_rad": "z",
}  # fmt: skip
"""Axis of each turn of the mocap frame. Joint 1 turns about y, joint 2 about −x."""


def plant_with_every_effect(plant: Plant) -> Plant:
    """Plant with every effect that it can have; added effects have zero strength."""
    return plant_with_searched_effects(plant, candidate_effects(plant))


def plant_with_searched_effects(plant: Plant, candidates: Sequence[str]) -> Plant:
    """Plant with the effects of some candidates; added effects have zero strength."""
    names = list(dict.fromkeys(effect_and_joint(c)[0] for c in candidates))
    full = plant.with_effects(*names)
    added = [EFFECTS[e].search_start for e in names if e not in plant.effects]
    start = {n: v for values in added for n, v in values.items() if n in full.parameters}
    return full.with_values(start)


def candidate_effects(plant: Plant) -> list[str]:
    """Effects that may be missing: all that a plant of this kind can have.

    For a plant other than the link, the effects that it already has are nuisance. If it was
    identified on the trials of the diagnosis, they compensated for what was missing; otherwise they
    absorb the error of their equations.
    """
    effects = applicable(DRIVES[plant.drive], LOADS[plant.load])
    if LOADS[plant.load].kind == "link":
        return effects
    return [name for name in effects if name not in plant.effects]


def all_fit_parameters(
    plant: Plant,
    trials: Sequence[Trial],
    catalogue: Sequence[str],
    is_known: bool = False,
    same_link: bool = False,
) -> list[FitParameter]:
    """Fit parameters of nuisance, trial variation and every candidate of a catalogue.

    `is_known`: whether a plant of another load was identified, and on none of these trials.
    `same_link`: whether the link is the one that the plant was identified on.
    """
    dof = trials[0].meta.dof
    effects = [
        q
        for e in catalogue
        for parameters in effect_candidates(plant, e, dof).values()
        for q in parameters
    ]
    return nuisance_and_variation(plant, trials, is_known, same_link) + effects


def is_known_elsewhere(plant: Plant, trials: Iterable[Trial]) -> bool:
    """Whether a plant of another load than the link was identified, and on none of these trials.

    A link is excluded: its values may change from day to day, within priors of their own.
    """
    provenance = plant.provenance
    elsewhere = provenance.fitted_trials and not any(map(provenance.was_fitted_to, trials))
    return bool(elsewhere) and LOADS[plant.load].kind != "link"


def nuisance_and_variation(
    plant: Plant, trials: Sequence[Trial], is_known: bool = False, same_link: bool = False
) -> list[FitParameter]:
    """Fit parameters without any effect; arguments as in `all_fit_parameters`."""
    nuisance = nuisance_fit_parameters(plant, trials[0].meta.dof, is_known, same_link)
    return nuisance + trial_variation(plant_with_every_effect(plant), trials)


def nuisance_fit_parameters(
    plant: Plant, dof: int, is_known: bool = False, same_link: bool = False
) -> list[FitParameter]:
    """Nominal parameters that are refitted; arguments as in `all_fit_parameters`."""
    full = plant_with_every_effect(plant)
    names = {v.name for v in full.step_model(dof, "twin").parameters}
    if LOADS[plant.load].kind != "link":
        return [
            FitParameter(q.name, "nuisance", {q.name: 1.0}, {}, _deviation(q, is_known),
                         q.low - q.value, q.high - q.value)
            for q in plant.parameters.values() if q.role != "fixed" and q.name in names
        ]  # fmt: skip
    result = []
    scale = SAME_LINK_FRACTION if same_link else 1.0
    for part, fraction in NUISANCE_PRIOR_FRACTION.items():
        for name in (n for n in names if part in n and full.parameters[n].role == "nuisance"):
            result.append(_relative(full.parameters[name], scale * fraction))
    shift_m, clock_s = FRAME_SHIFT_PRIOR_M, CLOCK_LIMIT_S
    for axis in TIP:
        name = f"frame shift {axis[4]}"
        result.append(FitParameter(name, "nuisance", {}, {axis: 1.0}, shift_m))
    for turn, axis in FRAME_TURNS.items():
        name = f"frame turn {axis}"
        prior_rad = FRAME_TURN_PRIOR_RAD["joint" if axis in "yx"[:dof] else "other"]
        result.append(FitParameter(name, "nuisance", {turn: 1.0}, {}, prior_rad))
    clock = {"sync_offset_s": 1.0}
    result.append(
        FitParameter("synchronisation", "nuisance", clock, {}, clock_s, -clock_s, clock_s)
    )
    return sorted(result, key=lambda q: q.name)


def effect_candidates(plant: Plant, effect: str, dof: int) -> dict[str, list[FitParameter]]:
    """Fit parameters of an effect as a candidate, and as one of each servo alone.

    Servos of a type have the same effects, so an effect of the servos has one strength for all
    joints, except offsets (`Effect.of_each_joint`); a fault of one servo is the further candidate
    `EFFECT:JOINT`. A bending effect may differ by plane and has a strength for each.
    """
    joints = range(1, dof + 1)
    candidates = {effect: effect_fit_parameters(plant, effect, effect, dof, joints)}
    kind = EFFECTS[effect]
    alike = kind.per_joint and not (kind.of_each_joint or kind.port in ("bend_torque", "stiffness"))
    if dof > 1 and alike:
        for joint in joints:
            name = f"{effect}:{joint}"
            candidates[name] = effect_fit_parameters(plant, effect, name, dof, [joint])
    return candidates


def effect_fit_parameters(
    plant: Plant, name: str, candidate: str, dof: int, joints: Sequence[int]
) -> list[FitParameter]:
    """Fit parameters of an effect in some joints: its strength first, then others that are fitted.

    The assumed staircase of the goals (`goal shape`) may be wrong in each joint separately.
    """
    full = plant_with_every_effect(plant)
    effect = EFFECTS[name]()
    scope = scope_of(plant.drive, plant.load, dof)
    declared = [q.name for q in effect.parameters(scope)]
    tied = not (effect.of_each_joint or effect.port in ("bend_torque", "stiffness"))
    groups: list[list[str]] = []
    for q in effect.per_joint:
        by_joint = [scope.name(q.name, j) for j in scope.joints if j in joints]
        together = tied and effect.parameter_needs.get(q.name) != "goal shape"
        groups += [by_joint] if together else [[n] for n in by_joint]
    groups += [[scope.name(q.name)] for q in effect.shared]
    strengths = effect.strengths(scope)
    last = {scope.name(name, j) for name in effect.fitted_last for j in scope.joints}
    result = []
    for group in (g for g in groups if set(g) <= set(declared)):
        first = full.parameters[group[0]]
        if first.role != "effect" and group[0] not in (*strengths, *last):
            continue
        has_scale = group[0] not in strengths and (first.prior_deviation or first.value)
        result.append(
            FitParameter(
                group[0], "effect", dict.fromkeys(group, 1.0), {},
                first.prior_deviation or abs(first.value) if has_scale else math.inf,
                max(full.parameters[n].low - full.parameters[n].value for n in group),
                min(full.parameters[n].high - full.parameters[n].value for n in group),
                effect=candidate, fitted_last=bool(last & set(group)),
            )
        )  # fmt: skip
    return sorted(result, key=lambda q: q.name not in strengths)


def _deviation(q: Parameter, is_known: bool) -> float:
    """Standard deviation of a nuisance parameter of another load than the link."""
    if is_known:
        return KNOWN_VALUE_FRACTION * (abs(q.value) or q.high - q.low)
    return BOUND_PRIOR_FRACTION * (q.high - q.low)


def _relative(q: Parameter, fraction: float) -> FitParameter:
    low, high = q.low / q.value - 1, q.high / q.value - 1
    return FitParameter(q.name, "nuisance", {q.name: q.value}, {}, fraction, low, high)


def written_values(
    full: Plant, fit_parameters: Sequence[FitParameter], values: Array, free: NDArray[np.bool_]
) -> dict[str, float]:
    """Values of the plant's parameters that were fitted for all trials.

    Shapes: `values` (p,), `free` (p,).
    """
    changed: dict[str, float] = {}
    for k, name, weight in moved_in_plant(full, fit_parameters, free):
        q = full.parameters[name]
        value = changed.get(name, q.value) + weight * values[k]
        changed[name] = float(np.clip(value, q.low, q.high))
    return changed


def moved_in_plant(
    full: Plant, fit_parameters: Sequence[FitParameter], free: NDArray[np.bool_]
) -> Iterator[tuple[int, str, float]]:
    """Index of each free fit parameter that holds for all trials, the plant's parameter that it
    moves, and its weight.
    """
    for k, q in enumerate(fit_parameters):
        if q.trial is None and free[k]:
            for name, weight in q.parameters.items():
                if name in full.parameters:
                    yield k, name, weight
