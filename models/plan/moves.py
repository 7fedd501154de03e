"""First mode of the link at rest, from the twin linearised there.

Moves from one place of the tip to another without inverting the twin, for comparison.

The rate-limited rigid move turns the joints as fast as the limits permit. ZVD shaping splits it in
three that leave no vibration of the first mode and little where its frequency is off (Singer and
Seering, *ASME J. Dynamic Systems* 112, 1990: zero vibration and derivative).

Inverse of held approaches of the twin over places and payloads, with the first mode at rest.

A twin that has moved does not come to rest at its relaxed position: inner friction, friction of the
joints and creep keep the tip 1 to 7 mm short of it. So a map holds the goals that bring the tip to
a place by an approach from upright, a ramp of `RAMP_S` and a hold of `HOLD_S`. They are the goals
of the relaxed twin for a place that lies farther by the shortfall, which is measured on the twin at
some places.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Final

import numpy as np
from numpy.typing import NDArray

from firmware_py.goals.outside.goal_map import GoalMap, PayloadMap
from firmware_py.safety.limits import Limits
from models.plan.tip_twin import TipTwin
from models.plant.plant import Plant

Array = NDArray[np.float64]
MOST_DAMPED: Final = 0.5
"""Damping ratio above which a mode does not count as vibration [assumed]."""
SEEN: Final = 0.1
"""Least part of the tip's largest modal motion along an axis for a mode to count [assumed]."""


@dataclass(frozen=True)
class VibrationMode:
    rate_rad_s: float  # Natural angular frequency, undamped
    damping_ratio: float  # Fraction of the critical damping

    @property
    def half_period_s(self) -> float:
        """Half of the period of the damped vibration."""
        return math.pi / (self.rate_rad_s * math.sqrt(1.0 - self.damping_ratio**2))

    @property
    def decay(self) -> float:
        """Amplitude after half a period over that before."""
        return math.exp(-self.damping_ratio * self.rate_rad_s * self.half_period_s)


def first_modes(twin: TipTwin, goal_rad: Array, payload_kg: float) -> list[VibrationMode]:
    """Slowest vibration of the tip along each planned axis, about rest.

    Shapes: `goal_rad` (dof,).
    """
    by_state, tip_by_state = twin.derivatives_at_rest(goal_rad, payload_kg)
    values, vectors = np.linalg.eig(by_state)
    poles = np.log(values[np.abs(values) > 1e-6]) / twin.period_s
    seen = np.abs(tip_by_state @ vectors[:, np.abs(values) > 1e-6])
    found = []
    for axis in seen:
        rate = np.abs(poles)
        damping = -poles.real / np.maximum(rate, 1e-12)
        own = (poles.imag > 1e-6) & (damping > 0) & (damping < MOST_DAMPED)
        own &= axis > SEEN * axis[own].max(initial=0.0)
        if not own.any():
            raise ValueError(f"the tip has no vibration with {payload_kg:g} kg")
        k = int(np.flatnonzero(own)[np.argmin(rate[own])])
        found.append(VibrationMode(float(rate[k]), float(damping[k])))
    return found


def rate_limited(start_rad: Array, end_rad: Array, limits: Limits, period_s: float) -> Array:
    """Goals of the fastest move within rate and acceleration, all joints together, shape (n, dof).

    The last row is the end. Shapes: `start_rad`, `end_rad` (dof,).
    """
    distance, most = float(np.max(np.abs(end_rad - start_rad))), limits.acceleration_rad_s2
    rate = min(limits.rate_rad_s, math.sqrt(distance * most))
    if distance == 0.0:
        return np.asarray(end_rad)[None, :]
    rise_s, total_s = rate / most, distance / rate + rate / most
    at_s = np.minimum(period_s * np.arange(1, math.ceil(total_s / period_s) + 1), total_s)
    # Ramps of the rate at both ends; sampled, no mean rate over a period exceeds them.
    ramps = [np.maximum(at_s - t, 0.0) ** 2 for t in (0.0, rise_s, total_s - rise_s, total_s)]
    way = 0.5 * most * (ramps[0] - ramps[1] - ramps[2] + ramps[3]) / distance
    return np.asarray(start_rad + way[:, None] * (end_rad - start_rad))


def zvd_impulses(mode: VibrationMode) -> list[tuple[float, float]]:
    """Delay in s and weight of each of the three impulses."""
    k, half = mode.decay, mode.half_period_s
    total = (1.0 + k) ** 2
    return [(0.0, 1.0 / total), (half, 2.0 * k / total), (2.0 * half, k * k / total)]


def shaped(column: Array, impulses: list[tuple[float, float]], period_s: float) -> Array:
    """Sum of delayed copies of a column that rests at its first value before, shape (n,).

    Shapes: `column` (n,).
    """
    rows = np.arange(len(column), dtype=np.float64)
    copies = [w * np.interp(rows - delay / period_s, rows, column) for delay, w in impulses]
    return np.asarray(np.sum(copies, axis=0))


