"""Plan of a path of the tip: the goals that lead it there, although the link bends."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from firmware_py.config import UNWATCHED_RATE_RAD_S
from firmware_py.core.documents import write_document
from firmware_py.core.errors import InputError
from firmware_py.core.units import ANGLE, CURRENT, LENGTH, TIME
from firmware_py.goals.tip_plan import TipPlan
from firmware_py.inference.bundle import ModelBundle
from firmware_py.inference.manifest import read_bundle_files
from firmware_py.link.link_description import STUDY_LINK
from firmware_py.safety.limits import Limits, limits_of_link
from models.bundle.plant import compare_with_bundle
from models.plan.paths import DesiredPath, PathOptions, built_in_path, read_path
from models.plan.planning import Method, PlanRequest, plan_path, shortest_move_s
from models.plan.probing import expected_deviation
from models.plant.plant import Plant

if TYPE_CHECKING:
    from matplotlib.figure import Figure


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
        from models.plan.picture import draw_plan

        path = Path(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        write_document(path, self.document)
        draw_plan(self.document, path.with_suffix(".svg"))
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
            chosen = PathOptions(size_m, tuple(centre_m), seconds, turns, angle_rad, duration_s)
            return _desired(path, dof, period_s, chosen)

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
