"""Page of plans that were run on the rig: paths, and distances of the tip from them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from firmware_py.core.errors import InputError
from firmware_py.core.units import LENGTH, POSITION, TIME
from firmware_py.goals.tip_plan import TipPlan, read_tip_plan
from hil.report.build_inputs import read_loop
from hil.report.build_page import EMULATED
from models.shared.drawing import Chart, Line, line_panels
from models.shared.pages import (
    NO_VALUE,
    Cell,
    Figure,
    LegendEntry,
    Paragraph,
    Part,
    Section,
    Table,
    TableCell,
    render_page,
)
from models.shared.palette import BLUE, GREEN, INK, ORANGE

Array = NDArray[np.float64]
Knowledge = Literal["rigid", "known", "unknown"]
"""Rigid kinematics; or the plan, with the payload known or estimated."""
KNOWLEDGE: Final[tuple[Knowledge, ...]] = ("rigid", "known", "unknown")
_NAME: Final = re.compile(rf"([12])dof_({'|'.join(KNOWLEDGE)})_([\d.]+)")
COLOURS: Final[dict[Knowledge, str]] = {"rigid": ORANGE, "known": BLUE, "unknown": GREEN}
WORDS: Final[dict[Knowledge, str]] = {
    "rigid": "rigid kinematics",
    "known": "plan, payload known",
    "unknown": "plan, payload estimated, second run",
}
PATH_RMS_TO_RIGID: Final = {"known": 1 / 25, "unknown": 1 / 20}
"""Target of the RMS path error over that of rigid kinematics, by what is known of the payload."""
RATIOS: Final = {"known": "known", "unknown": "estimated"}
"""Words for the payload, in the columns with the ratio to rigid kinematics."""


@dataclass(frozen=True)
class PlannedRun:
    """Last run of a plan in a directory of `dropstitch sil`."""

    dof: int
    knowledge: Knowledge
    payload_kg: float  # Payload of the rig
    plan: TipPlan
    tip_m: Array  # (n, dof), true tip at each row of the plan, in its last run
    rms_m: float  # RMS path error of that run, from timing.json
    max_m: float  # Largest path error of that run, from timing.json

    @property
    def away_m(self) -> Array:
        """Distance from the path, shape (n,)."""
        return np.asarray(np.linalg.norm(self.tip_m - self.plan.desired_tip_m(), axis=1))

    @property
    def time_s(self) -> Array:
        return np.arange(self.plan.rows, dtype=np.float64) * self.plan.period_s


def read_planned_runs(directory: Path) -> list[PlannedRun]:
    """Read the runs of `make tip-demo`, sorted by dof, payload and knowledge.

    The directory also holds the plans `inverse_Ndof.json` and `rigid_Ndof.json`.
    """
    runs = []
    for folder in sorted(directory.glob("*")):
        match = _NAME.fullmatch(folder.name)
        if match and (folder / "timing.json").exists():
            runs.append(_read(directory, folder, *match.groups()))
    if not runs:
        raise InputError(directory, "holds no run of a plan", "run 'make tip-demo'")
    return sorted(runs, key=lambda r: (r.dof, r.payload_kg, KNOWLEDGE.index(r.knowledge)))


def _read(directory: Path, folder: Path, dof: str, kind: str, payload: str) -> PlannedRun:
    knowledge = next(k for k in KNOWLEDGE if k == kind)
    method = "rigid" if knowledge == "rigid" else "inverse"
    plan = read_tip_plan(directory / f"{method}_{dof}dof.json")
    loop = read_loop(folder)
    if not (errors := loop.timing.path_errors):
        what = f"holds no whole run of the plan ({loop.timing.reason})"
        raise InputError(folder, what, "run it again")
    if loop.ticks is None or loop.true_tip_m is None:
        raise InputError(folder, "has no ticks.mcap or no trial/", "run it again")
    start = (len(errors) - 1) * plan.rows - int(loop.ticks["tick"][0])
    rows = slice(start, start + plan.rows)
    return PlannedRun(
        int(dof), knowledge, float(payload), plan,
        loop.true_tip_m[rows, : plan.dof], errors[-1].rms_m, errors[-1].max_m,
    )  # fmt: skip


def plan_figures(runs: Sequence[PlannedRun]) -> dict[str, Any]:
    """Return RMS path errors by dof and payload, with their ratios to those of rigid kinematics."""
    compared: dict[tuple[int, float], dict[Knowledge, float]] = {}
    for run in sorted(runs, key=lambda r: (r.dof, r.payload_kg)):
        compared.setdefault((run.dof, run.payload_kg), {})[run.knowledge] = run.rms_m
    cases: list[dict[str, Any]] = []
    for (dof, payload_kg), rms_m in compared.items():
        case = {"dof": dof, "payload_kg": payload_kg}
        case |= {f"{knowledge}_rms_m": value for knowledge, value in rms_m.items()}
        if "rigid" in rms_m:
            case |= {
                f"{k}_ratio": rms_m[k] / rms_m["rigid"] for k in PATH_RMS_TO_RIGID if k in rms_m
            }
        cases.append(case)
    return {"cases": cases}


def plans_page(runs: Sequence[PlannedRun]) -> str:
    """Return the page as HTML."""
    lead: list[Part] = [
        EMULATED,
        Paragraph(
            "The robot's loop ran each plan against emulated servos, with the rig behind them. The "
            "equations of the rig differ from those of the plant that was inverted, and its "
            "variation is drawn with another seed.", "lead",
        ),
        _error_table(runs),
    ]  # fmt: skip
    sections = [
        _paths([run for run in runs if run.dof == dof])
        for dof in dict.fromkeys(run.dof for run in runs)
    ]
    return render_page("The tip on its path", lead, sections)


def _error_table(runs: Sequence[PlannedRun]) -> Table:
    rows: list[list[Cell]] = []
    for case in plan_figures(runs)["cases"]:
        row: list[Cell] = [f"{case['dof']}DOF, {case['payload_kg']:g} kg"]
        for knowledge in KNOWLEDGE:
            rms_m = case.get(f"{knowledge}_rms_m")
            row.append(NO_VALUE if rms_m is None else LENGTH.number(rms_m, 2))
        for payload, most in PATH_RMS_TO_RIGID.items():
            ratio = case.get(f"{payload}_ratio")
            row.append(NO_VALUE if ratio is None else TableCell(f"{1 / ratio:.1f}", ratio <= most))
        rows.append(row)
    targets = ", ".join(f"{1 / most:.0f} ({RATIOS[k]})" for k, most in PATH_RMS_TO_RIGID.items())
    return Table(
        "Distance of the tip from its path, RMS in mm, with rest, approach and return",
        ["", *WORDS.values(), *(f"rigid over {RATIOS[k]}" for k in PATH_RMS_TO_RIGID)],
        rows,
        f"Targets: rigid kinematics over the plan at least {targets}.",
    )


def _paths(runs: Sequence[PlannedRun]) -> Section:
    """Section on the runs with one number of joints; two joints lead the tip in a plane."""
    plan, flat = runs[0].plan, runs[0].dof == 2
    paths, errors = [], []
    for payload_kg in dict.fromkeys(run.payload_kg for run in runs):
        alike = [run for run in runs if run.payload_kg == payload_kg]
        # Each line is thinner than the one beneath, because they coincide.
        widths = [1.2 + 1.1 * k for k in reversed(range(len(alike)))]
        lines = [
            Line(*_tip(run, run.tip_m), COLOURS[run.knowledge], width=width)
            for run, width in zip(alike, widths, strict=True)
        ]
        lines.append(Line(*_tip(runs[0], plan.desired_tip_m()), INK, "dashed", 0.9))
        listed = ", ".join(f"{WORDS[r.knowledge]} {LENGTH.text(r.rms_m, 2)} RMS" for r in alike)
        payload = f"{payload_kg:g} kg"
        paths.append(Chart(payload, f"Tip of the rig with {payload}: {listed}.", lines))
        lines = [
            Line(run.time_s, LENGTH.shown(np.maximum(run.away_m, 1e-4)), COLOURS[run.knowledge],
                 width=1.0)
            for run in alike
        ]  # fmt: skip
        listed = ", ".join(f"{WORDS[r.knowledge]} {LENGTH.text(r.max_m)}" for r in alike)
        errors.append(Chart(payload, f"Largest distance from the path: {listed}.", lines))
    x, y = POSITION.label("tip x"), POSITION.label("tip y")
    panels = (
        line_panels(paths, x, y, aspect="equal", adjustable="datalim")
        if flat
        else line_panels(paths, TIME.label("time"), x)
    )
    shown = [k for k in KNOWLEDGE if any(run.knowledge == k for run in runs)]
    legend = [LegendEntry(COLOURS[k], WORDS[k]) for k in shown]
    distances = line_panels(errors, TIME.label("time"), LENGTH.label("distance"), log=True)
    return Section(
        f"dof{plan.dof}", f"{plan.dof}DOF: {plan.path}",
        [
            Figure("Path", "", panels, legend=[LegendEntry(INK, "desired", "dashed"), *legend]),
            Figure("Distance from the path over time", "", distances, legend=legend),
        ],
    )  # fmt: skip


def _tip(run: PlannedRun, tip_m: Array) -> tuple[Array, Array]:
    """Coordinates of a path to draw: x and y of the drawn path, or x over the whole time."""
    if run.dof == 1:
        return run.time_s, tip_m[:, 0]
    x, y = tip_m[run.plan.start_row : run.plan.end_row].T
    return x, y
