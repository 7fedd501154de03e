"""Components of a plant by their kind in a plant document."""

from __future__ import annotations

from typing import Final

from models.plant.components.cascade import Cascade
from models.plant.components.drive import Current, Drive, Duty, Force, Measured
from models.plant.components.link import Link
from models.plant.components.load import FlexibleLink, Mass, Pendulum, PlantLoad

DRIVES: Final[dict[str, type[Drive]]] = {
    drive.kind: drive for drive in (Cascade, Duty, Force, Current, Measured)
}
LOADS: Final[dict[str, type[PlantLoad]]] = {
    load.kind: load for load in (Link, Pendulum, Mass, FlexibleLink)
}
