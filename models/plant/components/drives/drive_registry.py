"""Registry of the drives by their name in a plant document."""

from __future__ import annotations

from typing import Final

from models.plant.components.drives.cascade import Cascade
from models.plant.components.drives.current import Current
from models.plant.components.drives.drive_protocol import Drive
from models.plant.components.drives.duty import Duty
from models.plant.components.drives.force import Force
from models.plant.components.drives.measured import Measured

DRIVES: Final[dict[str, type[Drive]]] = {
    d.kind: d for d in (Cascade, Duty, Force, Current, Measured)
}
"""Drives by their name in a plant document."""
