"""Colours: contrast of all text, and series that colour-blind readers can tell apart."""

import itertools
import re

import numpy as np
import pytest
from matplotlib.colors import to_rgb

from models.shared import palette
from models.shared.pages import STYLE, stylesheet

# Simulation of colour blindness in linear RGB at full severity: Machado, Oliveira and Fernandes,
# "A Physiologically-based Model for Simulation of Color Vision Deficiency", 2009, table 1.
VISION = {
    "normal": np.eye(3),
    "protanopia": np.array([[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216],
                            [-0.003882, -0.048116, 1.051998]]),
    "deuteranopia": np.array([[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413],
                              [-0.011820, 0.042940, 0.968881]]),
    "tritanopia": np.array([[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602],
                            [0.004733, 0.691367, 0.303900]]),
}  # fmt: skip
TEXT, GRAPHICS = 4.5, 3.0
"""Least contrast by WCAG 2.1."""


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


@pytest.mark.parametrize("vision", VISION)
def test_series_can_be_told_apart(vision):
    for pair in itertools.combinations((*palette.SERIES, palette.INK), 2):
        one, other = (lab(np.clip(VISION[vision] @ linear(c), 0, 1)) for c in pair)
        assert np.linalg.norm(one - other) > 15, pair


def test_lines_stand_out_from_paper_and_ramps_darken_all_the_way():
    for colour in (*palette.SERIES, palette.AMBER, palette.ALARM, palette.MUTED):
        assert contrast(colour, palette.PAPER) >= GRAPHICS
    for ramp in (palette.ordered_colours(1), palette.ordered_colours(12)):
        values = [luminance(c) for c in ramp]
        assert values == sorted(values, reverse=True)


@pytest.mark.parametrize("colours", [palette.PAGE_COLOURS, palette.DARK_PAGE_COLOURS])
def test_text_of_pages_stands_out(colours):
    kinds = ("simulated", "measured", "mixed", "unknown")
    pairs = [(text, "paper") for text in ("ink", "quiet", "link", "met", "unmet")]
    pairs += [(text, "shade") for text in ("ink", *kinds)]
    pairs += [("paper", badge) for badge in ("met", "unmet", "quiet")]
    for text, behind in pairs:
        assert contrast(colours[text], colours[behind]) >= TEXT, (text, behind)


def test_the_style_sheet_takes_its_colours_from_the_palette():
    text = STYLE.read_text(encoding="utf-8")
    assert not re.search(r"#[0-9a-fA-F]{3,8}\b", text)
    defined = set(re.findall(r"--([\w-]+):", stylesheet()))
    assert set(re.findall(r"var\(--([\w-]+)\)", text)) <= defined
    figure = stylesheet().split(".figure {", 1)[1].split("}", 1)[0]
    assert f"--paper: {palette.PAPER};" in figure, "drawings are made for light paper"
