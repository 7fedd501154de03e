"""Overview picture of a directory of trials: deflection, current and DI by payload."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np

from firmware_py.display_units import ANGLE, CURRENT, DEFORMATION, LENGTH, PAYLOAD, TIME
from models.shared.drawing import FILE_STYLE
from models.shared.kinematics import rigid_tip_m
from models.shared.palette import ordered_colours
from models.trials.deformation import deformation_index
from models.trials.files import read_trials
from models.trials.trial import Trial, TrialSet

_LABELS = (
    (TIME.label("time"), LENGTH.label("tip deflection")),
    (ANGLE.label("angle 1"), LENGTH.label("tip deflection along x")),
    (ANGLE.label("angle 1"), CURRENT.label("current 1")),
    (ANGLE.label("angle 1"), DEFORMATION.label("Deformation Index")),
)


def draw_overview(directory: Path) -> Path:
    """Draw `overview.svg` from the first simulated trial of every payload in a directory.

    Rows: distance of the tip from a rigid link's over time; its component along x, current and
    Deformation Index over angle 1. One column per motion.
    """
    columns = _first_of_each_payload(read_trials(directory).where(lambda t: t.meta.source == "rig"))
    path = directory / "overview.svg"
    with plt.rc_context(FILE_STYLE):
        figure, axes = plt.subplots(
            4, len(columns), figsize=(6.0 * len(columns), 14.0), squeeze=False,
            layout="constrained",
        )  # fmt: skip
        for column, (title, trials) in zip(axes.T, columns.items(), strict=True):
            column[0].set_title(title)
            for trial, colour in zip(trials, ordered_colours(len(trials)), strict=True):
                _draw(column, trial, {"color": colour, "lw": 0.9})
            for axis, (x, y) in zip(column, _LABELS, strict=True):
                axis.set(xlabel=x, ylabel=y)
            column[0].legend(title="payload", fontsize="small", loc="upper right")
        figure.savefig(path, format="svg")
        plt.close(figure)
    return path


def _first_of_each_payload(trials: TrialSet) -> dict[str, list[Trial]]:
    columns: dict[str, dict[float, Trial]] = {}
    for t in sorted(trials, key=lambda t: (t.meta.dof, t.meta.trial, t.meta.payload_kg)):
        title = f"{t.meta.dof}DOF, {t.meta.motion}, {ANGLE.significant(t.meta.amplitude_rad)}"
        if t.meta.phase_2_rad:
            title += f", phase {ANGLE.significant(t.meta.phase_2_rad)}"
        columns.setdefault(title, {}).setdefault(t.meta.payload_kg, t)
    return {title: list(by_payload.values()) for title, by_payload in columns.items()}


def _draw(column: Any, trial: Trial, style: dict[str, Any]) -> None:
    meta, angle = trial.meta, trial.angle_rad
    deflection_m = trial.tip_m - rigid_tip_m(angle, meta.base_offset_m, meta.link_length_m)
    degrees = ANGLE.shown(angle[:, 0])
    column[0].plot(
        trial.time_s,
        LENGTH.shown(np.linalg.norm(deflection_m, axis=1)),
        **style,
        label=PAYLOAD.significant(meta.payload_kg),
    )
    column[1].plot(degrees, LENGTH.shown(deflection_m[:, 0]), **style)
    column[2].plot(degrees, trial.current_a[:, 0], **style)
    column[3].plot(degrees, DEFORMATION.shown(deformation_index(trial)), **style)
