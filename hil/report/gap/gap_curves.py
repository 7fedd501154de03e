"""Residuals over time before and after a gap was closed: of the units, and of the robot."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from firmware_py.display_units import error_unit
from firmware_py.signals import tip_names
from hil.report.build_inputs import LoopRun
from hil.report.gap.gap_figures import PART
from hil.report.gap.gap_inputs import GapInputs
from models.gap.report.gap_page import short_signal
from models.plant.identification.evaluation import TIP
from models.plant.identification.simulation_fit import measured_signals
from models.shared import svg_charts
from models.shared.palette import AFTER, BEFORE, MUTED

Array = NDArray[np.float64]
Titled = tuple[str, str]
"""A title and its drawing."""
UNIT_SIGNALS = ("tip_x_m", "tip_z_m", "di", "current_1_a")


def key() -> str:
    """What the colours of all these curves stand for."""
    return svg_charts.legend(
        [
            (BEFORE, "before"),
            (AFTER, "after"),
            (MUTED, "RMS, effect-free"),
        ]
    )


def unit_curves(inputs: GapInputs, payload_kg: float) -> list[Titled]:
    """Measured minus simulated in FMPy, on a sealed trial."""
    trial = next(t for t in inputs.sealed if t.meta.payload_kg == payload_kg)
    measured = measured_signals(trial)
    rows = {v: inputs.outputs[v][payload_kg] for v in ("before", "after")}
    units = inputs.units["before"][payload_kg]["units"]
    least = inputs.units.get("without", {}).get(payload_kg)
    return [
        _panel(
            short_signal(signal), trial.time_s,
            {v: measured[signal] - rows[v][signal] for v in rows},
            units[signal], least["rms"][signal] if least else None,
        )
        for signal in UNIT_SIGNALS if signal in measured and signal in units
    ]  # fmt: skip


def robot_curves(inputs: GapInputs, payload_kg: float) -> list[Titled]:
    """Predicted minus true tip in the plane of the joints, over the first motion of a run."""
    runs = {v: _first_motion(loops[payload_kg]) for v, loops in inputs.loops.items()
            if payload_kg in loops}  # fmt: skip
    before, after, least = (runs.get(v) for v in ("before", "after", "without"))
    if before is None or after is None:
        return []
    shared = min(len(before[0]), len(after[0]))
    axes = [a for a in TIP if a != "tip_y_m" or inputs.trials[0].meta.dof == 2]
    panels = []
    for axis in axes:
        k = TIP.index(axis)
        series = {"before": before[1][:shared, k], "after": after[1][:shared, k]}
        floor = None if least is None else _rms(least[1][:, k])
        panels.append(
            _panel(f"predicted {short_signal(axis)}", before[0][:shared], series, "m", floor)
        )
    return panels


def _first_motion(loop: LoopRun) -> tuple[Array, Array] | None:
    """Time and predicted minus true tip, (n, 3); None where the run did not keep them."""
    programme = loop.timing["run"].get("programme_s")
    if loop.ticks is None or loop.true_tip_m is None or not programme:
        return None
    time_s = loop.ticks["time_s"] - loop.ticks["time_s"][0]
    rows = (time_s >= programme["rest"]) & (time_s < programme["rest"] + programme[PART])
    predicted_m = np.column_stack([loop.ticks[name] for name in tip_names("predicted_")])
    return time_s[rows] - programme["rest"], (predicted_m - loop.true_tip_m)[rows]


def _panel(
    title: str, time_s: Array, series: Mapping[str, Array], unit: str, floor: float | None
) -> Titled:
    shown, factor, _ = error_unit(unit)
    curves = [(name, factor * values) for name, values in series.items()]
    sizes = " → ".join(f"{_rms(values):.3g}" for _, values in curves)
    drawing = svg_charts.traces(time_s, curves, shown, None if floor is None else factor * floor)
    return f"{title}, {sizes} {shown} RMS", drawing


def _rms(values: Array) -> float:
    return float(np.sqrt(np.nanmean(values**2)))
