"""The rigid link of `made_trials` as fixtures, and its motion."""

import numpy as np
import pytest

from tests.models import made_trials


@pytest.fixture
def make_trial():
    return made_trials.rigid_trial


@pytest.fixture
def rigid_markers():
    return made_trials.rigid_markers_m


@pytest.fixture
def swing_rad():
    """Three rest rows, then one slow swing of both joints, out of phase, shape (64, 2)."""
    phase = 2 * np.pi * np.arange(61) / 60
    swing = np.column_stack([-0.5 * np.sin(phase), 0.4 * (1 - np.cos(phase))])
    return np.vstack([np.zeros((3, 2)), swing])
