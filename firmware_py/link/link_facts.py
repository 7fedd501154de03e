"""Facts of a link that no identification changes: joints, size, mounting, servo.

A plan and a map of goals contain the facts of their plant. So the robot can distinguish an improved
plant of its own link from a plant of another link.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

import msgspec

from firmware_py.link.link_description import STANDARD_GRAVITY_M_S2, STUDY_LINK, LinkDescription

_SAME: Final = 1e-6
"""Relative or absolute tolerance for the comparison of two numbers [assumed]."""


class LinkFacts(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Facts that distinguish one link from another."""

    joints: int  # Number of joints
    length_m: float  # From the base plate to the last marker row
    width_m: float  # Side (or diameter) of the section
    base_offset_m: float  # Height of the base plate above the joint axes
    section: str  # Shape of the section
    # Acceleration by gravity in the link's frame, which describes the mounting
    gravity_m_s2: tuple[float, float, float]
    servo: str  # Model of the servos


STUDY_FACTS: Final = LinkFacts(
    joints=STUDY_LINK.joints, length_m=STUDY_LINK.length_m, width_m=STUDY_LINK.width_m,
    base_offset_m=STUDY_LINK.base_offset_m, section=STUDY_LINK.section,
    gravity_m_s2=(0.0, 0.0, -STANDARD_GRAVITY_M_S2), servo=STUDY_LINK.servo.model,
)  # fmt: skip


def facts_of_plant(plant: Mapping[str, Any]) -> LinkFacts | None:
    """Return the facts of a plant's link; None if the plant describes no link or lacks them."""
    try:
        described = plant.get("link")
        link = msgspec.convert(described, LinkDescription) if described else STUDY_LINK
        value = {
            name: float(plant["parameters"][name]["value"])
            for name in ("link_length_m", "link_width_m", "base_offset_m", "gravity_m_s2")
        }
        x, y, z = (value["gravity_m_s2"] * part for part in link.gravity.unit)
    except (AttributeError, KeyError, TypeError, ValueError, ZeroDivisionError):
        return None
    return LinkFacts(
        joints=link.joints, length_m=value["link_length_m"], width_m=value["link_width_m"],
        base_offset_m=value["base_offset_m"], section=link.section, gravity_m_s2=(x, y, z),
        servo=link.servo.model,
    )  # fmt: skip


def other_link(link: LinkFacts, there: LinkFacts) -> str:
    """Return the first fact in which two links differ, with both values; empty for none."""
    for field in msgspec.structs.fields(LinkFacts):
        one, other = getattr(link, field.name), getattr(there, field.name)
        if not _same(one, other):
            return f"{field.name} {_text(one)} instead of {_text(other)}"
    return ""


def _same(one: Any, other: Any) -> bool:
    if isinstance(one, tuple):
        return all(_same(a, b) for a, b in zip(one, other, strict=True))
    if isinstance(one, float):
        return math.isclose(one, other, rel_tol=_SAME, abs_tol=_SAME)
    return bool(one == other)


def _text(value: Any) -> str:
    if isinstance(value, tuple):
        return "[" + ", ".join(_text(v) for v in value) + "]"
    return f"{value:g}" if isinstance(value, float) else str(value)
