"""What may be turned to close a gap: directions in the parameters and outputs of the twin.

A knob at zero leaves the plant as it is. Three kinds: `nuisance` holds for all trials and never
counts as missing; `trial` varies from trial to trial with a known spread, and so belongs to the
noise floor; `effect` is what is looked for. All are linear in the parameters, p = p_0 + Σ w θ, so
one run with exact sensitivities serves every knob.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, Literal

from models.plant.components.drives import DRIVES
from models.plant.effects import EFFECTS, applicable
from models.plant.parameter import Parameter
from models.plant.plant import LOADS, Plant
from models.plant.scope import Scope
from models.trials.trial import Trial

Kind = Literal["nuisance", "trial", "effect"]

RELATIVE_PRIOR: Final = {"_stiffness_": 0.3, "_damping_": 0.5, "link_mass_kg": 0.2}
"""Nuisance of the link by what its name holds: spread of its share [assumed]."""

FRAME_SHIFT_M: Final = 0.005
"""Spread of the mocap frame's shift, common to all trials [assumed]."""

SYNC_LIMIT_S: Final = 0.010
"""Clocks within this count as synchronised (docs/sources.md, "Naming a missing effect")."""

TRIAL_SPREAD: Final = {
    "pressure": 0.01, "friction": 0.05, "eccentricity_m": 0.003, "sync_s": 0.002,
    "frame_m": 0.0003,
}  # fmt: skip
"""What differs between repetitions of one trial (standard deviations) [assumed]."""

TIP: Final = ("tip_x_m", "tip_y_m", "tip_z_m")


@dataclass(frozen=True)
class FitParameter:
    """One direction.

    Attributes
    ----------
    name : str
        For people.
    kind : str
        See `Kind`.
    parameters, outputs : dict of str to float
        How far each parameter, and each output at once, moves per unit.
    spread : float
        Standard deviation of the prior around zero; infinite for none.
    low, high : float
        Bounds.
    trial : int, optional
        Index of the only trial that it turns.
    effect : str
        Effect that it belongs to; empty for none.
    """

    name: str
    kind: Kind
    parameters: Mapping[str, float] = field(default_factory=dict)
    outputs: Mapping[str, float] = field(default_factory=dict)
    spread: float = math.inf
    low: float = -math.inf
    high: float = math.inf
    trial: int | None = None
    effect: str = ""


def plant_with_every_effect(plant: Plant) -> Plant:
    """Plant that holds every effect it can; those that it lacked at zero strength."""
    return plant.with_effects(*candidate_effects(plant))


def candidate_effects(plant: Plant) -> list[str]:
    """Effects that may be missing: all that a plant of this kind can hold.

    Of a plant that is not the link those that it holds already are nuisance: it was identified on
    the very trials that the gap is looked for in, so its own effects made up for what was missing.
    """
    every = applicable(DRIVES[plant.drive], LOADS[plant.load])
    if LOADS[plant.load].kind == "link":
        return every
    return [name for name in every if name not in plant.effects]


def nuisance_fit_parameters(plant: Plant, dof: int) -> list[FitParameter]:
    """Nominal parameters that are refitted before anything counts as missing."""
    full = plant_with_every_effect(plant)
    names = set(_owned(full, dof))
    if LOADS[plant.load].kind != "link":
        return [
            FitParameter(q.name, "nuisance", {q.name: 1.0}, {}, (q.high - q.low) / 4,
                 q.low - q.value, q.high - q.value)
            for q in plant.parameters.values() if q.role != "fixed" and q.name in names
        ]  # fmt: skip
    result = []
    for part, spread in RELATIVE_PRIOR.items():
        for name in (n for n in names if part in n and full.parameters[n].role == "nuisance"):
            result.append(_relative(full.parameters[name], spread))
    for axis in TIP:
        result.append(
            FitParameter(f"frame shift {axis[4]}", "nuisance", {}, {axis: 1.0}, FRAME_SHIFT_M)
        )
    result.append(
        FitParameter("synchronisation", "nuisance", {"sync_offset_s": 1.0}, {}, SYNC_LIMIT_S,
             -SYNC_LIMIT_S, SYNC_LIMIT_S)
    )  # fmt: skip
    return sorted(result, key=lambda k: k.name)


