"""Trials that are too short to have a spectrum."""

import numpy as np
import pytest

from firmware_py.errors import InputError
from models.plant.identification.noise_floor import check_duration


@pytest.mark.parametrize(("rows", "refused"), [(5, True), (40, True), (50, False), (500, False)])
def test_a_trial_below_three_quarters_of_a_second_is_refused(make_trial, rows, refused):
    """Its spectrum up to 8 Hz would have fewer coefficients than three bands of four."""
    trial = make_trial(np.zeros(rows), step_s=0.017, rest_samples=0)
    if not refused:
        check_duration(trial)
        return
    with pytest.raises(InputError, match=r"give at least 0\.75 s"):
        check_duration(trial)
