"""Drawings from matplotlib as SVG: one style, text as text, no external resources."""

from __future__ import annotations

import hashlib
import io
import math
import re
from collections.abc import Iterable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

import matplotlib
import numpy as np
from matplotlib import pyplot as plt
from matplotlib.figure import Figure
from matplotlib.rcsetup import cycler
from matplotlib.ticker import LogLocator, NullLocator
from numpy.typing import ArrayLike

from models.shared.pages import Panel
from models.shared.palette import GRID, INK, MUTED, PAPER, SERIES

if matplotlib.get_backend(auto_select=False) is None:
    matplotlib.use("svg")  # otherwise pyplot would look for a screen; a notebook has its own


SIZE_IN: Final = (4.3, 2.9)
"""Size of a drawing: its 9 pt text is about 10 px high on a phone, about 15 px in two columns."""
STYLE: Final = {
    "svg.fonttype": "none", "svg.hashsalt": "dropstitch", "font.size": 9,
    "axes.prop_cycle": cycler(color=SERIES),
    "axes.edgecolor": MUTED, "axes.labelcolor": INK, "text.color": INK, "xtick.color": INK,
    "ytick.color": INK, "xtick.labelsize": 8.5, "ytick.labelsize": 8.5, "axes.linewidth": 0.7,
    "xtick.major.width": 0.7, "ytick.major.width": 0.7, "axes.spines.top": False,
    "axes.spines.right": False, "axes.grid": True, "grid.color": GRID, "grid.linewidth": 0.7,
    "axes.axisbelow": True, "lines.linewidth": 1.4, "lines.solid_capstyle": "round",
    "figure.facecolor": "none", "axes.facecolor": "none", "path.simplify_threshold": 0.3,
}  # fmt: skip
"""matplotlib's settings for drawings inside a page."""
FILE_STYLE: Final = STYLE | {"figure.facecolor": PAPER, "savefig.facecolor": PAPER}
"""The same for pictures in separate files."""


def save_svg(figure: Figure, path: Path) -> None:
    """Save a picture in a file of its own; equal pictures give equal bytes."""
    with plt.rc_context(FILE_STYLE):
        figure.savefig(path, format="svg", metadata={"Date": None})


class Drawing:
    """Axes in the style of the pages, `height_in` high, rendered at the end of the block.

    ::

        with Drawing() as (drawing, ax):
            ax.plot(…)
        panels.append(drawing.panel("1DOF", "what it shows"))
    """

    def __init__(self, height_in: float = SIZE_IN[1]) -> None:
        self._size_in, self._svg, self._stack = (SIZE_IN[0], height_in), "", ExitStack()

    def __enter__(self) -> tuple[Drawing, Any]:
        self._stack.enter_context(plt.rc_context(STYLE))
        figure, ax = plt.subplots(figsize=self._size_in, layout="constrained")
        self._stack.callback(plt.close, figure)
        self._figure = figure
        return self, ax

    def __exit__(self, kind: object, *rest: object) -> None:
        with self._stack:
            if kind is None:
                self._svg = _to_svg(self._figure)

    def panel(self, title: str, alt: str) -> Panel:
        return Panel(title, alt, _with_unique_ids(self._svg, title + alt))


class Line(NamedTuple):
    """Line of a chart, in display units; `dash` is "solid", "dashed" or "dotted"."""

    x: ArrayLike
    y: ArrayLike
    colour: str
    dash: str = "solid"
    width: float = 1.4
    marker: str = ""


class Chart(NamedTuple):
    """Lines of a panel; `alt` says what they show."""

    title: str
    alt: str
    lines: Sequence[Line]


def plot_lines(ax: Any, lines: Iterable[Line]) -> None:
    for x, y, colour, dash, width, marker in lines:
        ax.plot(x, y, color=colour, linestyle=dash, linewidth=width, marker=marker, markersize=3.5)


def line_panels(
    charts: Sequence[Chart], xlabel: str, ylabel: str, log: bool = False, **axes: Any
) -> list[Panel]:
    """Draw each chart; a logarithmic y axis is the same in all. `axes`: for `Axes.set`."""
    values = np.concatenate([np.ravel(line.y) for chart in charts for line in chart.lines])
    panels = []
    for title, alt, lines in charts:
        with Drawing() as (drawing, ax):
            plot_lines(ax, lines)
            if log:
                log_axis(ax, values)
            ax.set(xlabel=xlabel, ylabel=ylabel, **axes)
        panels.append(drawing.panel(title, alt))
    return panels


def log_axis(ax: Any, values: Iterable[float], which: Literal["x", "y"] = "y") -> None:
    """Logarithmic axis around the positive `values`, labelled at 1, 2 and 5 in plain figures.

    With the values of every panel of a figure, its panels share one scale.
    """
    positive = [v for v in values if v > 0]
    ax.set(**{f"{which}scale": "log", f"{which}lim": (0.8 * min(positive), 1.25 * max(positive))})
    axis = ax.xaxis if which == "x" else ax.yaxis
    decades = math.log10(max(positive) / min(positive))
    axis.set_major_locator(LogLocator(subs=(1, 2, 5) if decades < 2.5 else (1,)))
    axis.set_major_formatter(lambda value, _: f"{value:g}")
    axis.set_minor_locator(NullLocator())


def _to_svg(figure: Any) -> str:
    """Inline SVG that scales with its box and uses the page's font."""
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>|<style.*?</style>", "", text, flags=re.DOTALL)
    text = re.sub(r"font-family: [^;\"]*;? ?", "", text)
    text = re.sub(r"<[^>]*>", _rounded, text)  # tags alone: the text has the labels of the axes
    text = re.sub(r"\n\s*", "\n", text)
    head, end, body = text.partition(">")
    head = re.sub(r' (width|height|version|xmlns(:xlink)?)="[^"]*"', "", head)
    return head + end + body.replace("xlink:href", "href")


def _rounded(tag: re.Match[str]) -> str:
    """Tag with its coordinates in hundredths of a point."""
    return re.sub(r"(\d+\.\d\d)\d+", r"\1", tag[0])


def _with_unique_ids(svg: str, about: str) -> str:
    """Make the ids of a drawing unique in the page.

    Definitions (markers, clips) are named by their content, which another figure may share, so each
    drawing gets a prefix. Unreferenced ids are removed.
    """
    prefix = hashlib.sha256((about + svg).encode()).hexdigest()[:6]
    used = set(re.findall(r'[("]#([\w.-]+)', svg))
    svg = re.sub(r' id="([^"]+)"', lambda m: f' id="{prefix}{m[1]}"' if m[1] in used else "", svg)
    return re.sub(r'([("]#)', rf"\g<1>{prefix}", svg)
