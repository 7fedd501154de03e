"""Plan of a path: reach, goals for each payload, feedback, probing motion, limits, document."""

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

from firmware_py.errors import InputError
from firmware_py.goals.plan_goals import check_plan_goals
from firmware_py.goals.tip_plan import PayloadPlan, TipPlan, as_columns
from firmware_py.link.link_description import STUDY_LINK
from firmware_py.safety.limits import Limits
from models.plan.feedback import with_feedback
from models.plan.inversion import Inverse, Inverter
from models.plan.moves import comparison_goals
from models.plan.paths import DesiredPath, Timeline, timeline
from models.plan.probing import design_probe
from models.plan.tip_twin import TipTwin
from models.plant.linear_twin import LinearTwins
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
CLOSE_M: Final = 2e-3
"""Distance above which a place counts as out of reach [assumed]."""
REACH_STEPS: Final = 6
"""Steps of the search for the nearest place: the tip is nearly linear in the goals."""
TINY: Final = 1e-9
"""Least distance between the bounds of that search, rad."""
STILL: Final = 1e-7
"""Change in a period below which goals (rad) or the desired tip (m) count as at rest [assumed]."""
MOVE_S: Final = (0.2, 4.0)
MOVE_STEP: Final = 0.06
"""Range in which the shortest move is searched, in s, and the resolution of the search
[assumed]."""
FINE_M: Final = 2e-3
"""Largest RMS error of a shortest move on the twin [assumed]."""


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
    twin = TipTwin(plant.step_model(request.dof), request.dof, request.period_s)
    middle = payloads[len(payloads) // 2]
    line = timeline(path, twin.resting_tip_m(np.zeros(request.dof), middle), request.period_s)
    where = f"path {path.name} (it begins {line.start_row * request.period_s:.2f} s into the plan)"
    _check_reach(twin, line, payloads, limits, where)
    report("path within reach")

    reach_m = plant.parameters["base_offset_m"].value + plant.parameters["link_length_m"].value
    inverter = Inverter(twin, line, reach_m, report)
    rigid = [inverter.response(inverter.pointing_rad(), m) for m in payloads]
    if request.method == "inverse":
        found = inverter.invert(payloads)
    else:
        tables = comparison_goals(
            inverter.pointing_rad(), line, limits,
            LinearTwins(plant, request.dof, request.period_s), payloads,
            zvd=request.method == "zvd",
        )  # fmt: skip
        found = [inverter.response(t, m) for t, m in zip(tables, payloads, strict=True)]
    plan = _document(path, request, line, twin, found, rigid)
    check_plan_goals(plan, limits, where)

    if request.feedback and request.method == "inverse":
        plan, refusal = with_feedback(plan, plant, limits, twin, inverter, found)
        report(f"no feedback: {refusal}" if refusal else "feedback designed")
        if request.probe and refusal:
            raise InputError("--probe", f"needs feedback of the tip: {refusal}", "leave it out")
    if request.probe:
        plan = msgspec.structs.replace(plan, probe=design_probe(plant, twin, payloads, limits))
        check_plan_goals(plan, limits, where)
        report("probing motion designed")
    for own in found:
        _check_prediction(twin, own, limits, where)
    return plan


def check_grid(plant: Plant, payloads_kg: Sequence[float]) -> None:
    """Refuse a plant that is not the link, and a grid of payloads that it does not carry."""
    grid = list(payloads_kg)
    if plant.load != "link":
        raise InputError(
            f"plant {plant.name!r}", "is not the link", "plans are made for the link alone"
        )
    if not grid or grid != sorted(set(grid)) or not 0 <= grid[0] <= grid[-1]:
        raise InputError("--payloads", f"are {grid}", "give rising masses in kg")
    check_payload(grid[-1], "--payloads", plant.link)


def _check_reach(
    twin: TipTwin, line: Timeline, payloads_kg: Sequence[float], limits: Limits, where: str
) -> None:
    """Refuse a path whose farthest points the resting tip cannot reach within the angle limits.

    The path is checked first, then the ways there and back, which swing out if the path is fast at
    its ends.
    """
    path = slice(line.start_row, line.end_row)
    for part, what, remedy in (
        (path, "leads", "make the path smaller, or move its centre"),
        (slice(0, None), "of the way there or back leads", "let the path begin and end slower"),
    ):
        desired_m = line.desired_m[part]
        # First rows of the largest distance, and of the largest and smallest coordinates
        rows = {np.sum(desired_m**2, axis=1).argmax(), *desired_m.argmax(0), *desired_m.argmin(0)}
        for row, payload_kg in product(sorted(rows), (payloads_kg[0], payloads_kg[-1])):
            nearest = nearest_rest_m(twin, desired_m[row], payload_kg, limits)
            if np.linalg.norm(nearest - desired_m[row]) > CLOSE_M:
                at = part.start + row
                raise InputError(
                    where, f"row {at} ({at * twin.period_s:.2f} s) {what} to "
                    f"{_place(desired_m[row])}, which the tip cannot reach with "
                    f"{payload_kg:g} kg and goals within limits.angle_rad; the nearest place "
                    f"is {_place(nearest)}", remedy,
                )  # fmt: skip


def nearest_rest_m(twin: TipTwin, wanted_m: Array, payload_kg: float, limits: Limits) -> Array:
    """Place nearest to a wanted one, shape (dof,), at which the tip can rest, shape (dof,)."""
    low, high = limits.angle_rad
    goal = np.zeros(twin.dof)
    tip = twin.resting_tip_m(goal, payload_kg)
    for _ in range(REACH_STEPS):
        slope = twin.resting_slope(goal, payload_kg)
        # Bounded by the limits: if one joint is at its limit, the other comes as near as it can.
        step = lsq_linear(slope, wanted_m - tip, (low - goal - TINY, high - goal + TINY)).x
        goal = np.clip(goal + step, low, high)
        tip = twin.resting_tip_m(goal, payload_kg)
    return tip


def _place(tip_m: Array) -> str:
    text = ", ".join(f"{value + 0.0:.3f}" for value in np.round(tip_m, 3))
    return f"({text}) m" if len(tip_m) > 1 else f"x = {text} m"


def _document(
    path: DesiredPath, request: PlanRequest, line: Timeline, twin: TipTwin,
    found: Sequence[Inverse], rigid: Sequence[Inverse],
) -> TipPlan:  # fmt: skip
    """Plan with the solution for each payload, compared with rigid kinematics."""
    held_out = request.plant.provenance.held_out
    own_error = held_out.dof.get(str(request.dof)) if held_out else None
    plant_m = own_error.tip_rms_m if own_error else None
    moving = [line.desired_m] if request.method == "inverse" else [f.goals_rad for f in found]
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
                payload_kg=own.payload_kg,
                goals_rad=as_columns(own.goals_rad, 7),
                tip_m=as_columns(twin.tip_m(own.outputs), 6),
                current_a=as_columns(twin.current_a(own.outputs), 4),
                residual_rms_m=own.residual_rms_m,
                rigid_rms_m=straight.residual_rms_m,
                expected_rms_m=math.hypot(own.residual_rms_m, plant_m or 0.0),
            )
            for own, straight in zip(found, rigid, strict=True)
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
    return int(np.flatnonzero(steps > STILL).max(initial=0)) + 1


