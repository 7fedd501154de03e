"""Page of plans that were run on the rig: paths, errors, margins of the feedback, lost trust."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from firmware_py.core.errors import InputError
from firmware_py.core.units import ANGLE, LENGTH, POSITION, TIME
from firmware_py.goals.plan_goals import PlanGoals
from firmware_py.goals.tip_plan import TipPlan, read_tip_plan
from firmware_py.safety.estimate_trust import FADE_S, TrustState
from hil.report.bode import bode_panels
from hil.report.build_inputs import read_loop
from hil.report.build_page import EMULATED
from models.plan.feedback import (
    LEAST_GAIN_DB,
    LEAST_PHASE_RAD,
    frequencies,
    open_loops,
    tip_responses,
)
from models.plant.linear_twin import LinearTwins
from models.plant.plant import Plant
from models.shared.drawing import Chart, Drawing, Line, line_panels, plot_lines
from models.shared.pages import (
    NO_VALUE,
    Cell,
    Figure,
    Folded,
    LegendEntry,
    Panel,
    Paragraph,
    Part,
    Section,
    Table,
    TableCell,
    render_page,
)
from models.shared.palette import (
    BLUE,
    GREEN,
    INK,
    ORANGE,
    PURPLE,
    SERIES,
    SPAN,
    ordered_colours,
)

Array = NDArray[np.float64]
Knowledge = Literal["rigid", "known", "unknown", "misled"]
"""Rigid kinematics; or the plan, with the payload known, estimated, or configured too small."""
KNOWLEDGE: Final[tuple[Knowledge, ...]] = ("rigid", "known", "unknown")
"""Runs that are compared. The run "misled" shows what happens when the estimate is not trusted."""
_ORDER: Final = (*KNOWLEDGE, "misled")
_NAME: Final = re.compile(rf"([12])dof_({'|'.join(_ORDER)})_([\d.]+)")
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
    payload_kg: float  # Payload of the rig; for "misled", the payload in the configuration
    plan: TipPlan
    tip_m: Array  # (n, dof), true tip at each row of the plan, in its last run
    rms_m: float  # RMS path error of that run, from timing.json
    max_m: float  # Largest path error of that run, from timing.json
    goals_rad: Array  # (n, dof), goals that were sent
    trust: NDArray[np.int64]  # (n,), a `TrustState` of each row
    unknown_kg: float = 0.0  # Further mass at the tip that the configuration lacks

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
    return sorted(runs, key=lambda r: (r.dof, r.payload_kg, _ORDER.index(r.knowledge)))


def _read(directory: Path, folder: Path, dof: str, kind: str, payload: str) -> PlannedRun:
    knowledge = next(k for k in _ORDER if k == kind)
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
    goals_rad = [loop.ticks[f"goal_{joint}_rad"][rows] for joint in range(1, plan.dof + 1)]
    return PlannedRun(
        int(dof), knowledge, float(payload), plan,
        loop.true_tip_m[rows, : plan.dof], errors[-1].rms_m, errors[-1].max_m,
        np.column_stack(goals_rad), loop.ticks["trust"][rows].astype(np.int64),
        loop.timing.environment.hidden.get("unmodelled_payload", 0.0),
    )  # fmt: skip


def plan_figures(runs: Sequence[PlannedRun]) -> dict[str, Any]:
    """Return RMS path errors by dof and payload, with their ratios to those of rigid kinematics.

    `K_ratio` is the largest ratio, `K_times_Ndof` the smallest improvement (the inverse ratio).
    """
    compared: dict[tuple[int, float], dict[Knowledge, float]] = {}
    for run in sorted(runs, key=lambda r: (r.dof, r.payload_kg)):
        if run.knowledge in KNOWLEDGE:
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
    figures: dict[str, Any] = {"cases": cases}
    for k in PATH_RMS_TO_RIGID:
        figures[f"{k}_ratio"] = max(_ratios(cases, k), default=None)
        for dof in dict.fromkeys(case["dof"] for case in cases):
            of_dof = _ratios([case for case in cases if case["dof"] == dof], k)
            figures[f"{k}_times_{dof}dof"] = min((1 / ratio for ratio in of_dof), default=None)
    return figures


def _ratios(cases: Sequence[Mapping[str, Any]], knowledge: str) -> list[float]:
    return [case[f"{knowledge}_ratio"] for case in cases if f"{knowledge}_ratio" in case]


def plans_page(runs: Sequence[PlannedRun], plant: Plant | None = None) -> str:
    """Return the page as HTML; diagrams of the feedback need the plant of the plans."""
    lead: list[Part] = [
        EMULATED,
        Paragraph(
            "The robot's loop ran each plan against emulated servos, with the rig behind them. The "
            "equations of the rig differ from those of the plant that was inverted, and its "
            "variation is drawn with another seed.", "lead",
        ),
        _error_table(runs),
    ]  # fmt: skip
    compared = [run for run in runs if run.knowledge in KNOWLEDGE]
    sections = [
        _paths([run for run in compared if run.dof == dof])
        for dof in dict.fromkeys(run.dof for run in compared)
    ]
    plans = {run.dof: run.plan for run in compared if run.knowledge != "rigid"}
    sections += [*_trust(runs), *_feedback(plans, plant)]
    return render_page("The tip on its path", lead, sections)


# --- paths and errors ---------------------------------------------------------------------------


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


# --- trust in the estimated tip -----------------------------------------------------------------


def _trust(runs: Sequence[PlannedRun]) -> list[Section]:
    """Section on the time without trust; none if no run has feedback."""
    guided = [run for run in runs if (run.trust != TrustState.NONE).any()]
    if not guided:
        return []
    states = (TrustState.FADING, TrustState.LOST)
    untrusted = [run for run in guided if np.isin(run.trust, states).any()]
    rows = [
        [f"{run.dof}DOF, {_payload_words(run)}",
         *(f"{run.plan.period_s * np.count_nonzero(run.trust == state):.1f}" for state in states)]
        for run in untrusted
    ]  # fmt: skip
    others = f"{len(guided) - len(untrusted)} of {len(guided)} runs trusted it all the time."
    parts: list[Part] = [
        Paragraph(
            "Two bad ticks in a row end the trust in the estimated tip: the innovation of a "
            "current is too large, the tip is out of range or not finite, or data are stale. The "
            f"corrections fade out within {FADE_S:g} s, and the plan goes on without them; or the "
            "robot stops, if robot.toml says so. They come back once the estimate was good for a "
            f"second. {others}"
        ),
    ]
    if rows:
        parts.append(Table("Time without trust, in s", ["", "fading", "lost"], rows))
    misled = [run for run in guided if run.knowledge == "misled"]
    if misled:
        legend = [LegendEntry(SPAN, "not trusted")]
        joints = range(max(run.dof for run in misled))
        legend += [LegendEntry(SERIES[j], f"correction of joint {j + 1}") for j in joints]
        title = "A robot with too small a payload in its configuration"
        panels = [panel for run in misled for panel in _without_trust(run)]
        parts.append(Figure(title, "", panels, legend=legend))
    return [Section("trust", "When the estimate is not trusted", parts)]


def _payload_words(run: PlannedRun) -> str:
    if run.knowledge != "misled":
        return f"{run.payload_kg:g} kg, {WORDS[run.knowledge]}"
    at_tip_kg = run.payload_kg + run.unknown_kg
    return f"{run.payload_kg:g} kg configured, {at_tip_kg:g} kg at the tip"


def _without_trust(run: PlannedRun) -> list[Panel]:
    """Distance from the path, and corrections: goals sent minus goals of the plan."""
    planned = PlanGoals(run.plan, run.payload_kg)
    beyond_rad = run.goals_rad - np.array([planned.at(row) for row in range(run.plan.rows)])
    corrections = [
        Line(run.time_s, ANGLE.shown(column), colour, width=1.0)
        for column, colour in zip(beyond_rad.T, SERIES, strict=False)
    ]
    distance = [Line(run.time_s, LENGTH.shown(run.away_m), PURPLE, width=1.0)]
    untrusted = np.concatenate([[False], run.trust > TrustState.TRUSTED, [False]])
    edges_s = run.plan.period_s * np.flatnonzero(np.diff(untrusted.astype(int)))
    most_mm, most_deg = LENGTH.text(run.max_m), ANGLE.text(np.abs(beyond_rad).max(), 2)
    name = f"{run.dof}DOF, {_payload_words(run)}"
    panels = []
    for title, lines, ylabel in (
        (f"{name}: distance from the path, {most_mm} at most", distance, LENGTH.label("distance")),
        (f"Corrections of the joints, {most_deg} at most", corrections, ANGLE.label("correction")),
    ):
        with Drawing() as (drawing, ax):
            for start_s, end_s in edges_s.reshape(-1, 2):
                ax.axvspan(start_s, end_s, color=SPAN, lw=0)
            plot_lines(ax, lines)
            ax.set(xlabel=TIME.label("time"), ylabel=ylabel)
        panels.append(drawing.panel(title, f"{title}; shaded where the estimate is not trusted."))
    return panels


# --- margins of the feedback --------------------------------------------------------------------


def _feedback(plans: Mapping[int, TipPlan], plant: Plant | None) -> list[Section]:
    """Section on margins; the Bode plots are of the linearised twin of `plant`."""
    guided = {dof: plan for dof, plan in sorted(plans.items()) if plan.feedback is not None}
    if not guided:
        return []
    parts: list[Part] = [
        Paragraph(
            "Each loop is opened at its joint, with the other one closed. One period of delay "
            "stands for the loop and the bus. The margins are the least of sliding joints, "
            "joints at rest, and a link that is 20 % stiffer or softer than the plant says; the "
            "sliding one is drawn."
        ),
        Folded("Margins over the grid of payloads", [_margin_table(guided)]),
    ]
    if plant is not None:
        for plan in guided.values():
            parts += _diagrams(plan, plant)
    return [Section("feedback", "Feedback of the estimated tip", parts)]


def _margin_table(plans: Mapping[int, TipPlan]) -> Table:
    rows: list[list[Cell]] = [
        [
            f"{dof}DOF, joint {joint}, {m.payload_kg:g} kg",
            TableCell(f"{m.gain_db:.1f}", bool(m.gain_db >= LEAST_GAIN_DB)),
            TableCell(ANGLE.number(m.phase_rad), bool(m.phase_rad >= LEAST_PHASE_RAD)),
            f"{m.crossover_rad_s:.1f}",
        ]
        for dof, plan in plans.items()
        if plan.feedback is not None
        for joint, margins in enumerate(plan.feedback.margins, start=1)
        for m in margins
    ]
    header = ["", "gain margin, dB", "phase margin, °", "crossover, rad/s"]
    targets = f"Targets: {LEAST_GAIN_DB:g} dB and {ANGLE.text(LEAST_PHASE_RAD, 0)}."
    return Table("", header, rows, targets)


def _diagrams(plan: TipPlan, plant: Plant) -> list[Figure]:
    """Bode plot of the loop of every joint, one curve for each payload."""
    if plan.feedback is None:
        return []
    grid, twins = plan.grid_kg.tolist(), LinearTwins(plant.step_model(plan.dof), plan.period_s)
    loops = [
        open_loops(filters, tip_responses(twins, payload_kg), plan.period_s)
        for filters, payload_kg in zip(plan.feedback.filters, grid, strict=True)
    ]
    frequency_hz, colours = frequencies(plan.period_s) / (2 * np.pi), ordered_colours(len(grid))
    legend = [LegendEntry(c, f"{m:g} kg") for c, m in zip(colours, grid, strict=True)]
    figures = []
    for joint in range(plan.dof):
        name = f"{plan.dof}DOF, joint {joint + 1}"
        sliding = [(of_payload[joint][0], c) for of_payload, c in zip(loops, colours, strict=True)]
        panels = bode_panels(
            frequency_hz, sliding, f"of the loop of {name}, by payload,", limits=(0.0, -180.0)
        )
        figures.append(Figure(f"Loop of {name}", "", panels, legend=legend))
    return figures
