"""Rig and plant mean the same by a strength: hidden in one, set in the other, the same change."""

import functools
import math

import numpy as np
import pytest

from models.plant.plant import read_plant
from models.plant.simulation.runner import CompiledModel, run_trial, trial_parameters
from models.plant.step_model import names
from models.rig.protocol import run_case

pytestmark = pytest.mark.slow

HIDDEN = {
    "sensor_lag": (0.02, "current_1_a", 0.2),
    "encoder_ripple": (0.004, "tip_x_m", 0.5),
    "cogging": (2.0, "current_1_a", 0.3),
    "marker_scale": (0.01, "tip_z_m", 0.02),
    "stiction": (3.0, "current_1_a", 0.65),
    "current_bias": (0.2, "current_1_a", 0.06),
    "current_scale": (0.1, "current_1_a", 0.5),
    "marker_frame_tilt": (0.02, "tip_x_m", 0.03),
    "sync_offset": (0.03, "tip_x_m", 0.3),
    "encoder_offset": (0.02, "tip_x_m", 0.2),
    "prebend": (0.05, "tip_x_m", 0.2),
}
"""Strength, the signal that shows it most, and the largest part of its change that the equations
may differ in: the rig's breakaway torque is full at a reversal and the plant's after some distance,
a rippled link is near its mode, which is lower in the nominal plant, and so are their currents."""

PERIOD_S = {"encoder_ripple": 9.0}
"""Period of the motion, 2.6 s for other effects: the ripple must stay below the link's mode."""


@pytest.fixture(scope="module")
def rested(parameters):
    """The rig after a pause in which the link rings down."""
    return parameters.changed(**{"world.settle_s": 0.3, "world.pause_s": 2.0})


@pytest.fixture(scope="module")
def cases(short_case, rested):
    """Case of a period, with the rig's run without a hidden effect."""

    @functools.cache
    def of(period_s):
        case = short_case(dof=1, amplitude_rad=math.radians(30.0), period_s=period_s)
        return case, run_case(rested, case)

    return of


@pytest.fixture(scope="module")
def twin():
    plant = read_plant().with_effects(*HIDDEN)
    return CompiledModel(plant.step_model(1))


@pytest.mark.parametrize("effect", HIDDEN)
def test_the_same_strength_makes_the_same_change(effect, rested, cases, twin):
    """Difference from the run without it: what else rig and plant differ in drops out."""
    strength, signal, differing = HIDDEN[effect]
    case, without = cases(PERIOD_S.get(effect, 2.6))
    moving = slice(without.meta.rest_samples, None)  # at rest a rig with breakaway torque sticks
    hidden = run_case(rested.hide({effect: strength}), case)
    model = twin.model
    changed = trial_parameters(model, without)
    (name,) = read_plant().with_effects(effect).strengths(effect, 1)
    changed[names(model.parameters).index(name)] += strength
    column = names(model.outputs).index(signal)
    plain, moved = (
        run_trial(twin, without, p)[:, column] for p in (trial_parameters(model, without), changed)
    )
    rig = (hidden.columns[signal] - without.columns[signal])[moving]
    plant = (moved - plain)[moving]
    assert np.linalg.norm(rig - plant) < differing * np.linalg.norm(rig)
    assert rig @ plant / (plant @ plant) == pytest.approx(1.0, abs=0.35)
