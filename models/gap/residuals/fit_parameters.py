"""Parameters of the fit: directions in parameters and outputs of the twin that may close a gap.

A fit parameter at zero leaves the plant unchanged. There are three kinds: `nuisance` holds for all
trials and never counts as missing; `trial` varies from trial to trial with a known standard
deviation, and so belongs to the noise floor; `effect` is searched for. All are linear in the
plant's parameters, p = p_0 + Σ w θ, so one run with exact sensitivities serves all of them.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, Literal

from models.gap.settings import DEFAULT_SETTINGS, GapSettings
from models.plant.components import DRIVES, LOADS
from models.plant.effects import EFFECTS, applicable
from models.plant.identification.evaluation import TIP
from models.plant.identification.noise_floor import trial_variation
from models.plant.parameter import Parameter
from models.plant.plant import Plant, scope_of
from models.trials.trial import Trial

Kind = Literal["nuisance", "trial", "effect"]

FRAME_TURNS: Final = {
    "marker_frame_roll_rad": "x", "marker_frame_tilt_rad": "y", "marker_frame_yaw_rad": "z",
}  # fmt: skip
"""Axis of each turn of the mocap frame. Joint 1 turns about y, joint 2 about −x."""


@dataclass(frozen=True)
class FitParameter:
    """One direction of the fit."""

    name: str  # Name of the parameter of the plant, or of the variation
    kind: Kind
    # Change of each plant parameter per unit
    parameters: Mapping[str, float] = field(default_factory=dict)
    # Direct change of each output per unit
    outputs: Mapping[str, float] = field(default_factory=dict)
    standard_deviation: float = math.inf  # Of the prior around zero; infinite without a prior
    low: float = -math.inf
    high: float = math.inf
    trial: int | None = None  # Index of the only trial that it acts on
    effect: str = ""  # Effect that it belongs to; empty if none
    fitted_last: bool = False


def plant_with_every_effect(plant: Plant) -> Plant:
    """Plant with every effect that it can have; added effects have zero strength."""
    return plant_with_searched_effects(plant, candidate_effects(plant))


def plant_with_searched_effects(plant: Plant, names: Sequence[str]) -> Plant:
    """Plant with some effects at the start of a search; added effects have zero strength."""
    full = plant.with_effects(*names)
    added = [EFFECTS[e].search_start for e in names if e not in plant.effects]
    start = {n: v for own in added for n, v in own.items() if n in full.parameters}
    return full.with_values(start)


def candidate_effects(plant: Plant) -> list[str]:
    """Effects that may be missing: all that a plant of this kind can have.

    For a plant other than the link, the effects that it already has are nuisance. If it was
    identified on the trials of the diagnosis, they compensated for what was missing; otherwise they
    absorb the error of their equations.
    """
    every = applicable(DRIVES[plant.drive], LOADS[plant.load])
    if LOADS[plant.load].kind == "link":
        return every
    return [name for name in every if name not in plant.effects]


def nuisance_fit_parameters(
    plant: Plant, dof: int, settings: GapSettings = DEFAULT_SETTINGS
) -> list[FitParameter]:
    """Nominal parameters that are refitted before anything counts as missing."""
    full = plant_with_every_effect(plant)
    names = set(_owned(full, dof))
    if LOADS[plant.load].kind != "link":
        return [
            FitParameter(q.name, "nuisance", {q.name: 1.0}, {}, _deviation(q, settings),
                         q.low - q.value, q.high - q.value)
            for q in plant.parameters.values() if q.role != "fixed" and q.name in names
        ]  # fmt: skip
    result = []
    for part, fraction in settings.nuisance_prior_fraction.items():
        for name in (n for n in names if part in n and full.parameters[n].role == "nuisance"):
            result.append(_relative(full.parameters[name], fraction))
    shift_m, clock_s = settings.frame_shift_prior_m, settings.clock_limit_s
    for axis in TIP:
        name = f"frame shift {axis[4]}"
        result.append(FitParameter(name, "nuisance", {}, {axis: 1.0}, shift_m))
    for turn, axis in FRAME_TURNS.items():
        name = f"frame turn {axis}"
        prior_rad = settings.frame_turn_prior_rad["joint" if axis in "yx"[:dof] else "other"]
        result.append(FitParameter(name, "nuisance", {turn: 1.0}, {}, prior_rad))
    clock = {"sync_offset_s": 1.0}
    result.append(
        FitParameter("synchronisation", "nuisance", clock, {}, clock_s, -clock_s, clock_s)
    )
    return sorted(result, key=lambda q: q.name)


def trial_fit_parameters(plant: Plant, trials: Sequence[Trial]) -> list[FitParameter]:
    """Variation between trials: pressure, friction, payload, clock and frame of each trial.

    For loads other than the link nothing varies.
    """
    full = plant_with_every_effect(plant)
    return [
        FitParameter(v.name, "trial", v.parameters, v.outputs, v.standard_deviation, trial=k)
        for k, trial in enumerate(trials)
        for v in trial_variation(full, _owned(full, trial.meta.dof), trial)
    ]


def is_alike_in_joints(name: str) -> bool:
    """Whether an effect first has one common strength for all joints."""
    effect = EFFECTS[name]
    own = effect.of_each_joint or effect.port in ("bend_torque", "stiffness")
    return bool(effect.per_joint) and not own


def effect_fit_parameters(
    plant: Plant, name: str, dof: int, separate_joints: bool = False
) -> list[FitParameter]:
    """Fit parameters of one effect: its strength first, then others that may be fitted.

    A servo's effect has one strength for all joints, except offsets (`Effect.of_each_joint`). A
    bending effect may differ by plane and has a strength for each. The assumed staircase of the
    goals (`goal shape`) may be wrong in each joint separately.
    """
    full = plant_with_every_effect(plant)
    effect = EFFECTS[name]()
    scope = scope_of(plant.drive, plant.load, dof)
    declared = [q.name for q in effect.parameters(scope)]
    tied = is_alike_in_joints(name) and not separate_joints
    groups: list[list[str]] = []
    for q in effect.per_joint:
        own = [scope.name(q.name, j) for j in scope.joints]
        together = tied and effect.parameter_needs.get(q.name) != "goal shape"
        groups += [own] if together else [[n] for n in own]
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
                effect=name, fitted_last=bool(last & set(group)),
            )
        )  # fmt: skip
    return sorted(result, key=lambda q: q.name not in strengths)


def moved_parameters(fit_parameters: Iterable[FitParameter]) -> list[str]:
    """Every parameter of the plant that some fit parameter moves, once."""
    return list(dict.fromkeys(n for q in fit_parameters for n in q.parameters))


def _deviation(q: Parameter, settings: GapSettings) -> float:
    """Standard deviation of a nuisance parameter of another load than the link."""
    if settings.plant_is_known:
        return settings.known_value_fraction * (abs(q.value) or q.high - q.low)
    return settings.bound_prior_fraction * (q.high - q.low)


def _relative(q: Parameter, fraction: float) -> FitParameter:
    low, high = q.low / q.value - 1, q.high / q.value - 1
    return FitParameter(q.name, "nuisance", {q.name: q.value}, {}, fraction, low, high)


def _owned(full: Plant, dof: int) -> list[str]:
    """Parameters of the plant that a twin with `dof` joints has."""
    return [v.name for v in full.step_model(dof, "twin").parameters]
