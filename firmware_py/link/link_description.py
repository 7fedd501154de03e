"""Description of a link, `link.toml`, which trial, plant, rig and robot.toml share.

The default is the study's link (`STUDY_LINK`). `dropstitch new LINK.toml` writes a file with
every key.
"""

from __future__ import annotations

import math
from functools import cached_property
from pathlib import Path
from typing import Any, Final, Literal

import msgspec

from firmware_py.bus.servo_models import PRESETS, ServoPreset, check_servo, model_named
from firmware_py.core.errors import InputError
from firmware_py.core.input_files import convert, read_toml
from firmware_py.link.marker_layout import MarkerLayout, square_layout

Vector = tuple[float, float, float]
Mounting = Literal["upright", "horizontal", "hanging", "balloon"]
SCHEMA: Final = 1
STANDARD_GRAVITY_M_S2: Final = 9.81
"""Gravity of the study: docs/sources.md, "The link"."""

DIRECTIONS: Final[dict[Mounting, Vector]] = {
    "upright": (0.0, 0.0, -1.0),
    "horizontal": (-1.0, 0.0, 0.0),
    "hanging": (0.0, 0.0, 1.0),
    "balloon": (0.0, 0.0, -1.0),
}
"""Direction of gravity in the link's frame, whose z axis is the link at zero angle."""

_RANGES: Final = {
    "length_m": (0.05, 10.0), "width_m": (0.01, 2.0), "base_offset_m": (0.0, 1.0),
    "pressure_pa": (5e3, 1.5e5), "mass_kg": (1e-3, 50.0), "tip_mass_kg": (1e-3, 50.0),
    "payload_kg": (0.0, 100.0),
}  # fmt: skip
_REQUIRED: Final = ("length_m", "width_m", "base_offset_m", "pressure_pa", "payload_kg")
"""Keys that every file must have: the study's values are no defaults for another link."""
_DESCRIBES: Final = {"length_m", "width_m", "pressure_pa", "markers"}
"""Keys that neither a plant nor a rig has, so that one of them identifies a link's file."""
PAYLOAD_HEADROOM: Final = 1.5
"""Ratio of the largest payload of the link's models to `payload_kg` [assumed]."""
MOST_PAYLOAD_TORQUE: Final = 10.0
"""Largest ratio of the payload's torque, held level, to the servo's; more is a wrong unit
[assumed]."""
CORNER_ROOM_M: Final = 0.1
"""Largest distance of a marker from the section [assumed]."""


