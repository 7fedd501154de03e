"""Colours of every page, chart and picture.

The series colours are distinct for people with red-green colour blindness too
(`tests/models/shared/test_palette.py` simulates it). Ordered quantities have ramps of steadily
falling lightness.
"""

from __future__ import annotations

from typing import Final

INK: Final = "#1f2933"
"""Text, axes, and measured signals."""
PAPER: Final = "#ffffff"
MUTED: Final = "#8a94a0"
"""Frames of charts, noise floors and other background."""
GRID: Final = "#e4e8ec"
SPAN: Final = "#d5dbe1"
"""Shaded spans of time."""

BLUE: Final = "#1d6a96"
ORANGE: Final = "#b4532a"
PURPLE: Final = "#4a1f6e"
GREEN: Final = "#2e9e6b"
AMBER: Final = "#c77700"
"""For use with blue and grey only: it is too close to orange for the others."""
SERIES: Final = (BLUE, ORANGE, PURPLE, GREEN)
"""Colours of series without an order, in this sequence."""

ALARM: Final = "#9c1c16"
"""Limits and what exceeds them: dashed lines and marks only, because it is close to orange."""
BEFORE: Final = ORANGE
AFTER: Final = BLUE
MEASURED: Final = INK
SIMULATED: Final = ORANGE

PAGE_COLOURS: Final = {
    "ink": INK, "paper": PAPER, "quiet": "#5b6673",
    "line": "#dfe4e9", "strong-line": "#b9c2cb", "shade": "#f5f7f9",
    "link": "#1d5f8a", "met": "#1f6f43", "unmet": "#a3231b",
    "simulated": "#8f4a12", "measured": "#1d5f8a", "mixed": "#6a3d9a", "unknown": "#5b6673",
    "large": "#e34a33",
}  # fmt: skip
"""Variables of `style.css`; text keeps a contrast of at least 4.5 on paper and shade."""
DARK_PAGE_COLOURS: Final = {
    "ink": "#e6eaee", "paper": "#14181d", "quiet": "#a9b3bd",
    "line": "#2f3841", "strong-line": "#5a6570", "shade": "#1f262d",
    "link": "#86bfe6", "met": "#6cc795", "unmet": "#f29186",
    "simulated": "#eaa872", "measured": "#86bfe6", "mixed": "#c7abea", "unknown": "#a9b3bd",
    "large": "#e34a33",
}  # fmt: skip
"""The same for readers who prefer dark pages; figures keep the light colours."""


def css_variables() -> str:
    """The page colours as CSS variables: light, and dark for readers who prefer it on screen."""

    def declared(selector: str, colours: dict[str, str]) -> str:
        rows = "".join(f"  --{name}: {colour};\n" for name, colour in colours.items())
        return f"{selector} {{\n{rows}}}\n"

    light = declared(":root", PAGE_COLOURS)
    # A figure keeps the light colours, because they are built into its drawing.
    dark = declared(":root", DARK_PAGE_COLOURS) + declared(".figure", PAGE_COLOURS)
    return f"{light}@media screen and (prefers-color-scheme: dark) {{\n{dark}}}\n"


def ordered_colours(count: int) -> list[str]:
    """Colours of an ordered quantity, amber to navy, all dark enough on paper."""
    import matplotlib
    from matplotlib.colors import to_hex

    ramp = matplotlib.colormaps["plasma_r"]
    fractions = [0.22 + 0.74 * k / max(count - 1, 1) for k in range(count)]
    return [str(to_hex(ramp(fraction))) for fraction in fractions]
