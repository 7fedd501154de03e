"""Ratio of the bend below the first marker row to the bend that the first two rows show.

Servo and markers are compared by the direction of the first marker row. Between the joint and that
row the link bends, and the bend follows the motion late (hysteresis, creep), so that the direction
seems late as well. The turn from the first row to the second one shows a bend of the same
material. Its multiple by the ratio computed here is taken from the first row's direction.

The ratio is that of the nominal link under a force F at its tip (docs/sources.md, "The link"): a
root patch of stiffness k, a span of bending stiffness EI and shear stiffness kGA displace a point
at height z above the base plate by

    w(z) = F (L / k + 1 / kGA) z + F (L z² / 2 - z³ / 6) / EI

across the link (Timoshenko beam). Shear is elastic: it bends, but it does not lag.
"""

from __future__ import annotations

from typing import Final, NamedTuple

ROOT_STIFFNESS_NM_RAD: Final = 350.0
BENDING_STIFFNESS_N_M2: Final = 135.0
SHEAR_STIFFNESS_N: Final = 2000.0
"""Of the nominal link: docs/sources.md, "The link"."""

RATIO_DEVIATION: Final = 0.5
"""Standard deviation of the ratio between links [assumed]: 0.4 with a rigid root, 4 with a rigid
span; the rig's links have 1.3 to 2.7."""


class BendRatio(NamedTuple):
    """Bend below the first row over the bend between the first two rows.

    Attributes
    ----------
    whole : float
        Of all bend, shear included.
    late : float
        Of the bend that lags.
    """

    whole: float
    late: float


def nominal_bend_ratio(base_offset_m: float, length_m: float) -> BendRatio:
    """Ratio of the nominal link.

    Parameters
    ----------
    base_offset_m, length_m : float
        Of the link; the first rows are at a quarter and a half of its length.

    Examples
    --------
    >>> ratio = nominal_bend_ratio(0.06, 0.95)
    >>> round(ratio.whole, 2), round(ratio.late, 2)
    (1.55, 1.42)
    """
    return BendRatio(
        _ratio(base_offset_m, length_m, 1 / SHEAR_STIFFNESS_N),
        _ratio(base_offset_m, length_m, 0.0),
    )


def _ratio(base_offset_m: float, length_m: float, shear_1_n: float) -> float:
    slope = length_m / ROOT_STIFFNESS_NM_RAD + shear_1_n

    def across(z_m: float) -> float:
        return slope * z_m + (length_m * z_m**2 / 2 - z_m**3 / 6) / BENDING_STIFFNESS_N_M2

    first, second = length_m / 4, length_m / 2
    below = across(first) / (base_offset_m + first)
    return below / ((across(second) - across(first)) / (second - first) - below)
