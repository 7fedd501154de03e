"""Learning from recorded runs of a plan: norm-optimal iterative learning on the twin.

With the goals u sent and the tip y measured, the next goals u + B c minimise::

    |desired - y - S c|^2 + (CHANGE * acceleration of B c)^2

S are the exact derivatives of the twin's tip along the goals sent, B the splines of the plan. The
twin gets the stiffness and damping that are estimated from the recording
(`models.plan.recorded_twin`). Its remaining error that repeats from run to run is contained in y
and need not be known (Amann, Owens and Rogers, *IEE Proc. Control Theory Appl.* 143, 1996; Bristow,
Tharayil and Alleyne, *IEEE Control Systems* 26, 2006). The step is taken as far as the twin itself,
shifted to the recorded run, predicts that it helps. The k-th run at a payload counts with 2 / (k +
1), so that learning averages runs that differ. After a run that was worse than the best one at its
payload, learning goes back to the best one and takes half the step.

Goals for other payloads get a part of the change that falls with the distance in payload, so that
the goals for the recorded payload change by exactly B c and all others as little as is smooth.

Feedback of the tip drives the tip of the observer onto the path, and so would undo what was learned
from motion capture. A plan that learns from motion capture therefore loses its corrections: its
goals contain those of the recorded run.

If joints follow their goals later or earlier than the twin's do, they do so with every payload:
that delay is measured on the recorded angles, and all goals are advanced by it.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from firmware_py.errors import InputError
from firmware_py.goals.plan_goals import check_plan_goals
from firmware_py.goals.tip_plan import BestRun, LearnedRun, PayloadPlan, TipPlan, as_columns
from firmware_py.safety.limits import Limits
from models.plan.expected_error import payload_correlation, unknown_error_m
from models.plan.inversion import goal_splines
from models.plan.plan_timeline import Timeline
from models.plan.recorded_plan_run import RecordedRun, interpolated, payload_weights
from models.plan.recorded_twin import recorded_twin
from models.plan.twin_sensitivity import TipTwin
from models.plant.plant import Plant

Array = NDArray[np.float64]
CHANGE_M_S2: Final = 1e-4
"""Tip error that 1 rad/s² of a change's acceleration outweighs: ten times the weight of planning,
because a measured tip has noise and the twin is least accurate where it hardly moves [assumed]."""
STEPS: Final = 3
"""Gauss–Newton steps with the same derivatives [assumed]."""
WORSE: Final = 1.3
"""RMS of a run over that of the best at its payload, above which learning goes back. Measured on
the rig, circle of 6 s with 1.8 kg: runs of one plan differ by a quarter."""
NEAR_KG: Final = 0.1
"""Difference below which two payloads count as one [assumed]."""
LONGEST_DELAY_PERIODS: Final = 3.0
LEAST_DELAY_PERIODS: Final = 0.25
"""Range of the delays of the joints, and the least delay that is compensated [assumed]."""


@dataclass(frozen=True)
class Improvement:
    """Improved plan, and the run that it learned from."""

    plan: TipPlan
    run: LearnedRun
    went_back: bool  # Whether the recorded run was worse than the best before it


def improve_plan(plan: TipPlan, run: RecordedRun, plant: Plant, limits: Limits) -> Improvement:
    """Improve a plan by a recorded run of it.

    The twin of `plant` gives the derivatives; it may differ from the plant that was inverted.
    """
    _check(plan, run, plant)
    if run.source == "mocap":
        plan = _without_corrections(plan)
    measured_m = _rms(run.tip_m - plan.desired_tip_m())
    start, gain, before = _start(plan, run, measured_m)
    went_back = start is not run
    twin = TipTwin(plant.step_model(plan.dof), plan.dof, plan.period_s)
    step = _Step(plan, start, twin, plant)
    tried: InputError | None = None
    for part in (1.0, 0.5, 0.25, 0.1):
        improved, predicted_m = step.plan(gain * part)
        try:
            check_plan_goals(improved, limits, f"plan {plan.path}, improved")
            break
        except InputError as error:
            tried = error
    else:
        raise tried or InputError("--improve", "changes nothing", "name another recording")
    unknown_m = unknown_error_m(plan, run, [run.payload_kg])[0]
    learned = LearnedRun(
        sha256=run.sha256, source=run.source, payload_kg=run.payload_kg, rms_m=measured_m,
        predicted_rms_m=predicted_m, goal_delay_s=step.delay_s, gain=gain * part,
        stiffness=step.stiffness, damping=step.damping,
        expected_rms_m=float(np.hypot(predicted_m, unknown_m)),
    )  # fmt: skip
    best = plan.best
    if before is None or measured_m < plan.learned[before.run].rms_m:
        own = BestRun(
            run=len(plan.learned), goals_rad=as_columns(run.goals_rad, 7),
            tip_m=as_columns(run.tip_m, 6), angle_rad=as_columns(run.angle_rad, 6),
        )  # fmt: skip
        best = (*(b for b in plan.best if b is not before), own)
    improved = msgspec.structs.replace(improved, learned=(*plan.learned, learned), best=best)
    return Improvement(improved, learned, went_back)


def _check(plan: TipPlan, run: RecordedRun, plant: Plant) -> None:
    """Refuse a run that adds nothing new, or is less accurate than an earlier one."""
    if any(run.sha256 == known.sha256 for known in plan.learned):
        raise InputError(
            "--improve", "names a recording that the plan was improved by already",
            "run the improved plan and name its recording",
        )  # fmt: skip
    if plant.load != "link":
        raise InputError(f"plant {plant.name!r}", "is not the link", "plans are made for the link")
    if run.source != "mocap" and any(known.source == "mocap" for known in plan.learned):
        raise InputError(
            "--improve", "names a log with the tip by the observer, whose error would undo what "
            "the plan has learned from motion capture", "name a trial with motion capture",
        )  # fmt: skip


class _Step:
    """Change of the goals by one recorded run."""

    def __init__(self, plan: TipPlan, run: RecordedRun, twin: TipTwin, plant: Plant) -> None:
        self._plan, self._run = plan, run
        rest = round(plan.rest_s / plan.period_s)
        desired = plan.desired_tip_m()
        line = Timeline(desired, rest, plan.start_row, plan.end_row, plan.drawn)
        self._basis, second = goal_splines(line, plan.period_s)
        self._rough = np.kron(np.eye(plan.dof), CHANGE_M_S2**2 * second.T @ second)
        self._rest, self._error = rest, desired - run.tip_m
        outputs = twin.run(run.goals_rad, run.payload_kg)
        self.delay_s = _delay_s(twin.angle_rad(outputs), run.angle_rad, plan.period_s)
        self._sent = self._late(run.goals_rad)
        twin, self.stiffness, self.damping = recorded_twin(
            twin, plant, self._sent, run.tip_m, run.payload_kg
        )
        self._twin, self._own_tip = twin, twin.tip_m(twin.run(self._sent, run.payload_kg))

    def plan(self, gain: float) -> tuple[TipPlan, float]:
        """Plan with a part of the change, and the RMS error that it predicts for the next run."""
        plan, run, twin = self._plan, self._run, self._twin
        lead_s = self.delay_s - plan.goal_lead_s
        c = gain * self._solved
        wanted = run.goals_rad + self._goals(c)
        tables = [self._moved(t, lead_s) for t in plan.goals_rad()]
        weights = payload_weights(plan, run.goals_payload_kg)
        # The change is spread over payloads like a Gaussian process with this correlation.
        spread = payload_correlation(plan.grid_kg, plan.grid_kg) @ weights
        spread = spread / float(weights @ spread)
        base = np.einsum("p,pnj->nj", weights, np.array(tables))
        change = np.linalg.lstsq(self._basis, wanted - base, rcond=None)[0]
        repeats = run.tip_m - self._own_tip
        unknown = unknown_error_m(plan, run, plan.grid_kg)
        payloads = []
        for own, table, part, off in zip(plan.payloads, tables, spread, unknown, strict=True):
            goals = table + part * (self._basis @ change)
            goals[: self._rest] = 0.0
            outputs = twin.run(self._late(goals), own.payload_kg)
            tip = twin.tip_m(outputs) + part * repeats
            left = _rms(tip - plan.desired_tip_m())
            payloads.append(_next(own, goals, tip, twin.current_a(outputs), left, off))
        improved = msgspec.structs.replace(plan, payloads=tuple(payloads), goal_lead_s=self.delay_s)
        predicted = self._predicted(interpolated(improved, run.goals_payload_kg))
        return improved, _rms(predicted - plan.desired_tip_m())

    @functools.cached_property
    def _solved(self) -> Array:
        """Coefficients of the change, as far as the shifted twin predicts that it helps."""
        slopes = self._twin.slopes(self._sent, self._late(self._basis), self._run.payload_kg)
        slopes = slopes.reshape(-1, slopes.shape[2])
        normal = slopes.T @ slopes + self._rough
        normal[np.diag_indices_from(normal)] += 1e-12 * np.trace(normal)
        c, cost = np.zeros(slopes.shape[1]), float(np.sum(self._error**2))
        error = self._error
        for _ in range(STEPS):
            step = np.linalg.solve(normal, slopes.T @ error.ravel() - self._rough @ c)
            for part in (1.0, 0.5, 0.25, 0.1):
                tried = c + part * step
                tip = self._predicted(self._run.goals_rad + self._goals(tried))
                own_error = self._plan.desired_tip_m() - tip
                own = float(np.sum(own_error**2) + tried @ self._rough @ tried)
                if own < cost:
                    c, cost, error = tried, own, own_error
                    break
            else:
                break
        return c

    def _predicted(self, goals_rad: Array) -> Array:
        """Tip of the recorded run with other goals: the measured tip plus the twin's change."""
        outputs = self._twin.run(self._late(goals_rad), self._run.payload_kg)
        return self._run.tip_m + self._twin.tip_m(outputs) - self._own_tip

    def _goals(self, c: Array) -> Array:
        return np.asarray(self._basis @ c.reshape(self._plan.dof, -1).T)

    def _late(self, table: Array) -> Array:
        return self._moved(table, -self.delay_s)

    def _moved(self, table: Array, lead_s: float) -> Array:
        """Table advanced by a time that need not be whole periods."""
        if lead_s == 0.0:
            return table
        rows = np.arange(len(table), dtype=np.float64)
        at = rows + lead_s / self._plan.period_s
        return np.column_stack([np.interp(at, rows, column) for column in table.T])


