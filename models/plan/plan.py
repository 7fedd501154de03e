"""Plan of a path of the tip: the goals that lead it there, although the link bends.

`plan` is the library's function; `plan_path` is the work: reach, goals for each payload, feedback,
probing motion, limits, document. Two methods without inversion serve for comparison. The
rate-limited rigid move turns the joints as fast as the limits permit. ZVD shaping splits it in
three that leave no vibration of the first mode and little where its frequency is off (Singer and
Seering, *ASME J. Dynamic Systems* 112, 1990: zero vibration and derivative).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from firmware_py.config import UNWATCHED_RATE_RAD_S
from firmware_py.core.documents import write_document
from firmware_py.core.errors import InputError
from firmware_py.core.units import ANGLE, CURRENT, LENGTH, TIME
from firmware_py.goals.plan_goals import check_plan_goals
from firmware_py.goals.tip_plan import PayloadPlan, TipPlan, as_columns
from firmware_py.inference.bundle import ModelBundle
from firmware_py.inference.manifest import read_bundle_files
from firmware_py.link.link_description import STUDY_LINK
from firmware_py.safety.limits import Limits, limits_of_link
from models.bundle.plant import compare_with_bundle
from models.plan.feedback import with_feedback
from models.plan.inversion import Inverter, rms
from models.plan.paths import (
    DesiredPath,
    PathOptions,
    Timeline,
    built_in_path,
    read_path,
    timeline,
)
from models.plan.probing import design_probe, expected_deviation
from models.plan.tip_twin import TipTwin, TwinRun
from models.plant.linear_twin import LinearMode, LinearTwins, resting_modes
from models.plant.parameter import check_payload
from models.plant.plant import Plant

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
Method = Literal["inverse", "rigid", "zvd"]
PAYLOAD_RATE_KG_S: Final = 0.5
"""Largest rate of the payload that goals are interpolated at [assumed]: the whole grid in four
seconds."""
MOVE_STEP: Final = 0.06
"""Relative resolution of the search for the shortest move [assumed]."""


@dataclass(frozen=True, repr=False)
class PathPlan:
    """Plan of a path, with the tip that the twin predicts for it; `plan` makes it.

    Attributes
    ----------
    document : TipPlan
        Goals for a grid of payloads, predicted tip and currents, feedback: the content of the file.

    Examples
    --------
    >>> import dropstitch
    >>> bundle = "docs/notebooks/bundle_1dof"
    >>> plant = dropstitch.read_plant(f"{bundle}/plant.json")
    >>> move = dropstitch.plan(
    ...     "point_to_point", plant, bundle, payloads_kg=[0.5], method="rigid"
    ... )
    >>> move.document.dof, move.document.payloads[0].payload_kg
    (1, 0.5)
    """

    document: TipPlan

    def __repr__(self) -> str:
        plan = self.document
        most_m = max(one.residual_rms_m for one in plan.payloads)
        return (
            f"<PathPlan {plan.path}, {plan.method}: {plan.duration_s:.1f} s, {plan.dof}DOF, "
            f"{plan.payloads_in_words}, predicted error {LENGTH.number(most_m, 2)} mm RMS at most>"
        )

    def plot(self) -> Figure:
        """Draw path and predicted tip, error, goals and currents, for every payload."""
        from models.plan.picture import plot_plan

        return plot_plan(self.document)

    def write(self, path: Path | str) -> Path:
        """Write the plan for `dropstitch run --plan`, and its picture beside it."""
        from models.shared.drawing import save_svg  # loads matplotlib

        path = Path(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        write_document(path, self.document)
        save_svg(self.plot(), path.with_suffix(".svg"))
        return path

    def as_json(self) -> dict[str, Any]:
        """Return the errors as plain types, as `dropstitch plan --json` prints them."""
        plan = self.document
        errors = ("payload_kg", "residual_rms_m", "rigid_rms_m", "expected_rms_m")
        return {
            "path": plan.path, "seconds": plan.duration_s,
            "plant_error_rms_m": plan.plant_error_rms_m,
            "payloads": [{name: getattr(one, name) for name in errors} for one in plan.payloads],
        }  # fmt: skip

    def summary(self) -> str:
        """Return the errors to expect at each payload, and the margins of the feedback."""
        plan = self.document
        lines = [
            f"{plan.path}, {plan.method}, {plan.duration_s:.1f} s with rest and ways, "
            f"{plan.dof}DOF",
            "tip error in mm, RMS    predicted  expected     rigid  largest current",
        ]
        for one in plan.payloads:
            lines.append(
                f"  {one.payload_kg:4g} kg            {LENGTH.number(one.residual_rms_m, 2):>10}"
                f"{LENGTH.number(one.expected_rms_m, 2):>10}{LENGTH.number(one.rigid_rms_m):>10}"
                f"{CURRENT.text(np.max(np.abs(one.current_a))):>17}"
            )
        if any(run.source == "mocap" for run in plan.learned):
            lines.append(
                "no feedback of the tip: it would lead the observer's tip onto the path and undo "
                "what was learned from motion capture"
            )
        elif plan.feedback is not None:
            margins = [m for of_joint in plan.feedback.margins for m in of_joint]
            lines.append(
                f"feedback of the tip: gain margin {min(m.gain_db for m in margins):.1f} dB, phase "
                f"margin {ANGLE.text(min(m.phase_rad for m in margins))} at least over the grid"
            )
        elif plan.method == "inverse":
            lines.append("no feedback of the tip")
        if plan.probe is not None:
            known, unknown = (
                max(expected_deviation(plan.probe, float(kg), known=known) for kg in plan.grid_kg)
                for known in (True, False)
            )
            duration = TIME.text(plan.probe.rows * plan.period_s, 1)
            lines.append(
                f"a probing motion of {duration} before the first run measures the stiffness to "
                f"± {known:.0%} where the payload is known, ± {unknown:.0%} where it is not"
            )
        if plan.plant_error_rms_m is None:
            lines.append(
                "the plant does not state its error: expected is what the inversion leaves"
            )
        return "\n".join(lines)


def plan(
    path: DesiredPath | Path | str,
    plant: Plant,
    bundle: ModelBundle | Path | str,
    *,
    size_m: float = 0.3,
    centre_m: Sequence[float] = (),
    seconds: float = 8.0,
    turns: int = 1,
    angle_rad: float = 0.0,
    move_s: float = 0.0,
    payloads_kg: Sequence[float] = (),
    limits: Limits | None = None,
    method: Method = "inverse",
    feedback: bool = True,
    fastest: bool = False,
    probe: bool = False,
    report: Callable[[str], None] = lambda text: None,
) -> PathPlan:
    """Plan goals that lead the tip along a path, by inversion of the twin.

    Parameters
    ----------
    path : str, Path or DesiredPath
        circle, figure_eight, line, square, star, hold, point_to_point or text:HELLO; or a CSV file
        with the columns time_s, x_m and, for two joints, y_m.
    plant : Plant
        Plant to invert.
    bundle : ModelBundle, Path or str
        Bundle of the robot: its joints and its period.
    size_m, centre_m, seconds, turns, angle_rad, move_s
        For a built-in path: half of its largest extent; its centre; duration of one turn, or of the
        text; times that it is passed; direction of a line, from x towards y; duration of a move of
        point_to_point, by default a quarter of `seconds`.
    payloads_kg : sequence of float
        Grid of payloads, rising; by default five up to the largest of the link.
    limits : Limits, optional
        Limits of the robot; by default those of one without `[limits]` that names the plant's link.
    method : {"inverse", "rigid", "zvd"}
        `rigid` takes the link as rigid, `zvd` also shapes the moves; both are for comparison.
    feedback : bool
        Whether the plan corrects the estimated tip while it runs.
    fastest : bool
        Whether to look for the shortest move of point_to_point that keeps the limits.
    probe : bool
        Whether the first run begins with a motion that measures stiffness and payload.
    report : callable
        Called with a phrase after each part of the work.

    Returns
    -------
    PathPlan
        The plan; `PathPlan.write` saves it.

    Raises
    ------
    InputError
        If the tip cannot reach the path or a limit is exceeded, with the row; if options contradict
        each other; or if the bundle is of another link.

    Examples
    --------
    >>> import dropstitch
    >>> bundle = "docs/notebooks/bundle_1dof"
    >>> plant = dropstitch.read_plant(f"{bundle}/plant.json")
    >>> dropstitch.plan("line", plant, bundle, seconds=6.0, payloads_kg=[0.0, 1.0])
    <PathPlan line, inverse: 11.4 s, 1DOF, 0 to 1 kg, predicted error 0.1... mm RMS at most>
    """
    files = read_bundle_files(bundle.directory if isinstance(bundle, ModelBundle) else bundle)
    dof, period_s = files.manifest.dof, files.manifest.period_s
    options = PathOptions(size_m, tuple(centre_m), seconds, turns, angle_rad, move_s)
    desired = _desired(path, dof, period_s, options)
    feedback = feedback and not desired.moves
    _refuse_contradictions(desired, method, feedback, fastest, probe, move_s)
    compare_with_bundle(plant, plant.where, files, "this plan")
    request = PlanRequest(
        plant, dof, period_s, limits or usual_limits(plant),
        tuple(payloads_kg or (plant.link or STUDY_LINK).payloads_kg), files.manifest_sha256, method,
        feedback, probe,
    )  # fmt: skip
    if fastest:

        def with_move(duration_s: float) -> DesiredPath:
            return _desired(path, dof, period_s, replace(options, move_s=duration_s))

        desired = with_move(shortest_move_s(with_move, request))
    return PathPlan(plan_path(desired, request, report))


def usual_limits(plant: Plant) -> Limits:
    """Limits of a robot without `[limits]`; they hold for servos without a bus watchdog as well."""
    limits = msgspec.structs.replace(Limits(), rate_rad_s=UNWATCHED_RATE_RAD_S)
    return limits_of_link(plant.link, limits, stated=()) if plant.link else limits


def _desired(
    path: DesiredPath | Path | str, dof: int, period_s: float, options: PathOptions
) -> DesiredPath:
    if isinstance(path, DesiredPath):
        return path
    if not str(path).lower().endswith(".csv"):
        return built_in_path(str(path), dof, period_s, options)
    if options != PathOptions():
        raise InputError(
            path, "contains size, place and time",
            "leave --size, --centre, --seconds, --turns, --angle-deg and --move out",
        )  # fmt: skip
    return read_path(Path(path), dof, period_s)


def _refuse_contradictions(
    path: DesiredPath, method: Method, feedback: bool, fastest: bool, probe: bool, move_s: float
) -> None:
    for option, is_wrong, what in (
        ("--zvd", method == "zvd" and not path.moves, "is for point_to_point"),
        ("--fastest", fastest and (method != "inverse" or not path.moves or move_s > 0),
         "is for the inverse of point_to_point without --move"),
        ("--probe", probe and (method != "inverse" or not feedback),
         "is for plans with feedback of the tip"),
    ):  # fmt: skip
        if is_wrong:
            raise InputError(option, what, "leave it out")


# --- from path to document ------------------------------------------------------------------------


@dataclass(frozen=True)
class PlanRequest:
    """Robot, payloads and method of a plan."""

    plant: Plant
    dof: int
    period_s: float
    limits: Limits  # Limits of the robot in force
    # Grid of payloads; between two of them the goals are nearly linear in the payload. Measured on
    # the twin of the demo, circle of 0.4 m in 8 s: interpolated goals leave 0.73 mm with 0.25 kg,
    # where those of the grid leave 0.66 and 0.71 mm.
    payloads_kg: Sequence[float]
    bundle_sha256: str = ""  # Hash of the manifest of the robot's bundle
    # "inverse": inversion of the twin. "rigid": the link taken as rigid, moves from rest to rest as
    # fast as the limits permit. "zvd": the same with ZVD shaping of the moves
    method: Method = "inverse"
    feedback: bool = True  # Whether the inverse gets feedback of the estimated tip
    # Whether a motion that measures stiffness and payload precedes the first run; needs feedback
    probe: bool = False


def plan_path(
    path: DesiredPath, request: PlanRequest, report: Callable[[str], None] = lambda text: None
) -> TipPlan:
    plant, payloads, limits = request.plant, request.payloads_kg, request.limits
    check_grid(plant, payloads)
    twin = TipTwin(plant, request.dof, request.period_s)
    middle = payloads[len(payloads) // 2]
    line = timeline(path, twin.resting_tip_m(np.zeros(request.dof), middle), request.period_s)
    where = f"path {path.name} (it begins {line.start_row * request.period_s:.2f} s into the plan)"
    _check_reach(twin, line, payloads, limits, where)
    report("path within reach")

    inverter = Inverter(twin, line, report)
    rigid = [twin.run(inverter.pointing_rad(), m) for m in payloads]
    if request.method == "inverse":
        runs = inverter.invert(payloads)
    else:
        tables = _comparison_goals(inverter.pointing_rad(), line, request)
        runs = [twin.run(table, m) for table, m in zip(tables, payloads, strict=True)]
    plan = _document(path, request, line, runs, rigid)
    check_plan_goals(plan, limits, where)

    if request.feedback and request.method == "inverse":
        plan, refusal = with_feedback(plan, plant, limits, twin, inverter, runs)
        report(f"no feedback: {refusal}" if refusal else "feedback designed")
        if request.probe and refusal:
            raise InputError("--probe", f"needs feedback of the tip: {refusal}", "leave it out")
    if request.probe:
        plan = msgspec.structs.replace(plan, probe=design_probe(plant, twin, payloads, limits))
        check_plan_goals(plan, limits, where)
        report("probing motion designed")
    for run in runs:
        _check_prediction(run, request, where)
    return plan


def check_grid(plant: Plant, payloads_kg: Sequence[float]) -> None:
    """Refuse a grid of payloads that does not rise, or that the plant does not carry."""
    grid = list(payloads_kg)
    if not grid or grid != sorted(set(grid)) or not 0 <= grid[0] <= grid[-1]:
        raise InputError("--payloads", f"are {grid}", "give rising masses in kg")
    check_payload(grid[-1], "--payloads", plant.link)


def _check_reach(
    twin: TipTwin, line: Timeline, payloads_kg: Sequence[float], limits: Limits, where: str
) -> None:
    """Refuse a path, or ways to and from it, that the resting tip cannot reach within the limits.

    The farthest points are tried: the first rows of the largest distance and coordinates.
    """
    farthest = np.sum(line.desired_m**2, axis=1).argmax()
    rows = {farthest, *line.desired_m.argmax(axis=0), *line.desired_m.argmin(axis=0)}
    for row, payload_kg in product(sorted(rows), (payloads_kg[0], payloads_kg[-1])):
        wanted = line.desired_m[row]
        nearest = nearest_rest_m(twin, wanted, payload_kg, limits)
        if np.linalg.norm(nearest - wanted) > 2e-3:
            on_path = line.start_row <= row < line.end_row
            raise InputError(
                where, f"row {row} ({row * twin.period_s:.2f} s) "
                f"{'leads' if on_path else 'of the way there or back leads'} to {_place(wanted)}, "
                f"which the tip cannot reach with {payload_kg:g} kg and goals within "
                f"limits.angle_rad; the nearest place is {_place(nearest)}",
                "make the path smaller, or move its centre" if on_path
                else "let the path begin and end slower",
            )  # fmt: skip


def nearest_rest_m(twin: TipTwin, wanted_m: Array, payload_kg: float, limits: Limits) -> Array:
    """Place nearest to a wanted one, shape (dof,), at which the tip can rest, shape (dof,)."""
    low, high = limits.angle_rad
    goal = np.zeros(twin.dof)
    tip = twin.resting_tip_m(goal, payload_kg)
    for _ in range(6):  # the tip is nearly linear in the goals
        slope = twin.resting_slope(goal, payload_kg)
        # Bounded by the limits: if one joint is at its limit, the other comes as near as it can.
        bounds = low - goal - 1e-9, high - goal + 1e-9
        step = lsq_linear(slope, wanted_m - tip, bounds).x
        goal = np.clip(goal + step, low, high)
        tip = twin.resting_tip_m(goal, payload_kg)
    return tip


def _place(tip_m: Array) -> str:
    text = ", ".join(f"{value + 0.0:.3f}" for value in np.round(tip_m, 3))
    return f"({text}) m" if len(tip_m) > 1 else f"x = {text} m"


def _document(
    path: DesiredPath, request: PlanRequest, line: Timeline, runs: Sequence[TwinRun],
    rigid: Sequence[TwinRun],
) -> TipPlan:  # fmt: skip
    held_out = request.plant.provenance.held_out
    plant_error = held_out.dof.get(str(request.dof)) if held_out else None
    plant_m = plant_error.tip_rms_m if plant_error else None
    moving = [line.desired_m] if request.method == "inverse" else [run.goals_rad for run in runs]
    residuals_m = [rms(run.tip_m - line.desired_m) for run in runs]
    return TipPlan(
        schema=TipPlan.VERSION,
        path=path.name,
        method=request.method,
        dof=request.dof,
        period_s=request.period_s,
        rest_s=line.rest_rows * request.period_s,
        start_row=line.start_row,
        end_row=line.end_row,
        drawn=line.drawn,
        desired_m=as_columns(line.desired_m, 6),
        payloads=tuple(
            PayloadPlan(
                payload_kg=run.payload_kg,
                goals_rad=as_columns(run.goals_rad, 7),
                tip_m=as_columns(run.tip_m, 6),
                current_a=as_columns(run.current_a, 4),
                residual_rms_m=residual_m,
                rigid_rms_m=rms(straight.tip_m - line.desired_m),
                expected_rms_m=math.hypot(residual_m, plant_m or 0.0),
            )
            for run, straight, residual_m in zip(runs, rigid, residuals_m, strict=True)
        ),
        payload_rate_kg_s=PAYLOAD_RATE_KG_S,
        plant_error_rms_m=plant_m,
        plant_sha256=request.plant.for_robot().sha256(),
        bundle_sha256=request.bundle_sha256,
        link=request.plant.link_facts(),
        moves=tuple(
            (first, first + max(_rows_until_rest(t[first:after]) for t in moving), after)
            for first, after in line.moves
        ),
    )


def _rows_until_rest(table: Array) -> int:
    """Row of a move at which the path, or else the goals, have come to rest."""
    steps = np.abs(np.diff(table, axis=0)).max(axis=1)
    return int(np.flatnonzero(steps > 1e-7).max(initial=0)) + 1  # rad or m in a period


def _check_prediction(run: TwinRun, request: PlanRequest, where: str) -> None:
    """Refuse a plan in which the twin violates a limit of measured signals, and name the row."""
    angle = run.angle_rad.tolist()
    for row in range(1, len(angle)):
        violation = request.limits.sample_violation(
            angle[row], run.current_a[row].tolist(), run.position_m[row].tolist(), 0.0,
            goal=run.goals_rad[row - 1].tolist(), angle_before=angle[row - 1],
        )  # fmt: skip
        if violation:
            raise InputError(
                where, f"row {row} ({row * request.period_s:.2f} s), {run.payload_kg:g} kg: the "
                f"twin predicts that {violation}",
                "make the path slower or smaller, or widen the limit",
            )  # fmt: skip


def shortest_move_s(path_of: Callable[[float], DesiredPath], request: PlanRequest) -> float:
    """Shortest duration of a move whose plans keep every limit and leave at most 2 mm RMS.

    Only the lightest and the heaviest payload of the request are tried.
    """
    ends = tuple(sorted({request.payloads_kg[0], request.payloads_kg[-1]}))
    request = replace(request, payloads_kg=ends, feedback=False)
    low, high = 0.2, 4.0

    def is_accurate(seconds: float) -> bool:
        plan = plan_path(path_of(seconds), request)
        return all(one.residual_rms_m < 2e-3 for one in plan.payloads)

    if not is_accurate(high):
        raise InputError("--fastest", f"finds no move within {high:g} s", "make the path smaller")
    while high > (1.0 + MOVE_STEP) * low:
        middle = math.sqrt(low * high)
        try:
            low, high = (low, middle) if is_accurate(middle) else (middle, high)
        except InputError:  # a limit is broken
            low = middle
    return high


# --- moves for comparison -------------------------------------------------------------------------


def _comparison_goals(pointing_rad: Array, line: Timeline, request: PlanRequest) -> list[Array]:
    """Goals for each payload of a rigid link whose moves are as fast as the limits permit.

    `pointing_rad`, shape (n, dof): goals at which the rigid link points at the desired tip.
    """
    period_s, tables = request.period_s, []
    twins = LinearTwins(request.plant.step_model(request.dof), period_s)
    for payload_kg in request.payloads_kg:
        table = pointing_rad.copy()
        for first, after in line.moves:
            end = pointing_rad[after - 1]
            fast = rate_limited(pointing_rad[first], end, request.limits, period_s)
            table[first + 1 : after] = end
            table[first + 1 : first + 1 + len(fast)] = fast[: after - first - 1]
            late_s = 0.0
            if request.method == "zvd":
                for joint, mode in enumerate(resting_modes(twins, payload_kg, end)):
                    column, impulses = table[first:after, joint], zvd_impulses(mode)
                    table[first:after, joint] = shaped(column, impulses, period_s)
                    late_s = max(late_s, impulses[-1][0])
            if len(fast) * period_s + late_s > (after - first - 1) * period_s:
                raise InputError("--seconds", "leaves no rest after a move", "give more time")
        tables.append(table)
    return tables


def rate_limited(start_rad: Array, end_rad: Array, limits: Limits, period_s: float) -> Array:
    """Goals of the fastest move within rate and acceleration, all joints together, shape (n, dof).

    The last row is the end.
    """
    distance, most = float(np.max(np.abs(end_rad - start_rad))), limits.acceleration_rad_s2
    rate = min(limits.rate_rad_s, math.sqrt(distance * most))
    rise_s, total_s = rate / most, distance / rate + rate / most
    at_s = np.minimum(period_s * np.arange(1, math.ceil(total_s / period_s) + 1), total_s)
    # Ramps of the rate at both ends; sampled, no mean rate over a period exceeds them.
    ramps = [np.maximum(at_s - t, 0.0) ** 2 for t in (0.0, rise_s, total_s - rise_s, total_s)]
    way = 0.5 * most * (ramps[0] - ramps[1] - ramps[2] + ramps[3]) / distance
    return np.asarray(start_rad + way[:, None] * (end_rad - start_rad))


def zvd_impulses(mode: LinearMode) -> list[tuple[float, float]]:
    """Delay in s and weight of each of the three impulses."""
    k, half = mode.decay, mode.half_period_s
    total = (1.0 + k) ** 2
    return [(0.0, 1.0 / total), (half, 2.0 * k / total), (2.0 * half, k * k / total)]


def shaped(column: Array, impulses: list[tuple[float, float]], period_s: float) -> Array:
    """Sum of delayed copies of a column (n,) that rests at its first value before, shape (n,)."""
    rows = np.arange(len(column), dtype=np.float64)
    copies = [w * np.interp(rows - delay / period_s, rows, column) for delay, w in impulses]
    return np.asarray(np.sum(copies, axis=0))
