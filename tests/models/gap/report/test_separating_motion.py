"""Motion of the menu that is recommended to tell look-alikes apart."""

from types import SimpleNamespace

import numpy as np
import pytest

from models.gap.report import separating_motion as module
from models.gap.report.separating_motion import NO_MOTION, separating_motion
from models.gap.settings import DEFAULT_SETTINGS


@pytest.fixture
def sizes(monkeypatch, make_trial):
    """Function: d′ by motion, where every motion separates as well as its largest goal rate."""
    found = SimpleNamespace(fitted=SimpleNamespace(load="link"), settings=DEFAULT_SETTINGS)
    monkeypatch.setattr(module, "_simulated", lambda plant, trial: trial)
    monkeypatch.setattr(
        module,
        "_separation",
        lambda _, trial, other: float(np.abs(np.diff(trial.goal_rad, axis=0)).max()),
    )

    def run(**conditions):
        trial = make_trial(np.zeros((80, 1)), **conditions)
        return separating_motion(found, [trial], ["a look-alike"])

    return run


def test_a_motion_that_a_servo_without_a_watchdog_may_not_run_is_not_recommended(sizes):
    best, offered = sizes(amplitude_rad=0.52, period_s=4.352)
    assert "free decay" not in offered  # begins with 6 rad/s
    assert {"multisine", "slow triangle", "step and hold"} <= set(offered)
    assert best in offered


def test_of_trials_that_are_too_fast_nothing_is_recommended(sizes):
    assert sizes(amplitude_rad=0.52, period_s=0.5) == (NO_MOTION, {})
