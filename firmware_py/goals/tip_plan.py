"""Document of a plan: goals over a grid of payloads that lead the tip along a path; feedback.

`dropstitch plan` writes it, the robot reads it. Each row is a control period. A plan rests,
moves to the path, along it, and back to rest, so that it can be repeated.
"""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from firmware_py.core.documents import Document, read_document
from firmware_py.core.errors import InputError
from firmware_py.goals.stiffness_estimate import ProbeDesign, wrong_in_probe
from firmware_py.link.link_facts import LinkFacts

Columns = tuple[tuple[float, ...], ...]
MOST_STATES: Final = 20
"""Most states of a filter that is read [assumed]."""


class RateFilter(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Discrete filter from the error of the tip in m to the rate of the correction in rad/s."""

    a: Columns  # State matrix of the discrete filter at the period of the plan, shape (n, n)
    b: Columns  # Input matrix, shape (n, 1)
    c: Columns  # Output matrix, shape (1, n)
    d: Columns  # Feedthrough, shape (1, 1)


class LoopMargins(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Smallest stability margins of a loop over the linearised twins at one payload."""

    payload_kg: float
    gain_db: float  # Gain margin, with the delay of loop and bus
    phase_rad: float  # Phase margin, with the delay of loop and bus
    crossover_rad_s: float  # Frequency at which the gain of the loop is 1


class FeedbackDesign(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Feedback of the estimated tip, with a filter for each payload of the plan and each joint."""

    filters: tuple[tuple[RateFilter, ...], ...]  # Filters by payload, then by joint
    margins: tuple[tuple[LoopMargins, ...], ...]  # Stability margins by joint, then by payload
    size_rad: float  # Largest correction of a goal
    rate_rad_s: float  # Largest rate of the correction
    # Root mean square innovation of a current above which the estimate is rejected
    innovation_a: float


class StiffnessSlopes(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Sensitivities to the relative stiffness of the link, at every row of a plan."""

    goals_rad: Columns  # Sensitivity of the goals that keep the tip on the path
    current_a: Columns  # Sensitivity of the currents if link and goals change together
    unmatched_a: Columns  # Sensitivity of the currents if the link changes alone
    friction_a: Columns  # Sensitivity of the current of each joint to its relative friction
    # Weight of a sample of each joint: 0 at rest, where dry friction can take any value
    weight: Columns
    # Sensitivity of the true tip minus the estimate of an observer with the plant's stiffness
    unseen_m: Columns


def _wrong_in_columns(columns: Columns, name: str, dof: int, rows: int) -> str:
    if len(columns) != dof or any(len(column) != rows for column in columns):
        return f"needs {dof} columns of {rows} rows in {name}"
    if not np.isfinite(columns).all():
        return f"has a value in {name} that is not finite"
    return ""


def wrong_in_feedback(
    design: FeedbackDesign | None, slopes: tuple[StiffnessSlopes | None, ...], dof: int, rows: int
) -> str:
    """Return the first error in the feedback of a plan, as a sentence; empty for none."""
    if design is None:
        return ""
    if len(design.filters) != len(slopes) or any(len(filters) != dof for filters in design.filters):
        return f"needs a filter for each of {len(slopes)} payloads and {dof} joints"
    for each in (f for filters in design.filters for f in filters):
        n = len(each.a)
        shapes = ((each.a, n, n), (each.b, n, 1), (each.c, 1, n), (each.d, 1, 1))
        if not 1 <= n <= MOST_STATES or any(
            len(m) != rows_ or any(len(row) != columns for row in m) or not np.isfinite(m).all()
            for m, rows_, columns in shapes
        ):
            return "has a filter whose matrices do not fit together"
        if np.max(np.abs(np.linalg.eigvals(np.array(each.a)))) >= 1.0:
            return "has a filter that is not stable"
    bounds = design.size_rad, design.rate_rad_s, design.innovation_a
    if not (0 <= bounds[0] <= 0.2 and 0 < bounds[1] <= 10 and bounds[2] > 0):
        return f"has feedback with the bounds {bounds}"
    for one in slopes:
        for name in StiffnessSlopes.__struct_fields__ if one is not None else ():
            if wrong := _wrong_in_columns(getattr(one, name), name, dof, rows):
                return wrong
    return ""


Array = NDArray[np.float64]
MOST_ROWS: Final = 100_000
"""Most rows of a plan that is read: 28 minutes [assumed]."""
_MAKE: Final = "write it anew with dropstitch plan"


class PayloadPlan(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Plan for one payload, as the twin predicts it."""

    payload_kg: float
    goals_rad: Columns  # Goals, one column per joint
    tip_m: Columns  # Predicted tip: x, and y with two joints
    current_a: Columns  # Predicted motor currents, one column per joint
    residual_rms_m: float  # Root mean square distance of the predicted tip from the path
    rigid_rms_m: float  # The same for goals from rigid kinematics
    # Expected distance: the residual combined with the plant's error on held-out trials. After
    # learning, combined with the remaining part of that error and the scatter between runs.
    expected_rms_m: float
    # Sensitivities to the stiffness of the link; None without feedback
    stiffness: StiffnessSlopes | None = None


class LearnedRun(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Recorded run from which a plan was improved."""

    sha256: str  # Hash of the recording
    source: str  # What measured the tip: "mocap" or "observer"
    payload_kg: float
    # Measured root mean square distance of the tip from the path, with the bias of the source
    rms_m: float
    # Distance that the twin predicts for the next run if all errors repeat
    predicted_rms_m: float
    # Measured delay of the joints relative to the twin's; 0 if it was not used
    goal_delay_s: float
    gain: float  # Applied fraction of the full correction
    stiffness: float  # Stiffness of the link relative to the plant's, estimated from the recording
    damping: float  # Damping of the link relative to the plant's, estimated from the recording
    # Prediction combined with the scatter between runs, and with the error of the plant if the
    # observer measured the tip
    expected_rms_m: float


class BestRun(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Best recorded run so far at a payload, to which learning returns after a worse one."""

    run: int  # Index in `learned`
    goals_rad: Columns  # Goals sent
    tip_m: Columns  # Measured tip
    angle_rad: Columns  # Measured joint angles


class TipPlan(Document, frozen=True):
    """Plan that leads the tip along a path."""

    VERSION: ClassVar[int] = 1
    MADE_BY: ClassVar[str] = "dropstitch plan"

    path: str
    # How the goals follow from the path: "inverse" of the twin; for comparison "rigid" kinematics,
    # or those with a "zvd" shaper, which does not excite the first mode
    method: str
    dof: int
    period_s: float  # Control period, the time between two rows
    rest_s: float  # Duration of the rest before the motion
    start_row: int  # First row of the path; before it the tip moves there
    end_row: int  # First row after the path; from it on the tip moves back
    # First row, and first row after, of each part of the path that is drawn: the strokes of a text
    drawn: tuple[tuple[int, int], ...]
    desired_m: Columns  # Desired tip: x, and y with two joints
    payloads: tuple[PayloadPlan, ...]  # In rising order of payload
    # Largest rate at which the interpolation between payloads follows the estimated payload
    payload_rate_kg_s: float
    # Root mean square error of the plant's tip on held-out trials; None if it is unknown
    plant_error_rms_m: float | None
    plant_sha256: str  # Hash of the inverted plant, as in the manifest of a bundle
    bundle_sha256: str  # Hash of the manifest of the robot's bundle
    link: LinkFacts  # Facts of the plant's link
    goal_lead_s: float = 0.0  # Time by which learning has advanced the goals
    learned: tuple[LearnedRun, ...] = ()  # Runs from which the plan was improved, in order
    best: tuple[BestRun, ...] = ()  # Best of these runs at each payload
    # Moves from rest to rest: first row, end of the move itself, and end of the rest that follows
    moves: tuple[tuple[int, int, int], ...] = ()
    feedback: FeedbackDesign | None = None  # Feedback of the estimated tip; None without
    # Motion before the first run that estimates stiffness and payload; it requires feedback
    probe: ProbeDesign | None = None

    @property
    def name(self) -> str:
        words = "".join(c if c.isalnum() else "_" for c in self.path)
        return f"plan_{words}" if self.method == "inverse" else f"plan_{words}_{self.method}"

    @property
    def rows(self) -> int:
        return len(self.desired_m[0])

    @property
    def duration_s(self) -> float:
        """Duration of one run of the plan, rest included."""
        return self.rows * self.period_s

    @property
    def grid_kg(self) -> Array:
        """Payloads in rising order, shape (p,)."""
        return np.array([payload.payload_kg for payload in self.payloads])

    @property
    def payloads_in_words(self) -> str:
        """Range of the payloads, like "0 to 2 kg"."""
        low, high = self.payloads[0].payload_kg, self.payloads[-1].payload_kg
        return f"{low:g} to {high:g} kg" if low < high else f"{low:g} kg alone"

    def conditions(self) -> dict[str, str | float]:
        """Return the conditions of a trial that runs the plan, by key of its TOML file."""
        return {
            "motion": self.name,
            "period_s": self.duration_s - self.rest_s,
            "amplitude_rad": float(np.max(np.abs(self.goals_rad()))),
            "phase_2_rad": 0.0,
        }

    def goals_rad(self) -> Array:
        """Goals for each payload, shape (p, n, dof)."""
        return np.array([np.transpose(payload.goals_rad) for payload in self.payloads])

    def desired_tip_m(self) -> Array:
        """Desired tip, shape (n, dof)."""
        return np.transpose(self.desired_m)


def as_columns(table: Array, decimals: int) -> Columns:
    """Return the rounded columns of a table, shape (n, columns), for a document."""
    return tuple(tuple(column) for column in (np.round(table, decimals) + 0.0).T.tolist())


def read_tip_plan(path: Path) -> TipPlan:
    plan = read_document(path, TipPlan)
    if wrong := _wrong_in(plan):
        raise InputError(path, wrong, _MAKE)
    return plan


def _wrong_in(plan: TipPlan) -> str:
    """Return the first error in a plan, as a sentence; empty for none."""
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
    for payload in plan.payloads:
        for name in ("goals_rad", "tip_m", "current_a"):
            if wrong := _wrong_in_columns(getattr(payload, name), name, plan.dof, plan.rows):
                return wrong
    slopes = tuple(payload.stiffness for payload in plan.payloads)
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
        if not 0 <= best.run < len(plan.learned):
            return f"has a best run {best.run} of {len(plan.learned)}"
        for columns in (best.goals_rad, best.tip_m, best.angle_rad):
            if wrong := _wrong_in_columns(columns, "its best runs", plan.dof, plan.rows):
                return wrong
    return ""
