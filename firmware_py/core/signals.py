"""Table of signals: names, units and descriptions of the quantities that rooms exchange.

The tick record, the recorder's schema, the CSV header of a trial and the variables of the FMUs
derive from it. A name ends in its SI unit; `{j}` stands for the joint, 1 or 2.
"""

from __future__ import annotations

import re
from typing import Final, NamedTuple

import numpy as np

PERIOD_S: Final = 0.017
"""Nominal control period: 256 steps of 17 ms make one cycle (the study, section IV-A)."""

STUDY_MARKERS: Final = 16
"""Markers on the study's link: four rows of four (the study, figure 4)."""

UNIT_OF_SUFFIX: Final = {
    "s": "s", "ns": "ns", "rad": "rad", "rad_s": "rad/s", "rad_s2": "rad/s2", "m": "m",
    "m_s": "m/s", "kg": "kg", "a": "A", "v": "V", "n": "N", "nm": "N.m", "pa": "Pa",
    "degc": "degC", "hz": "Hz", "w": "W", "ohm": "Ohm", "per_s": "1/s", "m_s2": "m/s2",
    "kg_m2": "kg.m2", "nm_rad": "N.m/rad", "nm_s_rad": "N.m.s/rad", "nm_a": "N.m/A",
    "a_s_rad": "A.s/rad", "v_s_rad": "V.s/rad", "rad_nm": "rad/(N.m)", "n_s_m": "N.s/m",
    "n_v": "N/V", "v_s_m": "V.s/m", "m_n": "m/N",
}  # fmt: skip
"""SI unit in FMI notation, by suffix of the name of a column or variable."""

_SUFFIX = re.compile("_(" + "|".join(sorted(UNIT_OF_SUFFIX, key=len, reverse=True)) + ")$")


class Signal(NamedTuple):
    name: str  # Name with the suffix of its unit
    unit: str  # SI unit; "1" for none
    description: str


def unit_of(name: str) -> str | None:
    """Return the SI unit that the suffix of a name declares, or None."""
    match = _SUFFIX.search(name)
    return UNIT_OF_SUFFIX[match.group(1)] if match else None


def without_unit(name: str) -> str:
    """Return the words of a name without the suffix of its unit."""
    return _SUFFIX.sub("", name).replace("_", " ")


_JOINT = (
    Signal("goal_{j}_rad", "rad", "goal angle of joint {j} sent to the servo"),
    Signal("angle_{j}_rad", "rad", "angle of joint {j} as the servo measures it"),
    Signal("current_{j}_a", "A", "motor current of joint {j}, positive pushes the angle positive"),
)
_TIP = tuple(Signal(f"tip_{axis}_m", "m", f"end effector, world frame, {axis}") for axis in "xyz")
_PREDICTED = tuple(
    Signal(f"predicted_tip_{axis}_m", "m", f"end effector by the bundle's predictor, {axis}")
    for axis in "xyz"
)
_HALF_WIDTH = tuple(
    Signal(f"half_width_{axis}_m", "m", f"half width of the 95 % prediction interval, {axis}")
    for axis in "xyz"
)
TIME = Signal("time_s", "s", "time since the start of the run")
PAYLOAD = Signal("payload_kg", "kg", "mass of the payload at the tip")
DI = Signal("di", "1", "Deformation Index (paper, equation 1)")
AGE = Signal("age_s", "s", "age of the sample; after a gap of the data a fraction of it")
_OBSERVED = (
    Signal("bend_{j}_rad", "rad", "bend of the whole link in the plane of joint {j}"),
    Signal("bend_rate_{j}_rad_s", "rad/s", "rate of the bend in the plane of joint {j}"),
    Signal("joint_rate_{j}_rad_s", "rad/s", "rate of joint {j}"),
    Signal("innovation_{j}_a", "A", "root mean square innovation of current {j} while it moves"),
)
_DEVIATION = tuple(
    Signal(f"tip_{axis}_deviation_m", "m", f"standard deviation of tip {axis} by the payload")
    for axis in "xyz"
)
IN_RANGE = Signal("in_range", "1", "1 where the predictor's inputs lie inside its training range")

