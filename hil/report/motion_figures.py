"""The paper's figures 7 to 11, drawn from `study.json`: how the link moves and deforms."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from hil.report.inputs import PhaseRun
from hil.report.svg import DOF_COLOUR, QUIET, Drawing, Figure, Panel, ramp

Json = dict[str, Any]
Studies = dict[int, Json]

PERCENT: Final = 1e2
AHEAD: Final = "2DOF, joint 2 ahead by 90°"
AZIMUTH: Final = np.radians(-20.0)
ELEVATION: Final = np.radians(20.0)


def motion_figures(studies: Studies, phase_90: PhaseRun) -> list[Figure]:
    """Paths, poses and DI, 1DOF beside 2DOF.

    Parameters
    ----------
    studies : dict
        `study.json` by dof.
    phase_90 : PhaseRun
        2DOF with joint 2 a quarter turn ahead; may be empty.
    """
    return [
        _paths(studies, phase_90.path),
        _poses(studies),
        _di_over_angle(studies),
        _mean_di(studies, phase_90.mean_di),
    ]


def _payload_legend(labels: list[str]) -> list[tuple[str, str, str]]:
    return [
        (colour, f"{label} kg", "solid")
        for label, colour in zip(labels, ramp(len(labels)), strict=True)
    ]


def _paths(studies: Studies, phase_90: Json) -> Figure:
    motions = {f"{dof}DOF": study["series"]["path"] for dof, study in studies.items()}
    if phase_90:
        motions[AHEAD] = phase_90
    panels: list[Panel] = []
    for motion, paths in motions.items():
        for view, project in (("from above", _from_above), ("oblique", _oblique)):
            with Drawing() as (drawing, ax):
                for path, colour in zip(paths.values(), ramp(len(paths)), strict=True):
                    point_m = np.column_stack([path[f"tip_{axis}_m"] for axis in "xyz"])
                    ax.plot(*project(point_m).T, color=colour, linewidth=1.1)
                if view == "from above":
                    ax.set(xlabel="x in m", ylabel="y in m", aspect="equal")
                    ax.set(xlim=(-0.9, 0.9), ylim=(-0.65, 0.65))
                else:
                    _draw_axes(ax)
            panels.append(
                drawing.panel(
                    f"{motion}, {view}",
                    f"Path of the end effector, {motion}, seen {view}, one line per payload; "
                    f"{_extent(paths)}.",
                )
            )
    return Figure(
        "Paths of the end effector", "The base joint stands at the origin, the link upright.",
        panels, "7", _payload_legend(list(next(iter(motions.values())))),
    )  # fmt: skip


def _extent(paths: Json) -> str:
    reach = {a: max(np.ptp(p[f"tip_{a}_m"]) for p in paths.values()) for a in "xy"}
    return f"it extends {reach['x']:.2f} m along x and {reach['y']:.2f} m along y"


def _from_above(point_m: Any) -> Any:
    return point_m[:, :2]


def _oblique(point_m: Any) -> Any:
    x, y, z = point_m.T
    right = -np.sin(AZIMUTH) * y + np.cos(AZIMUTH) * x
    away = np.sin(AZIMUTH) * x + np.cos(AZIMUTH) * y
    return np.column_stack([right, np.cos(ELEVATION) * z + np.sin(ELEVATION) * away])


def _draw_axes(ax: Any) -> None:
    """World axes at the origin in place of a frame."""
    for k, name in enumerate("xyz"):
        end = np.zeros((2, 3))
        end[1, k] = 0.35
        ax.plot(*_oblique(end).T, color=QUIET, linewidth=0.8)
        ax.annotate(name, _oblique(end * 1.12)[1], color=QUIET, ha="center", va="center")
    link = np.array([[0, 0, 0], [0, 0, 1.01]])
    ax.plot(*_oblique(link).T, color=QUIET, linewidth=0.8, linestyle=":")
    ax.set(aspect="equal", xlim=(-0.95, 0.95))
    ax.axis("off")


def _poses(studies: Studies) -> Figure:
    panels = []
    for dof, study in studies.items():
        poses = study["series"]["poses"]
        line_m = np.array(poses["centre_line_m"])
        for plane, k in (("x–z plane", 0), ("y–z plane", 1))[:dof]:
            with Drawing() as (drawing, ax):
                colours = ramp(len(line_m))
                for points, colour in zip(line_m, colours, strict=True):
                    whole = np.vstack([np.zeros(3), points])
                    ax.plot(whole[:, k], whole[:, 2], color=colour, marker="o", markersize=2.2)
                ax.set(xlabel=f"{'xy'[k]} in m", ylabel="z in m", aspect="equal")
                ax.set(xlim=(-0.8, 0.8), ylim=(0, 1.08))
            di = [PERCENT * v for v in poses["di"]]
            panels.append(
                drawing.panel(
                    f"{dof}DOF, {plane}, {poses['payload_kg']:g} kg",
                    f"Centre line of the link at {len(di)} equal times of the first cycle, "
                    f"{plane}; its DI goes from {min(di):.2f} to {max(di):.2f} %.",
                )
            )
    with Drawing() as (drawing, ax):
        for dof, study in studies.items():
            poses = study["series"]["poses"]
            ax.plot(
                poses["time_s"], PERCENT * np.array(poses["di"]),
                color=DOF_COLOUR[dof], marker="o", markersize=4,
            )  # fmt: skip
            ax.annotate(
                f"{dof}DOF", (poses["time_s"][-1], PERCENT * poses["di"][-1]),
                color=DOF_COLOUR[dof], xytext=(6, 0), textcoords="offset points",
                va="bottom" if dof == 1 else "top",
            )  # fmt: skip
        ax.set(xlabel="time in s", ylabel="DI in %", ylim=(0, None))
    panels.append(
        drawing.panel("DI of these poses", "DI of the poses over time, one line for each dof.")
    )
    times = next(iter(studies.values()))["series"]["poses"]["time_s"]
    legend = [(c, f"{t:.1f} s", "solid") for t, c in zip(times, ramp(len(times)), strict=True)]
    return Figure(
        "The link in motion",
        "Centre line through base plate and marker rows, drawn without exaggeration.",
        panels, "8", legend,
    )  # fmt: skip


def _di_over_angle(studies: Studies) -> Figure:
    panels = []
    top = max(max(c["di"]) for s in studies.values() for c in s["series"]["di"].values())
    for dof, study in studies.items():
        curves = study["series"]["di"]
        with Drawing() as (drawing, ax):
            for curve, colour in zip(curves.values(), ramp(len(curves)), strict=True):
                ax.plot(
                    np.degrees(curve["angle_1_rad"]), PERCENT * np.array(curve["di"]),
                    color=colour, linewidth=1.0,
                )  # fmt: skip
            ax.set(xlabel="angle 1 in °", ylabel="DI in %", xticks=[-30, -15, 0, 15, 30])
            ax.set_ylim(0, 1.05 * PERCENT * top)
        peaks = ", ".join(f"{PERCENT * max(c['di']):.2f} % at {k} kg" for k, c in curves.items())
        panels.append(
            drawing.panel(
                f"{dof}DOF",
                f"DI over the angle of joint 1 in {dof}DOF motion, one loop per payload; peaks: "
                f"{peaks}.",
            )
        )
    labels = list(next(iter(studies.values()))["series"]["di"])
    return Figure(
        "DI over the angle", "Trial 1, two cycles; marker noise alone adds about 0.07 %.",
        panels, "9 and 10", _payload_legend(labels),
    )  # fmt: skip


def _mean_di(studies: Studies, phase_90: dict[str, float]) -> Figure:
    lines = [
        (study["mean_di"], f"{dof}DOF" + (", in phase" if dof == 2 and phase_90 else ""),
         DOF_COLOUR[dof], "solid")
        for dof, study in studies.items()
    ]  # fmt: skip
    if phase_90:
        lines.append((phase_90, AHEAD, DOF_COLOUR[2], "dashed"))
    with Drawing() as (drawing, ax):
        for values, _, colour, dash in lines:
            ax.plot(
                [float(k) for k in values], [PERCENT * v for v in values.values()],
                color=colour, linestyle=dash, marker="o", markersize=4,
            )  # fmt: skip
        ax.set(xlabel="payload in kg", ylabel="mean DI in %", ylim=(0, None))
    alt = "; ".join(
        f"{label}: " + ", ".join(f"{PERCENT * v:.2f} % at {k} kg" for k, v in values.items())
        for values, label, *_ in lines
    )
    return Figure(
        "Mean DI by payload",
        "The paper does not give the phase of joint 2, so both ends of its range are here."
        if phase_90 else "Moving rows of trial 1.",
        [drawing.panel("1DOF and 2DOF", f"Mean DI over payload. {alt}.")], "11",
        [(colour, label, dash) for _, label, colour, dash in lines],
    )  # fmt: skip
