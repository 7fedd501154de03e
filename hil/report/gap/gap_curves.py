"""Residuals of the FMUs and of the robot before and after a gap was closed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from firmware_py.core.signals import tip_names
from firmware_py.core.units import error_unit, signal_words
from hil.report.build_inputs import LoopRun
from hil.report.gap.before_after import PART
from hil.report.gap.gap_inputs import GapInputs
from models.gap.report.gap_charts import BEFORE_AND_AFTER, draw_errors
from models.plant.identification.evaluation import TIP
from models.plant.identification.fit import measured_signals
from models.shared.drawing import Drawing
from models.shared.pages import LegendEntry, Panel
from models.shared.palette import MUTED

Array = NDArray[np.float64]
FMU_SIGNALS: Final = ("tip_x_m", "tip_z_m", "di", "current_1_a")
CURVE_LEGEND: Final = (*BEFORE_AND_AFTER, LegendEntry(MUTED, "RMS without the effect"))


def fmu_curves(inputs: GapInputs, payload_kg: float) -> list[Panel]:
    """Draw the residuals of the FMUs in FMPy, measured minus simulated, on a sealed trial."""
    trial = next(t for t in inputs.sealed if t.meta.payload_kg == payload_kg)
    measured = measured_signals(trial)
    rows = [inputs.outputs[variant][payload_kg] for variant in ("before", "after")]
    units = inputs.fmus["before"][payload_kg].units
    least = inputs.fmus.get("without", {}).get(payload_kg)
    return [
        _error_panel(
            signal_words(signal), trial.time_s, [measured[signal] - row[signal] for row in rows],
            units[signal], least.rms[signal] if least else None,
        )
        for signal in FMU_SIGNALS if signal in measured and signal in units
    ]  # fmt: skip


def robot_curves(inputs: GapInputs, payload_kg: float) -> list[Panel]:
    """Draw predicted minus true tip in the plane of the joints, over the first motion of a run."""
    runs = {v: _first_motion(loops[payload_kg]) for v, loops in inputs.loops.items()
            if payload_kg in loops}  # fmt: skip
    before, after, least = (runs.get(v) for v in ("before", "after", "without"))
    if before is None or after is None:
        return []
    shared = min(len(before[0]), len(after[0]))
    panels = []
    for axis in (a for a in TIP if a != "tip_y_m" or inputs.trials[0].meta.dof == 2):
        k = TIP.index(axis)
        floor = None if least is None else float(np.sqrt(np.nanmean(least[1][:, k] ** 2)))
        series = [errors[1][:shared, k] for errors in (before, after)]
        words = f"predicted {signal_words(axis)}"
        panels.append(_error_panel(words, before[0][:shared], series, "m", floor))
    return panels


def _error_panel(
    signal: str, time_s: Array, series: Sequence[Array], unit: str, floor: float | None
) -> Panel:
    """Error of a signal over time, before and after; shapes (n,)."""
    shown = error_unit(unit)
    with Drawing(2.1) as (drawing, ax):
        draw_errors(ax, time_s, series, shown, floor)
    before, after = (shown.significant(np.sqrt(np.nanmean(values**2))) for values in series)
    return drawing.panel(
        f"{signal}: {before} → {after} RMS",
        f"Error of {signal} over {time_s[-1] - time_s[0]:.1f} s: {before} RMS before, {after} RMS "
        "after.",
    )


def _first_motion(loop: LoopRun) -> tuple[Array, Array] | None:
    """Time, and predicted minus true tip (n, 3), in the first motion; None without a record."""
    programme = loop.timing.run.programme_s
    if loop.ticks is None or loop.true_tip_m is None or not programme:
        return None
    time_s = loop.ticks["time_s"] - loop.ticks["time_s"][0]
    rows = (time_s >= programme["rest"]) & (time_s < programme["rest"] + programme[PART])
    predicted_m = np.column_stack([loop.ticks[name] for name in tip_names("predicted_")])
    return time_s[rows] - programme["rest"], (predicted_m - loop.true_tip_m)[rows]
