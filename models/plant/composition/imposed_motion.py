"""Composition of a load on joints that move as measured; outputs are torque and load signals."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from models.plant.components.drives.drive_protocol import SI_UNIT_OF, Drive
from models.plant.components.load_protocol import PlantLoad
from models.plant.composition.driven_link import apply_measured_motion, declare_measured_motion
from models.plant.composition.equilibrium import start_in_motion
from models.plant.composition.output_lag import lag_outputs
from models.plant.composition.step_functions import build_step_model, payload_variable
from models.plant.effects import Effect
from models.plant.scope import Expr, Scope
from models.plant.step_model import StepModel, Variable

EFFORT_NAME: Final = {"nm": "torque", "n": "force"}
"""Name of the torque or force that a joint's motion needs, by its unit suffix."""


def compose_imposed(
    name: str, scope: Scope, drive: Drive, load: PlantLoad, effects: Sequence[Effect]
) -> StepModel:
    """Compose a load on joints whose coordinates are inputs (drive `measured`).

    Effects of the command do not act: there is no goal.
    """
    declare_measured_motion(scope, effects)
    scope.payload_kg = scope.input(payload_variable(scope))
    apply_measured_motion(scope, drive, load, effects)
    start_in_motion(scope)
    torque = scope.suffix["torque"]
    outputs: dict[str, tuple[Variable, Expr]] = {}
    for j in scope.joints:
        variable = Variable(
            f"{EFFORT_NAME[torque]}_{j}_{torque}", SI_UNIT_OF[torque], 0.0, f"measured, joint {j}"
        )
        outputs[variable.name] = (variable, scope.current[j])
    lagged = lag_outputs(scope, outputs | load.outputs(scope))
    return build_step_model(name, scope, lagged, inputs_at_end=True)
