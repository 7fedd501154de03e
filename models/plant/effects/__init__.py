"""Effects: what a plant can hold beyond its nominal drive and load.

An effect is one small class: its name in the catalogue, its parameters (the first one is its
strength: at zero the plant is exactly the one without it), the states that it adds, and the wires
that it changes at its port. Deriving from `Effect` is all it takes to make one known.
"""

from __future__ import annotations

import importlib
import pkgutil
from typing import Any, ClassVar, Final

from models.catalogue import CATALOGUE, Port
from models.plant.parameter import Parameter
from models.plant.scope import Scope

PORTS: Final[tuple[Port, ...]] = (
    "sensor", "command", "stiffness", "mass", "bend_torque", "servo_torque", "joint_torque",
)  # fmt: skip
"""Order in which the ports are served: what the sensors show is what the drive sees."""

EFFECTS: Final[dict[str, type[Effect]]] = {}
"""Effects by name; a class enters by being defined."""


class Effect:
    """Base of all effects.

    Attributes
    ----------
    name : str
        As a plant document calls it.
    port : str
        Where it acts; taken from the catalogue unless the class says otherwise.
    per_joint : tuple of Parameter
        With patterns as names ({j}, {angle}, {torque}); one of each for every joint.
    shared : tuple of Parameter
        One for all joints.
    """

    name: ClassVar[str]
    port: ClassVar[Port]
    per_joint: ClassVar[tuple[Parameter, ...]] = ()
    shared: ClassVar[tuple[Parameter, ...]] = ()

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        if not hasattr(cls, "port"):
            cls.port = CATALOGUE[cls.name].port
        EFFECTS[cls.name] = cls

    def parameters(self, scope: Scope) -> tuple[Parameter, ...]:
        """Parameters for the joints of `scope`, the strength first."""
        named = [
            _renamed(q, scope.name(q.name, j), scope) for q in self.per_joint for j in scope.joints
        ]
        return (*named, *self.shared)

    def apply(self, scope: Scope) -> None:
        """Change the wires of the port."""
        raise NotImplementedError


def _renamed(q: Parameter, name: str, scope: Scope) -> Parameter:
    unit = q.unit if scope.suffix["angle"] == "rad" else q.unit.replace("N.m", "N")
    return Parameter(
        name=name, unit=unit, value=q.value, low=q.low, high=q.high, role=q.role,
        description=q.description, source=q.source,
    )  # fmt: skip


for _module in pkgutil.iter_modules(__path__):
    importlib.import_module(f"{__name__}.{_module.name}")
