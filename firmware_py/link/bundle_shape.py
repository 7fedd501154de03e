"""Shape of the link of a bundle, for scenes in 3-D."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import msgspec

from firmware_py.core.input_files import read_json
from firmware_py.link.marker_layout import MarkerLayout, square_layout
from firmware_py.log.link_shape import LinkShape

__all__ = ["shape_of_bundle"]

_NEEDED: Final = ("base_offset_m", "link_length_m", "link_width_m", "span_position")


def shape_of_bundle(directory: Path) -> LinkShape | None:
    """Return the shape of a bundle's link; None if its plant is missing or describes no link."""
    path = directory / "plant.json"
    if not path.is_file():
        return None
    plant = read_json(path, "copy or train the bundle again")
    try:
        value = {name: float(entry["value"]) for name, entry in plant["parameters"].items()}
        described = (plant.get("link") or {}).get("markers")
        offset_m, length_m, width_m, position = (value[name] for name in _NEEDED)
        ratio = value["root_stiffness_1_nm_rad"] / value["span_stiffness_1_nm_rad"]
        layout = (
            msgspec.convert(described, MarkerLayout)
            if described
            else square_layout(length_m, width_m)
        )
    except (AttributeError, KeyError, TypeError, ValueError, ZeroDivisionError):
        return None
    return LinkShape(offset_m, length_m, layout.rows_m, layout.corners_m, (1.0 - position) * ratio)
