"""Quasi-static inverse of the twin over places and payloads, with the first mode at rest."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import Final

import numpy as np
from numpy.typing import NDArray

from firmware_py.goals.outside.goal_map import GoalMap, PayloadMap
from models.plan.moves.vibration_mode import first_modes
from models.plan.twin_sensitivity import TipTwin
from models.plant.plant import Plant

Array = NDArray[np.float64]
PLACES: Final = {1: 41, 2: 25}
"""Places along an axis, by joints: between two of them, 54 mm apart, the goals of a rigid link
curve by 0.3 mm of the tip (h²/8 · x/(1 - x²)^(3/2) at 0.5 m)."""
LARGEST_RAD: Final = 0.8
"""Largest goal that is mapped: beyond any limit, so that the limit is what refuses [assumed]."""
CLOSE_M: Final = 2e-4
"""Distance of the resting tip from the place at which the search ends [assumed]."""
STEPS: Final = 12
PROBE_RAD: Final = 1e-3


def map_rest(
    plant: Plant, dof: int, period_s: float, payloads_kg: Sequence[float], reach_m: float
) -> GoalMap:
    """Map places of the tip to the goals at which it rests there.

    Parameters
    ----------
    plant : Plant
        Plant of the link.
    dof : int
        Joints.
    period_s : float
        Control period of the robot.
    payloads_kg : sequence of float
        Rising.
    reach_m : float
        Largest coordinate.
    """
    twin = TipTwin(plant.step_model(dof), dof, period_s)
    places = np.linspace(-reach_m, reach_m, PLACES[dof])
    payloads = []
    for payload_kg in payloads_kg:
        table = _rest_goals(twin, places, payload_kg)
        modes = first_modes(twin, np.zeros(dof), payload_kg)
        payloads.append(
            PayloadMap(
                payload_kg=payload_kg,
                goals_rad=tuple(
                    tuple(None if np.isnan(v) else round(v, 6) for v in column)
                    for column in table.T.tolist()
                ),
                half_period_s=tuple(round(m.half_period_s, 5) for m in modes),
                decay=tuple(round(m.decay, 5) for m in modes),
            )
        )
    return GoalMap(
        schema=GoalMap.VERSION, dof=dof, period_s=period_s, places_m=tuple(places.tolist()),
        payloads=tuple(payloads), plant_sha256=plant.sha256(),
    )  # fmt: skip


def _rest_goals(twin: TipTwin, places: Array, payload_kg: float) -> Array:
    """Goals at every place, shape (places ** dof, dof); NaN where the tip cannot rest."""
    found = np.full((len(places),) * twin.dof + (twin.dof,), np.nan)
    zero = np.zeros(twin.dof)
    slope = _slope(twin, zero, payload_kg)
    rest = twin.resting_tip_m(zero, payload_kg)
    # From the middle outwards, each from the nearest that was found, with its slope.
    order = sorted(
        product(range(len(places)), repeat=twin.dof),
        key=lambda k: float(np.hypot(*_two(places[list(k)]))),
    )
    for index in order:
        wanted = places[list(index)]
        near = _nearest_found(found, index)
        start = zero + np.linalg.solve(slope, wanted - rest) if near is None else near
        found[index] = _solved(twin, wanted, start, slope, payload_kg)
    return found.reshape(-1, twin.dof)


def _two(place: Array) -> tuple[float, float]:
    return float(place[0]), float(place[-1]) if len(place) > 1 else 0.0


def _nearest_found(found: Array, index: tuple[int, ...]) -> Array | None:
    near = found[tuple(slice(max(0, k - 1), k + 2) for k in index)].reshape(-1, found.shape[-1])
    known = near[~np.isnan(near[:, 0])]
    return known.mean(axis=0) if len(known) else None


def _slope(twin: TipTwin, goal: Array, payload_kg: float) -> Array:
    tip = twin.resting_tip_m(goal, payload_kg)
    probes = (goal + PROBE_RAD * unit for unit in np.eye(twin.dof))
    return np.column_stack([(twin.resting_tip_m(p, payload_kg) - tip) / PROBE_RAD for p in probes])


def _solved(twin: TipTwin, wanted: Array, start: Array, slope: Array, payload_kg: float) -> Array:
    """Goals at which the tip rests at a place, with Broyden's updates of the slope."""
    goal, slope = np.clip(start, -LARGEST_RAD, LARGEST_RAD), slope.copy()
    tip = twin.resting_tip_m(goal, payload_kg)
    for _ in range(STEPS):
        if np.linalg.norm(tip - wanted) < CLOSE_M:
            return goal
        step = np.linalg.solve(slope, wanted - tip)
        goal = goal + step
        if np.abs(goal).max() > LARGEST_RAD:
            break
        new = twin.resting_tip_m(goal, payload_kg)
        slope += np.outer(new - tip - slope @ step, step) / float(step @ step)
        tip = new
    return np.full(twin.dof, np.nan)
