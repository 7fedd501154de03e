"""Map of the goals that bring the tip to rest at a place, over places and payloads.

A twin that has moved does not come to rest at its relaxed position: inner friction, friction of the
joints and creep keep the tip 1 to 7 mm short of it. So a map holds the goals that bring the tip to
a place by an approach from upright, a ramp of `RAMP_S` and a hold of `HOLD_S`. They are the goals
of the relaxed twin for a place that lies farther by the shortfall, which is measured on the twin at
some places.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import interpn
from scipy.ndimage import distance_transform_edt
from scipy.optimize import root

from firmware_py.goals.goal_map import GoalMap, PayloadMap
from models.plan.tip_twin import TipTwin
from models.plant.linear_twin import LinearMode, LinearTwins, resting_modes
from models.plant.plant import Plant

Array = NDArray[np.float64]
PLACES: Final = {1: 41, 2: 25}
"""Places along an axis, by joints: between two of them, 54 mm apart, the goals of a rigid link
curve by 0.3 mm of the tip (h²/8 · x/(1 - x²)^(3/2) at 0.5 m)."""
LARGEST_RAD: Final = 0.8
"""Largest goal that is mapped: beyond any limit, so that the limit refuses it [assumed]."""
RAMP_S: Final = 4.0
HOLD_S: Final = 10.0
"""Ramp and hold of the mapped approach [assumed]. Between 1 s and 60 s of holding, the tip of the
demo's twin moves on by up to 1.5 mm without payload, 5 mm with 1 kg and 2.5 mm with 2 kg."""
SPARSE: Final = (-1.0, -0.6, -0.17, 0.0, 0.17, 0.6, 1.0)
"""Places where the shortfall is measured, over the largest coordinate; denser near upright, where
it begins. Measured on the twin of the demo, 2DOF, 2 kg: interpolation leaves 0.4 mm, 0.14 mm RMS.
"""


def map_rest(
    plant: Plant, dof: int, period_s: float, payloads_kg: Sequence[float], reach_m: float
) -> tuple[GoalMap, list[list[LinearMode]]]:
    """Map of the goals, and the first mode of the link along each axis, by payload."""
    twin, linear = TipTwin(plant, dof, period_s), LinearTwins(plant.step_model(dof), period_s)
    places = np.linspace(-reach_m, reach_m, PLACES[dof])
    modes = [resting_modes(linear, payload_kg) for payload_kg in payloads_kg]
    goal_map = GoalMap(
        schema=GoalMap.VERSION, dof=dof, period_s=period_s, places_m=tuple(places.tolist()),
        payloads=tuple(
            PayloadMap(
                payload_kg=payload_kg,
                goals_rad=tuple(
                    tuple(None if np.isnan(v) else round(v, 6) for v in column)
                    for column in _approach_goals(twin, places, payload_kg).T.tolist()
                ),
                half_period_s=tuple(round(m.half_period_s, 5) for m in link_modes),
                decay=tuple(round(m.decay, 5) for m in link_modes),
            )
            for payload_kg, link_modes in zip(payloads_kg, modes, strict=True)
        ),
        plant_sha256=plant.for_robot().sha256(), link=plant.link_facts(),
    )  # fmt: skip
    return goal_map, modes


def _approach_goals(twin: TipTwin, places: Array, payload_kg: float) -> Array:
    """Goals that bring the tip to every place, shape (places ** dof, dof); NaN out of reach."""
    upright = np.zeros(twin.dof)
    slope, rest = twin.resting_slope(upright, payload_kg), twin.resting_tip_m(upright, payload_kg)
    indices = list(product(range(len(places)), repeat=twin.dof))
    relaxed = np.full((len(places),) * twin.dof + (twin.dof,), np.nan)
    # From the middle outwards, each from its nearest solved neighbours.
    for index in sorted(indices, key=lambda k: float(np.linalg.norm(places[list(k)]))):
        wanted = places[list(index)]
        near = relaxed[tuple(slice(max(0, k - 1), k + 2) for k in index)].reshape(-1, twin.dof)
        known = near[~np.isnan(near[:, 0])]
        start = known.mean(axis=0) if len(known) else np.linalg.solve(slope, wanted - rest)
        relaxed[index] = _relaxed_goal(twin, wanted, np.asarray(start), slope, payload_kg)
    short_m = _shortfall_m(twin, places, relaxed, payload_kg)
    goals = np.full_like(relaxed, np.nan)
    for index in indices:
        if not np.isnan(relaxed[index]).any():
            wanted = places[list(index)] + short_m[index]
            goals[index] = _relaxed_goal(twin, wanted, relaxed[index], slope, payload_kg)
    return goals.reshape(-1, twin.dof)


def _relaxed_goal(
    twin: TipTwin, wanted: Array, start: Array, slope: Array, payload_kg: float
) -> Array:
    """Goals at which the relaxed tip lies within 0.2 mm of a place; NaN where there are none."""
    start = np.clip(start, -LARGEST_RAD, LARGEST_RAD)

    def off(change: Array) -> Array:
        return twin.resting_tip_m(start + change, payload_kg) - wanted

    # Powell's hybrid method, whose slopes are updated after Broyden
    options = {"xtol": 1e-4, "maxfev": 15}
    solution = root(off, np.zeros(twin.dof), jac=lambda _: slope, options=options)
    goal = start + solution.x
    is_close = np.linalg.norm(solution.fun) < 2e-4 and np.abs(goal).max() <= LARGEST_RAD
    return goal if is_close else np.full(twin.dof, np.nan)


def _shortfall_m(twin: TipTwin, places: Array, relaxed: Array, payload_kg: float) -> Array:
    """Places minus the ends of approaches to the relaxed goals, in the shape of the goals."""
    sparse = np.rint((np.array(SPARSE) + 1.0) / 2.0 * (len(places) - 1)).astype(int)
    short = np.full((len(sparse),) * twin.dof + (twin.dof,), np.nan)
    time_s = np.arange(round((RAMP_S + HOLD_S) / twin.period_s) + 1) * twin.period_s
    ramp = np.minimum(time_s / RAMP_S, 1.0)[:, None]
    for index in product(range(len(sparse)), repeat=twin.dof):
        at = sparse[list(index)]
        goal = relaxed[tuple(at)]
        if not np.isnan(goal).any():
            apart = places[at] - twin.run(ramp * goal, payload_kg).tip_m[-1]
            if np.linalg.norm(apart) < 0.1:  # farther: the link has folded [assumed]
                short[index] = apart
    missing = np.isnan(short[..., 0])
    if missing.all():
        return np.zeros_like(relaxed)
    nearest = distance_transform_edt(missing, return_distances=False, return_indices=True)
    grid = np.stack(np.meshgrid(*[places] * twin.dof, indexing="ij"), axis=-1)
    return np.asarray(interpn([places[sparse]] * twin.dof, short[tuple(nearest)], grid))
