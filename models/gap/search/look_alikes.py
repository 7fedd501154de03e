"""What these trials cannot tell apart, and the motion that would.

Two effects are alike where refitting the other in place of the named one leaves the cost within
d′ < 3 of it, an error of a tenth in the named one's own equation allowed for. The menu's motions
are then simulated with the named effect, and the other fitted to them: the motion on which it fits
worst separates best.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, Final

import msgspec
import numpy as np

from firmware_py.motion import Kind, Motion
from firmware_py.signals import PERIOD_S
from models.gap.estimation.gauss_newton import GaussNewton
from models.gap.estimation.noise_floor import FORMULATION
from models.gap.residuals.residuals import Residuals
from models.gap.residuals.spectrum import Array
from models.gap.search.candidate import ALIKE, Candidate, SearchResult
from models.gap.search.effect_search import EffectSearch
from models.plant.plant import Plant
from models.plant.simulation.compiled_model import CompiledModel, run_trial
from models.plant.step_model import names
from models.trials.trial import Trial

REST_ROWS: Final = 60
MENU: Final[dict[str, Kind]] = {
    "multisine": "multisine", "payload swap": "sinusoid", "slow triangle": "triangle",
    "step and hold": "steps", "free decay": "decay",
}  # fmt: skip
NO_MOTION: Final = "none of the menu"
"""What is said of a plant that cannot run the menu."""
SWAPPED_KG: Final = 2.0
"""Payload of the swap, or none where the trials carried more than half of it."""


def look_alikes_of(naming: SearchResult, turn: int) -> list[Candidate]:
    """Candidates that did nearly as well as the one included in a turn.

    Where an equation misses a share ε of the gap, the gains of two effects that look alike differ
    by up to 2 ε sin(angle) of the whole either way; half of that is allowed for.
    """
    chosen = naming.chosen[turn]
    margin = ALIKE**2 + FORMULATION * chosen.separation**2
    return [
        c for c in naming.rounds[turn]
        if c.effects != chosen.effects and chosen.score - c.score < margin
    ]  # fmt: skip


def separating_motion(
    namer: EffectSearch, improved: Plant, others: list[Candidate], named: list[str]
) -> tuple[str, dict[str, float]]:
    """Motion of the menu that tells a named effect from its look-alikes best.

    Returns
    -------
    tuple
        Its name, and for every motion the least d′ from any of them; the menu is that of the link.
    """
    problem = namer.first.problem
    if improved.load != "link":
        return NO_MOTION, {}
    model = problem.trials[0]
    heaviest = max(t.meta.payload_kg for t in problem.trials)
    result = {}
    for label, kind in MENU.items():
        payload = heaviest
        if label == "payload swap":
            payload = SWAPPED_KG if heaviest <= SWAPPED_KG / 2 else 0.0
        trial = _simulated(improved, model, kind, payload)
        result[label] = min(_separation(namer, problem, trial, c, named) for c in others)
    return max(result, key=lambda label: result[label]), result


def _simulated(plant: Plant, like: Trial, kind: Kind, payload_kg: float) -> Trial:
    """Trial of a motion as a plant runs it."""
    meta = like.meta
    motion = Motion(kind, meta.amplitude_rad, meta.period_s, meta.phase_2_rad, meta.dof)
    goal_rad = motion.table_rad(rest_samples=REST_ROWS)
    columns: dict[str, Array] = {"time_s": PERIOD_S * np.arange(len(goal_rad), dtype=np.float64)}
    for j in range(meta.dof):
        columns[f"goal_{j + 1}_rad"] = columns[f"angle_{j + 1}_rad"] = goal_rad[:, j]
    conditions = msgspec.structs.replace(
        meta, motion=kind, payload_kg=payload_kg, rest_samples=REST_ROWS, source="simulated"
    )
    trial = Trial(kind, conditions, columns)
    compiled = CompiledModel(plant.step_model(meta.dof, "twin"))
    y = run_trial(compiled, trial)
    outputs: dict[str, Array] = {
        name: y[:, k] for k, name in enumerate(names(compiled.model.outputs))
    }
    return replace(trial, columns=columns | outputs)


def _separation(
    namer: EffectSearch, problem: Residuals, trial: Trial, other: Candidate, named: list[str]
) -> float:
    """d′ that is left when another effect is fitted to a trial, to first order."""
    common = [k for k, knob in enumerate(problem.knobs) if knob.trial in (None, 0)]
    there = Residuals(problem.plant, [trial], [problem.knobs[k] for k in common])
    floor = replace(namer.first.floor, curves={})
    estimator = GaussNewton(there, floor)
    point = estimator.linearise(estimator.at(other.point.values[common]))
    rest = [e for e in named if e not in other.effects][: len(named) - len(other.effects)]
    free = namer.free([*rest, *other.effects])[common]
    _, promised = estimator.step(point, free)
    return math.sqrt(max(2 * (point.cost - promised), 0.0))


def as_document(label: str, sizes: dict[str, float]) -> dict[str, Any]:
    """Plain form for gap.json."""
    return {"motion": label, "separation": {k: round(v, 2) for k, v in sizes.items()}}
