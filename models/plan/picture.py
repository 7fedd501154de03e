"""Picture of a plan: path and predicted tip, error over time, goals for every payload.

A probing motion lies before time 0.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from firmware_py.display_units import ANGLE, CURRENT, LENGTH, POSITION, TIME
from firmware_py.goals.tip_plan import TipPlan
from models.shared.drawing import FILE_STYLE
from models.shared.palette import INK, MUTED, SERIES

FLATTEST: Final = 0.3
"""Least height of the picture of a path over its width: a line along an axis would have none."""


def draw_plan(plan: TipPlan, path: Path) -> None:
    """Draw a plan as SVG."""
    desired, time_s = plan.desired_tip_m(), plan.period_s * np.arange(plan.rows)
    ramp = mpl.colormaps["viridis"](np.linspace(0.1, 0.85, len(plan.payloads)))
    with mpl.rc_context(FILE_STYLE | {"font.size": 8}):
        figure = Figure(figsize=(8.5, 6.5), layout="constrained")
        axes: dict[str, Any] = figure.subplot_mosaic([["path", "error"], ["goals", "current"]])
        _draw_path(axes["path"], plan, ramp)
        for colour, own in zip(ramp, plan.payloads, strict=True):
            tip, label = np.transpose(own.tip_m), f"{own.payload_kg:g} kg"
            away = LENGTH.shown(np.linalg.norm(tip - desired, axis=1))
            axes["error"].plot(time_s, away, color=colour, lw=0.8, label=label)
            for j in range(plan.dof):
                style = ("-", "--")[j]
                goal, current = own.goals_rad[j], own.current_a[j]
                axes["goals"].plot(time_s, ANGLE.shown(goal), style, color=colour, lw=0.8)
                axes["current"].plot(time_s, current, style, color=colour, lw=0.8)
        if plan.probe is not None:
            before_s = plan.period_s * np.arange(-plan.probe.rows, 0)
            for column, style in zip(plan.probe.goals_rad, ("-", "--"), strict=False):
                axes["goals"].plot(before_s, ANGLE.shown(column), style, color=MUTED, lw=0.8)
            axes["goals"].plot([], [], color=MUTED, lw=0.8, label="probing motion")
            axes["goals"].legend(fontsize="x-small", frameon=False)
        axes["error"].set(xlabel=TIME.label("time"), ylabel=LENGTH.label("predicted tip error"))
        axes["goals"].set(xlabel=TIME.label("time"), ylabel=ANGLE.label("goal"))
        axes["current"].set(xlabel=TIME.label("time"), ylabel=CURRENT.label("current"))
        handles, labels = axes["path"].get_legend_handles_labels()
        figure.legend(
            handles, labels, loc="outside lower center", ncols=len(labels), fontsize="small",
            frameon=False,
        )  # fmt: skip
        most = max(own.residual_rms_m for own in plan.payloads)
        rigid = [own.rigid_rms_m for own in plan.payloads]
        figure.suptitle(
            f"{plan.path}, {plan.method}: predicted error {LENGTH.number(most, 2)} mm RMS at most; "
            f"rigid kinematics {LENGTH.number(min(rigid))} to {LENGTH.number(max(rigid))} mm"
        )
        for joint in range(plan.dof if plan.dof > 1 else 0):
            name = f"joint {joint + 1}"
            axes["goals"].plot([], [], ("-", "--")[joint], color=SERIES[0], label=name)
            axes["goals"].legend(fontsize="x-small", frameon=False)
        figure.savefig(path, metadata={"Date": None})


def _draw_path(ax: Any, plan: TipPlan, colours: Any) -> None:
    """Draw path and predicted tips: for two joints in the plane, without the tips' way there and
    back.
    """
    desired, time_s = plan.desired_tip_m(), plan.period_s * np.arange(plan.rows)
    both = plan.dof == 2
    drawn = plan.drawn if both else ((0, plan.rows),)
    if both:
        ax.plot(*desired.T, color=MUTED, lw=0.7, ls=":", label="way")
    own = [
        (c, p.tip_m, f"{p.payload_kg:g} kg") for c, p in zip(colours, plan.payloads, strict=True)
    ]
    for colour, columns, label in [(INK, plan.desired_m, "desired"), *own]:
        tip, width = np.transpose(columns), 1.6 if label == "desired" else 0.8
        for start, end in drawn:
            line = tip[start:end].T if both else (time_s, tip[:, 0])
            ax.plot(*line, color=colour, lw=width, label=label if start == drawn[0][0] else None)
    if both:
        ax.set(xlabel=POSITION.label("tip x"), ylabel=POSITION.label("tip y"), aspect="equal")
        least = FLATTEST * float(np.max(np.ptp(desired, axis=0)))
        for values, put in zip(desired.T, (ax.set_xlim, ax.set_ylim), strict=True):
            if np.ptp(values) < least:
                middle = 0.5 * float(values.min() + values.max())
                put(middle - 0.5 * least, middle + 0.5 * least)
    else:
        ax.set(xlabel=TIME.label("time"), ylabel=POSITION.label("tip x"))
