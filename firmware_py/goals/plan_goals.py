"""Goals of a plan: interpolated between the plans for two payloads, by the payload at the tip.

The payload is known, or it is the observer's estimate. A known payload beyond those of the plan is
refused before the run; an estimate beyond them is reported after it, since the goals were then
those of the nearest payload. Every goal lies between those of two plans that keep the limits. The
check before the run includes the rate that a changing payload adds.
"""

from __future__ import annotations

from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from firmware_py.core.errors import InputError
from firmware_py.goals.goal_source import FollowedPayload, OwnGoals, interval_of
from firmware_py.goals.tip_plan import TipPlan
from firmware_py.inference.estimator import Estimate
from firmware_py.safety.limits import Limits
from firmware_py.safety.states import SafetyState
from firmware_py.summary import RunSummary

Array = NDArray[np.float64]
_REMEDY = "make the path slower or smaller, or widen the limit"


class PlanGoals(OwnGoals):
    """Goals of a plan as `firmware_py.goals.goal_source.GoalSource`.

    `payload_kg`: known payload; None follows the estimate, starting in the middle of the grid.
    `probes`: whether the plan's probing motion, if it has one, precedes slot 0.
    """

    def __init__(
        self, plan: TipPlan, payload_kg: float | None = None, *, probes: bool = True
    ) -> None:
        self._goals, self._grid = plan.goals_rad(), plan.grid_kg.tolist()
        self.slots, self.dof = self._goals.shape[1:]
        self._probe = np.zeros((0, self.dof))
        if probes and plan.probe is not None:
            self._probe = np.transpose(plan.probe.goals_rad)
        self.lead = len(self._probe)
        if payload_kg is not None and not self._grid[0] <= payload_kg <= self._grid[-1]:
            raise InputError(
                "payload_kg",
                f"is {payload_kg:g} kg, the plan {plan.path} holds {plan.payloads_in_words}",
                "plan again with --payloads that enclose it, or correct payload_kg",
            )  # fmt: skip
        self._payload = FollowedPayload(self._grid, payload_kg, plan.payload_rate_kg_s)

    @property
    def known_kg(self) -> float | None:
        return self._payload.kg if self._payload.is_known else None

    @property
    def payload_kg(self) -> float:
        return self._payload.kg

    def follow(self, estimate: Estimate, step_s: float) -> None:
        self._payload.follow(estimate.payload_kg, step_s)

    def at(self, slot: int) -> Array:
        """Return the goals of a slot for the payload, shape (dof,).

        Before slot 0 they probe the link, or wait at the first row.
        """
        if -self.lead <= slot < 0:
            return np.asarray(self.interpolated(self._goals[:, 0]) + self._probe[slot])
        return self.interpolated(self._goals[:, max(slot, 0) % self.slots])

    def interpolated(self, values: Array, payload_kg: float | None = None) -> Array:
        """Interpolate values of all payloads, shape (p, ...), to shape (...).

        `payload_kg`: clipped to the grid; by default the payload of this tick.
        """
        k, part = interval_of(self._grid, self._payload.kg if payload_kg is None else payload_kg)
        return np.asarray(values[k] + part * (values[k + 1] - values[k]) if part else values[k])


def check_plan_goals(plan: TipPlan, limits: Limits, where: str) -> None:
    """Refuse a plan whose goals violate a limit at some payload, or while the payload changes."""
    goals, step_s = plan.goals_rad(), plan.period_s
    limits = _beside_corrections(plan, limits)
    probe = np.zeros((0, plan.dof)) if plan.probe is None else np.transpose(plan.probe.goals_rad)
    names = [f"{payload.payload_kg:g} kg" for payload in plan.payloads]
    tables = list(zip(names, goals, strict=True))
    for whose, table in [("probing motion", goals[0, 0] + probe)] * bool(len(probe)) + tables:
        before, velocity = table[0], np.zeros(plan.dof)
        for row, goal in enumerate(table):
            violation = limits.goal_violation(
                goal.tolist(), before=before.tolist(), velocity=velocity.tolist(), period_s=step_s
            )
            if violation:
                raise InputError(
                    where, f"row {row} ({row * step_s:.2f} s), {whose}: {violation}", _REMEDY
                )
            before, velocity = goal, (goal - before) / step_s
    _check_change_of_payload(plan, goals, limits, where)


def _beside_corrections(plan: TipPlan, limits: Limits) -> Limits:
    """Return limits with a reserve for corrections, which may reverse within one period."""
    if plan.feedback is None:
        return limits
    size, rate = plan.feedback.size_rad, plan.feedback.rate_rad_s
    low, high = limits.angle_rad
    return msgspec.structs.replace(
        limits, angle_rad=(low + size, high - size), rate_rad_s=limits.rate_rad_s - rate,
        acceleration_rad_s2=limits.acceleration_rad_s2 - 2.0 * rate / plan.period_s,
    )  # fmt: skip


