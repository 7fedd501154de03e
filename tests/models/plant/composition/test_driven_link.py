"""The current that a measured motion needs, against that of the twin which made the motion."""

import numpy as np
import pytest

from models.plant.plant import read_plant
from models.plant.simulation.runner import CompiledModel
from models.plant.step_model import names

STEP_S, PERIOD_S, REST, COUNT = 0.017, 4.352, 60, 572
TORQUE_CONSTANT_NM_A = 6.83


OPTIONS = {
    "velocity_feedforward_1": 0.8,
    "position_integral_1_per_s2": 4.0,
    "setpoint_weight_1": 0.7,
}


@pytest.mark.parametrize("options", [{}, OPTIONS], ids=["cascade", "options"])
@pytest.mark.parametrize("interpolation, phase", [(1.0, 1.0), (1.0, 0.5), (0.0, 0.5), (0.0, 1.0)])
def test_the_current_of_a_motion_has_the_inertia_of_rotor_and_link(interpolation, phase, options):
    """Inertia and weight are in phase with the angle: 10 N·m/rad of them without payload.

    A rotor that is left out would be missed by J ω² = 1.8 N·m/rad, and taken for a link that is
    0.3 kg heavier.
    """
    plant = read_plant().with_values(
        {"goal_interpolation_1": interpolation, "current_phase_1": phase} | options
    )
    moving_s = STEP_S * np.maximum(np.arange(COUNT) - REST, 0)
    goal = -0.52 * np.sin(2 * np.pi / PERIOD_S * moving_s)
    twin, driven = (CompiledModel(plant.step_model(1, kind)) for kind in ("twin", "driven"))
    assert names(twin.model.outputs)[:2] == ["angle_1_rad", "current_1_a"]
    angle, current = twin.simulate(np.column_stack([goal, 0 * goal]), STEP_S)[:, :2].T
    u = np.column_stack([angle, 0 * angle])
    p = np.array(driven.model.parameter_values())
    y = driven.simulate(u[1:], STEP_S, p, driven.start(u[0], p))
    error_nm = TORQUE_CONSTANT_NM_A * (
        y[:, names(driven.model.outputs).index("current_1_a")] - current
    )
    rate = np.gradient(angle, STEP_S)
    seen = (np.arange(len(angle)) > REST) & (np.abs(rate) > 0.15)  # dry friction apart
    columns = np.column_stack([angle, rate, np.sign(rate), np.ones(len(angle))])
    per_rad, per_rate, *_ = np.linalg.lstsq(columns[seen], error_nm[seen], rcond=None)[0]
    assert abs(per_rad) < 0.25
    assert abs(per_rate) < 0.25, "friction that nobody has"
