"""Further starts of the drive's fit, where its cost has separate valleys.

A servo may have options, which a plant lacks until the data speak for them (`OPTIONS`). A limit of
its acceleration: above the motion's own acceleration it changes nothing, so no step leads from
"none" to a limit. Feed-forward of the rate and an integral of the position error, and a set-point
weight of the velocity loop: free in every fit they would pass for its gains. A servo that holds its
goals and one that interpolates them: by the phase at which the current is sampled the one passes
for the other. The servos of one robot most often do the same.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Final

import msgspec

from models.plant.components.drives.goal_profile import NO_ACCELERATION_LIMIT
from models.plant.parameter import Parameter
from models.plant.plant import Plant


@dataclass(frozen=True)
class DriveOption:
    """What a servo may have or lack."""

    # Beginnings of its parameters' names, with the value that stands for "none"
    none: dict[str, float]
    starts: tuple[tuple[float, ...], ...]  # Values to start from, one for each parameter


OPTIONS: Final = (
    DriveOption({"profile_acceleration_": NO_ACCELERATION_LIMIT}, ((30.0,), (10.0,))),
    DriveOption({"velocity_feedforward_": 0.0, "position_integral_": 0.0}, ((0.3, 2.0),)),
    DriveOption({"setpoint_weight_": 1.0}, ((0.8,),)),
)
"""Of a servo with a cascade. At the study's 0.75 rad/s the limits make a goal 12 and 38 ms late;
the others are those of a moderate setting [assumed]."""

OPTION_FALL: Final = 0.1
"""Least fall of the drive's cost for which an option is kept [assumed]."""

SHAPE: Final = ("goal_interpolation_{j}", "current_phase_{j}", "goal_delay_{j}_s")
"""Parameters of a goal's shape within the step."""

SHAPES_DIFFER: Final = 0.3
"""Difference of two joints' interpolation beyond which each is tried for both [assumed]."""


def starts_with_option(plant: Plant) -> list[Plant]:
    """Plants with one option more, its parameters free; none for one that the plant has or
    knows.
    """
    result = []
    for option in OPTIONS:
        own = [(n, q) for n, q in plant.parameters.items() if n.startswith(tuple(option.none))]
        known = any(
            q.role != "fixed" or q.value != none
            for begin, none in option.none.items() for n, q in own if n.startswith(begin)
        )  # fmt: skip
        if known or not own:
            continue
        for values in option.starts:
            start = dict(zip(option.none, values, strict=True))
            result.append(_with_parameters(plant, [
                msgspec.structs.replace(
                    q, value=value, role="nuisance", prior_deviation=q.prior_deviation or value
                )
                for begin, value in start.items() for n, q in own if n.startswith(begin)
            ]))  # fmt: skip
    return result


def with_options_of(plant: Plant, other: Plant) -> Plant:
    """Plant with the options of another one: priors around what was found."""
    begins = tuple(begin for option in OPTIONS for begin in option.none)
    return _with_parameters(plant, (q for n, q in other.parameters.items() if n.startswith(begins)))


def starts_with_alike_servos(plant: Plant) -> list[Plant]:
    """Plants in which each joint's goals have the shape of the other's; none where both are
    alike.
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
