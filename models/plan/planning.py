"""Plan of a path: reach, goals for each payload, limits, what is predicted and expected."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from firmware_py.errors import InputError
from firmware_py.goals.plan_goals import check_plan_goals
from firmware_py.goals.tip_plan import Columns, PayloadPlan, TipPlan
from firmware_py.safety.limits import Limits
from models.plan.inversion import Inverse, Inverter
from models.plan.path_shapes import DesiredPath
from models.plan.plan_timeline import Timeline, timeline
from models.plan.reach import check_reach
from models.plan.twin_sensitivity import TipTwin
from models.plant.plant import Plant

Array = NDArray[np.float64]
PAYLOADS_KG: Final = (0.0, 0.5, 1.0, 1.5, 2.0)
"""Grid of payloads: the study's range. Between two of them the goals are nearly linear in the
payload. Measured on the twin of the demo, circle of 0.4 m in 8 s: interpolated goals leave 0.73 mm
with 0.25 kg, where those of the grid leave 0.66 and 0.71 mm."""
PAYLOAD_RATE_KG_S: Final = 0.5
"""Largest rate of the payload of the goals [assumed]: the whole grid in four seconds."""
_REMEDY: Final = "make the path slower or smaller, or widen [limits]"


@dataclass(frozen=True)
class PlanRequest:
    """What a plan is made for.

    Attributes
    ----------
    plant : Plant
        Plant to invert.
    dof : int
        Joints.
    period_s : float
        Control period.
    limits : Limits
        Limits of the robot, as in force.
    payloads_kg : sequence of float
        Grid, rising.
    bundle_sha256 : str
        Hash of the manifest of the robot's bundle.
    rigid : bool
        Whether the link is taken as rigid, for comparison.
    """

    plant: Plant
    dof: int
    period_s: float
    limits: Limits
    payloads_kg: Sequence[float] = PAYLOADS_KG
    bundle_sha256: str = ""
    rigid: bool = False


def plan_path(
    path: DesiredPath, request: PlanRequest, report: Callable[[str], None] = lambda text: None
) -> TipPlan:
    """Plan a path.

    Parameters
    ----------
    path : DesiredPath
        Sampled with the control period.
    request : PlanRequest
        Plant, robot and payloads.
    report : callable
        Called with one phrase after each step.

    Raises
    ------
    InputError
        If the plant is not the link, the payloads do not rise, the tip cannot reach the path, or
        the plan breaks a limit.
    """
    _check(request)
    plant, payloads = request.plant, request.payloads_kg
    twin = TipTwin(plant.step_model(request.dof), request.dof, request.period_s)
    middle = payloads[len(payloads) // 2]
    line = timeline(path, twin.resting_tip_m(np.zeros(request.dof), middle), request.period_s)
    where = f"path {path.name}"
    check_reach(twin, line.desired_m, payloads, request.limits, where)
    report("path within reach")
    reach_m = plant.parameters["base_offset_m"].value + plant.parameters["link_length_m"].value
    inverter = Inverter(twin, line, reach_m, report)
    rigid = [inverter.rigid(m) for m in payloads]
    found = rigid if request.rigid else inverter.invert(payloads)
    plan = _document(path, request, line, twin, list(zip(found, rigid, strict=True)))
    check_plan_goals(plan, request.limits, where)
    for own in found:
        _check_prediction(twin, own, line, request.limits, where)
    return plan


def _document(
    path: DesiredPath, request: PlanRequest, line: Timeline, twin: TipTwin,
    found: Sequence[tuple[Inverse, Inverse]],
) -> TipPlan:  # fmt: skip
    """Plan of what was found for each payload, and of rigid kinematics beside it."""
    own_error = _own_error_m(request.plant, request.dof)
    return TipPlan(
        schema=TipPlan.VERSION,
        path=path.name,
        method="rigid" if request.rigid else "inverse",
        dof=request.dof,
        period_s=request.period_s,
        rest_s=line.rest_rows * request.period_s,
        start_row=line.start_row,
        end_row=line.end_row,
        drawn=line.drawn,
        desired_m=_columns(line.desired_m, 6),
        payloads=tuple(
            PayloadPlan(
                payload_kg=own.payload_kg,
                goals_rad=_columns(own.goals_rad, 7),
                tip_m=_columns(twin.tip_m(own.outputs), 6),
                current_a=_columns(twin.current_a(own.outputs), 4),
                residual_rms_m=own.residual_rms_m,
                rigid_rms_m=straight.residual_rms_m,
                expected_rms_m=math.hypot(own.residual_rms_m, own_error or 0.0),
            )
            for own, straight in found
        ),
        payload_rate_kg_s=PAYLOAD_RATE_KG_S,
        plant_error_rms_m=own_error,
        plant_sha256=request.plant.sha256(),
        bundle_sha256=request.bundle_sha256,
    )


def _check(request: PlanRequest) -> None:
    payloads = list(request.payloads_kg)
    if request.plant.load != "link":
        raise InputError(
            f"plant {request.plant.name!r}", "is not the link", "plans are made for the link alone"
        )
    if not payloads or payloads != sorted(set(payloads)) or not 0 <= payloads[0] <= payloads[-1]:
        raise InputError("--payloads", f"are {payloads}", "give rising masses in kg")
    if payloads[-1] > 3.0:
        raise InputError("--payloads", f"reach {payloads[-1]:g} kg", "give 3 kg at most")


def _own_error_m(plant: Plant, dof: int) -> float | None:
    """Error of the tip on trials that the plant was not fitted to; None where it is not known."""
    held_out = plant.provenance.held_out
    own = held_out.dof.get(str(dof)) if held_out else None
    return own.tip_rms_m if own else None


def _check_prediction(
    twin: TipTwin, found: Inverse, line: Timeline, limits: Limits, where: str
) -> None:
    """Refuse a plan in which the twin violates a limit of measured signals; names the row."""
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


def _columns(table: Array, decimals: int) -> Columns:
    rounded = np.round(table, decimals) + 0.0  # no negative zeros
    return tuple(tuple(column) for column in rounded.T.tolist())
