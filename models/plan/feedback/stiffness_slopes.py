"""Changes of a plan by a stiffer link: goals, currents, and the observer's error."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from firmware_py.goals.feedback_design import StiffnessSlopes
from firmware_py.goals.tip_plan import as_columns
from models.plan.feedback.linear_twin import DRY_FRICTION, STIFFNESS
from models.plan.inversion import Inverse, Inverter
from models.plan.twin_sensitivity import TipTwin
from models.plant.plant import Plant
from models.plant.simulation.compiled_model import CompiledModel
from models.plant.step_model import names

Array = NDArray[np.float64]
STIFFER: Final = 0.2
"""Relative change of stiffness over which the differences are taken: the one a plan
must tolerate."""
MORE_FRICTION: Final = 0.2
"""The same for friction [assumed]."""
DECIMALS: Final = 5
"""Digits of the differences in the document: of goals 10 µrad, of the tip 10 µm."""
MOVING_RAD_S: Final = 0.1
"""Joint rate at which a sample has half its weight: the observer's `learning_rate_rad_s`."""


def stiffness_slopes(
    plant: Plant, twin: TipTwin, inverter: Inverter, found: Inverse, driven: CompiledModel
) -> StiffnessSlopes:
    """Differentiate a plan for one payload by the relative stiffness of the link.

    `driven`: the link of the observer, driven by measured angles at a known payload.
    """
    changes = {
        n: (1.0 + STIFFER) * p.value for n, p in plant.parameters.items() if n.startswith(STIFFNESS)
    }
    rubbing = {
        n: (1.0 + MORE_FRICTION) * p.value
        for n, p in plant.parameters.items()
        if n.startswith((*DRY_FRICTION, "viscous_friction_"))
    }
    stiffer = twin.changed(changes)
    same = stiffer.run(found.goals_rad, found.payload_kg)
    follows = inverter.on(stiffer).invert_from(found)
    friction = twin.changed(rubbing).run(found.goals_rad, found.payload_kg)
    currents = twin.current_a(found.outputs)
    seen = _seen_tip_m(driven, twin, follows) - _seen_tip_m(driven, twin, found)
    moved = twin.tip_m(follows.outputs) - twin.tip_m(found.outputs)
    rate = np.gradient(twin.angle_rad(found.outputs), twin.period_s, axis=0)
    return StiffnessSlopes(
        goals_rad=as_columns((follows.goals_rad - found.goals_rad) / STIFFER, DECIMALS),
        current_a=as_columns((twin.current_a(follows.outputs) - currents) / STIFFER, DECIMALS),
        unmatched_a=as_columns((twin.current_a(same) - currents) / STIFFER, DECIMALS),
        friction_a=as_columns((twin.current_a(friction) - currents) / MORE_FRICTION, DECIMALS),
        weight=as_columns(rate**2 / (rate**2 + MOVING_RAD_S**2), DECIMALS),
        unseen_m=as_columns((moved - seen) / STIFFER, DECIMALS),
    )


def _seen_tip_m(driven: CompiledModel, twin: TipTwin, own: Inverse) -> Array:
    """Tip of the observer's link for the joint angles of a run, shape (n, dof)."""
    angle = twin.angle_rad(own.outputs)
    u = np.column_stack([angle, np.full(len(angle), own.payload_kg)])
    p = driven.model.parameter_values()
    y = driven.simulate(u[1:], twin.period_s, p, driven.start(u[0], p))
    places = [names(driven.model.outputs).index(n) for n in ("tip_x_m", "tip_y_m")[: twin.dof]]
    return y[:, places]
