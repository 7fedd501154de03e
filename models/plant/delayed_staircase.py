"""Staircase of a goal that takes effect late."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca


@dataclass(frozen=True)
class DelayedStaircase:
    """What a delay of the goal changes in the saw-tooth of the current."""

    # Share of the delayed goal in the goal, 0 to 1: without a delay the staircase is whole
    share: ca.SX
    rate: ca.SX  # Rate of the delayed goal, without its staircase
    phase_shift: ca.SX  # Phase of the step by which the current is sampled later after a jump
