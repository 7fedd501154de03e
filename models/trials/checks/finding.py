"""Finding of a check, and the limits for warning and refusing an import.

Each limit is a pair: beyond the first the import warns, beyond the second it refuses. The limits
are [assumed], because markers are placed by hand to about 1 mm, the link leans by up to 1.5° at
rest (prebend, payload), and a wrong frame shifts the tip by its offset, or by 17 mm per degree.
"""

from __future__ import annotations

from typing import Final, Literal, NamedTuple

Level = Literal["refused", "warning"]

OFFSET_M: Final = (0.008, 0.025)
"""Distance of the joint axes' crossing from the origin."""
TILT_RAD: Final = (0.0262, 0.087)
"""Tilt of the link at rest: 1.5° and 5°."""
YAW_RAD: Final = (0.035, 0.105)
"""Turn about the vertical, by the corners or by the direction of motion: 2° and 6°."""
SCALE: Final = (0.015, 0.05)
"""Relative error of the scale of distances."""
SHAPE_M: Final = (0.006, 0.015)
"""Distance of a single marker from its nominal place, after the best rigid motion."""
REST_ROWS: Final = (20, 2)
"""Rows at rest; fewer than the first warn, fewer than the second refuse."""
REST_MOVE_M: Final = (0.003, 0.010)
"""Motion of a marker within the rest rows."""
GAP_S: Final = (0.035, 0.1)
"""Time without a sample that interpolation bridges: two periods; the motion is below 4 Hz."""
UNSEEN: Final = (0.2, 0.8)
"""Fraction of the rows in which a marker is occluded."""
GAIN: Final = (0.15, 0.3)
"""Deviation of the ratio of the link's motion to the angle's from one; bend adds 0.1 at 2 kg."""
CLOCK_ERROR_S: Final = (0.002, 0.02)
"""Half width of the confidence interval of the clock's offset; the study's tip moves at 0.7 m/s."""
CLOCK_DRIFT_S: Final = 0.002
"""Change of the clock's offset between the halves of the motion; only a warning."""
DRIFT_DEVIATIONS: Final = 3.0
"""Number of standard errors that such a change must exceed."""
GIVEN_CLOCK_S: Final = 0.002
"""Difference of the user's offset from the estimate, beyond three half widths; only a warning."""
STUCK_RAD: Final = (0.03, 0.1)
"""Travel of a goal during which the angle stays constant. A servo with stiction lags by less; an
encoder's step is 1.5 mrad at most."""
REPEATED_LOAD: Final = 0.25
"""Relative difference of the load between trials of one payload and motion; on the rig it is 1 to
2 %."""
ACROSS: Final = (0.1, 0.3)
"""Motion of the link across the plane of the only joint, relative to that in it."""
PRESSURE_PA: Final = 1e3
"""Pressure below which the unit is not Pa: the link has some tens of kPa."""
COMMON_CLOCK_S: Final = (0.01, 0.05)
"""Offset between markers and angles that one file has on one clock."""


class ImportFinding(NamedTuple):
    """An error or a doubt about a recording."""

    level: Level  # How serious it is
    cause: str  # Kind of the cause, one word or two: `yaw`, `origin`, `swapped`, …
    text: str  # What was observed, with its likely cause
    remedy: str  # What the user can do, as an imperative


def level_of(value: float, limits: tuple[float, float]) -> Level | None:
    """Level of a value by its limits, None if it is within both."""
    size = abs(value)
    return "refused" if size > limits[1] else "warning" if size > limits[0] else None
