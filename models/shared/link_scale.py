"""Expected masses, stiffness and damping of a link of any size.

They follow from size, section and pressure, with the material of the study's link
(docs/sources.md, "The link"): walls of the same fabric, the same bond of the root patch. Rig and
plant multiply their values and bounds for the study's link by the ratio of the two links, so a link
described with the study's numbers has exactly the study's values.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Final

from firmware_py.link.link_description import STUDY_LINK, LinkDescription

WALL_STIFFNESS_N_M: Final = 60e3
"""Stiffness Et of the walls."""
WALL_SHEAR_N_M: Final = 4280.0
"""Shear stiffness Gt of the walls: 1070 N = 5/6 2h Gt."""
AREAL_MASS_KG_M2: Final = 0.9 / (4 * 0.15 * 0.95)
"""Mass of fabric and yarns per area of the walls."""
TIP_MASS_KG_M2: Final = 0.25 / 0.15**2
"""Mass of the hardware at the tip per area of the section."""
PATCH_LENGTH_RATIO: Final = 135.0 / 350.0 / 0.15
"""Length of link that bends like the root patch, relative to the width: 350 N·m/rad at 135 N·m²."""
HELD_RAD: Final = math.radians(30.0)
"""Largest angle of the study's motions."""
REFERENCE_PRESSURE_PA: Final = 41_300.0
MODAL_MASS_FRACTION: Final = 0.236
"""Fraction of a cantilever's mass that moves with its tip: 33/140 (Rayleigh, static deflection)."""


@dataclass(frozen=True)
class LinkScale:
    """Properties that follow from a link's description."""

    link: LinkDescription

    @property
    def perimeter_m(self) -> float:
        """Perimeter of the section."""
        return (4.0 if self.link.section == "square" else math.pi) * self.link.width_m

    @property
    def area_m2(self) -> float:
        """Area of the section."""
        return (1.0 if self.link.section == "square" else math.pi / 4) * self.link.width_m**2

    @property
    def mass_kg(self) -> float:
        """Mass of the link: as described, or from the area of its walls."""
        given = self.link.mass_kg
        return AREAL_MASS_KG_M2 * self.perimeter_m * self.link.length_m if given is None else given

    @property
    def tip_mass_kg(self) -> float:
        """Mass of the hardware at the tip: as described, or from the area of the section."""
        given = self.link.tip_mass_kg
        return TIP_MASS_KG_M2 * self.area_m2 if given is None else given

    @property
    def plate_m2(self) -> float:
        """Area that base plate and frame scale with."""
        return self.link.width_m**2

    @property
    def wall_bending_n_m2(self) -> float:
        """EI at the reference pressure: 2/3 h³ Et of a box, π r³ Et of a tube."""
        shape = 2 / 3 if self.link.section == "square" else math.pi / 8
        return shape * WALL_STIFFNESS_N_M * self.link.width_m**3

    @property
    def pressure_ratio(self) -> float:
        """Pressure relative to that of the known stiffness, which is proportional to it."""
        return self.link.pressure_pa / REFERENCE_PRESSURE_PA

    @property
    def bending_n_m2(self) -> float:
        """EI at the link's pressure."""
        return self.pressure_ratio * self.wall_bending_n_m2

    @property
    def root_nm_rad(self) -> float:
        """Stiffness of the root patch at the link's pressure."""
        return self.bending_n_m2 / (PATCH_LENGTH_RATIO * self.link.width_m)

    @property
    def span_nm_rad(self) -> float:
        """Stiffness of the span's hinge, 4/3 EI/L."""
        return 4 / 3 * self.bending_n_m2 / self.link.length_m

    @property
    def wall_shear_n(self) -> float:
        """Shear stiffness of the walls, κGA: 5/6 2h Gt of a box, π r Gt of a tube."""
        shape = 5 / 3 if self.link.section == "square" else math.pi / 2
        return shape * WALL_SHEAR_N_M * self.link.width_m

    @property
    def shear_n(self) -> float:
        """Shear stiffness of walls and pressure, which adds p A."""
        return self.wall_shear_n + self.link.pressure_pa * self.area_m2

    @property
    def limit_moment_nm(self) -> float:
        """Moment at which the section collapses, at the link's pressure: p h³/2, or π p r³.

        The pressure pulls with p A on the axis; at collapse the wall farthest from the compressed
        one carries all of it. Wrinkling begins earlier, where the compressed wall loses its
        tension: p h³/3, or π p r³/2.
        """
        shape = 1 / 2 if self.link.section == "square" else math.pi / 8
        return shape * self.link.pressure_pa * self.link.width_m**3

    def deflection_m(self, z_m: float, tip_n: float, *, shear: bool = True) -> float:
        """Displacement at height z above the base plate under a force F across the tip.

        A Timoshenko beam on the root patch of stiffness k:

            w(z) = F (L / k + 1 / κGA) z + F (L z² / 2 - z³ / 6) / EI
        """
        length_m = self.link.length_m
        slope = length_m / self.root_nm_rad + (1 / self.shear_n if shear else 0.0)
        return tip_n * (slope * z_m + (length_m * z_m**2 / 2 - z_m**3 / 6) / self.bending_n_m2)

    @property
    def tip_stiffness_n_m(self) -> float:
        """Force per displacement of the tip: root patch, bending and shear in series."""
        length = self.link.length_m
        return 1.0 / (
            length**2 / self.root_nm_rad + length**3 / (3 * self.bending_n_m2)
            + length / self.shear_n
        )  # fmt: skip

    @property
    def first_mode_rad_s(self) -> float:
        """Frequency of the first mode without payload, with a fixed base."""
        swinging_kg = MODAL_MASS_FRACTION * self.mass_kg + self.tip_mass_kg
        return math.sqrt(self.tip_stiffness_n_m / swinging_kg)

    @property
    def holding_nm(self) -> float:
        """Largest torque of a joint against the weight of link and payload, up to 30° from zero.

        The lever of the weight at angle q is g_x cos q - g_z sin q of the distance from the axis.
        For a link that stands or hangs it is one half at 30°, for a lying one all at zero.
        """
        link, reach = self.link, self.link.base_offset_m + self.link.length_m
        own = self.mass_kg * (link.base_offset_m + link.length_m / 2) + self.tip_mass_kg * reach
        x, y, z = link.gravity.unit
        levers = [
            abs(across * math.cos(q) - z * math.sin(q))
            for across in (x, y)[: link.joints]
            for q in (-HELD_RAD, 0.0, HELD_RAD)
        ]
        return max(levers) * link.gravity.size_m_s2 * (own + link.payload_kg * reach)

    @property
    def holding_of_limit(self) -> float:
        """`holding_nm` relative to the torque at the servo's current limit."""
        return self.holding_nm / self.link.preset.torque_limit_nm

    def over_study(self, name: str) -> float:
        """Ratio of a property to that of the study's link."""
        return float(getattr(self, name) / getattr(_STUDY, name))

    @cached_property
    def servo_ratios(self) -> dict[str, float]:
        """Ratios of the servo's preset to that of the study's servo."""
        own, study = self.link.preset, STUDY_LINK.preset
        names = (
            "torque_constant_nm_a", "coulomb_friction_nm", "viscous_friction_nm_s_rad",
            "load_friction", "rotor_inertia_kg_m2", "backlash_rad", "current_limit_a",
            "speed_limit_rad_s", "mass_kg", "torque_limit_nm",
        )  # fmt: skip
        return {name: getattr(own, name) / getattr(study, name) for name in names}


_STUDY: Final = LinkScale(STUDY_LINK)
