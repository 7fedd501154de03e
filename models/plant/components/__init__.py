"""Components of a plant by their kind in a plant document."""

from __future__ import annotations

from typing import Final

from models.plant.components.cascade import Cascade
from models.plant.components.drive import Drive
from models.plant.components.duty import Duty
from models.plant.components.flexible_link import FlexibleLink
from models.plant.components.link import Link
from models.plant.components.load import PlantLoad
from models.plant.components.measured import Measured
from models.plant.components.proportional import Current, Force
from models.plant.components.rigid_loads import Mass, Pendulum

DRIVES: Final[dict[str, type[Drive]]] = {
    drive.kind: drive for drive in (Cascade, Duty, Force, Current, Measured)
}
LOADS: Final[dict[str, type[PlantLoad]]] = {
    load.kind: load for load in (Link, Pendulum, Mass, FlexibleLink)
}
