"""Motion of the menu that is recommended to tell look-alikes apart."""

from types import SimpleNamespace

import numpy as np
import pytest

from models.gap.report import separating_motion as module
from models.gap.report.separating_motion import NO_MOTION, separating_motion


@pytest.fixture
def recommended(monkeypatch, make_trial):
    """Function: every motion separates as well as its largest goal rate."""
    monkeypatch.setattr(module, "_simulated", lambda plant, trial: trial)
    monkeypatch.setattr(
        module,
        "_separations",
        lambda _, trial, alike: [float(np.abs(np.diff(trial.goal_rad, axis=0)).max())],
    )

    def run(load="link", **conditions):
        trial = make_trial(np.zeros((80, 1)), **conditions)
        found = SimpleNamespace(fitted=SimpleNamespace(load=load), trials=[trial])
        return separating_motion(found, ["a look-alike"])

    return run


def test_a_motion_that_a_servo_without_a_watchdog_may_not_run_is_not_recommended(recommended):
    found = recommended(amplitude_rad=0.52, period_s=4.352)
    assert "free decay" not in found.separation  # begins with 6 rad/s
    assert {"multisine", "slow triangle", "step and hold"} <= set(found.separation)
    assert found.motion in found.separation


def test_nothing_is_recommended_for_fast_trials_and_other_loads(recommended):
    for found in (recommended(amplitude_rad=0.52, period_s=0.5), recommended("pendulum")):
        assert (found.motion, found.separation) == (NO_MOTION, {})
