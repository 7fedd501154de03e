"""Picture of a plan: path and predicted tip, error over time, goals for every payload.

A probing motion lies before time 0.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib import pyplot
from matplotlib.figure import Figure

from firmware_py.core.units import CURRENT, LENGTH, POSITION, TIME
from firmware_py.goals.tip_plan import TipPlan
from models.shared.drawing import FILE_STYLE, save_svg
from models.shared.palette import INK, MUTED, SERIES

LINES: Final = ("-", "--")
"""Line of each joint."""


def draw_plan(plan: TipPlan, path: Path) -> None:
    """Write the figure of `plot_plan`."""
    save_svg(plot_plan(plan), path)


def plot_plan(plan: TipPlan) -> Figure:
    desired, time_s = plan.desired_tip_m(), plan.period_s * np.arange(plan.rows)
    ramp = mpl.colormaps["viridis"](np.linspace(0.1, 0.85, len(plan.payloads)))
    with mpl.rc_context(FILE_STYLE | {"font.size": 8}):
        figure: Figure = pyplot.figure(figsize=(8.5, 6.5), layout="constrained")
        axes: dict[str, Any] = figure.subplot_mosaic([["path", "error"], ["goals", "current"]])
        _draw_path(axes["path"], plan, ramp)
        for colour, one in zip(ramp, plan.payloads, strict=True):
            away = np.linalg.norm(np.transpose(one.tip_m) - desired, axis=1)
            axes["error"].plot(time_s, away, color=colour, lw=0.8)
            for goal, current, line in zip(one.goals_rad, one.current_a, LINES, strict=False):
                axes["goals"].plot(time_s, goal, line, color=colour, lw=0.8)
                axes["current"].plot(time_s, current, line, color=colour, lw=0.8)
        legend = []
        if plan.probe is not None:
            before_s = plan.period_s * np.arange(-plan.probe.rows, 0)
            for goal, line in zip(plan.probe.goals_rad, LINES, strict=False):
                axes["goals"].plot(before_s, goal, line, color=MUTED, lw=0.8)
            legend = [("probing motion", MUTED, "-")]
        if plan.dof == 2:
            legend += [(f"joint {j + 1}", SERIES[0], LINES[j]) for j in (0, 1)]
        for label, colour, line in legend:
            axes["goals"].plot([], [], line, color=colour, lw=0.8, label=label)
        if legend:
            axes["goals"].legend(fontsize="x-small", frameon=False)
        axes["error"].set(xlabel=TIME.label("time"), ylabel=POSITION.label("predicted tip error"))
        axes["goals"].set(xlabel=TIME.label("time"), ylabel="goal in rad")
        axes["current"].set(xlabel=TIME.label("time"), ylabel=CURRENT.label("current"))
        handles, labels = axes["path"].get_legend_handles_labels()
        figure.legend(
            handles, labels, loc="outside lower center", ncols=len(labels), fontsize="small",
            frameon=False,
        )  # fmt: skip
        most = max(one.residual_rms_m for one in plan.payloads)
        rigid = [one.rigid_rms_m for one in plan.payloads]
        figure.suptitle(
            f"{plan.path}, {plan.method}: predicted error {LENGTH.number(most, 2)} mm RMS at most; "
            f"rigid kinematics {LENGTH.number(min(rigid))} to {LENGTH.number(max(rigid))} mm"
        )
        pyplot.close(figure)
    return figure


def _draw_path(ax: Any, plan: TipPlan, colours: Any) -> None:
    """Path and predicted tips: in the plane, without the ways; or one coordinate over time."""
    curves = [(INK, 1.6, "desired", plan.desired_m)]
    for colour, one in zip(colours, plan.payloads, strict=True):
        curves.append((colour, 0.8, f"{one.payload_kg:g} kg", one.tip_m))
    if plan.dof == 1:
        time_s = plan.period_s * np.arange(plan.rows)
        for colour, width, label, (x,) in curves:
            ax.plot(time_s, x, color=colour, lw=width, label=label)
        ax.set(xlabel=TIME.label("time"), ylabel=POSITION.label("tip x"))
        return
    ax.plot(*plan.desired_m, color=MUTED, lw=0.7, ls=":", label="way")
    for colour, width, label, (x, y) in curves:
        for start, end in plan.drawn:
            name = label if start == plan.drawn[0][0] else None
            ax.plot(x[start:end], y[start:end], color=colour, lw=width, label=name)
    ax.set(xlabel=POSITION.label("tip x"), ylabel=POSITION.label("tip y"), aspect="equal")
    # A line along an axis gets some height and width.
    least = 0.3 * float(np.max(np.ptp(plan.desired_m, axis=1)))
    for values, set_limits in zip(plan.desired_m, (ax.set_xlim, ax.set_ylim), strict=True):
        if np.ptp(values) < least:
            middle = 0.5 * (min(values) + max(values))
            set_limits(middle - 0.5 * least, middle + 0.5 * least)
