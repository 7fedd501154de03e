"""One picture of a directory of trials: what the link did, per payload."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("svg")
import matplotlib.pyplot as plt
import numpy as np

from models.shared.kinematics import rigid_tip_m
from models.trials.deformation import deformation_index
from models.trials.trial_files import Trial, TrialSet, read_trials

_LABELS = (
    ("time in s", "tip deflection in mm"),
    ("angle 1 in degrees", "tip deflection along x in mm"),
    ("angle 1 in degrees", "current 1 in A"),
    ("angle 1 in degrees", "Deformation Index in %"),
)


def draw_overview(directory: Path) -> Path:
    """Draw `overview.svg` from the first simulated trial of every payload in a directory.

    Rows: how far the tip is from where a rigid link would have it, over time; the part of that
    along x, current and Deformation Index over angle 1. One column per motion.
    """
    columns = _first_of_each_payload(read_trials(directory).where(lambda t: t.meta.source == "rig"))
    figure, axes = plt.subplots(
        4, len(columns), figsize=(6.0 * len(columns), 14.0), squeeze=False, layout="constrained"
    )
    for column, (title, trials) in zip(axes.T, columns.items(), strict=True):
        column[0].set_title(title)
        largest = max(t.meta.payload_kg for t in trials) or 1.0
        for trial in trials:
            colour = plt.get_cmap("viridis")(0.9 * trial.meta.payload_kg / largest)
            _draw(column, trial, {"color": colour, "lw": 0.9})
        for axis, (x, y) in zip(column, _LABELS, strict=True):
            axis.set_xlabel(x)
            axis.set_ylabel(y)
            axis.grid(alpha=0.3)
        column[0].legend(title="payload", fontsize="small", loc="upper right")
    path = directory / "overview.svg"
    figure.savefig(path)
    plt.close(figure)
    return path


def _first_of_each_payload(trials: TrialSet) -> dict[str, list[Trial]]:
    columns: dict[str, dict[float, Trial]] = {}
    for t in sorted(trials, key=lambda t: (t.meta.dof, t.meta.trial, t.meta.payload_kg)):
        title = f"{t.meta.dof}DOF, {t.meta.motion}, {np.degrees(t.meta.amplitude_rad):.3g}°"
        if t.meta.phase_2_rad:
            title += f", phase {np.degrees(t.meta.phase_2_rad):.3g}°"
        columns.setdefault(title, {}).setdefault(t.meta.payload_kg, t)
    return {title: list(by_payload.values()) for title, by_payload in columns.items()}


def _draw(column: Any, trial: Trial, style: dict[str, Any]) -> None:
    meta, angle = trial.meta, trial.angle_rad
    deflection_m = trial.tip_m - rigid_tip_m(angle, meta.base_offset_m, meta.link_length_m)
    degrees = np.degrees(angle[:, 0])
    column[0].plot(
        trial.time_s,
        1e3 * np.linalg.norm(deflection_m, axis=1),
        **style,
        label=f"{meta.payload_kg:g} kg",
    )
    column[1].plot(degrees, 1e3 * deflection_m[:, 0], **style)
    column[2].plot(degrees, trial.current_a[:, 0], **style)
    column[3].plot(degrees, 100.0 * deformation_index(trial), **style)
