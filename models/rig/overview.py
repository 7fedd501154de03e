"""Overview picture of a directory of trials: deflection, current and DI by payload."""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from firmware_py.core.units import ANGLE, CURRENT, DEFORMATION, LENGTH, PAYLOAD, TIME
from models.shared.drawing import FILE_STYLE, save_svg
from models.shared.kinematics import rigid_tip_m
from models.shared.palette import ordered_colours
from models.trials.deformation import deformation_index
from models.trials.files import read_trials
from models.trials.trial import Trial

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
    simulated = read_trials(directory).where(lambda t: t.meta.source == "rig")
    columns: dict[str, dict[float, Trial]] = {}
    for t in sorted(simulated, key=lambda t: (t.meta.dof, t.meta.trial, t.meta.payload_kg)):
        title = f"{t.meta.dof}DOF, {t.meta.motion}, {ANGLE.significant(t.meta.amplitude_rad)}"
        if t.meta.phase_2_rad:
            title += f", phase {ANGLE.significant(t.meta.phase_2_rad)}"
        columns.setdefault(title, {}).setdefault(t.meta.payload_kg, t)
    path = directory / "overview.svg"
    with plt.rc_context(FILE_STYLE):
        figure, axes = plt.subplots(
            4, len(columns), figsize=(6.0 * len(columns), 14.0), squeeze=False,
            layout="constrained",
        )  # fmt: skip
        for column, (title, by_payload) in zip(axes.T, columns.items(), strict=True):
            column[0].set_title(title)
            colours = ordered_colours(len(by_payload))
            for (payload_kg, t), colour in zip(by_payload.items(), colours, strict=True):
                rigid_m = rigid_tip_m(t.angle_rad, t.meta.base_offset_m, t.meta.link_length_m)
                deflection_m = t.tip_m - rigid_m
                angle = ANGLE.shown(t.angle_rad[:, 0])
                curves = (
                    (t.time_s, LENGTH.shown(np.linalg.norm(deflection_m, axis=1))),
                    (angle, LENGTH.shown(deflection_m[:, 0])),
                    (angle, t.current_a[:, 0]),
                    (angle, DEFORMATION.shown(deformation_index(t))),
                )
                label = PAYLOAD.significant(payload_kg)
                for axis, (x, y) in zip(column, curves, strict=True):
                    axis.plot(x, y, color=colour, lw=0.9, label=label)
            for axis, (x_label, y_label) in zip(column, _LABELS, strict=True):
                axis.set(xlabel=x_label, ylabel=y_label)
            column[0].legend(title="payload", fontsize="small", loc="upper right")
        save_svg(figure, path)
        plt.close(figure)
    return path
