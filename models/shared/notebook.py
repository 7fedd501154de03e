"""Figures and tables with which results show themselves in a notebook.

Results import this module when they are asked for a figure or a table, because matplotlib loads
slowly.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from firmware_py.core.signals import unit_of, without_unit

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]


def html_table(caption: str, head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Table for `_repr_html_`; the first cell of each row names it."""

    def line(cells: Iterable[object], tag: str) -> str:
        return "<tr>" + "".join(f"<{tag}>{escape(str(cell))}</{tag}>" for cell in cells) + "</tr>"

    body = "".join(line(row, "td") for row in rows)
    return (
        f"<table><caption>{escape(caption)}</caption>"
        f"<thead>{line(head, 'th')}</thead><tbody>{body}</tbody></table>"
    )


def plot_by_unit(title: str, time_s: Array, columns: Mapping[str, Array]) -> Figure:
    """Columns over time in SI units, one panel for each unit."""
    panels: dict[str, dict[str, Array]] = {}
    for name, values in columns.items():
        panels.setdefault(unit_of(name) or "", {})[name] = values
    labels = {unit: _quantities(shown) for unit, shown in panels.items()}
    return plot_panels(
        title, time_s, {_axis_label(labels[unit], unit): shown for unit, shown in panels.items()}
    )


def plot_against(
    title: str, time_s: Array, measured: Mapping[str, Array], simulated: Mapping[str, Array]
) -> Figure:
    """Measured and simulated signals over time in SI units, one panel for each signal."""
    panels = {
        _axis_label(without_unit(name), unit_of(name) or ""): {
            "measured": measured[name],
            "simulated": simulated[name],
        }
        for name in simulated
    }
    return plot_panels(title, time_s, panels)


def plot_panels(title: str, time_s: Array, panels: Mapping[str, Mapping[str, Array]]) -> Figure:
    """Panels below each other over one axis of time, by the label of their y axis."""
    from matplotlib import pyplot

    from models.shared.drawing import FILE_STYLE

    with pyplot.rc_context(FILE_STYLE):
        # A figure of pyplot is what a notebook shows as a picture.
        figure: Figure = pyplot.figure(figsize=(7.0, 0.6 + 1.6 * len(panels)), layout="constrained")
        axes = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
        for ax, (label, lines) in zip(axes, panels.items(), strict=True):
            for name, values in lines.items():
                ax.plot(time_s, values, lw=1.0, label=name)
            ax.set_ylabel(label)
            ax.legend(fontsize="small", loc="center left", bbox_to_anchor=(1.0, 0.5))
        axes[0].set_title(title)
        axes[-1].set_xlabel("time, s")
        pyplot.close(figure)
    return figure


def _quantities(names: Iterable[str]) -> str:
    """Quantities of columns that share a unit: "goal, angle" for goal_1_rad and angle_1_rad."""
    return ", ".join(dict.fromkeys(name.split("_")[0] for name in names))


def _axis_label(quantity: str, unit: str) -> str:
    return f"{quantity}, {unit}" if unit else quantity
