"""Picture of simulated and measured signals: one column per trial, one row per signal."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from firmware_py.display_units import PAYLOAD, TIME, signal_unit, signal_words
from models.plant.identification.evaluation import Comparison, compare_with_trials
from models.plant.plant import Plant
from models.shared.palette import MUTED, SIMULATED
from models.trials.trial import Trial


def draw_fit(plant: Plant, trials: Sequence[Trial], path: Path) -> Path:
    """Draw the smallest and largest payload of each number of joints as SVG; return the path."""
    from matplotlib import pyplot

    from models.shared.svg_drawing import FILE_STYLE  # loads matplotlib

    columns = compare_with_trials(plant, _extremes(trials))
    signals = list(dict.fromkeys(s for c in columns for s in c.simulated))
    with pyplot.rc_context(FILE_STYLE):
        figure, axes = pyplot.subplots(
            len(signals), len(columns), squeeze=False, sharex="col",
            figsize=(3.4 * len(columns), 1.5 * len(signals)), layout="constrained",
        )  # fmt: skip
        for column, c in zip(axes.T, columns, strict=True):
            payload = PAYLOAD.significant(c.trial.meta.payload_kg)
            column[0].set_title(f"{c.trial.meta.dof}DOF, {payload}", fontsize=9)
            column[-1].set_xlabel(TIME.label("time"), fontsize=8)
            for axis, signal in zip(column, signals, strict=True):
                _panel(axis, c, signal)
        axes[0, 0].legend(fontsize=7)
        figure.suptitle(f"{plant.name}: measured, and simulated from the goals", fontsize=10)
        figure.savefig(path, format="svg")
        pyplot.close(figure)
    return path


def _extremes(trials: Sequence[Trial]) -> list[Trial]:
    chosen: list[Trial] = []
    for dof in sorted({t.meta.dof for t in trials}):
        own = sorted((t for t in trials if t.meta.dof == dof), key=lambda t: t.meta.payload_kg)
        chosen += own if len(own) == 1 else [own[0], own[-1]]
    return chosen


def _panel(axis: object, c: Comparison, signal: str) -> None:
    axis.tick_params(labelsize=7)  # type: ignore[attr-defined]
    if signal not in c.simulated:
        axis.set_visible(False)  # type: ignore[attr-defined]
        return
    unit = signal_unit(signal)
    every = max(1, len(c.trial) // 300)
    for values, style, label in (
        (c.measured[signal], {"color": MUTED, "lw": 2.0}, "measured"),
        (c.simulated[signal], {"color": SIMULATED, "lw": 0.8}, "plant"),
    ):
        rows = np.round(unit.shown(values[::every]), 3)
        axis.plot(c.trial.time_s[::every], rows, label=label, **style)  # type: ignore[attr-defined]
    axis.set_ylabel(unit.label(signal_words(signal)), fontsize=7)  # type: ignore[attr-defined]
