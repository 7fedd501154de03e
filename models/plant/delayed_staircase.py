"""Effect of a delayed goal on the saw-tooth of the current."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca


@dataclass(frozen=True)
class DelayedStaircase:
    """Effect of a goal's delay on the saw-tooth of the current."""

    # Weight of the delayed goal, 0 to 1; the remainder keeps the staircase without delay
    share: ca.SX
    rate: ca.SX  # Rate of the delayed goal, without its staircase
    phase_shift: ca.SX  # Additional delay of the current's sample, as a fraction of the step
