"""Charts of the gap workflow on matplotlib axes: heat map, bars, waterfall, traces.

matplotlib draws these charts, because it lays out ticks, labels and scales.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any, Final

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from firmware_py.display_units import TIME, DisplayUnit
from models.shared.pages import LegendEntry
from models.shared.palette import AFTER, BEFORE, INK, MUTED, PAPER, heat_colours

Array = NDArray[np.float64]
SHOWN_ROWS: Final = 400
"""Most points of a trace: a screen shows no more."""
BEFORE_AND_AFTER: Final = (LegendEntry(BEFORE, "before"), LegendEntry(AFTER, "after"))


def heat_map_height_in(rows: int, *, curve: bool = False) -> float:
    """Height of a heat map in inches."""
    return 0.6 + 0.26 * rows + (0.3 if curve else 0.0)


def draw_heat_map(
    ax: Any,
    rows: Sequence[str],
    columns: Sequence[str],
    cells: Mapping[tuple[str, str], float],
    *,
    most: float,
    faint: Collection[tuple[str, str]] = (),
    curve: Array | None = None,
) -> None:
    """Draw a table of values on a logarithmic colour scale from 1, white, to `most`, dark red.

    `curve` (n,), between -1 and 1, is drawn above the columns over their whole width.
    """
    scale = LogNorm(1.0, max(most, 1.5), clip=True)
    colours, whole = heat_colours(), all(float(v).is_integer() for v in cells.values())
    for (row, column), value in cells.items():
        x, y = columns.index(column), rows.index(row)
        fraction = 0.0 if (row, column) in faint else float(scale(value))
        ax.fill_between([x - 0.47, x + 0.47], y - 0.45, y + 0.45, color=colours(fraction), lw=0)
        ink = MUTED if (row, column) in faint else PAPER if fraction > 0.6 else INK
        text = f"{value:.0f}" if whole or value >= 9.95 else f"{value:.1f}"
        ax.text(x, y, text, color=ink, ha="center", va="center", fontsize=8.5)
    top = -0.5
    if curve is not None:
        top = -1.7
        place = np.linspace(-0.5, len(columns) - 0.5, len(curve))
        ax.plot(place, -1.1 - 0.5 * curve, color=MUTED, lw=1.2)
    ax.set(xlim=(-0.5, len(columns) - 0.5), ylim=(len(rows) - 0.5, top))
    ax.set_yticks(range(len(rows)), rows)
    turned = sum(map(len, columns)) > 44  # letters of 8.5 pt that fit side by side
    ax.set_xticks(
        range(len(columns)), columns,
        **({"rotation": 40, "ha": "right", "rotation_mode": "anchor"} if turned else {}),
    )  # fmt: skip
    ax.tick_params(length=0)
    ax.grid(False)
    ax.spines[:].set_visible(False)


def heat_legend(most: float) -> list[LegendEntry]:
    """Legend of the colours of `draw_heat_map`: noise, the largest value and two in between."""
    colours = heat_colours()
    values = np.geomspace(1.0, max(most, 1.5), 4)
    labels = ["1 (noise)", *(f"{v:.2g}" for v in values[1:-1]), f"{values[-1]:.2g} noise floors"]
    return [
        LegendEntry(_hex(colours(fraction)), label)
        for fraction, label in zip((0.12, 1 / 3, 2 / 3, 1.0), labels, strict=True)
    ]


def draw_bars(
    ax: Any, rows: Sequence[tuple[str, float]], limit: float, said: str, marked: int = 1
) -> None:
    """Draw horizontal bars with their values, the first ones coloured, and a line at a limit."""
    for k, (_, value) in enumerate(rows):
        ax.barh(k, value, height=0.7, color=BEFORE if k < marked else MUTED)
        _bar_label(ax, value, k, f"{value:.1f}")
    _value_axis(ax, [label for label, _ in rows], [value for _, value in rows], limit, said)


def draw_waterfall(ax: Any, steps: Sequence[tuple[str, float]], limit: float, said: str) -> None:
    """Draw what each step leaves (solid) and removes (pale), with a line at a limit.

    The first step is the start, the last one the noise floor.
    """
    before = steps[0][1]
    for k, (_, value) in enumerate(steps):
        colour = BEFORE if k == 0 else MUTED if k == len(steps) - 1 else AFTER
        ax.barh(k, max(before - value, 0.0), left=min(value, before), height=0.7, color=AFTER,
                alpha=0.18)  # fmt: skip
        ax.barh(k, value, height=0.7, color=colour)
        _bar_label(ax, max(value, before), k, f"{value:.2f}")
        before = value
    _value_axis(ax, [label for label, _ in steps], [value for _, value in steps], limit, said)


def _bar_label(ax: Any, end: float, row: int, text: str) -> None:
    ax.annotate(
        text, (end, row), (4, 0), textcoords="offset points", va="center", fontsize=8.5,
    )  # fmt: skip


def _value_axis(
    ax: Any, labels: Sequence[str], values: Sequence[float], limit: float, said: str
) -> None:
    ax.axvline(limit, color=INK, linestyle="--", linewidth=1)
    ax.set_yticks(range(len(labels)), labels)
    ax.set(xlim=(0, 1.12 * max(*values, 1.1 * limit)), ylim=(len(labels) - 0.4, -0.6), xlabel=said)
    ax.tick_params(axis="y", length=0)
    ax.grid(False, axis="y")


def draw_traces(
    ax: Any,
    time_s: Array,
    series: Sequence[Array],
    unit: DisplayUnit,
    quantity: str,
    floor: float | None = None,
) -> None:
    """Draw errors over time, the first before and the second after, on a band of ± `floor`."""
    if floor is not None:
        ax.axhspan(-unit.factor * floor, unit.factor * floor, color=MUTED, alpha=0.2, lw=0)
    every = max(1, len(time_s) // SHOWN_ROWS)
    for values, colour in zip(series, (BEFORE, AFTER), strict=False):
        ax.plot(time_s[::every] - time_s[0], unit.shown(values)[::every], color=colour, lw=1.1)
    most = max((float(np.nanmax(np.abs(unit.shown(v)))) for v in series), default=0.0) or 1.0
    ax.set(ylim=(-1.08 * most, 1.08 * most), xlim=(0, time_s[-1] - time_s[0]))
    ax.set(xlabel=TIME.label("time"), ylabel=unit.label(quantity))
    ax.yaxis.set_major_locator(MaxNLocator(5, symmetric=True))


def _hex(colour: tuple[float, float, float, float]) -> str:
    return "#" + "".join(f"{round(255 * v):02x}" for v in colour[:3])