class LinkGravity(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Table `[gravity]`."""

    # Mounting of the link at zero angle. Horizontal: gravity along -x, in the plane of joint 1.
    # Balloon: upright, with a part of the weight carried by the balloon.
    mounting: Mounting = "upright"
    # Direction of gravity for any other mounting, in a frame with z along the link at zero angle
    direction: Vector | None = None
    # Fraction of the weight, payload included, that the link has to carry: below 1 with a balloon.
    # The inertia is not reduced.
    effective_weight: float = 1.0

    @property
    def unit(self) -> Vector:
        x, y, z = self.direction or DIRECTIONS[self.mounting]
        size = math.hypot(x, y, z)
        return (x / size, y / size, z / size)

    @property
    def size_m_s2(self) -> float:
        """Effective acceleration by gravity: the fraction of the weight times g."""
        return STANDARD_GRAVITY_M_S2 * self.effective_weight

    @property
    def vector_m_s2(self) -> Vector:
        """Effective acceleration by gravity as a vector in the link's frame."""
        x, y, z = self.unit
        size = self.size_m_s2
        return (x * size, y * size, z * size)


class LinkServo(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Table `[servo]`: a model, and the values that differ from its preset (`ServoPreset`)."""

    model: str = "H54-200-S500-R"
    gear: float | None = None
    torque_constant_nm_a: float | None = None
    coulomb_friction_nm: float | None = None
    viscous_friction_nm_s_rad: float | None = None
    load_friction: float | None = None
    rotor_inertia_kg_m2: float | None = None
    backlash_rad: float | None = None
    current_limit_a: float | None = None
    speed_limit_rad_s: float | None = None
    mass_kg: float | None = None
    source: str | None = None

    @property
    def whole(self) -> ServoPreset:
        """Preset of the model with the values of the table."""
        values = {
            f.name: value
            for f in msgspec.structs.fields(ServoPreset)
            if (value := getattr(self, f.name)) is not None
        }
        return msgspec.structs.replace(model_named(self.model).preset, **values)


class LinkDescription(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True,
                      dict=True):  # fmt: skip
    schema: int = SCHEMA
    name: str = "link"
    joints: Literal[1, 2] = 2
    length_m: float = 0.95  # From the base plate to the last marker row
    width_m: float = 0.15  # Side (or diameter) of the section
    section: Literal["square", "round"] = "square"
    base_offset_m: float = 0.06  # Height of the base plate above the joint axes
    pressure_pa: float = 41_300.0
    mass_kg: float | None = None  # Mass of the link; None estimates it from the size
    # Mass of the hardware at the tip; None estimates it from the size
    tip_mass_kg: float | None = None
    payload_kg: float = 2.0  # Largest payload in use
    # Positions of the markers; by default four rows of four at the corners
    markers: MarkerLayout | None = None
    gravity: LinkGravity = LinkGravity()
    servo: LinkServo = LinkServo()

    @cached_property
    def layout(self) -> MarkerLayout:
        return self.markers or square_layout(self.length_m, self.marker_width_m)

    @property
    def marker_width_m(self) -> float:
        """Distance of two neighbouring markers in the default layout."""
        return self.width_m if self.section == "square" else self.width_m / math.sqrt(2.0)

    @property
    def most_payload_kg(self) -> float:
        """Largest payload of plant, twin and observer: 3 kg for the study's link."""
        return PAYLOAD_HEADROOM * self.payload_kg

    @property
    def payloads_kg(self) -> tuple[float, ...]:
        """Five payloads from zero to the largest; only zero if the link carries none."""
        return tuple(sorted({round(self.payload_kg * k / 4, 4) for k in range(5)}))

    @property
    def preset(self) -> ServoPreset:
        return self.servo.whole

    def conditions(self) -> dict[str, Any]:
        """Return the conditions of a trial of this link, by key of its TOML file."""
        facts: dict[str, Any] = {
            "base_offset_m": self.base_offset_m,
            "link_length_m": self.length_m,
            "link_width_m": self.width_m,
            "pressure_pa": self.pressure_pa,
        }
        if self.layout != square_layout(self.length_m, self.width_m):
            facts["markers"] = msgspec.to_builtins(self.layout)
        if self.gravity.vector_m_s2 != STUDY_LINK.gravity.vector_m_s2:
            facts["gravity_m_s2"] = list(self.gravity.vector_m_s2)
        return facts


STUDY_LINK: Final = LinkDescription(name="drop-stitch link of the study")
"""The study's link: docs/sources.md, "The link"; masses and servo as in rig and plant."""


def describes_link(document: Any) -> bool:
    """Whether a decoded TOML document describes a link, not a plant or a rig.

    A key of its size is enough; `read_link` then reports the missing ones.
    """
    return isinstance(document, dict) and not _DESCRIBES.isdisjoint(document)


def read_link(path: Path | str) -> LinkDescription:
    path = Path(path)
    document = read_toml(path, "write one with 'dropstitch new LINK.toml'")
    link = convert(document, LinkDescription, path, "", "see docs/plant/link.md for every key")
    for key in _REQUIRED:
        if key not in document:
            raise InputError(
                path, f"{key} is missing", "give that of your link (docs/plant/link.md)"
            )
    check_link(link, path)
    return link


def check_link(link: LinkDescription, where: Path | str) -> None:
    """Refuse values that are out of range or do not fit together."""
    if link.schema != SCHEMA:
        raise InputError(where, f"schema is {link.schema}", f"this version reads {SCHEMA}")
    for key, (low, high) in _RANGES.items():
        value = getattr(link, key)
        if value is not None and not low <= value <= high:
            raise InputError(
                where, f"{key} is {value:g}, outside {low:g} to {high:g}",
                "give it in the unit of its name",
            )  # fmt: skip
    gravity = link.gravity
    if not 0.0 <= gravity.effective_weight <= 1.0:
        raise InputError(
            where, f"gravity.effective_weight is {gravity.effective_weight:g}",
            "give the part of the weight that is left, 0 to 1",
        )  # fmt: skip
    if gravity.direction is not None:
        size = math.hypot(*gravity.direction)
        if not (math.isfinite(size) and size > 0):
            raise InputError(
                where, "gravity.direction has no direction", "give one, like [0, 0, -1]"
            )
    if link.servo.model not in PRESETS:
        raise InputError(
            where, f"servo.model {link.servo.model!r} is not known",
            f"use one of {', '.join(PRESETS)}",
        )  # fmt: skip
    check_servo(link.preset, where)
    _check_payload(link, where)
    link.layout.check(where, link.length_m)
    _check_corners(link, where)


def _check_payload(link: LinkDescription, where: Path | str) -> None:
    """Refuse a payload far beyond what the servo can hold, such as one in grams."""
    weight_nm = link.payload_kg * link.gravity.size_m_s2 * (link.base_offset_m + link.length_m)
    ratio = weight_nm / link.preset.torque_limit_nm
    if ratio > MOST_PAYLOAD_TORQUE:
        raise InputError(
            where, f"payload_kg is {link.payload_kg:g}, whose weight takes {ratio:.0f} times the "
            f"torque of {link.servo.model}", "give it in kg",
        )  # fmt: skip


def _check_corners(link: LinkDescription, where: Path | str) -> None:
    """Refuse markers that are far from the link's section."""
    farthest_m = max(abs(v) for corner in link.layout.corners_m for v in corner)
    if farthest_m > link.width_m / 2 + CORNER_ROOM_M:
        raise InputError(
            where, f"[markers] corners_m reach {farthest_m:g} m from the axis, the link is "
            f"{link.width_m:g} m wide", "correct corners_m or width_m",
        )  # fmt: skip
