"""Limits of a planned motion as inequalities: of its goals, and of the twin's response.

The limits of the goals are linear in the coefficients of the motion. Those of the twin are given by
their violation, and by the outputs that it depends on.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from firmware_py.safety.limits import Limits
from firmware_py.signals import PERIOD_S
from models.gap.estimation.curve_transfer import STUDY_REST_S
from models.plant.identification.noise_floor import Array

REST_SAMPLES: Final = round(STUDY_REST_S / PERIOD_S)
"""Rows at rest before a planned motion."""
GOAL_MARGIN: Final = 0.97
"""Fraction of a limit of the goals that is used [assumed]."""
TWIN_MARGIN: Final = 0.85
"""Fraction of a limit of current and following error that the twin may use; the rest covers the
difference between twin and robot [assumed]."""
TIP_MARGIN: Final = 0.98
"""The same for the tip, where this difference is some millimetres [assumed]."""
ROW_STEP: Final = 3
"""Every third row enters a linear programme: one in 51 ms, a twentieth of the shortest period."""


def goal_limits(
    basis: Array, limits: Limits, dof: int, row_step: int = ROW_STEP
) -> tuple[Array, Array]:
    """Matrix A and limits b of A x ≤ b: angle, rate and acceleration of the goals.

    The coefficients of the `dof` joints follow each other in x. Shapes: `basis` (n, c).
    """
    rate = np.diff(basis, axis=0) / PERIOD_S
    both: tuple[tuple[Array, float, float], ...] = (
        (basis, limits.angle_rad[1], -limits.angle_rad[0]),
        (rate, limits.rate_rad_s, limits.rate_rad_s),
        (
            np.diff(rate, axis=0) / PERIOD_S,
            limits.acceleration_rad_s2,
            limits.acceleration_rad_s2,
        ),
    )
    rows, limit = [], []
    for table, high, low in both:
        moving = table[REST_SAMPLES::row_step]
        for sign, most in ((1.0, high), (-1.0, low)):
            rows.append(sign * moving)
            limit.append(np.full(len(moving), GOAL_MARGIN * most))
    one = np.concatenate(rows)
    every = np.asarray(np.kron(np.eye(dof), one), dtype=np.float64)
    return every, np.tile(np.concatenate(limit), dof)


def twin_limits(
    y: Array, outputs: Sequence[str], goal_rad: Array, limits: Limits
) -> list[tuple[Array, dict[str, float]]]:
    """Violation of each limit as a fraction of it, shape (n,), and what each output adds to it.

    Covers current, following error and tip; negative where the limit is kept. A signal that already
    exceeds the margin at rest may use half of the remaining distance to its limit.

    Shapes: `y` (n, outputs), `goal_rad` (n, joints).
    """
    result: list[tuple[Array, dict[str, float]]] = []

    def add(name: str, value: Array, most: float, margin: float = TWIN_MARGIN) -> None:
        for sign in (1.0, -1.0):
            used = sign * value / most
            allowed = max(margin, float(1 + used[0]) / 2) if used[0] < 1 else margin
            result.append((used - allowed, {name: sign / most}))

    for j in range(goal_rad.shape[1]):
        current, angle = f"current_{j + 1}_a", f"angle_{j + 1}_rad"
        add(current, y[:, outputs.index(current)], limits.current_a)
        error = y[:, outputs.index(angle)] - goal_rad[:, j]
        add(angle, error, limits.following_error_rad)
    for k, name in enumerate(("tip_x_m", "tip_y_m", "tip_z_m")):
        middle = (limits.tip_max_m[k] + limits.tip_min_m[k]) / 2
        half = (limits.tip_max_m[k] - limits.tip_min_m[k]) / 2
        add(name, y[:, outputs.index(name)] - middle, half, TIP_MARGIN)
    return result