PLACES: Final = {1: 41, 2: 25}
"""Places along an axis, by joints: between two of them, 54 mm apart, the goals of a rigid link
curve by 0.3 mm of the tip (h²/8 · x/(1 - x²)^(3/2) at 0.5 m)."""
LARGEST_RAD: Final = 0.8
"""Largest goal that is mapped: beyond any limit, so that the limit refuses it [assumed]."""
CLOSE_M: Final = 2e-4
"""Distance of the resting tip from the place at which the search ends [assumed]."""
RAMP_S: Final = 4.0
HOLD_S: Final = 10.0
"""Ramp and hold of the mapped approach [assumed]. Between 1 s and 60 s of holding, the tip of the
demo's twin moves on by up to 1.5 mm without payload, 5 mm with 1 kg and 2.5 mm with 2 kg."""
SPARSE: Final = (-1.0, -0.6, -0.17, 0.0, 0.17, 0.6, 1.0)
"""Places where the shortfall is measured, over the largest coordinate; denser near upright, where
it begins. Measured on the twin of the demo, 2DOF, 2 kg: interpolation leaves 0.4 mm, 0.14 mm RMS.
"""
MOST_SHORT_M: Final = 0.1
"""Largest shortfall that counts: beyond it the link has folded [assumed]."""
STEPS: Final = 12
PROBE_RAD: Final = 1e-3


def map_rest(
    plant: Plant, dof: int, period_s: float, payloads_kg: Sequence[float], reach_m: float
) -> GoalMap:
    """Map places of the tip to the goals that bring it to rest there.

    The approach begins upright: a ramp of 4 s to the goals, which are then held for 10 s.
    """
    twin = TipTwin(plant.step_model(dof), dof, period_s)
    places = np.linspace(-reach_m, reach_m, PLACES[dof])
    payloads = []
    for payload_kg in payloads_kg:
        table = _held_goals(twin, places, payload_kg)
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
        payloads=tuple(payloads), plant_sha256=plant.for_robot().sha256(),
        link=plant.link_facts(),
    )  # fmt: skip


def _held_goals(twin: TipTwin, places: Array, payload_kg: float) -> Array:
    """Goals that bring the tip to every place, shape (places ** dof, dof); NaN out of reach."""
    slope = _slope(twin, np.zeros(twin.dof), payload_kg)
    relaxed = _relaxed_goals(twin, places, slope, payload_kg)
    short_m = _shortfall_m(twin, places, relaxed, payload_kg)
    found = np.full_like(relaxed, np.nan)
    for index in product(range(len(places)), repeat=twin.dof):
        if not np.isnan(relaxed[index]).any():
            wanted = places[list(index)] + short_m[index]
            found[index] = _solved(twin, wanted, relaxed[index], slope, payload_kg)
    return found.reshape(-1, twin.dof)


def _shortfall_m(twin: TipTwin, places: Array, relaxed: Array, payload_kg: float) -> Array:
    """Places minus the ends of held approaches to the relaxed goals, in the shape of the goals."""
    sparse = np.rint((np.array(SPARSE) + 1.0) / 2.0 * (len(places) - 1)).astype(int)
    short = np.full((len(sparse),) * twin.dof + (twin.dof,), np.nan)
    for index in product(range(len(sparse)), repeat=twin.dof):
        at = sparse[list(index)]
        goal = relaxed[tuple(at)]
        if np.isnan(goal).any():
            continue
        own = places[at] - twin.held_tip_m(goal, payload_kg, RAMP_S, HOLD_S)
        if np.linalg.norm(own) < MOST_SHORT_M:
            short[index] = own
    short = _filled(short)
    for axis in range(twin.dof):
        short = np.apply_along_axis(
            lambda column: np.interp(places, places[sparse], column), axis, short
        )
    return short


def _filled(short: Array) -> Array:
    """Shortfalls with missing ones replaced by the nearest; zeros if none is known."""
    known = np.argwhere(~np.isnan(short[..., 0]))
    if not len(known):
        return np.zeros_like(short)
    filled = short.copy()
    for index in np.argwhere(np.isnan(short[..., 0])):
        nearest = known[int(np.argmin(np.linalg.norm(known - index, axis=1)))]
        filled[tuple(index)] = short[tuple(nearest)]
    return filled


def _relaxed_goals(twin: TipTwin, places: Array, slope: Array, payload_kg: float) -> Array:
    """Goals at which the relaxed tip lies at every place, by index; NaN where there are none."""
    found = np.full((len(places),) * twin.dof + (twin.dof,), np.nan)
    zero = np.zeros(twin.dof)
    rest = twin.resting_tip_m(zero, payload_kg)
    # From the middle outwards, each from its nearest solved neighbours, with the slope there.
    order = sorted(
        product(range(len(places)), repeat=twin.dof),
        key=lambda k: float(np.hypot(*_two(places[list(k)]))),
    )
    for index in order:
        wanted = places[list(index)]
        near = _nearest_found(found, index)
        start = zero + np.linalg.solve(slope, wanted - rest) if near is None else near
        found[index] = _solved(twin, wanted, start, slope, payload_kg)
    return found


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
    """Goals at which the relaxed tip lies at a place, with Broyden's updates of the slope."""
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
