"""Loop on real servos: a whole run, a stop in motion, a limit; torque off at the end of each."""

import msgspec
import numpy as np
import pytest

from firmware_py.safety.states import SafetyState
from firmware_py.summary import Ended
from tests.hitl.conftest import AMPLITUDE_RAD, RATE_RAD_S, REACH_RAD

pytestmark = pytest.mark.hitl

FOLLOWING_RAD = 0.05
"""How far the arm may be behind: its own lag at 0.15 rad/s, and a link that swings."""


def column(summary, name, dof):
    return np.column_stack([summary.records[name.format(j)] for j in range(1, dof + 1)])


def test_the_arm_follows_the_motion_from_where_it_stands_to_its_end(hardware):
    with hardware.bus() as bus:
        summary = hardware.run(hardware.loop(bus))
    assert (summary.ended, summary.released) == (Ended.FINISHED, True)
    goal_rad = column(summary, "goal_{}_rad", hardware.config.dof)
    angle_rad = column(summary, "angle_{}_rad", hardware.config.dof)
    assert np.abs(goal_rad).max() == pytest.approx(AMPLITUDE_RAD, rel=0.01)
    assert np.abs(angle_rad).max() <= REACH_RAD
    assert np.ptp(angle_rad, axis=0).min() > AMPLITUDE_RAD, "it moves"
    assert np.abs(angle_rad[1:] - goal_rad[:-1]).max() < FOLLOWING_RAD
    steps_rad = np.abs(
        np.diff(np.vstack([angle_rad[:1], goal_rad]), axis=0)
    )  # from where it stands
    assert steps_rad.max() <= RATE_RAD_S * hardware.config.period_s * (
        summary.records["missed"].max() + 1
    )
    assert (summary.records["stale_ticks"] == 0).all()


class StopAt:
    """Telemetry that asks for a stop after some ticks, as SIGTERM would."""

    drops = 0

    def __init__(self, ticks):
        self.left, self.loop = ticks, None

    def put(self, record):
        self.left -= 1
        if self.left == 0:
            self.loop.stop("SIGTERM")


def test_a_stop_in_motion_brings_the_arm_to_rest_and_releases_it(hardware):
    stop = StopAt(80)
    with hardware.bus() as bus:
        stop.loop = hardware.loop(bus, telemetry=stop)
        summary = hardware.run(stop.loop)
    assert (summary.ended, summary.reason) == (Ended.SIGNALLED, "SIGTERM")
    assert summary.released
    assert summary.ticks < 80 + 60, "at once, not at the motion's end"
    goal_rad = column(summary, "goal_{}_rad", hardware.config.dof)
    assert np.ptp(goal_rad[-10:], axis=0).max() == 0.0, "the last goal is held"


def test_a_limit_stops_the_arm_and_releases_it(hardware):
    low_ceiling = msgspec.structs.replace(
        hardware.config.limits_in_force, tip_max_m=(1.2, 1.2, 0.5)
    )
    with hardware.bus() as bus:
        summary = hardware.run(hardware.loop(bus, limits=low_ceiling))
    assert summary.ended is Ended.TRIPPED
    assert "the predicted tip has z" in summary.reason
    assert summary.released
    running = summary.records["state"] <= SafetyState.DEGRADED
    assert running.sum() <= low_ceiling.persistence_ticks
