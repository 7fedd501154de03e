"""Application of the effects port by port, with the load's torques in between."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from models.plant.components.load_protocol import PlantLoad
from models.plant.effects import Effect
from models.plant.scope import Scope
from models.shared.catalogue import Port


def apply_effects(scope: Scope, ports: Iterable[Port], effects: Sequence[Effect]) -> None:
    """Apply the effects port by port; they are in the order of `models.plant.effects.order`."""
    for port in ports:
        for effect in effects:
            if effect.port == port:
                effect.apply(scope)


def apply_load_torques(scope: Scope, load: PlantLoad, effects: Sequence[Effect]) -> None:
    """Set every torque except the drive's: on the bends, on the joints and through the gears.

    The motion of joints and bends must be set.
    """
    apply_effects(scope, ("stiffness", "mass"), effects)
    load.apply_elastic_torques(scope)
    apply_effects(scope, ("bend_torque", "joint_torque"), effects)
    load.apply_transmitted_torque(scope)
    apply_effects(scope, ("servo_torque",), effects)
