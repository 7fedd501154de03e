"""Feedback of the estimated tip along a plan: bounded corrections of the goals.

The error of the estimated tip passes a filter, whose output is the rate of the correction. The
correction is the integral of this rate. Its bounds of size and rate act at the integrator itself,
so nothing winds up. While the goals blend into the plan, after a replug or missed slots, the tip is
not meant to be on the path, and the integral is held. Filters for all payloads of the plan run in
parallel, and their rates are interpolated like the goals.

At a known payload the stiffness of the link is estimated as well
(`firmware_py.goals.stiffness_estimate`). Goals and estimated tip adopt it at the start of each run
of the plan, when the arm rests. A probing motion before the first run
(`firmware_py.goals.stiffness_estimate`) estimates stiffness and payload; if it is certain, both are
kept for the whole run.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from firmware_py.goals.plan_goals import PlanGoals
from firmware_py.goals.stiffness_estimate import ProbeEstimate, ProbeResult, StiffnessEstimate
from firmware_py.goals.tip_plan import RateFilter, StiffnessSlopes, TipPlan
from firmware_py.inference.estimator import Estimate
from firmware_py.inference.predictor import TRUSTED_M, Prediction
from firmware_py.safety.estimate_trust import EstimateTrust, TrustOptions, TrustState

Array = NDArray[np.float64]
WIDEST_M: Final = 0.06
"""Half width above which feedback rejects the tip, too [assumed]. It is larger than `TRUSTED_M`,
because the interval widens with the innovation for a wrong stiffness, which feedback corrects."""


class Correction:
    """Correction that is added to the goals of a source; this one is zero."""

    trust: TrustState = TrustState.NONE  # Trust in the estimated tip
    lost_because = ""  # Reason of the latest loss of trust; empty without one
    stop_reason = ""  # Reason why the robot must stop; empty for none

    def __init__(self, dof: int) -> None:
        self.value_rad = np.zeros(dof)  # Correction of the latest tick

    def update(
        self, slot: int, step_s: float, fresh: bool, current_a: Array, estimate: Estimate,
        prediction: Prediction, following: bool = True,
    ) -> Array:  # fmt: skip
        """Return the correction of a tick, shape (dof,).

        `following`: whether the goals follow the source, without a blend or a stop in progress.
        """
        return self.value_rad


class TipFeedback(Correction):
    """Feedback of a plan as `Correction`.

    `innovations`: indices of the currents' innovations among the signals of an estimate.
    `assume_payload`: called after a probing motion with the payload that the observer must assume,
    or None if it has to estimate it anew.
    """

    def __init__(
        self, plan: TipPlan, goals: PlanGoals, options: TrustOptions, innovations: list[int],
        assume_payload: Callable[[float | None], None] = lambda payload_kg: None,
    ) -> None:  # fmt: skip
        super().__init__(plan.dof)
        if plan.feedback is None:
            raise ValueError("the plan has no feedback")
        design, self._goals, self._innovations = plan.feedback, goals, innovations
        self._dof, self._rows = plan.dof, plan.rows
        self._size_rad, self._rate_rad_s = design.size_rad, design.rate_rad_s
        self._most_innovation_a = design.innovation_a
        self._desired_m = np.ascontiguousarray(plan.desired_tip_m())
        filters = [f for payload in design.filters for f in payload]
        self._a, self._b, self._c, self._d = _side_by_side(filters, plan.dof)
        self._x = np.zeros(len(self._a))
        self._tables = _tables(plan)
        # At a known payload the tables are interpolated once, not in every tick.
        self._slopes: dict[str, Array] | None = None
        if goals.known_kg is not None and self._tables:
            self._slopes = {n: goals.interpolated(table) for n, table in self._tables.items()}
        self._estimate = StiffnessEstimate(plan.dof)
        self.stiffness, self._assume_payload = 0.0, assume_payload
        self.probe_result: ProbeResult | None = None
        self._known_kg = goals.known_kg
        self._probing: ProbeEstimate | None = None
        if plan.probe is not None and goals.lead and self._tables:
            self._probing = ProbeEstimate(plan.probe, self._known_kg)
        self._integral = np.zeros(plan.dof)
        self._trust = EstimateTrust(options, plan.period_s)
        self.trust = self._trust.state

    def update(
        self, slot: int, step_s: float, fresh: bool, current_a: Array, estimate: Estimate,
        prediction: Prediction, following: bool = True,
    ) -> Array:  # fmt: skip
        if self._probing is not None:
            # A wrong stiffness biases the observer: its estimate is not used before it restarts.
            if slot < 0:
                self._probing.take(slot + self._probing.rows, fresh, current_a)
            else:
                self._conclude(self._probing.result())
            return self.value_rad
        trust = self._trust
        doubt = self._doubt(fresh, estimate, prediction)
        trust.update(doubt, step_s)
        self.trust, self.lost_because = trust.state, trust.reason
        if trust.stops:
            self.stop_reason = f"the estimated tip is no longer trusted: {trust.reason}"
        if slot < 0:
            return self.value_rad
        row = slot % self._rows
        if row == 0 and self.probe_result is None:
            self.stiffness = self._estimate.value
        if trust.state is TrustState.TRUSTED and not doubt and following:
            self._follow(row, step_s, current_a, prediction.tip_m)
        elif trust.state is TrustState.LOST:
            self._integral[:] = 0.0
            self._x[:] = 0.0
        wanted = self._integral
        if self._slopes is not None:
            wanted = wanted + self.stiffness * self._slopes["goals_rad"][row]
        wanted = trust.fraction * _within(wanted, self._size_rad)
        step = _within(wanted - self.value_rad, self._rate_rad_s * step_s)
        self.value_rad = self.value_rad + step
        return self.value_rad

    def _conclude(self, result: ProbeResult | None) -> None:
        """Adopt the estimate of the probing motion if it is certain, and restart the observer."""
        self._probing, payload_kg = None, self._known_kg
        if result is not None and result.certain:
            self.probe_result, self.stiffness = result, result.stiffness
            if payload_kg is None:
                payload_kg = result.payload_kg
                interpolated = self._goals.interpolated
                self._slopes = {
                    n: interpolated(table, payload_kg) for n, table in self._tables.items()
                }
        self._assume_payload(payload_kg)

    def _doubt(self, fresh: bool, estimate: Estimate, prediction: Prediction) -> str:
        if not fresh:
            return "the data is stale"
        tip = prediction.tip_m
        if not (math.isfinite(tip[0]) and math.isfinite(tip[1]) and math.isfinite(estimate.di)):
            return "it is not finite"
        widest_m = max(prediction.half_width_m.tolist())
        if not widest_m <= WIDEST_M or not (prediction.in_range or widest_m > TRUSTED_M):
            return "it is out of range"
        innovation_a = self.innovation_a(estimate)
        if not innovation_a <= self._most_innovation_a:
            return f"its innovation is {innovation_a:.2f} A"
        return ""

    def innovation_a(self, estimate: Estimate) -> float:
        """Return the largest innovation of a current; 0 if the estimator provides none."""
        return max((float(estimate.signals[k]) for k in self._innovations), default=0.0)

    def _follow(self, row: int, step_s: float, current_a: Array, tip_m: Array) -> None:
        """Update the estimate of the stiffness, the filters and the integral with a sample."""
        slopes, dof = self._slopes, self._dof
        error = self._desired_m[row] - tip_m[:dof]
        if slopes is not None:
            if self.probe_result is None:
                unmatched = slopes["unmatched_a"][row]
                moved = slopes["current_a"][row] - unmatched
                excess = current_a - slopes["planned_a"][row] - self.stiffness * moved
                self._estimate.update(
                    excess.tolist(), unmatched.tolist(), slopes["friction_a"][row].tolist(),
                    slopes["weight"][row].tolist(),
                )  # fmt: skip
            error -= self.stiffness * slopes["unseen_m"][row]
        rates = self._c @ self._x + self._d @ error
        self._x = self._a @ self._x + self._b @ error
        rate = _within(self._goals.interpolated(rates.reshape(-1, dof)), self._rate_rad_s)
        self._integral = _within(self._integral + step_s * rate, self._size_rad)


def _side_by_side(
    filters: Sequence[RateFilter], dof: int
) -> tuple[Array, Array, Array, Array]:  # fmt: skip
    """Stack all filters into one state space, from the errors of the tip to all rates.

    Filter k gets the error of coordinate k mod dof. One large matrix product is faster than many
    small ones.
    """
    states = sum(len(f.a) for f in filters)
    a, b = np.zeros((states, states)), np.zeros((states, dof))
    c, d = np.zeros((len(filters), states)), np.zeros((len(filters), dof))
    first = 0
    for k, each in enumerate(filters):
        here = slice(first, first := first + len(each.a))
        a[here, here], c[k, here] = each.a, each.c[0]
        b[here, k % dof], d[k, k % dof] = np.array(each.b)[:, 0], each.d[0][0]
    return a, b, c, d


def _within(values: Array, most: float) -> Array:
    """Clip values to ±most; NumPy's clip takes four times as long."""
    return np.minimum(np.maximum(values, -most), most)


def _tables(plan: TipPlan) -> dict[str, Array]:
    """Return slopes and currents by name, shape (payloads, rows, dof); empty without slopes."""
    slopes = [payload.stiffness for payload in plan.payloads]
    if None in slopes:
        return {}
    tables = {
        name: np.array([np.transpose(getattr(slope, name)) for slope in slopes])
        for name in StiffnessSlopes.__struct_fields__
    }
    currents = [np.transpose(payload.current_a) for payload in plan.payloads]
    return tables | {"planned_a": np.array(currents)}
