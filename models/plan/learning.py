"""Learning from recorded runs of a plan: norm-optimal iterative learning on the twin.

With the goals u sent and the tip y measured, the next goals u + B c minimise::

    |desired - y - S c|^2 + (CHANGE * acceleration of B c)^2

S are the exact derivatives of the twin's tip along the goals sent, B the splines of the plan. The
twin gets the stiffness and damping of the link that fit the recording. Its remaining error that
repeats from run to run is contained in y and need not be known (Amann, Owens and Rogers, *IEE Proc.
Control Theory Appl.* 143, 1996; Bristow, Tharayil and Alleyne, *IEEE Control Systems* 26, 2006).
The step is taken as far as the twin itself, shifted to the recorded run, predicts that it helps.
The k-th run at a payload counts with 2 / (k + 1), so that learning averages runs that differ. After
a run that was worse than the best one at its payload, learning goes back to the best one and takes
half the step.

Goals for other payloads get a part of the change that falls with the distance in payload, so that
the goals for the recorded payload change by exactly B c and all others as little as is smooth.

Feedback of the tip drives the tip of the observer onto the path, and so would undo what was learned
from motion capture. A plan that learns from motion capture therefore loses its corrections: its
goals contain those of the recorded run.

If joints follow their goals later or earlier than the twin's do, they do so with every payload:
that delay is measured on the recorded angles, and all goals are advanced by it.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Final

import numpy as np
from msgspec.structs import replace
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import least_squares
from scipy.signal import correlate

from firmware_py.core.errors import InputError
from firmware_py.core.signals import tip_names
from firmware_py.goals.plan_goals import check_plan_goals
from firmware_py.goals.tip_plan import BestRun, LearnedRun, TipPlan, as_columns
from firmware_py.log.recording import logged_run, read_recording
from firmware_py.safety.limits import Limits
from firmware_py.safety.states import SafetyState
from models.plan.inversion import GoalSplines, gauss_newton, rms
from models.plan.tip_twin import TipTwin
from models.plant.linear_twin import STIFFNESS
from models.plant.plant import Plant
from models.trials.files import read_trial

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RecordedRun:
    """One run of a plan."""

    goals_rad: Array  # (n, dof), goals sent at each row
    angle_rad: Array  # (n, dof), angles measured at each row
    tip_m: Array  # (n, dof)
    # Mass at the tip: the trial's, or the one that the robot was set to or estimated
    payload_kg: float
    goals_payload_kg: float  # Payload, within the grid, that the goals were interpolated at
    source: str  # Source of the tip: "mocap" or "observer"
    sha256: str  # Hash of the file


ALIKE: Final = 0.15
"""Largest RMS difference of the goals sent from those of the plan, over the RMS of the latter, at
which a recording counts as a run of it [assumed]: goals for payloads 2 kg apart differ by 0.1."""
MOST: Final = 1e6
"""Largest goal, angle or place, in radians and metres, far beyond any robot [assumed]: the squares
of larger ones could overflow."""
LEAST_FRESH: Final = 0.9
"""Least fraction of rows with a measurement; between them it is interpolated [assumed]."""
CORRECTED_KG: Final = 0.25
"""Distance from the mass at the tip within which corrections, not another payload, explain the
goals of a trial [assumed]: half the step of the default grid."""


def read_plan_run(path: Path, plan: TipPlan) -> RecordedRun:
    """Read the last complete run of a plan from a trial (`.csv`) or a log of the robot (`.mcap`).

    A trial holds the tip by motion capture and the mass at the tip, a log the tip that the robot
    predicted with its observer. Of several runs the last complete one counts, because the robot's
    estimate of the payload has settled there.
    """
    is_trial = path.suffix.lower() == ".csv"
    table, payload_kg, assumed_kg = (_of_trial if is_trial else _of_log)(path, plan)
    for what, values in ((path, table), (f"plan {plan.path}", plan.goals_rad())):
        if not np.all(np.abs(values) < MOST):
            wrong = f"has goals, angles or places that are not finite or beyond {MOST:g}"
            raise InputError(what, wrong, "record it again")
    start = _start_row(table[:, : plan.dof], plan)
    table = table[start : start + plan.rows]
    goals, angle, tip = np.split(table, 3, axis=1)
    fitting_kg, difference = fitting_payload(plan, goals)
    if difference > ALIKE * np.sqrt(np.mean(interpolated(plan, fitting_kg) ** 2)):
        raise InputError(
            path, f"is no run of the plan {plan.path}: its goals differ by {difference:.3f} rad",
            "name a recording of this plan",
        )  # fmt: skip
    goals_kg = _goals_payload_kg(plan, fitting_kg, payload_kg, assumed_kg)
    return RecordedRun(
        goals, angle, tip, goals_kg if payload_kg is None else payload_kg, goals_kg,
        "mocap" if is_trial else "observer", hashlib.sha256(path.read_bytes()).hexdigest(),
    )  # fmt: skip


def _of_log(path: Path, plan: TipPlan) -> tuple[Array, float | None, float | None]:
    """Goals, angles and tip of the last complete run, the mass at the tip, and the payload that the
    robot used.
    """
    log = read_recording(path)
    columns, names = log.columns, _columns(path, log.dof, plan, tip_names("predicted_"))
    table, tick = np.column_stack([columns[n] for n in names]), columns["tick"].astype(np.int64)
    fresh = (columns["stale_ticks"] == 0) & (columns["state"] < SafetyState.STOPPING)
    fresh &= np.isfinite(table).all(axis=1)
    runs = int(tick[fresh].max(initial=-1) + 1) // plan.rows
    if runs < 1:
        raise InputError(path, f"ends before the {plan.rows} rows of the plan", "run it once whole")
    grid = np.arange((runs - 1) * plan.rows, runs * plan.rows, dtype=np.float64)
    inside = fresh & (tick >= grid[0]) & (tick <= grid[-1])
    measured = np.count_nonzero(inside)
    if measured < LEAST_FRESH * plan.rows:
        wrong = f"misses {plan.rows - measured} of {plan.rows} measurements"
        raise InputError(path, wrong, "record the run again")
    facts, estimate = logged_run(log), columns["payload_kg"][inside]
    assumed_kg = facts.assumed_payload_kg
    if assumed_kg is None and np.isfinite(estimate).all():
        assumed_kg = float(estimate.mean())
    return _resampled(grid, tick[inside].astype(float), table[inside]), facts.payload_kg, assumed_kg


def _of_trial(path: Path, plan: TipPlan) -> tuple[Array, float | None, float | None]:
    """Table and mass as in `_of_log`; a trial does not record the payload that the robot used."""
    trial = read_trial(path)
    table = trial.stack(*_columns(path, trial.meta.dof, plan, tip_names()))
    since_s = trial.time_s - trial.time_s[0]
    if np.any(np.mean(np.isfinite(table), axis=0) < LEAST_FRESH):
        raise InputError(path, "has too many empty cells", "record the run again")
    at_s = np.arange(0.0, since_s[-1] + 1e-9, plan.period_s)
    if len(at_s) < plan.rows:
        raise InputError(path, f"is shorter than the {plan.rows} rows of the plan", "run it whole")
    return _resampled(at_s, since_s, table), trial.meta.payload_kg, None


def _columns(path: Path, dof: int, plan: TipPlan, tip: tuple[str, ...]) -> list[str]:
    """Names of the columns of goals, angles and planned coordinates of the tip."""
    if dof != plan.dof:
        raise InputError(
            path, f"is of {dof} joints, the plan of {plan.dof}", "name a recording of this plan"
        )
    return [f"{n}_{j}_rad" for n in ("goal", "angle") for j in range(1, dof + 1)] + [*tip[:dof]]


def _resampled(at: Array, places: Array, table: Array) -> Array:
    """Columns at other places; between them, and in empty cells, they are interpolated linearly."""
    measured = np.isfinite(table)
    return np.column_stack([
        np.interp(at, places[rows], column[rows])
        for column, rows in zip(table.T, measured.T, strict=True)
    ])  # fmt: skip


def _start_row(goals: Array, plan: TipPlan) -> int:
    """Row of a recording at which its last complete run begins, by matching the plan's goals."""
    wanted = np.mean(plan.goals_rad(), axis=0)
    power = np.concatenate([[0.0], np.cumsum(np.sum(goals**2, axis=1))])
    distance = power[plan.rows :] - power[: -plan.rows] + np.sum(wanted**2)
    for planned, sent in zip(wanted.T, goals.T, strict=True):
        distance -= 2.0 * correlate(sent, planned, mode="valid", method="fft")
    # A shift of a run by some rows causes a squared difference of 2 % [assumed]. The start is the
    # minimum within the last valley as deep as that.
    near = distance <= distance.min() + 0.02 * np.sum(wanted**2)
    last = int(np.flatnonzero(near)[-1])
    low = max(0, last - plan.rows // 2)
    return low + int(np.argmin(distance[low : last + 1]))


def _goals_payload_kg(
    plan: TipPlan, fitting_kg: float, payload_kg: float | None, assumed_kg: float | None
) -> float:
    """Payload that the goals were interpolated at.

    The goals sent include the corrections of feedback, which no recording separates. So the payload
    that fits them is right only without corrections. Else it is the one that the robot used, or for
    a trial the mass at the tip, unless the robot estimated that with a large error.
    """
    corrected = plan.feedback is not None and plan.feedback.size_rad > 0.0
    likely_kg = payload_kg if assumed_kg is None else assumed_kg
    if not corrected or likely_kg is None:
        return fitting_kg
    likely_kg = float(np.clip(likely_kg, plan.grid_kg[0], plan.grid_kg[-1]))
    is_near = assumed_kg is not None or abs(fitting_kg - likely_kg) <= CORRECTED_KG
    return likely_kg if is_near else fitting_kg


def interpolated(plan: TipPlan, payload_kg: float) -> Array:
    """Goals of a plan for a payload, as the robot interpolates them, shape (n, dof)."""
    return np.asarray(np.einsum("p,pnj->nj", payload_weights(plan, payload_kg), plan.goals_rad()))


def payload_weights(plan: TipPlan, payload_kg: float) -> Array:
    """Weight of the goals for each payload of the grid in the interpolation, shape (p,)."""
    grid = plan.grid_kg
    return np.array([np.interp(payload_kg, grid, row) for row in np.eye(len(grid))])


def fitting_payload(plan: TipPlan, goals_rad: Array) -> tuple[float, float]:
    """Payload whose interpolated goals are nearest to those sent (n, dof), and the RMS difference.

    Between two payloads of the grid the goals lie on a line, onto which those sent are projected.
    """
    tables, grid = plan.goals_rad(), plan.grid_kg
    if len(grid) == 1:
        tables, grid = np.repeat(tables, 2, axis=0), np.repeat(grid, 2)
    candidates = []
    for k, (low, high) in enumerate(pairwise(tables)):
        way = high - low
        part = np.sum((goals_rad - low) * way) / max(np.sum(way**2), np.finfo(float).tiny)
        part = np.clip(part, 0.0, 1.0)
        difference = float(np.sqrt(np.mean((goals_rad - low - part * way) ** 2)))
        candidates.append((difference, float(grid[k] + part * (grid[k + 1] - grid[k]))))
    difference, payload_kg = min(candidates)
    return payload_kg, difference


CHANGE_M_S2: Final = 1e-4
"""Tip error that 1 rad/s² of a change's acceleration outweighs: ten times the weight of planning,
because a measured tip has noise and the twin is least accurate where it hardly moves [assumed]."""
WORSE: Final = 1.3
"""RMS of a run over that of the best at its payload, above which learning goes back. Measured on
the rig, circle of 6 s with 1.8 kg: runs of one plan differ by a quarter."""


def improve_plan(
    plan: TipPlan, run: RecordedRun, plant: Plant, limits: Limits
) -> tuple[TipPlan, bool]:
    """Plan improved by a recorded run, and whether learning went back to an earlier, better run.

    The twin of `plant` gives the derivatives; it may differ from the plant that was inverted.
    """
    if any(run.sha256 == known.sha256 for known in plan.learned):
        raise InputError(
            "--improve", "names a recording that the plan was improved by already",
            "run the improved plan and name its recording",
        )  # fmt: skip
    if run.source != "mocap" and any(known.source == "mocap" for known in plan.learned):
        raise InputError(
            "--improve", "names a log with the tip by the observer, whose error would undo what "
            "the plan has learned from motion capture", "name a trial with motion capture",
        )  # fmt: skip
    twin = TipTwin(plant, plan.dof, plan.period_s)
    if run.source == "mocap":
        plan = _without_corrections(plan)
    measured_m = rms(run.tip_m - plan.desired_tip_m())

    def is_comparable(known: LearnedRun) -> bool:
        return known.source == run.source and abs(known.payload_kg - run.payload_kg) < 0.1

    gain = 2.0 / (sum(map(is_comparable, plan.learned)) + 2.0)
    comparable = [b for b in plan.best if is_comparable(plan.learned[b.run])]
    best = comparable[-1] if comparable else None
    start, best_m = run, np.inf if best is None else plan.learned[best.run].rms_m
    went_back = measured_m > WORSE * best_m
    if best is not None and went_back:
        start = RecordedRun(
            np.transpose(best.goals_rad), np.transpose(best.angle_rad), np.transpose(best.tip_m),
            plan.learned[best.run].payload_kg, run.goals_payload_kg, run.source, run.sha256,
        )  # fmt: skip
        gain *= 0.5
    step = _Step(plan, start, twin)
    for part in (1.0, 0.5, 0.25, 0.1):
        improved, predicted_m = step.plan(part * gain)
        try:
            check_plan_goals(improved, limits, f"plan {plan.path}, improved")
            break
        except InputError:
            if part == 0.1:
                raise
    learned = LearnedRun(
        sha256=run.sha256, source=run.source, payload_kg=run.payload_kg, rms_m=measured_m,
        predicted_rms_m=predicted_m, goal_delay_s=step.delay_s, gain=part * gain,
        stiffness=step.stiffness, damping=step.damping,
        expected_rms_m=float(np.hypot(predicted_m, unknown_error_m(plan, run, run.payload_kg))),
    )  # fmt: skip
    bests = plan.best
    if measured_m < best_m:
        this = BestRun(
            run=len(plan.learned), goals_rad=as_columns(run.goals_rad, 7),
            tip_m=as_columns(run.tip_m, 6), angle_rad=as_columns(run.angle_rad, 6),
        )  # fmt: skip
        bests = (*(b for b in plan.best if b is not best), this)
    return replace(improved, learned=(*plan.learned, learned), best=bests), went_back


def _without_corrections(plan: TipPlan) -> TipPlan:
    """Plan without feedback; a probing motion needs it, but then the corrections are zero."""
    if plan.feedback is None:
        return plan
    if plan.probe is not None:
        return replace(plan, feedback=replace(plan.feedback, size_rad=0.0))
    payloads = tuple(replace(one, stiffness=None) for one in plan.payloads)
    return replace(plan, feedback=None, payloads=payloads)


class _Step:
    """Change of the goals by one recorded run."""

    def __init__(self, plan: TipPlan, run: RecordedRun, twin: TipTwin) -> None:
        self._plan, self._run, self._desired = plan, run, plan.desired_tip_m()
        self._rest = round(plan.rest_s / plan.period_s)
        splines = GoalSplines(self._desired.shape, self._rest, plan.period_s, CHANGE_M_S2)
        self._splines = splines
        modelled_rad = twin.run(run.goals_rad, run.payload_kg).angle_rad
        self.delay_s = _delay_s(modelled_rad, run.angle_rad, plan.period_s)
        sent = self._late(run.goals_rad)
        self._twin, self.stiffness, self.damping = recorded_twin(
            twin, sent, run.tip_m, run.payload_kg
        )
        # Error that repeats from run to run
        self._repeats = run.tip_m - self._twin.run(sent, run.payload_kg).tip_m

        def error(c: Array) -> Array:
            tip = self._predicted(run.goals_rad + splines.goals(c))
            return np.append(tip - self._desired, splines.rough @ c)

        def slopes(c: Array) -> Array:
            by_c = self._twin.slopes(sent, self._late(splines.basis), run.payload_kg)
            return np.concatenate([by_c.reshape(-1, len(c)), splines.rough])

        c, _ = gauss_newton(error, slopes, np.zeros(len(splines.rough)), 1)
        self._change = splines.goals(c)

    def plan(self, gain: float) -> tuple[TipPlan, float]:
        """Plan with a part of the change, and the RMS error that it predicts for the next run."""
        plan, run = self._plan, self._run
        lead_s = self.delay_s - plan.goal_lead_s
        tables = [self._moved(table, lead_s) for table in plan.goals_rad()]
        weights = payload_weights(plan, run.goals_payload_kg)
        # The change is spread over payloads like a Gaussian process with this correlation.
        spread = payload_correlation(plan.grid_kg, plan.grid_kg) @ weights
        spread = spread / float(weights @ spread)
        base = np.einsum("p,pnj->nj", weights, np.array(tables))
        change = run.goals_rad + gain * self._change - base
        change = self._splines.goals(self._splines.fit(change))
        unknown_m = unknown_error_m(plan, run, plan.grid_kg)
        payloads = []
        for one, table, part, off_m in zip(plan.payloads, tables, spread, unknown_m, strict=True):
            goals = table + part * change
            goals[: self._rest] = 0.0
            twin_run = self._twin.run(self._late(goals), one.payload_kg)
            tip = twin_run.tip_m + part * self._repeats
            residual_m = rms(tip - self._desired)
            payloads.append(
                replace(
                    one, goals_rad=as_columns(goals, 7), tip_m=as_columns(tip, 6),
                    current_a=as_columns(twin_run.current_a, 4), residual_rms_m=residual_m,
                    expected_rms_m=float(np.hypot(residual_m, off_m)),
                )
            )  # fmt: skip
        improved = replace(plan, payloads=tuple(payloads), goal_lead_s=self.delay_s)
        predicted = self._predicted(interpolated(improved, run.goals_payload_kg))
        return improved, rms(predicted - self._desired)

    def _predicted(self, goals_rad: Array) -> Array:
        """Tip of the recorded run with other goals."""
        return self._twin.run(self._late(goals_rad), self._run.payload_kg).tip_m + self._repeats

    def _late(self, table: Array) -> Array:
        return self._moved(table, -self.delay_s)

    def _moved(self, table: Array, lead_s: float) -> Array:
        """Table advanced by a time that need not be whole periods."""
        rows = np.arange(len(table), dtype=np.float64)
        return _resampled(rows + lead_s / self._plan.period_s, rows, table)


LONGEST_DELAY_PERIODS: Final = 3.0
LEAST_DELAY_PERIODS: Final = 0.25
"""Range of the delays of the joints, and the least delay that is compensated [assumed]."""


def _delay_s(twin_rad: Array, measured_rad: Array, period_s: float) -> float:
    """Delay of measured angles behind those of the twin; 0 if it is small."""
    rows = np.arange(len(twin_rad), dtype=np.float64)

    def distance(periods: float) -> float:
        return float(np.sum((measured_rad - _resampled(rows - periods, rows, twin_rad)) ** 2))

    grid = np.arange(-LONGEST_DELAY_PERIODS, LONGEST_DELAY_PERIODS + 1e-9, 0.05)
    delay = float(min(grid, key=distance))
    if abs(delay) > LONGEST_DELAY_PERIODS - 0.1:
        if distance(delay) > 0.5 * distance(0.0):
            return 0.0  # another cause than time
        raise InputError(
            "--improve", f"names a recording whose joints follow {LONGEST_DELAY_PERIODS:g} periods "
            f"or more {'later' if delay > 0 else 'earlier'} than the twin's",
            "check the clock of the recording, or identify the plant again",
        )  # fmt: skip
    return 0.0 if abs(delay) < LEAST_DELAY_PERIODS else delay * period_s


STIFFNESS_SD: Final = 0.2
DAMPING_SD: Final = 0.5
"""Prior standard deviations of the logarithms of both factors [assumed]."""
NOISE_M: Final = 2e-3
"""Standard deviation of the tip about the fitted twin: the error of the demo's plant on trials that
it was not fitted to."""
CORRELATED_S: Final = 0.5
"""Time over which that error counts once: about a period of the first mode."""


def recorded_twin(
    twin: TipTwin, goals_rad: Array, tip_m: Array, payload_kg: float
) -> tuple[TipTwin, float, float]:
    """Twin with the stiffness k and damping c of the link that fit a recorded tip y, and both.

    Learning multiplies errors by the inverse of the twin. At the first mode that inverse is right
    only if the twin has the mode at the frequency of the link: with a link that is a fifth stiffer
    than its plant, errors there did not fall from run to run. The relative k and c minimise::

        sum |y - tip(k, c) - offset|^2 / NOISE^2 + (log k / STIFFNESS_SD)^2 + (log c / DAMPING_SD)^2

    The offset of the recording is free. The priors keep k and c near 1 if a run does not determine
    them. Shapes: `goals_rad` (n, dof), `tip_m` (n, dof).
    """
    sd = np.array([STIFFNESS_SD, DAMPING_SD])
    weight = np.sqrt(twin.period_s / CORRELATED_S) / NOISE_M

    def scaled(logs: Array) -> TipTwin:
        stiffness, damping = np.exp(logs)
        return twin.scaled({STIFFNESS: stiffness, ("root_damping", "span_damping"): damping})

    def off(logs: Array) -> Array:
        other = scaled(logs)
        error = tip_m - other.run(goals_rad, payload_kg).tip_m
        return np.concatenate([weight * (error - error.mean(axis=0)).ravel(), logs / sd])

    logs = least_squares(off, np.zeros(2), bounds=(-4.0 * sd, 4.0 * sd), x_scale=sd, xtol=1e-3).x
    stiffness, damping = (float(f) for f in np.exp(logs))
    return scaled(logs), stiffness, damping


PAYLOAD_REACH_KG: Final = 1.0
"""Distance in payload over which a change fades: correlation length of the learned
goals [assumed]."""
SCATTER: Final = 0.25
"""RMS difference of two runs of a plan over the plant's error. Measured on the rig, circle of 6 s
with 1.8 kg: runs differ by a quarter."""
REMAINS: Final = 1e-3
"""Part of the plant's squared error that remains at the payload of a run [assumed]: without it
several runs at one payload make the equations singular."""


def payload_correlation(a_kg: ArrayLike, b_kg: ArrayLike) -> Array:
    """Correlation of goals and of the plant's error between payloads, shape (a, b)."""
    apart = np.subtract.outer(np.asarray(a_kg), np.asarray(b_kg)) / PAYLOAD_REACH_KG
    return np.asarray(np.exp(-0.5 * apart**2))


def unknown_error_m(plan: TipPlan, run: RecordedRun, payloads_kg: ArrayLike) -> Array:
    """RMS error at payloads that neither the twin nor the recorded runs predict.

    Over payloads the plant's error is a Gaussian process with the correlation by which changes of
    the goals are spread (Rasmussen and Williams, *Gaussian Processes for Machine Learning*, 2006,
    equation 2.26). Its posterior error and the scatter between runs are independent. Runs whose tip
    comes from the observer do not reduce the plant's error: the observer has it too.
    """
    plant_m = plan.plant_error_rms_m or 0.0
    scatter_m = SCATTER * (plant_m or rms(run.tip_m - plan.desired_tip_m()))
    measured_kg = [known.payload_kg for known in plan.learned if known.source == "mocap"]
    if run.source == "mocap":
        measured_kg.append(run.payload_kg)
    among = payload_correlation(measured_kg, measured_kg) + REMAINS * np.eye(len(measured_kg))
    across = payload_correlation(payloads_kg, measured_kg)
    explained = np.sum(across * np.linalg.solve(among, across.T).T, axis=-1)
    variance = np.maximum(1.0 - explained, 0.0)
    return np.asarray(np.hypot(plant_m * np.sqrt(variance), scatter_m))
