"""Ratios to the study's link: moments of an inflated section, and the area of a round one."""

import math

import msgspec
import numpy as np
import pytest

from firmware_py.link.link_description import STUDY_LINK
from models.shared.link_scale import LinkScale

ROUND = msgspec.structs.replace(STUDY_LINK, section="round")
PARTS = 40_000


def wall(section, width_m):
    """Distance from the axis of bending, and length, of equal parts of the wall."""
    if section == "round":
        angle = 2 * np.pi * (np.arange(PARTS) + 0.5) / PARTS
        return width_m / 2 * np.sin(angle), np.full(PARTS, np.pi * width_m / PARTS)
    side = width_m * ((np.arange(PARTS) + 0.5) / PARTS - 0.5)
    flat = np.full(PARTS, width_m / 2)
    return np.concatenate([side, side, flat, -flat]), np.full(4 * PARTS, width_m / PARTS)


def bent(section, width_m, pressure_pa, curvature):
    """Moment and least strain of a membrane that takes no compression, at a curvature.

    The stiffness of the wall is one; its mean strain is that at which it holds the pressure.
    """
    distance_m, length_m = wall(section, width_m)
    area_m2 = width_m**2 * (math.pi / 4 if section == "round" else 1.0)
    low, high = -1e9, 1e9
    for _ in range(200):
        mean = (low + high) / 2
        tension = np.maximum(mean + curvature * distance_m, 0.0)
        low, high = (low, mean) if tension @ length_m > pressure_pa * area_m2 else (mean, high)
    return float(tension * distance_m @ length_m), mean - curvature * width_m / 2


@pytest.mark.parametrize(
    ("section", "onset", "collapse"),
    [("square", 1 / 3, 1 / 2), ("round", math.pi / 16, math.pi / 8)],
)
def test_onset_and_collapse_of_an_inflated_section(section, onset, collapse):
    width_m, pressure_pa = 0.15, 41_300.0
    unit_nm = pressure_pa * width_m**3
    slack = pressure_pa * width_m / 4 / (width_m / 2)  # curvature at which one wall is slack
    before, least = bent(section, width_m, pressure_pa, 0.999 * slack)
    assert least > 0 > bent(section, width_m, pressure_pa, 1.001 * slack)[1]
    assert before == pytest.approx(onset * unit_nm, rel=2e-3)
    assert bent(section, width_m, pressure_pa, 2e3 * slack)[0] == pytest.approx(
        collapse * unit_nm, rel=2e-2
    )
    link = msgspec.structs.replace(STUDY_LINK, section=section)
    assert LinkScale(link).limit_moment_nm == pytest.approx(collapse * unit_nm)


def test_a_round_link_has_less_of_all_that_goes_by_its_section():
    for name in ("limit_moment_nm", "tip_mass_kg", "mass_kg"):
        assert LinkScale(ROUND).over_study(name) == pytest.approx(math.pi / 4), name
        assert LinkScale(STUDY_LINK).over_study(name) == 1.0, name
