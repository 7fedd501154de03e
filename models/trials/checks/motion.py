"""Motion of a trial of the link: angles against markers and goals, currents, goals as stated.

The direction of the first marker row follows the joint angles, the angles follow their goals, and
the current drives against friction and holds the weight. The goals have the period, phase and
amplitude that the conditions state.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

from firmware_py.core.motion import KINDS
from models.shared.kinematics import base_rotation, pointing_angles_rad
from models.trials.checks import causes
from models.trials.checks.causes import ImportFinding
from models.trials.recordings.series import row_centre_m
from models.trials.trial import Array, Trial

LEAST_MOTION_RAD: Final = 0.03
"""Smallest standard deviation of an angle for a motion to be judged."""
MOVING_RAD_S: Final = 0.05
"""Speed above which friction has its full value."""
STANDARD_M_S2: Final = 9.81
ALIKE: Final = 0.9
"""Smallest correlation of two signals with the same motion."""


def judge_motion(trial: Trial) -> list[ImportFinding]:
    """Findings on the motion of a trial of the link, the most likely cause first."""
    return [*_against_link(trial), *_against_goals(trial), *_against_currents(trial)]


def link_direction(trial: Trial) -> Array | None:
    """Direction of the first row (or the tip) from the joint axes, unit vectors (n, 3), or None."""
    if "m01_x_m" not in trial.columns:
        return None
    for root_m in (row_centre_m(trial.marker_rows_m[:, 0], trial.meta.layout), trial.tip_m):
        apart_m = np.linalg.norm(root_m, axis=1, keepdims=True)
        direction = root_m / np.where(apart_m > 0, apart_m, np.nan)  # the origin has no direction
        if np.isfinite(direction).all(axis=1).mean() >= 0.5:
            return np.asarray(direction)
    return None


ANGLE_UNITS: Final = (
    ("turns, not in rad", 2 * np.pi), ("rad twice converted from deg", np.degrees(1.0)),
    ("mrad, not in rad", 1e-3),
)  # fmt: skip
"""Mistakes in the unit of an angle, and how far the link turns per radian that it says."""


def _against_link(trial: Trial) -> list[ImportFinding]:
    """Findings on signs, joints, direction and size of the angles against the link's direction."""
    direction, angle, dof = link_direction(trial), trial.angle_rad, trial.meta.dof
    if direction is None or not np.isfinite(angle).all():
        return []
    visible = np.isfinite(direction).all(axis=1)
    direction, angle = direction[visible], angle[visible]
    pointing = pointing_angles_rad(direction)[:, :dof]
    if max(angle.std(axis=0).max(), pointing.std(axis=0).max()) < LEAST_MOTION_RAD:
        return []
    findings = _signs_and_joints(pointing, angle)
    if findings:
        return findings
    nominal = base_rotation(angle)[:, :, 2]
    moved, due = (v[:, :2] - v[:, :2].mean(axis=0) for v in (direction, nominal))
    if dof == 1:
        _, (along, across), _ = np.linalg.svd(moved, full_matrices=False)
        findings = causes.SECOND_JOINT.beyond(across / along if along > 0 else 0.0)
    if findings or not np.sum(due * due) > 0:  # or the angles stand still
        return findings
    along = np.sum(due * moved)
    across = np.sum(due[:, 0] * moved[:, 1] - due[:, 1] * moved[:, 0])
    gain = float(np.hypot(along, across) / np.sum(due * due))
    units = [name for name, factor in ANGLE_UNITS if abs(gain / factor - 1) < 0.15]
    unit = f": it is in {units[0]}" if units else ""
    aside = causes.MOVED_ASIDE.beyond(float(np.arctan2(across, along)))
    return aside or causes.GAIN.beyond(gain - 1, gain=gain, unit=unit)


def _signs_and_joints(pointing: Array, angle: Array) -> list[ImportFinding]:
    """Findings on signs and order of the joints, comparing each direction with each angle."""
    joints = range(angle.shape[1])
    fit = np.array([[correlation(pointing[:, i], angle[:, j]) for j in joints] for i in joints])
    findings = [
        finding
        for j in joints
        if fit[j, j] < -ALIKE
        for finding in causes.SIGN.raised(joint=j + 1, correlation=fit[j, j])
    ]
    if findings or len(joints) == 1:
        return findings
    crossed = np.abs(fit[[0, 1], [1, 0]]).min()
    is_swapped = crossed > ALIKE and fit.diagonal().min() < crossed - 0.1
    return causes.JOINTS_SWAPPED.raised() if is_swapped else []


