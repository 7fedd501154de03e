"""Motion figures of the study: paths, poses and DI of the link (Figs. 7 to 11)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from firmware_py.core.units import ANGLE, DEFORMATION, PAYLOAD, POSITION, TIME
from models.shared.drawing import Drawing, nested_widths
from models.shared.pages import Figure, LegendEntry, Panel
from models.shared.palette import INK, MUTED, SERIES, ordered_colours
from models.study.document import StudyDocument, TipPath

Studies = Mapping[str, StudyDocument]
"""Studies by kind of motion."""

MARGIN: Final = 1.1
"""Ratio of a drawing's size to its contents."""

ASPECT: Final = 0.72
"""Ratio of height to width of a path seen from above."""

AZIMUTH: Final = np.radians(-20.0)
ELEVATION: Final = np.radians(20.0)
NESTED: Final = (
    " Where the lines of the payloads cover each other, each is narrower than the one beneath: the "
    "lightest lies at the bottom."
)


def motion_figures(studies: Studies) -> list[Figure]:
    """Draw paths, shapes and DI, with a panel for each kind of motion."""
    return [_paths(studies), _poses(studies), _di_over_angle(studies), _mean_di(studies)]


def _payload_legend(labels: list[str]) -> list[LegendEntry]:
    return [
        LegendEntry(colour, _payload_words(label))
        for label, colour in zip(labels, ordered_colours(len(labels)), strict=True)
    ]


def _payload_words(label: str) -> str:
    """Label of a run's key: "0.5 kg", "2 kg, phase 90°"."""
    payload, _, phase = label.partition(" phase ")
    return f"{payload} kg" + (f", phase {phase.removesuffix('deg')}°" if phase else "")


def _paths(studies: Studies) -> Figure:
    motions = {motion: study.series.path for motion, study in studies.items()}
    point_m = np.concatenate([_points_m(p) for paths in motions.values() for p in paths.values()])
    reach_m = float(np.linalg.norm(point_m, axis=1).max())
    half_m = MARGIN * float(max(np.abs(point_m[:, 0]).max(), np.abs(point_m[:, 1]).max() / ASPECT))
    panels: list[Panel] = []
    nested = False
    for motion, paths in motions.items():
        for view, project in (("from above", _from_above), ("oblique", _oblique)):
            lines = [project(_points_m(path)) for path in paths.values()]
            widths = nested_widths(lines, 2.0 * half_m)
            nested = nested or widths[0] != widths[-1]
            with Drawing() as (drawing, ax):
                colours = ordered_colours(len(lines))
                for line, colour, width in zip(lines, colours, widths, strict=True):
                    ax.plot(*line.T, color=colour, linewidth=width)
                if view == "from above":
                    ax.set(xlabel=POSITION.label("x"), ylabel=POSITION.label("y"), aspect="equal")
                    ax.set(xlim=(-half_m, half_m), ylim=(-ASPECT * half_m, ASPECT * half_m))
                else:
                    _draw_axes(ax, reach_m)
            panels.append(
                drawing.panel(
                    f"{motion}, {view}",
                    f"Path of the end effector, {motion}, seen {view}, one line per payload; "
                    f"{_extent(paths)}.",
                )
            )
    return Figure(
        "Paths of the end effector",
        "The base joint is at the origin; at angle zero the link is along z." + NESTED * nested,
        panels, "7", _payload_legend(list(next(iter(motions.values())))),
    )  # fmt: skip


def _points_m(path: TipPath) -> Any:
    return np.column_stack([path.tip_x_m, path.tip_y_m, path.tip_z_m])


def _extent(paths: Mapping[str, TipPath]) -> str:
    reach_x_m = max(np.ptp(p.tip_x_m) for p in paths.values())
    reach_y_m = max(np.ptp(p.tip_y_m) for p in paths.values())
    return f"it extends {POSITION.text(reach_x_m)} along x and {POSITION.text(reach_y_m)} along y"


def _from_above(point_m: Any) -> Any:
    return point_m[:, :2]


def _oblique(point_m: Any) -> Any:
    x, y, z = point_m.T
    right = -np.sin(AZIMUTH) * y + np.cos(AZIMUTH) * x
    away = np.sin(AZIMUTH) * x + np.cos(AZIMUTH) * y
    return np.column_stack([right, np.cos(ELEVATION) * z + np.sin(ELEVATION) * away])


def _draw_axes(ax: Any, reach_m: float) -> None:
    """Draw the world axes at the origin and the link at angle zero, instead of a frame."""
    for k, name in enumerate("xyz"):
        end = np.zeros((2, 3))
        end[1, k] = 0.35 * reach_m
        ax.plot(*_oblique(end).T, color=MUTED, linewidth=0.8)
        ax.annotate(name, _oblique(end * 1.12)[1], color=INK, ha="center", va="center")
    link = np.array([[0, 0, 0], [0, 0, reach_m]])
    ax.plot(*_oblique(link).T, color=MUTED, linewidth=0.8, linestyle=":")
    ax.set(aspect="equal", xlim=(-reach_m, reach_m))
    ax.axis("off")


