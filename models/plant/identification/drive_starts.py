"""Further starts of the drive's fit, whose cost has several local minima.

A servo may have options (`OPTIONS`), which a plant lacks until the data support them:

- A limit of the goal's acceleration. Above the motion's own acceleration it has no effect, so no
  step of a fit leads from "none" to a limit.
- Feed-forward of the rate with an integral of the position error, and a set-point weight of the
  velocity loop. If they were free in every fit, they would be confused with the loop's gains.

A servo that holds its goals and one that interpolates them are confused too, by the phase at which
the current is sampled. The servos of one robot usually do the same.
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
    """Option that a servo may or may not have."""

    # Value that means "none", by the start of a parameter's name
    none: dict[str, float]
    starts: tuple[tuple[float, ...], ...]  # Values from which fits start, one for each parameter


OPTIONS: Final = (
    DriveOption({"profile_acceleration_": NO_ACCELERATION_LIMIT}, ((30.0,), (10.0,))),
    DriveOption({"velocity_feedforward_": 0.0, "position_integral_": 0.0}, ((0.3, 2.0),)),
    DriveOption({"setpoint_weight_": 1.0}, ((0.8,),)),
)
"""Options of a servo with a cascade. At the study's 0.75 rad/s the limits delay a goal by 12 and
38 ms; the others are moderate settings [assumed]."""

OPTION_FALL: Final = 0.1
"""Smallest relative decrease of the drive's cost for which an option is accepted [assumed]."""

SHAPE: Final = ("goal_interpolation_{j}", "current_phase_{j}", "goal_delay_{j}_s")
"""Parameters of a goal's shape within the step."""

SHAPES_DIFFER: Final = 0.3
"""Difference between two joints' interpolation above which each is tried for both [assumed]."""


def starts_with_option(plant: Plant) -> list[Plant]:
    """Plants with one more option, its parameters free, for each that the plant does not have."""
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
    """Plant with the options of another one; their fitted values are the priors."""
    begins = tuple(begin for option in OPTIONS for begin in option.none)
    return _with_parameters(plant, (q for n, q in other.parameters.items() if n.startswith(begins)))


def starts_with_alike_servos(plant: Plant) -> list[Plant]:
    """Plants in which both joints' goals have one joint's shape; none if the shapes are alike."""
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