def _check_change_of_payload(plan: TipPlan, goals: Array, limits: Limits, where: str) -> None:
    """Refuse goals that keep the limits only at a constant payload.

    With the payload m changing at m', the goal g(t, m) moves at ∂g/∂t + m' ∂g/∂m. If the change
    begins within a period h, it accelerates by another m' ∂g/∂m / h, and 2 m' ∂²g/∂t∂m.
    """
    if len(plan.payloads) < 2:
        return
    step_s, change = plan.period_s, plan.payload_rate_kg_s
    by_payload = np.diff(goals, axis=0) / np.diff(plan.grid_kg)[:, None, None]
    rate = np.diff(goals, axis=1, prepend=goals[:, :1]) / step_s
    acceleration = np.diff(rate, axis=1, prepend=np.zeros_like(rate[:, :1])) / step_s
    mixed = np.abs(np.diff(rate, axis=0)) / np.diff(plan.grid_kg)[:, None, None]
    by_estimate = change * np.abs(by_payload)
    both = np.maximum(np.abs(rate[1:]), np.abs(rate[:-1])) + by_estimate
    total = np.maximum(np.abs(acceleration[1:]), np.abs(acceleration[:-1]))
    total = total + by_estimate / step_s + 2.0 * change * mixed
    for what, values, key, unit in (
        ("moves at", both, "rate_rad_s", "rad/s"),
        ("accelerates at", total, "acceleration_rad_s2", "rad/s2"),
    ):
        limit = getattr(limits, key)
        k, row, joint = np.unravel_index(int(np.argmax(values)), values.shape)
        most = float(values[k, row, joint])
        if most > limit:
            raise InputError(
                where, f"row {row} ({row * step_s:.2f} s), {plan.grid_kg[k]:g} to "
                f"{plan.grid_kg[k + 1]:g} kg: the goal of joint {joint + 1} {what} {most:.2f} "
                f"{unit} while the estimate of the payload changes, the limit is {limit:g} {unit} "
                f"(limits.{key})",
                _REMEDY,
            )  # fmt: skip


TOLERANCE: Final = 0.05
"""Excess that is reported, relative to the largest payload of the plan, or in kg if that is zero
[assumed: the estimate of a payload at the end of the grid may exceed it by as much]."""


def payload_beyond_plan(plan: TipPlan, known_kg: float | None, summary: RunSummary) -> str:
    """Return a sentence if the estimated payload was outside the range of the plan, or "".

    The estimate is the median over the second half of the motion, when it has settled.

    `known_kg`: known payload of the run; None if it was estimated.
    """
    if known_kg is not None:
        return ""
    records = summary.records
    moving = (records["tick"] >= 0) & (records["state"] < SafetyState.STOPPING)
    estimated_kg = records["payload_kg"][moving & np.isfinite(records["payload_kg"])]
    settled_kg = estimated_kg[len(estimated_kg) // 2 :]
    if not len(settled_kg):
        return ""
    payload_kg = float(np.median(settled_kg))
    nearest_kg = _nearest_kg(plan, payload_kg)
    if nearest_kg is None:
        return ""
    return (
        f"the payload is estimated at {payload_kg:.2f} kg, the plan holds "
        f"{plan.payloads_in_words}: its goals were those for {nearest_kg:g} kg, and the tip is "
        "further off its path than the plan expects; plan again with --payloads that enclose it"
    )


def recording_beyond_plan(plan: TipPlan, payload_kg: float) -> str:
    """Return a sentence if a recorded payload is outside the range of the run's plan, or ""."""
    nearest_kg = _nearest_kg(plan, payload_kg)
    if nearest_kg is None:
        return ""
    return (
        f"the payload of the recording is {payload_kg:g} kg, the plan holds "
        f"{plan.payloads_in_words}: what it learns is for {nearest_kg:g} kg, and it stays without "
        f"goals for {payload_kg:g} kg; plan again with --payloads that enclose it, and run that"
    )


def _nearest_kg(plan: TipPlan, payload_kg: float) -> float | None:
    """Return the end of the grid that a payload lies beyond; None if it lies inside."""
    low, high = float(plan.grid_kg[0]), float(plan.grid_kg[-1])
    nearest_kg = min(max(payload_kg, low), high)
    return nearest_kg if abs(payload_kg - nearest_kg) > TOLERANCE * (high or 1.0) else None
