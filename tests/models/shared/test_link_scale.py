"""Ratios to the study's link: moments of an inflated section, and the area of a round one."""

import math

import msgspec
import numpy as np
import pytest

from firmware_py.link.link_description import STUDY_LINK
from models.shared.link_scale import LEAST_SPAN_POSITION, LinkScale

PARTS = 40_000


def scale_of(**changes):
    return LinkScale(msgspec.structs.replace(STUDY_LINK, **changes))


def bent(section, width_m, pressure_pa, curvature):
    """Moment and least strain of a membrane that takes no compression, at a curvature.

    The stiffness of the wall is one; its mean strain is that at which it holds the pressure.
    """
    if section == "round":
        turn = 2 * np.pi * (np.arange(PARTS) + 0.5) / PARTS
        distance_m, length_m = width_m / 2 * np.sin(turn), np.full(PARTS, np.pi * width_m / PARTS)
        area_m2 = width_m**2 * math.pi / 4
    else:
        side, flat = width_m * ((np.arange(PARTS) + 0.5) / PARTS - 0.5), np.full(PARTS, width_m / 2)
        distance_m = np.concatenate([side, side, flat, -flat])
        length_m, area_m2 = np.full(4 * PARTS, width_m / PARTS), width_m**2
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
    collapsed, _ = bent(section, width_m, pressure_pa, 2e3 * slack)
    assert collapsed == pytest.approx(collapse * unit_nm, rel=2e-2)
    assert scale_of(section=section).limit_moment_nm == pytest.approx(collapse * unit_nm)


@pytest.mark.parametrize(("section", "per_area"), [("square", 1 / 6), ("round", 1 / 8)])
def test_pressure_enters_bending_by_prestress_and_shear_by_its_pull(section, per_area):
    """Le Van and Wielgosz (2005): p A I/S, which is p A h²/6 of a box and p A r²/2 of a tube."""
    low, high = (scale_of(section=section, pressure_pa=p) for p in (20_000.0, 50_000.0))
    pull_n = 30_000.0 * low.area_m2
    assert high.bending_n_m2 - low.bending_n_m2 == pytest.approx(pull_n * per_area * 0.15**2)
    assert high.shear_n - low.shear_n == pytest.approx(pull_n)
    assert high.wall_shear_n == low.wall_shear_n
    assert high.root_nm_rad / low.root_nm_rad == pytest.approx(high.bending_n_m2 / low.bending_n_m2)


def test_values_of_the_study_link_and_of_a_round_one():
    assert scale_of().bending_n_m2 == pytest.approx(135.0)
    assert scale_of(pressure_pa=0.0).bending_n_m2 == pytest.approx(135.0 * (1 - 0.0258), abs=0.0135)
    for name in ("limit_moment_nm", "tip_mass_kg", "mass_kg"):
        assert scale_of(section="round").over_study(name) == pytest.approx(math.pi / 4), name


@pytest.mark.parametrize("length_m", [0.5, 0.95])
def test_the_hinge_of_the_span_moves_and_turns_the_tip_as_the_span_does(length_m):
    scale = scale_of(length_m=length_m)
    turn = (1 - scale.span_position) * length_m / scale.span_nm_rad
    across = turn * (1 - scale.span_position) * length_m
    exact = length_m**3 / (3 * scale.bending_n_m2) + length_m / scale.shear_n
    assert across == pytest.approx(exact)
    if scale.span_position > LEAST_SPAN_POSITION:
        assert turn == pytest.approx(length_m**2 / (2 * scale.bending_n_m2))
    if length_m == 0.95:
        assert (scale.span_position, scale.span_nm_rad) == pytest.approx((0.184, 232.0), rel=2e-3)
