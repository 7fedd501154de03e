"""Further starts of the drive's fit, where its cost has separate valleys.

A servo without a limit of its acceleration and one with a low limit: above the motion's own
acceleration the limit changes nothing, so no step leads from "none" to a limit. A servo that holds
its goals and one that interpolates them: by the phase at which the current is sampled the one
passes for the other. The servos of one robot most often do the same.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Final

import msgspec

from models.plant.components.drives.goal_profile import NO_ACCELERATION_LIMIT
from models.plant.parameter import Parameter
from models.plant.plant import Plant

LIMIT: Final = "profile_acceleration_"
"""Beginning of the names of the limits."""

STARTS_RAD_S2: Final = (30.0, 10.0)
"""Limits to start from: at the study's 0.75 rad/s they make a goal 12 and 38 ms late [assumed]."""

PROFILE_FALL: Final = 0.05
"""Least fall of the drive's cost for which a profile is kept [assumed]."""

SHAPE: Final = ("goal_interpolation_{j}", "current_phase_{j}", "goal_delay_{j}_s")
"""Parameters of a goal's shape within the step."""

SHAPES_DIFFER: Final = 0.3
"""Difference of two joints' interpolation beyond which each is tried for both [assumed]."""


def profiled_starts(plant: Plant) -> list[Plant]:
    """Plants with a free limit; none where the drive has no limit to free, or it is known.

    Parameters
    ----------
    plant : Plant
        To start from.
    """
    limits = [q for n, q in plant.parameters.items() if n.startswith(LIMIT)]
    if any(q.value < NO_ACCELERATION_LIMIT for q in limits) or not limits:
        return []
    return [
        _with_parameters(
            plant,
            (
                msgspec.structs.replace(q, value=start, role="nuisance", prior_deviation=start)
                for q in limits
            ),
        )
        for start in STARTS_RAD_S2
    ]


def with_profile_of(plant: Plant, other: Plant) -> Plant:
    """Plant with the limits of another one: priors around what was found.

    Parameters
    ----------
    plant, other : Plant
        Of one kind of drive.
    """
    return _with_parameters(plant, (q for n, q in other.parameters.items() if n.startswith(LIMIT)))


def starts_with_alike_servos(plant: Plant) -> list[Plant]:
    """Plants in which each joint's goals have the shape of the other's; none where both are alike.

    Parameters
    ----------
    plant : Plant
        As fitted to both joints.
    """
    interpolation = [plant.parameters.get(SHAPE[0].format(j=j)) for j in (1, 2)]
    values = [q.value for q in interpolation if q is not None and q.role != "fixed"]
    if len(values) < 2 or abs(values[0] - values[1]) <= SHAPES_DIFFER:
        return []
    return [
        plant.with_values(
            {q.format(j=b): plant.parameters[q.format(j=a)].value for q in SHAPE}
        )
        for a, b in ((1, 2), (2, 1))
    ]  # fmt: skip


def _with_parameters(plant: Plant, parameters: Iterable[Parameter]) -> Plant:
    return replace(plant, parameters={**plant.parameters, **{q.name: q for q in parameters}})
