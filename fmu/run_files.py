"""Result files of a simulated FMU: table and plot."""

from __future__ import annotations

import csv
from pathlib import Path

import matplotlib.pyplot as plt

from firmware_py.core import units as display_units
from firmware_py.core.signals import TIME
from fmu.fmpy_run import FmuRun
from models.shared.drawing import FILE_STYLE
from models.shared.palette import SERIES


def write_fmu_run(result: FmuRun, path: Path) -> None:
    """Write time, inputs and outputs as CSV in SI units, one row per step."""
    columns = [result.time_s, *result.columns.values()]
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([TIME.name, *result.columns])
        writer.writerows([repr(float(v)) for v in row] for row in zip(*columns, strict=True))


def draw_run(result: FmuRun, path: Path) -> None:
    """Plot a run as SVG, one panel per quantity; trial dashed, predictions dotted."""
    panels: dict[tuple[str, str], list[str]] = {}
    for name in result.columns:
        panels.setdefault((_quantity(name), result.units[name]), []).append(name)
    with plt.rc_context(FILE_STYLE):
        figure, axes = plt.subplots(
            len(panels), 1, figsize=(8.0, 2.2 * len(panels)), sharex=True, squeeze=False,
            layout="constrained",
        )  # fmt: skip
        for axis, ((quantity, unit), columns) in zip(axes[:, 0], panels.items(), strict=True):
            shown = display_units.DEFORMATION if "di" in columns else display_units.value_unit(unit)
            variables = list(dict.fromkeys(name.removeprefix("predicted_") for name in columns))
            for name in columns:
                predicted = name not in variables
                place = variables.index(name.removeprefix("predicted_"))
                colour, style = SERIES[place % len(SERIES)], ":" if predicted else "-"
                axis.plot(
                    result.time_s, shown.shown(result.columns[name]), style, lw=1.0,
                    color=colour, label=name,
                )  # fmt: skip
                if name in result.measured and not predicted:  # tip and predicted tip share it
                    axis.plot(
                        result.time_s, shown.shown(result.measured[name]), "--", lw=1.0,
                        color=colour, alpha=0.5, label=f"{name}, trial",
                    )  # fmt: skip
            axis.set_ylabel(shown.label(quantity))
            axis.legend(fontsize="small", loc="center left", bbox_to_anchor=(1.0, 0.5))
        axes[0, 0].set_title(result.title)
        axes[-1, 0].set_xlabel(display_units.TIME.label("time"))
        figure.savefig(path, format="svg", metadata={"Date": None})
        plt.close(figure)


def _quantity(name: str) -> str:
    """Quantity of a variable; for "tip_x_m" and "predicted_tip_x_m" it is the tip."""
    if name == "di":
        return "DI"
    for quantity in ("half_width", "tip", "angle", "goal", "current", "payload", "in_range"):
        if quantity in name:
            return {"goal": "angle", "half_width": "half width"}.get(quantity, quantity)
    return name
