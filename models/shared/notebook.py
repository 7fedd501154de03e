"""Figures and tables with which results show themselves in a notebook.

Results import this module when they are asked for a figure or a table, because matplotlib loads
slowly.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from firmware_py.core.signals import unit_of, without_unit
from models.shared.palette import MUTED, SIMULATED

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
    by_unit: dict[str, dict[str, Array]] = {}
    for name, values in columns.items():
        by_unit.setdefault(unit_of(name) or "", {})[name] = values
    panels = {_axis_label(_quantities(shown), unit): shown for unit, shown in by_unit.items()}
    return _plot_panels([(title, time_s, panels)])


def plot_against(
    runs: Iterable[tuple[str, Array, Mapping[str, Array], Mapping[str, Array]]], title: str = ""
) -> Figure:
    """Measured and simulated signals in SI units, a column for each run and a row for each signal.

    `runs`: title, time, measured and simulated signals of each.
    """
    columns = []
    for head, time_s, measured, simulated in runs:
        panels = {
            _axis_label(without_unit(name), unit_of(name) or ""): {
                "measured": measured[name],
                "simulated": simulated[name],
            }
            for name in simulated
        }
        columns.append((head, time_s, panels))
    return _plot_panels(columns, title)


_LOOKS: Final = {
    "measured": {"color": MUTED, "lw": 2.0}, "simulated": {"color": SIMULATED, "lw": 0.8},
}  # fmt: skip
"""Where a plant fits, its thin line lies on the wide one of the measurement."""


def _plot_panels(
    columns: Sequence[tuple[str, Array, Mapping[str, Mapping[str, Array]]]], title: str = ""
) -> Figure:
    """Columns of panels over time; each has a title, its time, and panels by their y label."""
    from matplotlib import pyplot

    from models.shared.drawing import FILE_STYLE

    labels = list(dict.fromkeys(label for _, _, panels in columns for label in panels))
    size = 3.5 * max(2, len(columns)), 0.6 + 1.6 * len(labels)
    with pyplot.rc_context(FILE_STYLE):
        # A figure of pyplot is what a notebook shows as a picture.
        figure: Figure = pyplot.figure(figsize=size, layout="constrained")
        axes = figure.subplots(len(labels), len(columns), sharex="col", squeeze=False)
        for column, (head, time_s, panels) in zip(axes.T, columns, strict=True):
            column[0].set_title(head)
            column[-1].set_xlabel("time, s")
            for ax, label in zip(column, labels, strict=True):
                ax.set_visible(label in panels)
                for name, values in panels.get(label, {}).items():
                    ax.plot(time_s, values, label=name, **({"lw": 1.0} | _LOOKS.get(name, {})))
                ax.set_ylabel(label)
        for ax in axes[:, -1]:
            if ax.get_visible():
                ax.legend(fontsize="small", loc="center left", bbox_to_anchor=(1.0, 0.5))
        figure.suptitle(title)
        pyplot.close(figure)
    return figure


def _quantities(names: Iterable[str]) -> str:
    """Quantities of columns that share a unit: "goal, angle" for goal_1_rad and angle_1_rad."""
    return ", ".join(dict.fromkeys(name.split("_")[0] for name in names))


def _axis_label(quantity: str, unit: str) -> str:
    return f"{quantity}, {unit}" if unit else quantity
