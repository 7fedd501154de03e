"""Feedback of an inverted plan: loops for its grid, and the changes by a stiffer link."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec

from firmware_py.errors import InputError
from firmware_py.goals.plan_goals import check_plan_goals
from firmware_py.goals.tip_plan import TipPlan
from firmware_py.safety.limits import Limits
from models.plan.feedback.feedback_loops import design_feedback, keeps_margins
from models.plan.feedback.stiffness_slopes import stiffness_slopes
from models.plan.inversion import Inverse, Inverter
from models.plan.twin_sensitivity import TipTwin
from models.plant.plant import Plant
from models.plant.simulation.compiled_model import CompiledModel


def with_feedback(
    plan: TipPlan, plant: Plant, limits: Limits, twin: TipTwin, inverter: Inverter,
    found: Sequence[Inverse],
) -> tuple[TipPlan, str]:  # fmt: skip
    """Add feedback; if that is impossible, return the plan unchanged, and the reason.

    Feedback needs loops that keep the margins, and limits that leave room for corrections.
    """
    design = design_feedback(plant, plan.dof, plan.period_s, plan.grid_kg.tolist())
    if not keeps_margins(design):
        return plan, "no gain of a loop keeps its margins"
    guided = msgspec.structs.replace(plan, feedback=design)
    try:
        check_plan_goals(guided, limits, f"path {plan.path}")
    except InputError as error:
        return plan, f"the limits leave no room for corrections ({error})"
    driven = CompiledModel(plant.step_model(plan.dof, "driven"))
    payloads = tuple(
        msgspec.structs.replace(
            own, stiffness=stiffness_slopes(plant, twin, inverter, inverse, driven)
        )
        for own, inverse in zip(plan.payloads, found, strict=True)
    )
    return msgspec.structs.replace(guided, payloads=payloads), ""
