"""Limits of what the twin does under a planned motion."""

from types import SimpleNamespace

import numpy as np
import pytest

from firmware_py.errors import InputError
from firmware_py.safety.limits import Limits
from models.gap.experiment.motion_design import MotionDesigner
from models.gap.experiment.motion_limits import TIP_MARGIN, twin_limits

OUTPUTS = ("current_1_a", "angle_1_rad", "tip_x_m", "tip_y_m", "tip_z_m")
LIMITS = Limits(tip_min_m=(-1.0, -1.0, 0.5), tip_max_m=(1.0, 1.0, 1.012))


def largest(tip_z_m, current_a=(0.0, 0.0), limits=LIMITS):
    """Largest violation of a twin that rests, then is at the second values."""
    y = np.zeros((2, len(OUTPUTS)))
    y[:, 0], y[:, 4] = current_a, tip_z_m
    return max(float(v.max()) for v, _ in twin_limits(y, OUTPUTS, np.zeros((2, 1)), limits))


def test_a_tip_that_rests_within_the_margin_leaves_room_for_a_motion():
    middle, half = 0.756, 0.256
    assert (1.010 - middle) / half > TIP_MARGIN
    assert largest((1.010, 1.010)) < 0  # a motion may begin there
    assert largest((1.010, 1.0105)) < 0 < largest((1.010, 1.0115))
    assert largest((1.005, 1.006)) < 0 < largest((1.005, 1.010))  # else the margin holds


@pytest.mark.parametrize(("tip_z_m", "current_a"), [(1.013, 0.0), (1.0, 100.0)])
def test_a_limit_that_is_exceeded_at_rest_stays_exceeded(tip_z_m, current_a):
    assert largest((tip_z_m, tip_z_m), (current_a, current_a)) > 0


@pytest.mark.parametrize("excess", [np.inf, 0.01])
def test_limits_that_the_twin_exceeds_at_rest_are_refused(excess):
    designer = SimpleNamespace(twin_excess=lambda x, payload_kg: excess)
    with pytest.raises(InputError, match="no room for a motion with 2 kg"):
        MotionDesigner._within_twin_limits(designer, np.ones(4), 2.0)


def test_a_motion_is_made_smaller_until_it_keeps_the_limits():
    designer = SimpleNamespace(twin_excess=lambda x, payload_kg: float(x.max()) - 0.5)
    x = MotionDesigner._within_twin_limits(designer, np.ones(4), 2.0)
    assert 0.3 < x.max() <= 0.5
