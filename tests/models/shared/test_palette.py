"""Colours: contrast of all text, and series that colour-blind readers can tell apart."""

import re

import numpy as np
import pytest
from matplotlib.colors import to_rgb

from models.shared import palette
from models.shared.pages import STYLE, stylesheet

# Simulation of colour blindness in linear RGB at full severity: Machado, Oliveira and Fernandes,
# "A Physiologically-based Model for Simulation of Color Vision Deficiency", 2009, table 1.
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
