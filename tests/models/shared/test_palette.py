import itertools
import re

import numpy as np
import pytest
from matplotlib.colors import to_rgb

from models.shared import palette
from models.shared.pages import STYLE, stylesheet

# Simulation of colour blindness in linear RGB at full severity: Machado, Oliveira and Fernandes,
# "A Physiologically-based Model for Simulation of Color Vision Deficiency", 2009, table 1.
SEEN_BY = {
    "everybody": np.eye(3),
    "protanopes": np.array([[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216],
                            [-0.003882, -0.048116, 1.051998]]),
    "deuteranopes": np.array([[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413],
                              [-0.011820, 0.042940, 0.968881]]),
    "tritanopes": np.array([[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602],
                            [0.004733, 0.691367, 0.303900]]),
}  # fmt: skip


def linear(colour):
    c = np.array(to_rgb(colour))
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)


def luminance(colour):
    return float(linear(colour) @ (0.2126, 0.7152, 0.0722))


def contrast(one, other):
    """WCAG 2.1 contrast ratio."""
    light, dark = sorted((luminance(one), luminance(other)), reverse=True)
    return (light + 0.05) / (dark + 0.05)


def lab(rgb):
    """CIE L*a*b* under D65 of linear sRGB."""
    to_xyz = np.array(
        [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750],
         [0.0193339, 0.1191920, 0.9503041]]
    )  # fmt: skip
    ratio = to_xyz @ rgb / np.array([0.95047, 1.0, 1.08883])
    f = np.where(ratio > 216 / 24389, np.cbrt(ratio), (24389 / 27 * ratio + 16) / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


@pytest.mark.parametrize("who", SEEN_BY)
def test_series_can_be_told_apart(who):
    for one, other in itertools.combinations((*palette.SERIES, palette.INK), 2):
        seen = [lab(np.clip(SEEN_BY[who] @ linear(c), 0, 1)) for c in (one, other)]
        assert np.linalg.norm(seen[0] - seen[1]) > 15, (one, other)


def test_lines_and_text_stand_out_from_paper():
    for colour in (*palette.SERIES, palette.AMBER, palette.ALARM, palette.MUTED):
        assert contrast(colour, palette.PAPER) >= 3.0  # WCAG 2.1, graphics
    for name in ("ink", "quiet", "link", "met", "unmet"):
        assert contrast(palette.PAGE_COLOURS[name], palette.PAPER) >= 4.5  # WCAG 2.1, text


@pytest.mark.parametrize("count", [1, 2, 5, 12])
def test_ordered_colours_darken_all_the_way(count):
    values = [luminance(c) for c in palette.ordered_colours(count)]
    assert len(values) == count and values == sorted(values, reverse=True)


def test_the_heat_ramp_runs_from_light_to_dark():
    values = [luminance(palette.heat_colours()(fraction)) for fraction in np.linspace(0, 1, 20)]
    assert values == sorted(values, reverse=True)


def test_the_style_sheet_uses_the_palette_and_no_colour_of_its_own():
    text = STYLE.read_text(encoding="utf-8")
    assert not re.search(r"#[0-9a-fA-F]{3,8}\b", text)
    defined = set(re.findall(r"--([\w-]+):", stylesheet()))
    assert set(re.findall(r"var\(--([\w-]+)\)", text)) <= defined
    for name, colour in palette.PAGE_COLOURS.items():
        assert f"--{name}: {colour};" in stylesheet()