def correlation(a: Array, b: Array) -> float:
    """Correlation of two signals; 1 if one of them hardly moves."""
    if min(a.std(), b.std()) < LEAST_MOTION_RAD:
        return 1.0
    return float(np.corrcoef(a, b)[0, 1])


def runs_against(goal_rad: Array, angle_rad: Array) -> bool:
    """Whether the angle (n,) of a joint mirrors its goal (n,): one of them has the wrong sign."""
    return correlation(angle_rad, goal_rad) < -ALIKE


def _against_goals(trial: Trial) -> list[ImportFinding]:
    findings: list[ImportFinding] = []
    goal, angle, stated_rad = trial.goal_rad, trial.angle_rad, trial.meta.amplitude_rad
    for j, (q, g) in enumerate(zip(angle.T, goal.T, strict=True), start=1):
        if not np.isfinite(q).all() or min(q.std(), g.std()) < LEAST_MOTION_RAD:
            continue
        factor = float(q.std() / g.std())
        if runs_against(g, q):
            findings += causes.GOAL_AGAINST.raised(joint=j)
        elif not 0.3 < factor < 3.0:
            findings += causes.GOAL_FACTOR.raised(joint=j, factor=factor)
        elif (lead := _lead(g, q)) > 0:
            findings += causes.GOAL_BEHIND.raised(joint=j, lead_s=lead * trial.step_s)
    # A motion may begin away from zero, and a servo's zero may be elsewhere.
    reaches = (float(np.max(np.abs(goal - goal[0]))), float(np.max(np.abs(goal))))
    reach_rad = min(reaches, key=lambda reach: abs(reach - stated_rad))
    if reach_rad > LEAST_MOTION_RAD:
        off = (reach_rad - stated_rad) / max(reach_rad, stated_rad)
        findings += causes.AMPLITUDE.beyond(off, reach_rad=reach_rad, stated_rad=stated_rad)
    return findings


def _lead(goal: Array, angle: Array) -> int:
    """Samples by which an angle moves before its goal; 0 if it does not resemble the goal."""
    if correlation(goal, angle) < 0.95:
        return 0
    inner = slice(5, -5)
    delayed = [np.var(np.roll(angle, lead)[inner] - goal[inner]) for lead in range(-5, 6)]
    return int(np.argmin(delayed)) - 5


# --- currents ------------------------------------------------------------------------------------


def _against_currents(trial: Trial) -> list[ImportFinding]:
    """Findings on order, sign and weight of the currents.

    A joint holds the torque of gravity g on the link with direction u: its current is in proportion
    to -g·∂u/∂angle, and friction adds a term along the motion. If both have the wrong sign, it is
    that of the current; if only the weight differs, it is the stated gravity.
    """
    findings = causes.CURRENTS_SWAPPED.raised() if _are_swapped(trial) else []
    stated = np.array(trial.meta.gravity)
    reach_m = trial.meta.base_offset_m + trial.meta.link_length_m
    for j, (current, q) in enumerate(zip(trial.current_a.T, trial.angle_rad.T, strict=True)):
        rate = np.gradient(q, trial.step_s)
        if not np.isfinite(current + q).all() or np.std(rate) < MOVING_RAD_S:
            continue
        both_ways = min(q.max(), -q.min()) > LEAST_MOTION_RAD and not stated[:2].any()
        if both_ways and current.min() >= 0.0 < current.std():
            findings += causes.CURRENT_SIZE.raised(joint=j + 1)
        step_rad = 1e-4 * np.eye(trial.meta.dof)[j]
        ends = [base_rotation(trial.angle_rad + way * step_rad)[:, :, 2] for way in (1, -1)]
        lever = (ends[1] - ends[0]) / 2e-4
        known = np.sqrt((lever**2).mean(axis=0)) > 0.1  # relative to the link's length
        design = np.column_stack([lever[:, known], np.tanh(rate / MOVING_RAD_S)])
        terms, *_ = np.linalg.lstsq(design, current, rcond=None)
        shown, due = np.zeros(3), np.where(known, stated, 0.0)
        shown[known] = terms[:-1]
        sizes = float(np.linalg.norm(shown) * np.linalg.norm(due))
        if np.linalg.norm(due) < 0.5 * np.linalg.norm(stated) or sizes == 0.0:
            continue
        along = float(shown @ due) / sizes
        part = np.linalg.norm(design[:, :-1] @ terms[:-1]) / np.linalg.norm(current)
        noise = max(0.2 * np.std(current - design @ terms), 0.1 * current.std())
        is_slow = rate.var() / q.var() * reach_m < 0.5 * STANDARD_M_S2  # weight outweighs inertia
        if terms[-1] < -noise and along < -0.5 and part > 0.1:
            findings += causes.CURRENT_SIGN.raised(joint=j + 1)
        elif terms[-1] > noise and along < 0.5 and part > 0.5 and is_slow:
            direction = shown / np.linalg.norm(shown)
            findings += causes.GRAVITY_DIRECTION.raised(joint=j + 1, shown=direction, stated=stated)
    return findings