def _delay_s(twin_rad: Array, measured_rad: Array, period_s: float) -> float:
    """Delay of measured angles behind those of the twin; 0 if it is small."""
    rows = np.arange(len(twin_rad), dtype=np.float64)

    def distance(periods: float) -> float:
        late = [np.interp(rows - periods, rows, column) for column in twin_rad.T]
        return float(np.sum((measured_rad - np.column_stack(late)) ** 2))

    grid = np.arange(-LONGEST_DELAY_PERIODS, LONGEST_DELAY_PERIODS + 1e-9, 0.05)
    found = float(grid[int(np.argmin([distance(p) for p in grid]))])
    if abs(found) < LEAST_DELAY_PERIODS or abs(found) > LONGEST_DELAY_PERIODS - 0.1:
        return 0.0
    return found * period_s


def _next(
    own: PayloadPlan, goals: Array, tip: Array, current: Array, left_m: float, off_m: float
) -> PayloadPlan:
    """Plan for one payload after a part of a change, with the expected remaining error."""
    return msgspec.structs.replace(
        own, goals_rad=as_columns(goals, 7), tip_m=as_columns(tip, 6),
        current_a=as_columns(current, 4), residual_rms_m=left_m,
        expected_rms_m=float(np.hypot(left_m, off_m)),
    )  # fmt: skip


