"""Plan of a path: reach, goals for each payload, feedback, probing motion, limits, document.

Two methods without inversion serve for comparison. The rate-limited rigid move turns the joints as
fast as the limits permit. ZVD shaping splits it in three that leave no vibration of the first mode
and little where its frequency is off (Singer and Seering, *ASME J. Dynamic Systems* 112, 1990: zero
vibration and derivative).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Final, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from firmware_py.core.errors import InputError
from firmware_py.goals.plan_goals import check_plan_goals
from firmware_py.goals.tip_plan import PayloadPlan, TipPlan, as_columns
from firmware_py.link.link_description import STUDY_LINK
from firmware_py.safety.limits import Limits
from models.plan.feedback import with_feedback
from models.plan.inversion import Inverter, rms
from models.plan.paths import DesiredPath, Timeline, timeline
from models.plan.probing import design_probe
from models.plan.tip_twin import TipTwin, TwinRun
from models.plant.linear_twin import LinearMode, LinearTwins, resting_modes
from models.plant.parameter import check_payload
from models.plant.plant import Plant

Array = NDArray[np.float64]
Method = Literal["inverse", "rigid", "zvd"]
PAYLOADS_KG: Final = STUDY_LINK.payloads_kg
"""Grid of payloads: the study's range. Between two of them the goals are nearly linear in the
payload. Measured on the twin of the demo, circle of 0.4 m in 8 s: interpolated goals leave 0.73 mm
with 0.25 kg, where those of the grid leave 0.66 and 0.71 mm."""
PAYLOAD_RATE_KG_S: Final = 0.5
"""Largest rate of the payload that goals are interpolated at [assumed]: the whole grid in four
seconds."""
MOVE_STEP: Final = 0.06
"""Relative resolution of the search for the shortest move [assumed]."""


@dataclass(frozen=True)
class PlanRequest:
    """Robot, payloads and method of a plan."""

    plant: Plant
    dof: int
    period_s: float
    limits: Limits  # Limits of the robot in force
    payloads_kg: Sequence[float] = PAYLOADS_KG
    bundle_sha256: str = ""  # Hash of the manifest of the robot's bundle
    # "inverse": inversion of the twin. "rigid": the link taken as rigid, moves from rest to rest as
    # fast as the limits permit. "zvd": the same with ZVD shaping of the moves
    method: Method = "inverse"
    feedback: bool = True  # Whether the inverse gets feedback of the estimated tip
    # Whether a motion that measures stiffness and payload precedes the first run; needs feedback
    probe: bool = False


def plan_path(
    path: DesiredPath, request: PlanRequest, report: Callable[[str], None] = lambda text: None
) -> TipPlan:
    plant, payloads, limits = request.plant, request.payloads_kg, request.limits
    check_grid(plant, payloads)
    twin = TipTwin(plant, request.dof, request.period_s)
    middle = payloads[len(payloads) // 2]
    line = timeline(path, twin.resting_tip_m(np.zeros(request.dof), middle), request.period_s)
    where = f"path {path.name} (it begins {line.start_row * request.period_s:.2f} s into the plan)"
    _check_reach(twin, line, payloads, limits, where)
    report("path within reach")

    inverter = Inverter(twin, line, report)
    rigid = [twin.run(inverter.pointing_rad(), m) for m in payloads]
    if request.method == "inverse":
        runs = inverter.invert(payloads)
    else:
        tables = _comparison_goals(inverter.pointing_rad(), line, request)
        runs = [twin.run(table, m) for table, m in zip(tables, payloads, strict=True)]
    plan = _document(path, request, line, runs, rigid)
    check_plan_goals(plan, limits, where)

    if request.feedback and request.method == "inverse":
        plan, refusal = with_feedback(plan, plant, limits, twin, inverter, runs)
        report(f"no feedback: {refusal}" if refusal else "feedback designed")
        if request.probe and refusal:
            raise InputError("--probe", f"needs feedback of the tip: {refusal}", "leave it out")
    if request.probe:
        plan = msgspec.structs.replace(plan, probe=design_probe(plant, twin, payloads, limits))
        check_plan_goals(plan, limits, where)
        report("probing motion designed")
    for run in runs:
        _check_prediction(run, request, where)
    return plan


def check_grid(plant: Plant, payloads_kg: Sequence[float]) -> None:
    """Refuse a grid of payloads that does not rise, or that the plant does not carry."""
    grid = list(payloads_kg)
    if not grid or grid != sorted(set(grid)) or not 0 <= grid[0] <= grid[-1]:
        raise InputError("--payloads", f"are {grid}", "give rising masses in kg")
    check_payload(grid[-1], "--payloads", plant.link)


def _check_reach(
    twin: TipTwin, line: Timeline, payloads_kg: Sequence[float], limits: Limits, where: str
) -> None:
    """Refuse a path, or ways to and from it, that the resting tip cannot reach within the limits.

    The farthest points are tried: the first rows of the largest distance and coordinates.
    """
    farthest = np.sum(line.desired_m**2, axis=1).argmax()
    rows = {farthest, *line.desired_m.argmax(axis=0), *line.desired_m.argmin(axis=0)}
    for row, payload_kg in product(sorted(rows), (payloads_kg[0], payloads_kg[-1])):
        wanted = line.desired_m[row]
        nearest = nearest_rest_m(twin, wanted, payload_kg, limits)
        if np.linalg.norm(nearest - wanted) > 2e-3:
            on_path = line.start_row <= row < line.end_row
            raise InputError(
                where, f"row {row} ({row * twin.period_s:.2f} s) "
                f"{'leads' if on_path else 'of the way there or back leads'} to {_place(wanted)}, "
                f"which the tip cannot reach with {payload_kg:g} kg and goals within "
                f"limits.angle_rad; the nearest place is {_place(nearest)}",
                "make the path smaller, or move its centre" if on_path
                else "let the path begin and end slower",
            )  # fmt: skip


def nearest_rest_m(twin: TipTwin, wanted_m: Array, payload_kg: float, limits: Limits) -> Array:
    """Place nearest to a wanted one, shape (dof,), at which the tip can rest, shape (dof,)."""
    low, high = limits.angle_rad
    goal = np.zeros(twin.dof)
    tip = twin.resting_tip_m(goal, payload_kg)
    for _ in range(6):  # the tip is nearly linear in the goals
        slope = twin.resting_slope(goal, payload_kg)
        # Bounded by the limits: if one joint is at its limit, the other comes as near as it can.
        bounds = low - goal - 1e-9, high - goal + 1e-9
        step = lsq_linear(slope, wanted_m - tip, bounds).x
        goal = np.clip(goal + step, low, high)
        tip = twin.resting_tip_m(goal, payload_kg)
    return tip


def _place(tip_m: Array) -> str:
    text = ", ".join(f"{value + 0.0:.3f}" for value in np.round(tip_m, 3))
    return f"({text}) m" if len(tip_m) > 1 else f"x = {text} m"


def _document(
    path: DesiredPath, request: PlanRequest, line: Timeline, runs: Sequence[TwinRun],
    rigid: Sequence[TwinRun],
) -> TipPlan:  # fmt: skip
    held_out = request.plant.provenance.held_out
    plant_error = held_out.dof.get(str(request.dof)) if held_out else None
    plant_m = plant_error.tip_rms_m if plant_error else None
    moving = [line.desired_m] if request.method == "inverse" else [run.goals_rad for run in runs]
    residuals_m = [rms(run.tip_m - line.desired_m) for run in runs]
    return TipPlan(
        schema=TipPlan.VERSION,
        path=path.name,
        method=request.method,
        dof=request.dof,
        period_s=request.period_s,
        rest_s=line.rest_rows * request.period_s,
        start_row=line.start_row,
        end_row=line.end_row,
        drawn=line.drawn,
        desired_m=as_columns(line.desired_m, 6),
        payloads=tuple(
            PayloadPlan(
                payload_kg=run.payload_kg,
                goals_rad=as_columns(run.goals_rad, 7),
                tip_m=as_columns(run.tip_m, 6),
                current_a=as_columns(run.current_a, 4),
                residual_rms_m=residual_m,
                rigid_rms_m=rms(straight.tip_m - line.desired_m),
                expected_rms_m=math.hypot(residual_m, plant_m or 0.0),
            )
            for run, straight, residual_m in zip(runs, rigid, residuals_m, strict=True)
        ),
        payload_rate_kg_s=PAYLOAD_RATE_KG_S,
        plant_error_rms_m=plant_m,
        plant_sha256=request.plant.for_robot().sha256(),
        bundle_sha256=request.bundle_sha256,
        link=request.plant.link_facts(),
        moves=tuple(
            (first, first + max(_rows_until_rest(t[first:after]) for t in moving), after)
            for first, after in line.moves
        ),
    )


def _rows_until_rest(table: Array) -> int:
    """Row of a move at which the path, or else the goals, have come to rest."""
    steps = np.abs(np.diff(table, axis=0)).max(axis=1)
    return int(np.flatnonzero(steps > 1e-7).max(initial=0)) + 1  # rad or m in a period


def _check_prediction(run: TwinRun, request: PlanRequest, where: str) -> None:
    """Refuse a plan in which the twin violates a limit of measured signals, and name the row."""
    angle = run.angle_rad.tolist()
    for row in range(1, len(angle)):
        violation = request.limits.sample_violation(
            angle[row], run.current_a[row].tolist(), run.position_m[row].tolist(), 0.0,
            goal=run.goals_rad[row - 1].tolist(), angle_before=angle[row - 1],
        )  # fmt: skip
        if violation:
            raise InputError(
                where, f"row {row} ({row * request.period_s:.2f} s), {run.payload_kg:g} kg: the "
                f"twin predicts that {violation}",
                "make the path slower or smaller, or widen the limit",
            )  # fmt: skip


def shortest_move_s(path_of: Callable[[float], DesiredPath], request: PlanRequest) -> float:
    """Shortest duration of a move whose plans keep every limit and leave at most 2 mm RMS.

    Only the lightest and the heaviest payload of the request are tried.
    """
    ends = tuple(sorted({request.payloads_kg[0], request.payloads_kg[-1]}))
    request = replace(request, payloads_kg=ends, feedback=False)
    low, high = 0.2, 4.0

    def is_accurate(seconds: float) -> bool:
        plan = plan_path(path_of(seconds), request)
        return all(one.residual_rms_m < 2e-3 for one in plan.payloads)

    if not is_accurate(high):
        raise InputError("--fastest", f"finds no move within {high:g} s", "make the path smaller")
    while high > (1.0 + MOVE_STEP) * low:
        middle = math.sqrt(low * high)
        try:
            low, high = (low, middle) if is_accurate(middle) else (middle, high)
        except InputError:  # a limit is broken
            low = middle
    return high


def _comparison_goals(pointing_rad: Array, line: Timeline, request: PlanRequest) -> list[Array]:
    """Goals for each payload of a rigid link whose moves are as fast as the limits permit.

    `pointing_rad`, shape (n, dof): goals at which the rigid link points at the desired tip.
    """
    period_s, tables = request.period_s, []
    twins = LinearTwins(request.plant.step_model(request.dof), period_s)
    for payload_kg in request.payloads_kg:
        table = pointing_rad.copy()
        for first, after in line.moves:
            end = pointing_rad[after - 1]
            fast = rate_limited(pointing_rad[first], end, request.limits, period_s)
            table[first + 1 : after] = end
            table[first + 1 : first + 1 + len(fast)] = fast[: after - first - 1]
            late_s = 0.0
            if request.method == "zvd":
                for joint, mode in enumerate(resting_modes(twins, payload_kg, end)):
                    column, impulses = table[first:after, joint], zvd_impulses(mode)
                    table[first:after, joint] = shaped(column, impulses, period_s)
                    late_s = max(late_s, impulses[-1][0])
            if len(fast) * period_s + late_s > (after - first - 1) * period_s:
                raise InputError("--seconds", "leaves no rest after a move", "give more time")
        tables.append(table)
    return tables


def rate_limited(start_rad: Array, end_rad: Array, limits: Limits, period_s: float) -> Array:
    """Goals of the fastest move within rate and acceleration, all joints together, shape (n, dof).

    The last row is the end.
    """
    distance, most = float(np.max(np.abs(end_rad - start_rad))), limits.acceleration_rad_s2
    rate = min(limits.rate_rad_s, math.sqrt(distance * most))
    rise_s, total_s = rate / most, distance / rate + rate / most
    at_s = np.minimum(period_s * np.arange(1, math.ceil(total_s / period_s) + 1), total_s)
    # Ramps of the rate at both ends; sampled, no mean rate over a period exceeds them.
    ramps = [np.maximum(at_s - t, 0.0) ** 2 for t in (0.0, rise_s, total_s - rise_s, total_s)]
    way = 0.5 * most * (ramps[0] - ramps[1] - ramps[2] + ramps[3]) / distance
    return np.asarray(start_rad + way[:, None] * (end_rad - start_rad))


def zvd_impulses(mode: LinearMode) -> list[tuple[float, float]]:
    """Delay in s and weight of each of the three impulses."""
    k, half = mode.decay, mode.half_period_s
    total = (1.0 + k) ** 2
    return [(0.0, 1.0 / total), (half, 2.0 * k / total), (2.0 * half, k * k / total)]


def shaped(column: Array, impulses: list[tuple[float, float]], period_s: float) -> Array:
    """Sum of delayed copies of a column (n,) that rests at its first value before, shape (n,)."""
    rows = np.arange(len(column), dtype=np.float64)
    copies = [w * np.interp(rows - delay / period_s, rows, column) for delay, w in impulses]
    return np.asarray(np.sum(copies, axis=0))