def current_terms(current: Array, angle: Array, step_s: float) -> tuple[Array, Array]:
    """Fit a current by an offset, the sine of the angle (load) and the rate's sign (friction).

    `current` and `angle` have shape (n,). Returns the three coefficients in A, (3,), and the
    residual, (n,).
    """
    rate = np.gradient(angle, step_s)
    design = np.column_stack([np.ones_like(angle), np.sin(angle), np.tanh(rate / MOVING_RAD_S)])
    terms, *_ = np.linalg.lstsq(design, current, rcond=None)
    return terms, current - design @ terms


def _are_swapped(trial: Trial) -> bool:
    """Whether each of two currents fits the other joint's motion better.

    The ratio of the residual variances is at most 0.4 on the rig, 2.4 and more if the currents are
    exchanged.
    """
    angle, current = trial.angle_rad, trial.current_a
    moves = np.isfinite(angle + current).all() and angle.std(axis=0).min() > LEAST_MOTION_RAD
    if trial.meta.dof == 1 or not moves:
        return False
    return all(
        current_terms(current[:, i], angle[:, i], trial.step_s)[1].var()
        > 1.5 * current_terms(current[:, i], angle[:, 1 - i], trial.step_s)[1].var()
        for i in (0, 1)
    )


# --- goals ---------------------------------------------------------------------------------------


def judge_goals(trial: Trial) -> list[ImportFinding]:
    """Findings on the goals of a whole trial."""
    findings = [*judge_standing_goals(trial), *_missing_rows(trial)]
    return [*(findings or _sinusoid(trial)), *_phase(trial)]


def judge_standing_goals(trial: Trial) -> list[ImportFinding]:
    """Findings on goals that do not move although the conditions state an amplitude.

    Goals do not move if a joint was moved by hand; such a trial has `amplitude_rad = 0`. There are
    no findings on a trial of a plant that is not the link.
    """
    stated_rad = trial.meta.amplitude_rad
    if not trial.meta.link_length_m > 0 or not stated_rad > LEAST_MOTION_RAD:
        return []
    moved_rad = np.ptp(trial.goal_rad, axis=0)
    for j, (goal, angle) in enumerate(zip(trial.goal_rad.T, trial.angle_rad.T, strict=True)):
        # No servo that holds its goal lets the joint move by 11 degrees.
        beyond_rad = np.ptp(angle) - moved_rad[j]
        if np.std(goal) < LEAST_MOTION_RAD and np.isfinite(angle).all() and beyond_rad > 0.2:
            return causes.STILL_GOAL.raised(
                joint=j + 1, moved_rad=np.ptp(angle), goal_rad=moved_rad[j]
            )
    if not moved_rad.any():
        return causes.STILL_GOALS.raised(stated_rad=stated_rad)
    return [] if moved_rad.all() else causes.IDLE_JOINT.raised(joint=int(np.argmin(moved_rad)) + 1)


def _missing_rows(trial: Trial) -> list[ImportFinding]:
    """Finding on a row in which goal and angle jump together.

    An angle lags its goal, and cannot follow a step of it within 50 ms.
    """
    if trial.step_s > 0.05 or len(trial) < 8:
        return []
    for j in range(trial.meta.dof):
        goal, angle = (_jumps(values[:, j]) for values in (trial.goal_rad, trial.angle_rad))
        row = int(np.argmax(np.where(goal * angle > 0, np.abs(angle), 0.0)))
        if goal[row] * angle[row] > 0:
            return causes.MISSING_ROWS.raised(
                joint=j + 1, jump=angle[row], row=row + 3, at_s=trial.time_s[row + 1]
            )
    return []


def _jumps(values: Array) -> Array:
    """Changes from row to row, (n - 1,), that differ much from adjacent ones; else zero.

    A jump is 0.02 rad, thirteen steps of a coarse encoder, and twenty times the median change of
    the rate.
    """
    change = np.diff(values)
    limit = max(0.02, 20 * float(np.median(np.abs(np.diff(change)))))
    padded = np.pad(np.abs(change), 2, mode="edge")
    beside = np.max([padded[k : k + len(change)] for k in (0, 1, 3, 4)], axis=0)
    wrapped = np.abs(np.abs(change) - 2 * np.pi) < 0.5
    jumps = (np.abs(change) - 1.5 * beside > limit) & ~wrapped
    return np.asarray(np.where(jumps, change, 0.0))


