"""Reach of the arm: whether its tip can rest where a path leads, with every payload.

Plan of a path: reach, goals for each payload, limits, predicted and expected error.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
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
from models.plan.moves import first_modes, rate_limited, shaped, zvd_impulses
from models.plan.paths import DesiredPath, Timeline, timeline
from models.plan.probing import design_probe
from models.plan.tip_twin import TipTwin
from models.plant.parameter import check_payload
from models.plant.plant import Plant

Array = NDArray[np.float64]
CLOSE_M: Final = 2e-3
"""Distance above which a place counts as out of reach [assumed]."""
STEPS: Final = 6
"""Steps of the search: the tip is nearly linear in the goals."""
PROBE_RAD: Final = 1e-3
TINY: Final = 1e-9
"""Least distance between the bounds of the search, rad."""


def check_reach(
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
        desired_m, first = line.desired_m[part], part.start
        for row in _farthest(desired_m):
            for payload_kg in (payloads_kg[0], payloads_kg[-1]):
                nearest = nearest_rest_m(twin, desired_m[row], payload_kg, limits)
                if np.linalg.norm(nearest - desired_m[row]) > CLOSE_M:
                    raise InputError(
                        where, f"row {first + row} ({(first + row) * twin.period_s:.2f} s) {what} "
                        f"to {_place(desired_m[row])}, which the tip cannot reach with "
                        f"{payload_kg:g} kg and goals within limits.angle_rad; the nearest place "
                        f"is {_place(nearest)}", remedy,
                    )  # fmt: skip


def nearest_rest_m(twin: TipTwin, wanted_m: Array, payload_kg: float, limits: Limits) -> Array:
    """Place nearest to a wanted one at which the tip can rest, shape (dof,).

    Shapes: `wanted_m` (dof,).
    """
    low, high = limits.angle_rad
    goal = np.zeros(twin.dof)
    tip = twin.resting_tip_m(goal, payload_kg)
    for _ in range(STEPS):
        slope = np.column_stack(
            [
                (twin.resting_tip_m(goal + PROBE_RAD * unit, payload_kg) - tip) / PROBE_RAD
                for unit in np.eye(twin.dof)
            ]
        )
        # Bounded by the limits: if one joint is at its limit, the other comes as near as it can.
        step = lsq_linear(slope, wanted_m - tip, (low - goal - TINY, high - goal + TINY)).x
        goal = np.clip(goal + step, low, high)
        tip = twin.resting_tip_m(goal, payload_kg)
    return tip


def _farthest(desired_m: Array) -> list[int]:
    """First rows of the largest distance, and of the largest and smallest coordinates."""
    extreme = [int(np.argmax(np.sum(desired_m**2, axis=1)))]
    for column in desired_m.T:
        extreme += [int(np.argmax(column)), int(np.argmin(column))]
    return sorted(set(extreme))


def _place(tip_m: Array) -> str:
    text = ", ".join(f"{value + 0.0:.3f}" for value in np.round(tip_m, 3))
    return f"({text}) m" if len(tip_m) > 1 else f"x = {text} m"


PAYLOADS_KG: Final = STUDY_LINK.payloads_kg
"""Grid of payloads: the study's range. Between two of them the goals are nearly linear in the
payload. Measured on the twin of the demo, circle of 0.4 m in 8 s: interpolated goals leave 0.73 mm
with 0.25 kg, where those of the grid leave 0.66 and 0.71 mm."""
PAYLOAD_RATE_KG_S: Final = 0.5
"""Largest rate of the payload that goals are interpolated at [assumed]: the whole grid in four
seconds."""
STILL: Final = 1e-7
"""Change in a period below which goals (rad) or the desired tip (m) count as at rest [assumed]."""
MOVE_S: Final = (0.2, 4.0)
MOVE_STEP: Final = 0.06
"""Range in which the shortest move is searched, in s, and the resolution of the search
[assumed]."""
FINE_M: Final = 2e-3
"""Largest RMS error of a shortest move on the twin [assumed]."""
Method = Literal["inverse", "rigid", "zvd"]
_REMEDY: Final = "make the path slower or smaller, or widen the limit"


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
    check_request(request)
    plant, payloads = request.plant, request.payloads_kg
    twin = TipTwin(plant.step_model(request.dof), request.dof, request.period_s)
    middle = payloads[len(payloads) // 2]
    line = timeline(path, twin.resting_tip_m(np.zeros(request.dof), middle), request.period_s)
    begin_s = line.start_row * request.period_s
    where = f"path {path.name} (it begins {begin_s:.2f} s into the plan)"
    check_reach(twin, line, payloads, request.limits, where)
    report("path within reach")
    reach_m = plant.parameters["base_offset_m"].value + plant.parameters["link_length_m"].value
    inverter = Inverter(twin, line, reach_m, report)
    rigid = [inverter.rigid(m) for m in payloads]
    if request.method == "inverse":
        found = inverter.invert(payloads)
    elif line.moves:
        tables = comparison_goals(inverter.pointing_rad(), line, twin, request)
        found = [inverter.found(t, m) for t, m in zip(tables, payloads, strict=True)]
    else:
        found = rigid
    plan = _document(path, request, line, twin, list(zip(found, rigid, strict=True)))
    check_plan_goals(plan, request.limits, where)
    if request.feedback and request.method == "inverse":
        plan, refusal = with_feedback(plan, request.plant, request.limits, twin, inverter, found)
        report(f"no feedback: {refusal}" if refusal else "feedback designed")
        if request.probe and refusal:
            raise InputError("--probe", f"needs feedback of the tip: {refusal}", "leave it out")
    if request.probe:
        probe = design_probe(request.plant, twin, payloads, request.limits)
        plan = msgspec.structs.replace(plan, probe=probe)
        check_plan_goals(plan, request.limits, where)
        report("probing motion designed")
    for own in found:
        _check_prediction(twin, own, line, request.limits, where)
    return plan


def _document(
    path: DesiredPath, request: PlanRequest, line: Timeline, twin: TipTwin,
    found: Sequence[tuple[Inverse, Inverse]],
) -> TipPlan:  # fmt: skip
    """Plan with the solution for each payload, compared with rigid kinematics."""
    own_error = _own_error_m(request.plant, request.dof)
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
                expected_rms_m=math.hypot(own.residual_rms_m, own_error or 0.0),
            )
            for own, straight in found
        ),
        payload_rate_kg_s=PAYLOAD_RATE_KG_S,
        plant_error_rms_m=own_error,
        plant_sha256=request.plant.for_robot().sha256(),
        bundle_sha256=request.bundle_sha256,
        link=request.plant.link_facts(),
        moves=_moves(
            line, None if request.method == "inverse" else [f.goals_rad for f, _ in found]
        ),
    )


def comparison_goals(
    pointing_rad: Array, line: Timeline, twin: TipTwin, request: PlanRequest
) -> list[Array]:
    """Goals of a rigid link whose moves are as fast as the limits permit, for each payload.

    `pointing_rad`, shape (n, dof): goals at which the rigid link points at the desired tip.
    """
    period_s, tables = request.period_s, []
    for payload_kg in request.payloads_kg:
        table = pointing_rad.copy()
        for first, after in line.moves:
            end = pointing_rad[after - 1]
            fast = rate_limited(pointing_rad[first], end, request.limits, period_s)
            table[first:after] = end
            table[first] = pointing_rad[first]
            table[first + 1 : first + 1 + len(fast)] = fast[: after - first - 1]
            late_s = 0.0
            if request.method == "zvd":
                modes = first_modes(twin, end, payload_kg)
                for joint, mode in enumerate(modes):
                    column, impulses = table[first:after, joint], zvd_impulses(mode)
                    table[first:after, joint] = shaped(column, impulses, period_s)
                    late_s = max(late_s, impulses[-1][0])
            if len(fast) * period_s + late_s > (after - first - 1) * period_s:
                raise InputError("--seconds", "leaves no rest after a move", "give more time")
        tables.append(table)
    return tables


def _moves(line: Timeline, tables: Sequence[Array] | None) -> tuple[tuple[int, int, int], ...]:
    """Moves with the row at which the path, or else the goals, have come to rest."""
    found = []
    for first, after in line.moves:
        over = 0
        for table in (line.desired_m,) if tables is None else tables:
            steps = np.abs(np.diff(table[first:after], axis=0)).max(axis=1)
            over = max(over, int(np.flatnonzero(steps > STILL).max(initial=0)) + 1)
        found.append((first, first + over, after))
    return tuple(found)


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


def check_request(request: PlanRequest) -> None:
    """Refuse a plant that is not the link, and invalid payloads."""
    payloads = list(request.payloads_kg)
    if request.plant.load != "link":
        raise InputError(
            f"plant {request.plant.name!r}", "is not the link", "plans are made for the link alone"
        )
    if not payloads or payloads != sorted(set(payloads)) or not 0 <= payloads[0] <= payloads[-1]:
        raise InputError("--payloads", f"are {payloads}", "give rising masses in kg")
    check_payload(payloads[-1], "--payloads", request.plant.link)


def _own_error_m(plant: Plant, dof: int) -> float | None:
    """Error of the tip on trials that the plant was not fitted to; None if it is unknown."""
    held_out = plant.provenance.held_out
    own = held_out.dof.get(str(dof)) if held_out else None
    return own.tip_rms_m if own else None


def _check_prediction(
    twin: TipTwin, found: Inverse, line: Timeline, limits: Limits, where: str
) -> None:
    """Refuse a plan in which the twin violates a limit of measured signals, and name the row."""
    y = found.outputs
    angle, current, tip = twin.angle_rad(y), twin.current_a(y), twin.tip_in_space_m(y)
    for row in range(1, len(line.desired_m)):
        violation = limits.sample_violation(
            angle[row].tolist(), current[row].tolist(), tip[row].tolist(), 0.0,
            goal=found.goals_rad[row - 1].tolist(), angle_before=angle[row - 1].tolist(),
        )  # fmt: skip
        if violation:
            raise InputError(
                where, f"row {row} ({row * twin.period_s:.2f} s), {found.payload_kg:g} kg: the "
                f"twin predicts that {violation}", _REMEDY,
            )  # fmt: skip
