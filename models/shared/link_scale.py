"""Expected masses, stiffness and damping of a link of any size.

They follow from size, section and pressure, with the material of the study's link
(docs/sources.md, "The link"): walls of the same fabric, the same bond of the root patch. Rig and
plant multiply their values and bounds for the study's link by the ratio of the two links, so a link
described with the study's numbers has exactly the study's values.

The mechanics are those of an inflated beam (Le Van and Wielgosz, *Thin-Walled Structures* 43,
2005): pressure adds p A to the shear stiffness and p A I/S to the bending stiffness of the walls,
with A the area, I/S the second moment of the walls over their section. That of the walls themselves
does not depend on it. The limit moment is in proportion to pressure.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from firmware_py.link.link_description import STUDY_LINK, LinkDescription

Array = NDArray[np.float64]

REFERENCE_PRESSURE_PA: Final = 41_300.0
WALL_STIFFNESS_N_M: Final = 60e3 - REFERENCE_PRESSURE_PA * 0.15 / 4
"""Stiffness Et of the walls; the tension p h/4 of the study's link adds up to 60 kN/m, 135 N·m²."""
WALL_SHEAR_N_M: Final = 4280.0
"""Shear stiffness Gt of the walls: 1070 N = 5/6 2h Gt."""
AREAL_MASS_KG_M2: Final = 0.9 / (4 * 0.15 * 0.95)
"""Mass of fabric and yarns per area of the walls."""
TIP_MASS_KG_M2: Final = 0.25 / 0.15**2
"""Mass of the hardware at the tip per area of the section."""
PATCH_LENGTH_RATIO: Final = 135.0 / 350.0 / 0.15
"""Length of link that bends like the root patch, relative to the width: 350 N·m/rad at 135 N·m²."""
LEAST_SPAN_POSITION: Final = 0.15
"""Nearest place of the span's hinge to the root: the piece of link between two hinges that are
nearer swings too fast for the steps of a simulation."""
MODAL_MASS_FRACTION: Final = 0.236
"""Fraction of a cantilever's mass that moves with its tip: 33/140 (Rayleigh, static deflection)."""


