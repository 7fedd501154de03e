"""Registry of the drives by their name in a plant document.

Composition of drive, load and effects, by name, into a step model.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Final, Literal

from firmware_py.link.link_description import STUDY_LINK, LinkDescription
from models.plant.components.cascade import Cascade
from models.plant.components.current import Current
from models.plant.components.drive import Drive
from models.plant.components.duty import Duty
from models.plant.components.flexible_link import FlexibleLink
from models.plant.components.force import Force
from models.plant.components.link import Link
from models.plant.components.load import PlantLoad
from models.plant.components.measured import Measured
from models.plant.components.rigid_loads import GearedShaft, GearedSlide, Mass, Pendulum
from models.plant.composition.driven import FOLLOW_RATE, compose_driven, compose_imposed
from models.plant.composition.observer import compose_observer, observer_parameters
from models.plant.composition.twin import compose_twin
from models.plant.effects import Effect
from models.plant.parameter import Parameter
from models.plant.scope import Scope
from models.plant.step_model import StepModel

DRIVES: Final[dict[str, type[Drive]]] = {
    d.kind: d for d in (Cascade, Duty, Force, Current, Measured)
}
"""Drives by their name in a plant document."""


ModelKind = Literal["twin", "observer", "driven"]
LOADS: Final[dict[str, type[PlantLoad]]] = {
    load.kind: load for load in (Link, Pendulum, Mass, FlexibleLink, GearedShaft, GearedSlide)
}
"""Loads by their name in a plant document."""
COMPOSERS: Final = {
    "twin": compose_twin, "observer": compose_observer, "driven": compose_driven,
}  # fmt: skip


@lru_cache(maxsize=64)  # composing an observer of two joints takes three seconds
def compose_plant(
    load: str, drive: str, effects: tuple[type[Effect], ...],
    parameters: tuple[tuple[str, Parameter], ...], dof: int, kind: ModelKind,
    columns: tuple[str, ...], link: LinkDescription | None = None,
) -> StepModel:  # fmt: skip
    """Compose a plant from hashable parts; values are arguments, so plants share a model.

    `link` sets markers, direction of gravity and largest payload; by default the study's.
    """
    scope, held = scope_of(drive, load, dof, columns, link), [effect() for effect in effects]
    known, observer = dict(parameters), kind != "twin"
    scope.declare([known[q.name] for q in declared_parameters(scope, drive, load, held, observer)])
    imposed = kind == "twin" and "imposed motion" in DRIVES[drive].features
    compose = compose_imposed if imposed else COMPOSERS[kind]
    return compose(f"{kind}_{dof}dof", scope, DRIVES[drive](), LOADS[load](), held)


def scope_of(
    drive: str,
    load: str,
    dof: int,
    columns: tuple[str, ...] = (),
    link: LinkDescription | None = None,
) -> Scope:
    """Scope of a drive and a load, before anything is declared."""
    own = link or STUDY_LINK
    return Scope(
        tuple(range(1, dof + 1)), dict(LOADS[load].suffix), columns,
        None if link is None else link.layout, own.gravity.unit, own.most_payload_kg,
        frozenset(DRIVES[drive].features) | frozenset(LOADS[load].features),
    )  # fmt: skip


def declared_parameters(
    scope: Scope, drive: str, load: str, effects: list[Effect], observer: bool
) -> list[Parameter]:
    """Parameters of drive, load, effects and observer, in that order."""
    return [
        *DRIVES[drive]().parameters(scope),
        *LOADS[load]().parameters(scope),
        *(q for effect in effects for q in effect.parameters(scope)),
        *((FOLLOW_RATE, *observer_parameters()) if observer and load == "link" else ()),
    ]
