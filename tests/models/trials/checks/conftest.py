"""A trial of the checks: a rigid link that swings twice, 1 rad from end to end."""

import numpy as np
import pytest


@pytest.fixture
def trial(make_trial):
    moving_s = np.maximum(0.017 * np.arange(240) - 0.34, 0.0)
    return make_trial(-0.5 * np.sin(np.pi * moving_s), period_s=2.0, rest_samples=20)