def _start(
    plan: TipPlan, run: RecordedRun, measured_m: float
) -> tuple[RecordedRun, float, BestRun | None]:
    """Run to start from, fraction of the step, and the best earlier run at this payload."""
    near = [r for r in plan.learned if _alike(r, run)]
    gain = 2.0 / (len(near) + 2.0)
    alike = [b for b in plan.best if _alike(plan.learned[b.run], run)]
    best = alike[-1] if alike else None
    if best is None or measured_m <= WORSE * plan.learned[best.run].rms_m:
        return run, gain, best
    known = plan.learned[best.run]
    goals, angle, tip = (np.transpose(t) for t in (best.goals_rad, best.angle_rad, best.tip_m))
    start = RecordedRun(
        goals, angle, tip, known.payload_kg, run.goals_payload_kg,
        known.source, run.sha256,
    )  # fmt: skip
    return start, 0.5 * gain, best


def _alike(known: LearnedRun, run: RecordedRun) -> bool:
    """Whether errors of two runs are comparable: same payload, and same source of the tip."""
    return known.source == run.source and abs(known.payload_kg - run.payload_kg) < NEAR_KG


def _without_corrections(plan: TipPlan) -> TipPlan:
    """Plan without feedback; with a probing motion, which needs it, the corrections are set to
    zero.
    """
    if plan.feedback is None:
        return plan
    if plan.probe is not None:
        return msgspec.structs.replace(
            plan, feedback=msgspec.structs.replace(plan.feedback, size_rad=0.0)
        )
    payloads = tuple(msgspec.structs.replace(own, stiffness=None) for own in plan.payloads)
    return msgspec.structs.replace(plan, feedback=None, payloads=payloads)


def _rms(error: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(error**2, axis=1))))
