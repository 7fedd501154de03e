"""Supervisors in operation, for the tests of limits, blends and states."""

import numpy as np

from firmware_py.bus.servo_bus import BusStatus
from firmware_py.safety.limits import Limits
from firmware_py.safety.states import SafetyState
from firmware_py.safety.supervisor import SafetySupervisor

TIP = np.array([0.1, 0.0, 1.0])
# Powers of two, so that "at the limit" is exact.
LIMITS = Limits(
    angle_rad=(-0.5, 0.5), rate_rad_s=1.0, acceleration_rad_s2=64.0, current_a=4.0,
    following_error_rad=0.25, jump_rad=0.125,
    tip_min_m=(-1.0, -1.0, 0.0), tip_max_m=(1.0, 1.0, 1.5),
    persistence_ticks=3, stale_ticks=3, blend_s=1.0, stop_deceleration_rad_s2=8.0, hold_s=0.5,
)  # fmt: skip
EXACT_S = 1 / 64


def started(limits=LIMITS, at=0.0, dof=1, period_s=EXACT_S, desired=None):
    supervisor = SafetySupervisor(limits, dof, period_s)
    supervisor.arm(np.full(dof, at))
    assert supervisor.state is SafetyState.READY
    supervisor.start()
    supervisor.rebase(np.full(dof, at if desired is None else desired))
    return supervisor


def check(supervisor, angle=0.0, current=0.0, status=BusStatus.OK, **changed):
    given_ = {"alert": 0, "tip_m": TIP, "di": 0.01, "missed": 0} | changed
    return supervisor.check(status, given_["alert"], np.array([angle]), np.array([current]),
                            given_["tip_m"], given_["di"], given_["missed"])  # fmt: skip


def first_goal_after(supervisor, *desired):
    for value in desired:
        goal = supervisor.admit(np.array([value]))
    return goal[0]
