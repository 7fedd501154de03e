"""Picture of a plan: path and predicted tip, error over time, goals for every payload."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from firmware_py.display_units import ANGLE, CURRENT, LENGTH, POSITION, TIME
from firmware_py.goals.tip_plan import TipPlan
from models.shared.palette import INK, MUTED, SERIES
from models.shared.svg_drawing import FILE_STYLE


def draw_plan(plan: TipPlan, path: Path) -> None:
    """Draw a plan as SVG.

    Parameters
    ----------
    plan : TipPlan
        The plan.
    path : Path
        File to write.
    """
    desired, time_s = plan.desired_tip_m(), plan.period_s * np.arange(plan.rows)
    ramp = mpl.colormaps["viridis"](np.linspace(0.1, 0.85, len(plan.payloads)))
    with mpl.rc_context(FILE_STYLE | {"font.size": 8}):
        figure = Figure(figsize=(8.5, 6.5), layout="constrained")
        axes: dict[str, Any] = figure.subplot_mosaic([["path", "error"], ["goals", "current"]])
        if plan.dof == 2:
            axes["path"].plot(*desired.T, color=MUTED, lw=0.7, ls=":", label="way")
            for k, (start, end) in enumerate(plan.drawn):
                label = "desired" if k == 0 else None
                axes["path"].plot(*desired[start:end].T, color=INK, lw=1.6, label=label)
            axes["path"].set(xlabel=POSITION.label("tip x"), ylabel=POSITION.label("tip y"))
            axes["path"].set_aspect("equal")
        else:
            axes["path"].plot(time_s, desired[:, 0], color=INK, lw=1.6, label="desired")
            axes["path"].set(xlabel=TIME.label("time"), ylabel=POSITION.label("tip x"))
        for colour, own in zip(ramp, plan.payloads, strict=True):
            tip, label = np.transpose(own.tip_m), f"{own.payload_kg:g} kg"
            away = LENGTH.shown(np.linalg.norm(tip - desired, axis=1))
            lines = tip.T if plan.dof == 2 else (time_s, tip[:, 0])
            axes["path"].plot(*lines, color=colour, lw=0.8, label=label)
            axes["error"].plot(time_s, away, color=colour, lw=0.8, label=label)
            for j in range(plan.dof):
                style = ("-", "--")[j]
                goal, current = own.goals_rad[j], own.current_a[j]
                axes["goals"].plot(time_s, ANGLE.shown(goal), style, color=colour, lw=0.8)
                axes["current"].plot(time_s, current, style, color=colour, lw=0.8)
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
