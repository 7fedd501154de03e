"""A picture of a plant beside measurement: one column a trial, one row a signal."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from models.plant.identification.evaluation import Comparison, compare
from models.plant.plant import Plant
from models.trials.trial import Trial

_SHOWN = {"m": (1e3, "mm"), "rad": (57.29578, "deg"), "a": (1.0, "A"), "di": (100.0, "%")}


def draw(plant: Plant, trials: Sequence[Trial], path: Path) -> Path:
    """Draw least and largest payload of each number of joints; returns the path (SVG)."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    columns = compare(plant, _extremes(trials))
    signals = list(dict.fromkeys(s for c in columns for s in c.simulated))
    figure, axes = pyplot.subplots(
        len(signals), len(columns), squeeze=False, sharex="col",
        figsize=(3.4 * len(columns), 1.5 * len(signals)), layout="constrained",
    )  # fmt: skip
    for column, c in zip(axes.T, columns, strict=True):
        column[0].set_title(f"{c.trial.meta.dof}DOF, {c.trial.meta.payload_kg:g} kg", fontsize=9)
        column[-1].set_xlabel("time, s", fontsize=8)
        for axis, signal in zip(column, signals, strict=True):
            _panel(axis, c, signal)
    axes[0, 0].legend(fontsize=7)
    figure.suptitle(f"{plant.name}: measured and simulated from the goals", fontsize=10)
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
    factor, unit = _SHOWN.get(signal.rsplit("_", 1)[-1], (1.0, ""))
    every = max(1, len(c.trial) // 300)
    for values, style, label in (
        (c.measured[signal], {"color": "0.6", "lw": 2.0}, "measured"),
        (c.simulated[signal], {"color": "C3", "lw": 0.8}, "plant"),
    ):
        rows = np.round(factor * values[::every], 3)
        axis.plot(c.trial.time_s[::every], rows, label=label, **style)  # type: ignore[attr-defined]
    axis.set_ylabel(f"{signal.rsplit('_', 1)[0]}, {unit}", fontsize=7)  # type: ignore[attr-defined]