def trial_fit_parameters(
    plant: Plant, trials: Sequence[Trial], spread: Mapping[str, float] = TRIAL_SPREAD
) -> list[FitParameter]:
    """What varies from trial to trial, for each trial."""
    if LOADS[plant.load].kind != "link":
        return []
    full = plant_with_every_effect(plant)
    result = []
    for k, trial in enumerate(trials):
        own = [full.parameters[n] for n in _owned(full, trial.meta.dof)]
        stiff = [q for q in own if q.unit == "N.m/rad" or q.name == "root_limit_moment_nm"]
        friction = [q for q in own if "_friction_" in q.name]

        def add(
            name: str, parameters: Mapping[str, float], outputs: Mapping[str, float], s: float,
            k: int = k,
        ) -> None:  # fmt: skip
            result.append(FitParameter(name, "trial", parameters, outputs, s, trial=k))

        add("pressure", {q.name: q.value for q in stiff}, {}, spread["pressure"])
        add("friction", {q.name: q.value for q in friction}, {}, spread["friction"])
        add("eccentricity_m", {"payload_offset_share": 1 / trial.meta.link_length_m}, {},
            spread["eccentricity_m"])  # fmt: skip
        add("sync_s", {"sync_offset_s": 1.0}, {}, spread["sync_s"])
        for axis in TIP:
            add("frame_m", {}, {axis: 1.0}, spread["frame_m"])
    return result


def effect_fit_parameters(plant: Plant, name: str, dof: int) -> list[FitParameter]:
    """Knobs of one effect: its strength first, then what else of it may be fitted.

    A servo's effect is the same in every joint (`models.shared.catalogue`); the bend's may differ
    by plane, and then have a strength each.
    """
    full = plant_with_every_effect(plant)
    effect = EFFECTS[name]()
    scope = Scope(tuple(range(1, dof + 1)), suffix=dict(LOADS[plant.load].suffix))
    declared = [q.name for q in effect.parameters(scope)]
    if name == "cross_axis_coupling" and dof == 1:
        return []
    tied = effect.port not in ("bend_torque", "stiffness")
    groups: list[list[str]] = []
    for q in effect.per_joint:
        own = [scope.name(q.name, j) for j in scope.joints]
        groups += [own] if tied else [[n] for n in own]
    groups += [[scope.name(q.name)] for q in effect.shared]
    strengths = effect.strengths(scope)
    result = []
    for group in (g for g in groups if set(g) <= set(declared)):
        first = full.parameters[group[0]]
        if first.role != "effect":
            continue
        is_strength = group[0] in strengths or first.value == 0  # then it has no scale of its own
        result.append(
            FitParameter(
                group[0], "effect", dict.fromkeys(group, 1.0), {},
                math.inf if is_strength else max(abs(first.value), 1e-9),
                max(full.parameters[n].low - full.parameters[n].value for n in group),
                min(full.parameters[n].high - full.parameters[n].value for n in group),
                effect=name,
            )
        )  # fmt: skip
    return sorted(result, key=lambda k: k.name not in strengths)


def moved_parameters(knobs: Iterable[FitParameter]) -> list[str]:
    """Every parameter that some knob moves, once."""
    return list(dict.fromkeys(n for k in knobs for n in k.parameters))


def _relative(q: Parameter, spread: float) -> FitParameter:
    return FitParameter(
        q.name, "nuisance", {q.name: q.value}, {}, spread, q.low / q.value - 1, q.high / q.value - 1
    )


def _owned(full: Plant, dof: int) -> list[str]:
    """Parameters of the plant that a twin of `dof` joints has."""
    return [v.name for v in full.step_model(dof, "twin").parameters]


def strength_of(plant: Plant, name: str, dof: int) -> dict[str, Any]:
    """Present value of each strength of an effect."""
    scope = Scope(tuple(range(1, dof + 1)), suffix=dict(LOADS[plant.load].suffix))
    full = plant_with_every_effect(plant)
    return {n: full.parameters[n].value for n in EFFECTS[name].strengths(scope)}