_STAGES = ("wake", "read", "estimate", "predict", "command", "check", "write", "log")
STAGES: Final = _STAGES
"""Stages of a tick in the order in which they run."""


def joint_signals(dof: int) -> tuple[Signal, ...]:
    """Return goal, angle and current of each joint, in the trial's column order."""
    return tuple(
        Signal(*(field.format(j=j) for field in signal))
        for j in range(1, dof + 1)
        for signal in _JOINT
    )


def marker_signals(markers: int) -> tuple[Signal, ...]:
    """Return the coordinates of a number of markers, m01 first."""
    return tuple(
        Signal(f"m{i:02d}_{axis}_m", "m", f"marker {i}, world frame, {axis}")
        for i in range(1, markers + 1)
        for axis in "xyz"
    )


def trial_signals(dof: int, markers: int = STUDY_MARKERS) -> tuple[Signal, ...]:
    return (TIME, *joint_signals(dof), *_TIP, *marker_signals(markers))


def feature_names(dof: int) -> tuple[str, ...]:
    """Return the inputs of the predictor: angles, currents, DI (the study, equations 2 and 3)."""
    joints = range(1, dof + 1)
    return (*(f"angle_{j}_rad" for j in joints), *(f"current_{j}_a" for j in joints), DI.name)


def observer_signals(dof: int) -> tuple[Signal, ...]:
    """Return the observer's signals for a predictor beside DI: tip, payload, motion, innovation."""
    joints = tuple(
        Signal(*(field.format(j=j) for field in signal))
        for j in range(1, dof + 1)
        for signal in _OBSERVED
    )
    return (*_TIP, PAYLOAD, *joints, *_DEVIATION)


def tip_names(prefix: str = "") -> tuple[str, str, str]:
    """Return the names of the end effector's coordinates, with a prefix like `predicted_`."""
    return (f"{prefix}tip_x_m", f"{prefix}tip_y_m", f"{prefix}tip_z_m")


def tick_signals(dof: int) -> tuple[Signal, ...]:
    """Return every column of the tick record, in order."""
    stages = tuple(
        Signal(f"{stage}_ns", "ns", f"time spent in the stage '{stage}' of the tick")
        for stage in _STAGES
    )
    return (
        Signal("tick", "1", "number of the control period since the start, skipped ones counted"),
        TIME,
        Signal("deadline_ns", "ns", "absolute deadline of the tick on the monotonic clock"),
        *joint_signals(dof),
        PAYLOAD,
        DI,
        *_PREDICTED,
        *_HALF_WIDTH,
        IN_RANGE,
        Signal(
            "state", "1", "state of the safety supervisor (firmware_py.safety.states.SafetyState)"
        ),
        Signal("trust", "1", "trust in the estimated tip (firmware_py.safety.estimate_trust)"),
        Signal(
            "bus_status", "1", "result of the bus transfer (firmware_py.bus.servo_bus.BusStatus)"
        ),
        Signal("stale_ticks", "1", "age of the measured data in ticks, 0 is fresh"),
        Signal(
            "alert", "1", "hardware error bits of the servos, or-ed; 256 torque lost, 512 watchdog"
        ),
        *stages,
        Signal("busy_ns", "ns", "whole tick from wake-up to the end of the log stage"),
        Signal("bus_wait_ns", "ns", "part of the tick spent waiting for the servos"),
        Signal("lateness_ns", "ns", "wake-up behind the deadline"),
        Signal(
            "sample_late_ns", "ns", "measurement behind the deadline: wake-up and a second read"
        ),
        Signal("preempted_ns", "ns", "run-queue delay of the loop's thread during the period"),
        Signal("steal_ns", "ns", "time of computing for which the processor itself stood still"),
        Signal("missed", "1", "deadlines missed since the previous tick"),
    )


_INTEGERS = {"tick", "state", "bus_status", "stale_ticks", "alert", "missed", "in_range", "trust"}


def tick_dtype(dof: int) -> np.dtype[np.void]:
    """Return the type of a packed tick record: 64-bit integers and doubles."""
    return np.dtype(
        [
            (s.name, np.int64 if s.unit == "ns" or s.name in _INTEGERS else np.float64)
            for s in tick_signals(dof)
        ]
    )
