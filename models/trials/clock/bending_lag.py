"""Ratio of the bend below the first marker row to the bend between the first two rows.

Servo and markers are compared by the direction of the first marker row. The link bends between the
joint and that row, and the bend lags the motion (hysteresis, creep), so the direction seems to lag
as well. The turn from the first row to the second measures a bend of the same material. That bend,
times the ratio computed here, is subtracted from the first row's direction.

The ratio is that of a nominal link of this size (docs/sources.md, "The link";
`models.shared.link_scale`) under a force F at its tip: a root patch of stiffness k, a span of
bending stiffness EI and shear stiffness kGA displace a point at height z above the base plate by

    w(z) = F (L / k + 1 / kGA) z + F (L z² / 2 - z³ / 6) / EI

across the link (Timoshenko beam). Shear is elastic: it displaces the point, but it does not lag.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import msgspec

from firmware_py.link.link_description import STUDY_LINK
from models.shared.link_scale import LinkScale
from models.trials.trial import TrialMeta

RATIO_DEVIATION: Final = 0.5
"""Standard deviation of the ratio between links [assumed]. The ratio is 0.4 with a rigid root and 4
with a rigid span; the rig's links have 1.3 to 2.7."""


class BendRatio(NamedTuple):
    """Bend below the first row, relative to the bend between the first two rows."""

    whole: float  # Ratio of all bend, shear included
    late: float  # Ratio of the lagging bend, without shear


def nominal_bend_ratio(meta: TrialMeta) -> BendRatio:
    """Ratio for a nominal link of this size; zero with a single row of markers."""
    if meta.layout.rows < 2:
        return BendRatio(0.0, 0.0)
    size = {"length_m": meta.link_length_m, "width_m": meta.link_width_m}
    link = msgspec.structs.replace(STUDY_LINK, pressure_pa=meta.pressure_pa, **size)
    scale = LinkScale(link)
    return BendRatio(_ratio(meta, scale, 1 / scale.shear_n), _ratio(meta, scale, 0.0))


def _ratio(meta: TrialMeta, scale: LinkScale, shear_1_n: float) -> float:
    length_m = meta.link_length_m
    slope = length_m / scale.root_nm_rad + shear_1_n

    def across(z_m: float) -> float:
        return slope * z_m + (length_m * z_m**2 / 2 - z_m**3 / 6) / scale.bending_n_m2

    first, second = meta.layout.rows_m[:2]
    below = across(first) / (meta.base_offset_m + first)
    return below / ((across(second) - across(first)) / (second - first) - below)