def _check_prediction(twin: TipTwin, found: Inverse, limits: Limits, where: str) -> None:
    """Refuse a plan in which the twin violates a limit of measured signals, and name the row."""
    y = found.outputs
    angle, current, tip = twin.angle_rad(y), twin.current_a(y), twin.tip_in_space_m(y)
    for row in range(1, len(y)):
        violation = limits.sample_violation(
            angle[row].tolist(), current[row].tolist(), tip[row].tolist(), 0.0,
            goal=found.goals_rad[row - 1].tolist(), angle_before=angle[row - 1].tolist(),
        )  # fmt: skip
        if violation:
            raise InputError(
                where, f"row {row} ({row * twin.period_s:.2f} s), {found.payload_kg:g} kg: the "
                f"twin predicts that {violation}",
                "make the path slower or smaller, or widen the limit",
            )  # fmt: skip


def shortest_move_s(path_of: Callable[[float], DesiredPath], request: PlanRequest) -> float:
    """Shortest duration of a move whose plans keep every limit and leave little error.

    Only the lightest and the heaviest payload of the request are tried.
    """
    ends = tuple(sorted({request.payloads_kg[0], request.payloads_kg[-1]}))
    tried = replace(request, payloads_kg=ends, feedback=False)
    low, high = MOVE_S

    def keeps(seconds: float) -> bool:
        try:
            plan = plan_path(path_of(seconds), tried)
        except InputError:
            return False
        return all(own.residual_rms_m < FINE_M for own in plan.payloads)

    if not keeps(high):
        plan_path(path_of(high), tried)  # names the limit
        raise InputError("--fastest", f"finds no move within {high:g} s", "make the path smaller")
    while high > (1.0 + MOVE_STEP) * low:
        middle = math.sqrt(low * high)
        low, high = (low, middle) if keeps(middle) else (middle, high)
    return high