class LinkScale:
    """Properties that follow from a link's description.

    `plate_m2` is the area that base plate and frame scale with.
    """

    def __init__(self, link: LinkDescription) -> None:
        self.link = link
        is_square = link.section == "square"
        width_m, length_m, pressure_pa = link.width_m, link.length_m, link.pressure_pa
        self.perimeter_m = (4.0 if is_square else math.pi) * width_m
        self.area_m2 = (1.0 if is_square else math.pi / 4) * width_m**2
        self.plate_m2 = width_m**2

        # Masses of link and hardware at the tip: as described, or from the areas
        walls_kg = AREAL_MASS_KG_M2 * self.perimeter_m * length_m
        self.mass_kg = walls_kg if link.mass_kg is None else link.mass_kg
        tip_kg = TIP_MASS_KG_M2 * self.area_m2
        self.tip_mass_kg = tip_kg if link.tip_mass_kg is None else link.tip_mass_kg

        # Second moment of the walls per thickness, I/t: 2/3 h³ of a box, π r³ of a tube
        self.second_moment_m3 = (2 / 3 if is_square else math.pi / 8) * width_m**3
        # Tension of the straight walls by pressure, p A over the perimeter: p h/4
        self.tension_n_m = pressure_pa * self.area_m2 / self.perimeter_m
        # EI; the tension adds p A h²/6 of a box, p A r²/2 of a tube
        self.bending_n_m2 = self.second_moment_m3 * (WALL_STIFFNESS_N_M + self.tension_n_m)
        # The root patch bends like a piece of link.
        self.root_nm_rad = self.bending_n_m2 / (PATCH_LENGTH_RATIO * width_m)
        # κGA: 5/6 2h Gt of a box, π r Gt of a tube; pressure adds p A
        self.wall_shear_n = (5 / 3 if is_square else math.pi / 2) * WALL_SHEAR_N_M * width_m
        self.shear_n = self.wall_shear_n + pressure_pa * self.area_m2

        # One hinge at σ L stands for the span. A force P at the tip of a cantilever that bends and
        # shears turns it by P L²/(2 EI) and moves it by P L³/(3 EI) + P L/κGA (Timoshenko). The
        # hinge does both at σ = 1/3 - 2 EI/(κGA L²), with the stiffness (1 - σ) 2 EI/L. In a short
        # link shear prevails: at `LEAST_SPAN_POSITION` it still moves the tip as the span does.
        shear = 2 * self.bending_n_m2 / (self.shear_n * length_m**2)
        self.span_position = max(1 / 3 - shear, LEAST_SPAN_POSITION)
        lever_m = (1 - self.span_position) * length_m
        compliance_m_n = length_m**3 / (3 * self.bending_n_m2) + length_m / self.shear_n
        self.span_nm_rad = lever_m**2 / compliance_m_n

        # The section collapses at p h³/2 of a box, π p r³ of a tube. The pressure pulls with p A on
        # the axis; at collapse the wall farthest from the compressed one carries all of it.
        # Wrinkling begins earlier, where the compressed wall loses its tension: p h³/3, π p r³/2.
        self.limit_moment_nm = (1 / 2 if is_square else math.pi / 8) * pressure_pa * width_m**3

    def deflection(self, z_m: Array, tip_n: float, own_n_m: float = 0.0) -> tuple[Array, Array]:
        """Displacement across the link in m and turn of the section in rad at heights z.

        Timoshenko's beam on a root patch of stiffness k, with a force F at its tip and q per length
        (its weight):

            w(z) = (F L + q L²/2) z/k + [F z + q (L z - z²/2)] / κGA
                   + [F (L z²/2 - z³/6) + q z² (6 L² - 4 L z + z²)/24] / EI

        The section turns by the parts of w' that are not shear.
        """
        length, z = self.link.length_m, np.asarray(z_m)
        root = (tip_n * length + own_n_m * length**2 / 2) / self.root_nm_rad
        shear = (tip_n * z + own_n_m * (length * z - z**2 / 2)) / self.shear_n
        bent = tip_n * (length * z**2 / 2 - z**3 / 6)
        bent = bent + own_n_m * z**2 * (6 * length**2 - 4 * length * z + z**2) / 24
        turn = tip_n * (length * z - z**2 / 2)
        turn = turn + own_n_m * (length**2 * z / 2 - length * z**2 / 2 + z**3 / 6)
        return root * z + shear + bent / self.bending_n_m2, root + turn / self.bending_n_m2

    @property
    def first_mode_rad_s(self) -> float:
        """Frequency of the first mode without payload, with a fixed base."""
        # Root patch, bending and shear in series
        tip_stiffness_n_m = 1.0 / float(self.deflection(np.array(self.link.length_m), 1.0)[0])
        swinging_kg = MODAL_MASS_FRACTION * self.mass_kg + self.tip_mass_kg
        return math.sqrt(tip_stiffness_n_m / swinging_kg)

    @property
    def holding_nm(self) -> float:
        """Largest torque of a joint against the weight of link and payload, up to 30° from zero.

        The lever of the weight at angle q is g_x cos q - g_z sin q of the distance from the axis.
        For a link that stands or hangs it is one half at 30°, for a lying one all at zero.
        """
        link, reach = self.link, self.link.base_offset_m + self.link.length_m
        link_kg_m = (
            self.mass_kg * (link.base_offset_m + link.length_m / 2) + self.tip_mass_kg * reach
        )
        x, y, z = link.gravity.unit
        levers = [
            abs(across * math.cos(q) - z * math.sin(q))
            for across in (x, y)[: link.joints]
            for q in (-math.pi / 6, 0.0, math.pi / 6)
        ]
        return max(levers) * link.gravity.size_m_s2 * (link_kg_m + link.payload_kg * reach)

    @property
    def holding_of_limit(self) -> float:
        """`holding_nm` relative to the torque at the servo's current limit."""
        return self.holding_nm / self.link.preset.torque_limit_nm

    def over_study(self, name: str) -> float:
        """Ratio of a property to that of the study's link."""
        return float(getattr(self, name) / getattr(_STUDY, name))

    def ratio_of_unit(self, powers: Mapping[str, int]) -> float:
        """Ratio of a quantity of the drive, by the exponents of the symbols in its unit.

        Torques are in proportion to the servo's torque and currents to its current. The motion is
        the study's, and with it rates and times.
        """
        servo = self.servo_ratios
        torque, current = powers.get("N", 0), powers.get("A", 0)
        return servo["torque_limit_nm"] ** torque * servo["current_limit_a"] ** current

    @cached_property
    def servo_ratios(self) -> dict[str, float]:
        """Ratios of the servo's preset to that of the study's servo."""
        servo, study = self.link.preset, STUDY_LINK.preset
        names = (
            "torque_constant_nm_a", "coulomb_friction_nm", "viscous_friction_nm_s_rad",
            "load_friction", "rotor_inertia_kg_m2", "backlash_rad", "current_limit_a",
            "speed_limit_rad_s", "mass_kg", "torque_limit_nm",
        )  # fmt: skip
        return {name: getattr(servo, name) / getattr(study, name) for name in names}


_STUDY: Final = LinkScale(STUDY_LINK)
