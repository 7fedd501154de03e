"""Sag of a nominal link of given size under its weight at rest (Timoshenko beam).

The weight F of payload and hardware at the tip, and the link's weight q per length, act by their
components across the link. With a root patch of stiffness k, bending stiffness EI and shear
stiffness kGA (docs/sources.md, "The link") they displace a point at height z above the base plate
by

    w(z) = (F L + q L² / 2) z / k + F z / kGA + F (L z² / 2 - z³ / 6) / EI
           + q z² (6 L² - 4 L z + z²) / (24 EI).

An upright link at zero angle does not sag, a lying one does.
"""

from __future__ import annotations

import msgspec
import numpy as np

from firmware_py.link.link_description import STUDY_LINK
from models.shared.link_scale import LinkScale
from models.trials.importers.mocap_frame import nominal_markers_m
from models.trials.trial import Array, TrialMeta


def nominal_sag_m(meta: TrialMeta, turn: Array) -> Array:
    """Displacement of each marker of a nominal link by weight, in the world frame, shape (k, 3)."""
    axis = turn[:, 2]
    gravity = np.array(meta.gravity)
    across = gravity - (gravity @ axis) * axis
    size_m_s2 = float(np.linalg.norm(across))
    places = nominal_markers_m(meta)
    if size_m_s2 < 1e-6:
        return np.zeros_like(places)
    direction = across / size_m_s2
    link = msgspec.structs.replace(
        STUDY_LINK, length_m=meta.link_length_m, width_m=meta.link_width_m,
        pressure_pa=meta.pressure_pa or STUDY_LINK.pressure_pa,
    )  # fmt: skip
    scale, length_m = LinkScale(link), meta.link_length_m
    tip_n = (scale.tip_mass_kg + meta.payload_kg) * size_m_s2
    own_n_m = scale.mass_kg * size_m_s2 / length_m
    root = (tip_n * length_m + own_n_m * length_m**2 / 2) / scale.root_nm_rad

    def displaced(z: Array) -> Array:
        bent = tip_n * (length_m * z**2 / 2 - z**3 / 6)
        bent += own_n_m * z**2 * (6 * length_m**2 - 4 * length_m * z + z**2) / 24
        return (root + tip_n / scale.shear_n) * z + bent / scale.bending_n_m2

    z = places[:, 2] - meta.base_offset_m
    slope = (displaced(z + 1e-4) - displaced(z - 1e-4)) / 2e-4
    in_section = (places * [1.0, 1.0, 0.0]) @ turn.T
    sunk = np.outer(displaced(z), direction)  # the section also turns with the link
    return np.asarray(sunk - np.outer(slope * (in_section @ direction), axis))
