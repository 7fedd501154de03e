"""Document of a plan: goals over a grid of payloads that lead the tip along a path.

`python -m models plan` writes it, the robot reads it. Rows are control periods: first the rest,
then the way to the path, the path, and the way back to rest, so that a plan can be repeated.
"""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from firmware_py.documents import Document, read_document
from firmware_py.errors import InputError
from firmware_py.goals.feedback_design import (
    FeedbackDesign,
    StiffnessSlopes,
    wrong_in_feedback,
)
from firmware_py.goals.probe_design import ProbeDesign, wrong_in_probe
from firmware_py.link.link_facts import LinkFacts

__all__ = ["BestRun", "LearnedRun", "PayloadPlan", "TipPlan", "as_columns", "read_tip_plan"]

Array = NDArray[np.float64]
MOST_ROWS: Final = 100_000
"""Rows of the longest plan that is read: 28 minutes [assumed]."""
_MAKE: Final = "write it anew with python -m models plan"

Columns = tuple[tuple[float, ...], ...]


class PayloadPlan(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Plan for one payload, as the twin predicts it."""

    payload_kg: float
    goals_rad: Columns  # Goals, one column per joint
    tip_m: Columns  # Tip that they give: x, and y where there are two joints
    current_a: Columns  # Motor currents, one column per joint
    residual_rms_m: float  # Root mean square distance of that tip from the path
    rigid_rms_m: float  # The same for goals from rigid kinematics
    # The residual together with the plant's own error on trials that it was not fitted to; in a
    # plan that has learned, with what the runs leave of that error, and the scatter between runs
    expected_rms_m: float
    # Differences that a stiffer link makes; None where the plan has no feedback
    stiffness: StiffnessSlopes | None = None


class LearnedRun(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Recorded run from which a plan was improved."""

    sha256: str  # Hash of the recording
    source: str  # {"mocap", "observer"}, What measured the tip
    payload_kg: float
    # Measured root mean square distance of the tip from the path, bias of the source included
    rms_m: float
    # The same as the twin predicts it for the next run, where all errors repeat
    predicted_rms_m: float
    # Measured time by which the joints follow later than the twin's; 0 where it was not used
    goal_delay_s: float
    gain: float  # Fraction of the full correction that was applied
    stiffness: float  # Those of the link over those of the plant, as the recording tells
    damping: float
    # The prediction together with the scatter between runs, and with the error of the plant where
    # the observer measured the tip
    expected_rms_m: float


class BestRun(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Best recorded run so far at a payload, to which learning goes back after a worse one."""

    run: int  # Its place in `TipPlan.learned`
    goals_rad: Columns  # Goals that were sent
    tip_m: Columns  # Measured tip and joint angles
    angle_rad: Columns


class TipPlan(Document, frozen=True):
    """Plan of a path of the tip."""

    VERSION: ClassVar[int] = 1
    MADE_BY: ClassVar[str] = "python -m models plan"

    path: str
    # {"inverse", "rigid", "zvd"}, Whether the twin was inverted, or, for comparison, the link taken
    # as rigid, or that shaped so that the first mode is not excited
    method: str
    dof: int
    period_s: float  # Control period: the time between two rows
    rest_s: float  # Rest before the motion
    # First row of the path, and the first after it; outside is the way there and back
    start_row: int
    end_row: int
    # Rows between which the path is drawn: the strokes of a text; first and after the last
    drawn: tuple[tuple[int, int], ...]
    desired_m: Columns  # Where the tip is wanted: x, and y where there are two joints
    payloads: tuple[PayloadPlan, ...]  # In rising order of payload
    # Largest rate at which the robot changes the payload between whose plans it interpolates
    payload_rate_kg_s: float
    # Error of the tip of the plant on trials that it was not fitted to
    plant_error_rms_m: float | None
    # Hashes of the plant that was inverted, as the manifest of a bundle has it, and of the manifest
    # of the robot's bundle
    plant_sha256: str
    bundle_sha256: str
    link: LinkFacts  # Facts of the plant's link
    goal_lead_s: float = 0.0  # Time by which learning has moved the goals ahead
    learned: tuple[LearnedRun, ...] = ()  # Runs that improved the plan, in order
    best: tuple[BestRun, ...] = ()  # Best of them, one for each payload that was run
    # Moves from rest to rest: first row, row at which the move itself is over, and the row after
    # the rest that follows
    moves: tuple[tuple[int, int, int], ...] = ()
    feedback: FeedbackDesign | None = None
    # Motion before the first run that tells stiffness and payload; it needs feedback
    probe: ProbeDesign | None = None

    @property
    def name(self) -> str:
        """Name of the motion in trials and logs."""
        words = "".join(c if c.isalnum() else "_" for c in self.path)
        return f"plan_{words}" if self.method == "inverse" else f"plan_{words}_{self.method}"

    @property
    def rows(self) -> int:
        """Number of control periods."""
        return len(self.desired_m[0])

    @property
    def duration_s(self) -> float:
        """Time of one run of the plan, the rest included."""
        return self.rows * self.period_s

    @property
    def grid_kg(self) -> Array:
        """Payloads, rising, shape (p,)."""
        return np.array([own.payload_kg for own in self.payloads])

    @property
    def payloads_in_words(self) -> str:
        """Range of its payloads, like "0 to 2 kg"."""
        low, high = self.payloads[0].payload_kg, self.payloads[-1].payload_kg
        return f"{low:g} to {high:g} kg" if low < high else f"{low:g} kg alone"

    def conditions(self) -> dict[str, str | float]:
        """Conditions of a trial that is a run of the plan, named as in its TOML file."""
        return {
            "motion": self.name,
            "period_s": self.duration_s - self.rest_s,
            "amplitude_rad": float(np.max(np.abs(self.goals_rad()))),
            "phase_2_rad": 0.0,
        }

    def goals_rad(self) -> Array:
        """Goals for each payload, shape (p, n, dof)."""
        return np.array([np.transpose(own.goals_rad) for own in self.payloads])

    def desired_tip_m(self) -> Array:
        """Desired tip, shape (n, dof)."""
        return np.transpose(self.desired_m)


def as_columns(table: Array, decimals: int) -> Columns:
    """Columns of a table as a document holds them, without negative zeros.

    Shapes: `table` (n, columns).
    """
    return tuple(tuple(column) for column in (np.round(table, decimals) + 0.0).T.tolist())


def read_tip_plan(path: Path) -> TipPlan:
    """Read and check a plan."""
    plan = read_document(path, TipPlan)
    if wrong := _wrong_in(plan):
        raise InputError(path, wrong, _MAKE)
    return plan


def _wrong_in(plan: TipPlan) -> str:
    """First thing in a plan that cannot be, as a sentence; empty for none."""
    if plan.dof not in (1, 2):
        return f"is for {plan.dof} joints; 1 or 2 can move"
    if len(plan.desired_m) != plan.dof or not 2 <= plan.rows <= MOST_ROWS:
        return f"needs {plan.dof} columns of 2 to {MOST_ROWS} rows in desired_m"
    if any(len(c) != plan.rows for c in plan.desired_m) or not np.isfinite(plan.desired_m).all():
        return "has columns of different length, or a value that is not finite, in desired_m"
    ends = (plan.start_row, plan.end_row), *plan.drawn
    if not all(0 <= first < after <= plan.rows for first, after in ends):
        return f"has a path or a stroke outside of its {plan.rows} rows"
    if not all(0 <= first < over < after <= plan.rows for first, over, after in plan.moves):
        return f"has a move outside of its {plan.rows} rows"
    if not 1e-3 <= plan.period_s <= 1.0:
        return f"has a period of {plan.period_s:g} s, outside 0.001 to 1 s"
    if not 0 <= plan.rest_s < plan.duration_s:
        return f"rests for {plan.rest_s:g} s of {plan.duration_s:g} s"
    if not plan.payloads:
        return "has no payload"
    if not 0 < plan.payload_rate_kg_s <= 100:
        return f"changes the payload by {plan.payload_rate_kg_s:g} kg/s, outside 0 to 100 kg/s"
    grid = plan.grid_kg
    if not (np.isfinite(grid).all() and grid[0] >= 0 and (np.diff(grid) > 0).all()):
        return "has payloads that are negative or do not rise"
    for own in plan.payloads:
        for name in ("goals_rad", "tip_m", "current_a"):
            columns: Columns = getattr(own, name)
            if len(columns) != plan.dof or any(len(c) != plan.rows for c in columns):
                return f"needs {plan.dof} columns of {plan.rows} rows in {name}"
            if not np.isfinite(columns).all():
                return f"has a value in {name} that is not finite"
    slopes = tuple(own.stiffness for own in plan.payloads)
    if plan.probe is not None and (plan.feedback is None or None in slopes):
        return "has a probe without feedback"
    return (
        _wrong_in_learning(plan)
        or wrong_in_feedback(plan.feedback, slopes, plan.dof, plan.rows)
        or wrong_in_probe(plan.probe, plan.dof)
    )


def _wrong_in_learning(plan: TipPlan) -> str:
    if not abs(plan.goal_lead_s) <= 1.0:
        return f"moves its goals ahead by {plan.goal_lead_s:g} s, more than 1 s"
    for best in plan.best:
        tables = best.goals_rad, best.tip_m, best.angle_rad
        if not 0 <= best.run < len(plan.learned):
            return f"has a best run {best.run} of {len(plan.learned)}"
        if any(len(t) != plan.dof or any(len(c) != plan.rows for c in t) for t in tables):
            return f"needs {plan.dof} columns of {plan.rows} rows in its best runs"
        if not all(np.isfinite(t).all() for t in tables):
            return "has a value in a best run that is not finite"
    return ""
