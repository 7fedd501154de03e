"""Presliding of dry friction in a drive with a small gear."""

from __future__ import annotations

from typing import Final

import casadi as ca

from models.plant.scope import Scope
from models.plant.step_model import Variable

BRISTLE_DAMPING_S: Final = 5e-3
"""Damping time of the bristles: a sticking joint oscillates for a few periods only."""

BRISTLE_REVERSAL_S: Final = 5e-4
"""Shortest time in which the bristles reverse: half an internal step."""


def declare_presliding(scope: Scope, joint: int) -> None:
    """Add the torque of the drive on a small gear and the presliding of its friction.

    The drive loads the teeth like the load does (BAM), so friction depends on the drive's torque.
    Dry friction holds a joint at rest by bristles that bend before they slide (Dahl 1968)::

        ż = (q̇ − |q̇| z) / (δ + |q̇| T),   direction = z + T_d ż

    z reaches sign(q̇) within the distance δ and is constant at rest; a smooth sign of the rate alone
    would let the joint creep. T bounds the rate of change for the integrator.
    """
    scope.gear_drive_torque[joint] = ca.SX.sym(f"drive_torque_{joint}")
    z = scope.state(Variable(f"bristle_{joint}", "1"))
    speed = ca.fabs(scope.rate[joint])
    reach = scope.p("presliding_{j}_{angle}", joint) + speed * BRISTLE_REVERSAL_S
    scope.states[z.name()].rate = (scope.rate[joint] - speed * z) / reach
    scope.friction_direction[joint] = z + BRISTLE_DAMPING_S * scope.states[z.name()].rate
