"""Contrast of all text, computed from the colours of the style sheet and of the drawings."""

import re

import numpy as np
import pytest
from matplotlib.colors import to_rgb

from models.shared.drawing import Drawing
from models.shared.pages import stylesheet
from models.shared.palette import DARK_PAGE_COLOURS, INK, PAGE_COLOURS, PAPER
from models.trials.checks.page import Curve, chart

LEAST = 4.5
"""WCAG 2.1, success criterion 1.4.3."""
RULE = re.compile(r"([^{}]+)\{([^{}]*)\}")


def contrast(one, other):
    """WCAG 2.1 contrast ratio."""

    def luminance(colour):
        c = np.array(to_rgb(colour))
        linear = np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)
        return float(linear @ (0.2126, 0.7152, 0.0722))

    light, dark = sorted((luminance(one), luminance(other)), reverse=True)
    return (light + 0.05) / (dark + 0.05)


def declared(css, selector):
    """Variables with a colour that the last rule of a selector sets."""
    found = [dict(re.findall(r"--([\w-]+):\s*(#\w+)", body)) for head, body in RULE.findall(css)
             if head.strip().endswith(selector) and "#" in body]  # fmt: skip
    return found[-1]


def schemes():
    """Colours in light, in dark, and in a figure on a dark page, as a browser resolves them."""
    light, dark = stylesheet().split("@media screen and (prefers-color-scheme: dark) {", 1)
    dark = dark.split("\n}\n}", 1)[0]
    return {
        "light and print": declared(light, ":root"),
        "dark": declared(dark + "\n}", ":root"),
        "figure in dark": declared(dark + "\n}", ".figure"),
    }


def pairs():
    """Variables of text and of what is behind it: each rule's own, or the page's paper."""
    kinds = ("simulated", "measured", "mixed", "unknown")
    found = set()
    for selector, body in RULE.findall(stylesheet()):
        text = re.search(r"(?<![-\w])color: var\(--([\w-]+)\)", body)
        behind = re.search(r"background(?:-color)?: var\(--([\w-]+)\)", body)
        names = [text[1]] if text else (["ink"] if behind and "scrollbar" not in selector else [])
        for name in kinds if names == ["kind"] else names:
            found.add((name, behind[1] if behind else "paper"))
            if ".notice" in selector:
                found.add((name, "shade"))
    badges = re.findall(r"\.badge\.\w+ \{ background: var\(--([\w-]+)\)", stylesheet())
    found -= {("ink", name) for name in badges} | {("paper", "paper")}
    return found | {("paper", name) for name in badges}


@pytest.mark.parametrize("scheme", schemes())
def test_text_stands_out_from_what_is_behind_it(scheme):
    colours = schemes()[scheme]
    assert colours.keys() == PAGE_COLOURS.keys()
    checked = pairs()
    assert {
        ("ink", "paper"),
        ("quiet", "paper"),
        ("simulated", "shade"),
        ("paper", "met"),
    } <= checked
    for text, behind in checked:
        ratio = contrast(colours[text], colours[behind])
        assert ratio >= LEAST, (text, behind, round(ratio, 2))


def test_dark_is_for_screens_only_and_figures_keep_the_light_colours():
    css = stylesheet()
    assert "prefers-color-scheme: dark" not in css.replace("screen and (prefers-color-scheme", "")
    assert schemes()["figure in dark"] == schemes()["light and print"] == PAGE_COLOURS
    assert schemes()["dark"] == DARK_PAGE_COLOURS


def text_colours(svg):
    """Colours of the text of a drawing; its default is the drawing's own fill, or black."""
    own = re.search(r"<svg[^>]* fill=\"(#\w+)\"", svg)
    styles = re.findall(r"<text\b([^>]*)>", svg)
    found = [re.search(r"fill[:=]\s*\"?(#\w+)", style) for style in styles]
    return {match[1] if match else (own[1] if own else "#000000") for match in found}


def test_text_of_drawings_stands_out_from_the_plate_behind_them():
    with Drawing() as (drawing, ax):
        ax.plot([0, 1], [0, 1], label="line")
        ax.set(xlabel="x", ylabel="y", title="t")
        ax.legend()
    line = np.arange(3.0)
    drawn = [drawing.panel("a", "b").svg, chart([Curve(line, line, INK)], "x", "y")]
    for svg in drawn:
        colours = text_colours(svg)
        assert colours
        assert all(contrast(colour, PAPER) >= LEAST for colour in colours), colours
