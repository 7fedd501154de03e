"""Repetitions that scatter at one payload, as those of a link that nearly folds."""

from dataclasses import replace

import numpy as np
import pytest

from models.gap.diagnosis import diagnose
from models.gap.residuals.fit_parameters import candidate_effects
from models.trials.trial import TrialSet

pytestmark = pytest.mark.slow

SCATTER_M = 0.004
ALL_TRIALS_M = 0.001


def scattering(trials):
    """Trials whose tip sways slowly with 1 kg, mostly in opposite directions in two repetitions."""
    result = []
    for trial in trials:
        sway = np.sin(2 * np.pi * 0.6 * trial.columns["time_s"] + 1.0)
        size_m = ALL_TRIALS_M + (SCATTER_M if trial.meta.trial == 1 else -SCATTER_M)
        moved = {
            name: trial.columns[name] + trial.meta.payload_kg * size_m * sway
            for name in ("tip_x_m", "tip_z_m")
        }
        result.append(replace(trial, columns={**trial.columns, **moved}))
    return TrialSet(tuple(result))


@pytest.fixture
def diagnosis(plant, hidden):
    """Function () -> diagnosis of such trials over a few effects."""
    trials = scattering(hidden().trials)
    few = ("backlash", "creep", "viscous_friction", "unmodelled_payload")
    others = [e for e in candidate_effects(plant) if e not in few]
    return lambda: diagnose(plant, trials, leave_out=others)


def test_the_floor_grows_at_that_payload_and_nothing_is_named(diagnosis):
    found = diagnosis()
    assert set(found.floor.amplification_power) == {1.0}
    assert (found.named, found.verdict) == ((), "no gap")
