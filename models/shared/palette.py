"""Colours of every page, chart and picture.

The series colours can be told apart by people with red-green colour blindness as well
(`tests/models/shared/test_palette.py` simulates it); ordered quantities have ramps whose lightness
falls all the way.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from matplotlib.colors import Colormap

INK: Final = "#1f2933"
"""Text, axes, and what was measured."""
PAPER: Final = "#ffffff"
MUTED: Final = "#8a94a0"
"""Frames of charts, noise floors, what stands in the background."""
GRID: Final = "#e4e8ec"
SPAN: Final = "#d5dbe1"
"""Shaded spans of time."""

BLUE: Final = "#1d6a96"
ORANGE: Final = "#b4532a"
PURPLE: Final = "#4a1f6e"
GREEN: Final = "#2e9e6b"
AMBER: Final = "#c77700"
"""Beside blue and what is grey only: too near orange for the others."""
SERIES: Final = (BLUE, ORANGE, PURPLE, GREEN)
"""Of what has no order, in this sequence."""

ALARM: Final = "#9c1c16"
"""Limits and what exceeds them: dashed lines and marks, because it is near orange."""
BEFORE: Final = ORANGE
AFTER: Final = BLUE
MEASURED: Final = INK
SIMULATED: Final = ORANGE

PAGE_COLOURS: Final = {
    "ink": INK,
    "paper": PAPER,
    "quiet": "#5b6673",
    "line": "#dfe4e9",
    "strong-line": "#b9c2cb",
    "shade": "#f5f7f9",
    "link": "#1d5f8a",
    "met": "#1f6f43",
    "unmet": "#a3231b",
    "simulated": "#8f4a12",
    "measured": "#1d5f8a",
    "mixed": "#6a3d9a",
    "unknown": "#5b6673",
}
"""Variables of `style.css`; text keeps a contrast of at least 4.5 on paper and shade."""

DARK_PAGE_COLOURS: Final = {
    "ink": "#e6eaee",
    "paper": "#14181d",
    "quiet": "#a9b3bd",
    "line": "#2f3841",
    "strong-line": "#5a6570",
    "shade": "#1f262d",
    "link": "#86bfe6",
    "met": "#6cc795",
    "unmet": "#f29186",
    "simulated": "#eaa872",
    "measured": "#86bfe6",
    "mixed": "#c7abea",
    "unknown": "#a9b3bd",
}
"""The same where a reader prefers dark pages; figures keep the light ones."""

HEAT: Final = ("#fff7ec", "#fdcc8a", "#e34a33", "#7f0000")
"""White to dark red by way of orange (ColorBrewer, OrRd)."""


def css_variables() -> str:
    """The page colours as CSS variables: light, and dark on the screens of those who prefer it.

    A figure keeps the light colours: its drawing has them built in.
    """
    light = _declared(":root", PAGE_COLOURS)
    dark = _declared(":root", DARK_PAGE_COLOURS) + _declared(".figure", PAGE_COLOURS)
    return f"{light}@media screen and (prefers-color-scheme: dark) {{\n{dark}}}\n"


def _declared(selector: str, colours: dict[str, str]) -> str:
    rows = "".join(f"  --{name}: {colour};\n" for name, colour in colours.items())
    return f"{selector} {{\n{rows}}}\n"


def ordered_colours(count: int) -> list[str]:
    """Colours of an ordered quantity, amber to navy, all dark enough on paper."""
    import matplotlib
    from matplotlib.colors import to_hex

    ramp = matplotlib.colormaps["plasma_r"]
    fractions = [0.22 + 0.74 * k / max(count - 1, 1) for k in range(count)]
    return [str(to_hex(ramp(fraction))) for fraction in fractions]


def heat_colours() -> Colormap:
    """The heat ramp as a colour map over 0 to 1."""
    from matplotlib.colors import LinearSegmentedColormap

    return LinearSegmentedColormap.from_list("heat", HEAT)