def _poses(studies: Studies) -> Figure:
    panels = []
    shown_m = np.concatenate([
        np.asarray(study.series.poses.centre_line_m, dtype=np.float64).reshape(-1, 3)
        for study in studies.values()
    ])  # fmt: skip
    half_m = MARGIN * float(np.nanmax(np.abs(shown_m[:, :2])))
    bottom_m, top_m = (MARGIN * float(f(shown_m[:, 2])) for f in (np.nanmin, np.nanmax))
    for motion, study in studies.items():
        poses = study.series.poses
        line_m = np.array(poses.centre_line_m, dtype=np.float64)
        for plane, k in (("x–z plane", 0), ("y–z plane", 1))[: study.dof]:
            with Drawing() as (drawing, ax):
                colours = ordered_colours(len(line_m))
                for points, colour in zip(line_m, colours, strict=True):
                    whole = np.vstack([np.zeros(3), points])
                    ax.plot(whole[:, k], whole[:, 2], color=colour, marker="o", markersize=2.2)
                ax.set(xlabel=POSITION.label("xy"[k]), ylabel=POSITION.label("z"), aspect="equal")
                ax.set(xlim=(-half_m, half_m), ylim=(min(bottom_m, 0.0), top_m))
            di = DEFORMATION.shown(poses.di)
            panels.append(
                drawing.panel(
                    f"{motion}, {plane}, {PAYLOAD.significant(poses.payload_kg)}",
                    f"Centre line of the link at {len(di)} equal times of the first cycle, "
                    f"{plane}; its DI goes from {min(di):.2f} to {max(di):.2f} %.",
                )
            )
    with Drawing() as (drawing, ax):
        for (motion, study), colour in zip(studies.items(), SERIES, strict=False):
            poses = study.series.poses
            ax.plot(
                poses.time_s, DEFORMATION.shown(poses.di),
                color=colour, marker="o", markersize=4, label=motion,
            )  # fmt: skip
        ax.set(xlabel=TIME.label("time"), ylabel=DEFORMATION.label("DI"), ylim=(0, None))
        ax.legend(
            frameon=False, fontsize=8, handlelength=1.2, columnspacing=1.0, ncols=3,
            loc="lower center", bbox_to_anchor=(0.5, 1.0),
        )  # fmt: skip
    panels.append(
        drawing.panel(
            "DI of these poses", "DI of the poses over time, one line for each kind of motion."
        )
    )
    times = next(iter(studies.values())).series.poses.time_s
    legend = [
        LegendEntry(colour, TIME.text(t))
        for t, colour in zip(times, ordered_colours(len(times)), strict=True)
    ]
    return Figure(
        "Shape of the link",
        "Centre line through base plate and marker rows, to scale.",
        panels, "8", legend,
    )  # fmt: skip


def _di_over_angle(studies: Studies) -> Figure:
    panels = []
    top = max(max(c.di) for s in studies.values() for c in s.series.di.values())
    widest = ANGLE.shown(max(a for s in studies.values() for a in s.training.amplitude_rad))
    for motion, study in studies.items():
        curves = study.series.di
        with Drawing() as (drawing, ax):
            for curve, colour in zip(curves.values(), ordered_colours(len(curves)), strict=True):
                ax.plot(
                    ANGLE.shown(curve.angle_1_rad), DEFORMATION.shown(curve.di),
                    color=colour, linewidth=1.0,
                )  # fmt: skip
            ax.set(
                xlabel=ANGLE.label("angle 1"),
                ylabel=DEFORMATION.label("DI"),
                xticks=np.round(np.linspace(-1.0, 1.0, 5) * widest, 1),
            )
            ax.set_ylim(0, 1.05 * DEFORMATION.factor * top)
        peaks = ", ".join(
            f"{DEFORMATION.text(max(c.di))} at {_payload_words(k)}" for k, c in curves.items()
        )
        panels.append(
            drawing.panel(
                motion,
                f"DI over the angle of joint 1, {motion}, one loop per payload; peaks: {peaks}.",
            )
        )
    labels = list(next(iter(studies.values())).series.di)
    return Figure(
        "DI over the angle", "Trial 1, two cycles. Marker noise alone contributes about 0.07 %.",
        panels, "9 and 10", _payload_legend(labels),
    )  # fmt: skip


def _mean_di(studies: Studies) -> Figure:
    lines = [
        (motion, study.mean_di, colour)
        for (motion, study), colour in zip(studies.items(), SERIES, strict=False)
    ]
    with Drawing() as (drawing, ax):
        for _, values, colour in lines:
            ax.plot(
                [float(k) for k in values], DEFORMATION.shown(list(values.values())),
                color=colour, marker="o", markersize=4,
            )  # fmt: skip
        ax.set(xlabel=PAYLOAD.label("payload"), ylabel=DEFORMATION.label("mean DI"), ylim=(0, None))
        ax.set_xticks(sorted({float(k) for _, values, _ in lines for k in values}))
    alt = "; ".join(
        f"{motion}: " + ", ".join(f"{DEFORMATION.text(v)} at {k} kg" for k, v in values.items())
        for motion, values, _ in lines
    )
    return Figure(
        "Mean DI by payload",
        "Rows of trial 1 in motion. The paper does not state the phase by which joint 2 leads "
        "joint 1: at 0° both joints move together, at 90° the tip follows a loop.",
        [drawing.panel("1DOF and 2DOF", f"Mean DI over payload. {alt}.")], "11",
        [LegendEntry(colour, motion) for motion, _, colour in lines],
    )  # fmt: skip