class SineFit(NamedTuple):
    """Sinusoid fitted to samples."""

    period_s: float
    amplitude: complex  # With the phase at the first sample, as Re(−i a exp(iωt))
    residual: float  # Root mean square


def fit_sine(time_s: Array, goal_rad: Array, period_s: float) -> SineFit:
    """Fit a sinusoid with a known period to goals (n,)."""
    phase = 2 * np.pi * (time_s - time_s[0]) / period_s
    design = np.column_stack([np.ones_like(phase), np.sin(phase), np.cos(phase)])
    terms, *_ = np.linalg.lstsq(design, goal_rad, rcond=None)
    residual = float(np.sqrt(np.mean((goal_rad - design @ terms) ** 2)))
    return SineFit(period_s, complex(terms[1], terms[2]), residual)


def _sinusoid(trial: Trial) -> list[ImportFinding]:
    """Findings on the period of a sinusoid, and on a sinusoid under another name."""
    meta, rest, period_s = trial.meta, trial.meta.rest_samples, trial.meta.period_s
    goal, time_s = trial.goal_rad[rest:, 0], trial.time_s[rest:]
    if meta.motion not in KINDS or len(goal) < 8 or goal.std() < LEAST_MOTION_RAD:
        return []
    # A motion may end with a return to zero of a second, or continue at rest after two periods.
    length_s = min(time_s[-1] - time_s[0] - 1.2, 1.9 * period_s)
    window = time_s <= time_s[0] + length_s
    if length_s < 0.95 * period_s or not goal[window].std() > 0:
        return []
    time_s, goal = time_s[window], goal[window]
    is_sinusoid = meta.motion == "sinusoid"
    is_sampled = period_s > 4 * trial.step_s
    stated = fit_sine(time_s, goal, period_s)
    if is_sinusoid and not (is_sampled and stated.residual**2 < 0.5 * goal.var()):
        return causes.NO_SINUSOID.raised(period_s=period_s)
    if not is_sampled:
        return []
    best = minimize_scalar(
        lambda other_s: fit_sine(time_s, goal, other_s).residual, method="bounded",
        bounds=(0.7 * period_s, 1.3 * period_s), options={"xatol": 1e-6 * period_s},
    )  # fmt: skip
    fit = fit_sine(time_s, goal, float(best.x))
    # The steps of a small servo leave 0.001 of 30°, or two thirds of a step of 1.5 mrad.
    if fit.residual > max(0.01 * abs(fit.amplitude), 1e-3):
        return []
    if not is_sinusoid:  # below one and a half periods it may be another motion
        is_long = length_s >= 1.5 * fit.period_s
        return causes.MOTION.raised(period_s=fit.period_s, motion=meta.motion) if is_long else []
    if stated.residual < 3 * fit.residual:
        return []
    off = abs(fit.period_s / period_s - 1)
    return causes.PERIOD.beyond(off, period_s=fit.period_s, stated_s=period_s)


def _phase(trial: Trial) -> list[ImportFinding]:
    """Finding if joint 2 leads joint 1 by another phase than the conditions state."""
    meta = trial.meta
    if meta.dof != 2 or meta.motion != "sinusoid":
        return []
    # The second half of the first cycle and the first half of the second: joint 2 is faded in.
    start_s = trial.time_s[min(meta.rest_samples, len(trial) - 1)] + 0.5 * meta.period_s
    cycle = (trial.time_s >= start_s) & (trial.time_s < start_s + meta.period_s)
    if trial.time_s[-1] < start_s + 0.9 * meta.period_s or cycle.sum() < 8:
        return []
    goals = trial.goal_rad[cycle].T
    one, two = (fit_sine(trial.time_s[cycle], goal, meta.period_s) for goal in goals)
    if any(
        np.std(goal) < LEAST_MOTION_RAD or fit.residual**2 > 0.1 * np.var(goal)
        for goal, fit in zip(goals, (one, two), strict=True)
    ):
        return []  # no phase is defined
    lead = two.amplitude / one.amplitude
    off = float(np.angle(lead * np.exp(-1j * meta.phase_2_rad)))
    shown = float(np.angle(lead * np.exp(1e-9j)))  # half a turn is positive
    return causes.PHASE.beyond(off, lead_rad=shown, stated_rad=meta.phase_2_rad)
