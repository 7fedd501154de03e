"""Effects of the command: delay of the goal, gain of its loop, limits of current and torque."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

import casadi as ca
import numpy as np

from models.plant.effects import Effect
from models.plant.parameter import Parameter
from models.plant.scope import DelayedStaircase, Scope
from models.plant.step_model import Variable


class DeadTime(Effect):
    """Delay θ of the goal, by the Padé approximant of order 2/3.

    e^−x ≈ (1 − 2x/5 + x²/20) / (1 + 3x/5 + 3x²/20 + x³/60),  x = s D  [Baker & Graves-Morris 1996]

    The relative error is 1.4e-4 (ωD)⁶, 1e-4 for 80 ms at 2 Hz; three first-order lags have
    (ωD)²/6. The approximant is strictly proper: a step does not pass at once. States of a delay of
    zero would be infinitely fast. So the states delay by D = √(θ² + D_0²) and their output is
    weighted by θ/D: the mean delay is θ exactly, at zero the goal is unchanged, and all is smooth
    in θ.

    The approximant smooths steps. A goal with a shape within the step is therefore delayed without
    its staircase, and the drive adds the staircase's saw-tooth to the current (`DelayedStaircase`).
    A second parameter shifts the phase at which the current samples it; a drive without a staircase
    does not have it.
    """

    name = "dead_time"
    parameter_needs = MappingProxyType({"dead_time_phase_{j}": "goal shape"})
    per_joint = (
        Parameter("dead_time_{j}_s", "s", 0.0, 0.0, 0.2,
                  "delay of the goal on its way to the servo's loop",
                  'docs/sources.md, "Control tables": line time, 1 to 26 ms', role="effect"),
        Parameter("dead_time_phase_{j}", "1", 0.0, -1.0, 1.0,
                  "phase by which the current is sampled later after the goal's jump than without "
                  "the delay",
                  "unknown: the current may be a mean or be sampled", role="effect",
                  prior_deviation=0.5),
    )  # fmt: skip

    def apply(self, scope: Scope) -> None:
        for j in scope.joints:
            sent, sampling = scope.goal[j], scope.sampling.get(j)
            goal = sent if sampling is None else sampling.smooth_goal()
            dead_s = scope.p("dead_time_{j}_s", j)
            # D_0: the shortest delay that a step of 3 ms integrates stably, |pole| ≤ 4.1 / D.
            delay_s = ca.sqrt(dead_s**2 + 5e-3**2)
            first = scope.state(Variable(f"delayed_{j}_1", "1"), sent)
            second = scope.state(Variable(f"delayed_{j}_2", "1"))
            third = scope.state(Variable(f"delayed_{j}_3", "1"))
            scope.states[first.name()].rate = second / delay_s
            scope.states[second.name()].rate = third / delay_s
            jerk = 60 * (goal - first) - 36 * second - 9 * third
            scope.states[third.name()].rate = jerk / delay_s
            delayed = first - 2 * second / 5 + third / 20
            # derivative of `delayed`, by the rates of its states above
            rate = (3 * (goal - first) - 0.8 * second - 0.85 * third) / delay_s
            share = dead_s / delay_s
            scope.goal[j] = sent + share * (delayed - sent)
            if sampling is not None:
                shift = scope.p("dead_time_phase_{j}", j)
                sampling.delay = DelayedStaircase(share, rate, shift)


class PositionGainChange(Effect):
    """Position loop with another gain than the identified one, k_p (1 + c).

    The cause is a changed register of the servo, or another servo of the same make. A lower gain
    makes the joint lag its goal by ġ / k_p, much like a delay, but also rounds off the goal's turns
    and leaves the joint softer.
    """

    name = "position_gain_change"
    needs = ("position gain",)
    of_each_joint = True
    per_joint = (
        Parameter("position_gain_change_{j}", "1", 0.0, -0.8, 3.0,
                  "relative change of the position gain",
                  'docs/sources.md, "Control tables": position P gain', role="effect"),
    )  # fmt: skip

    def apply(self, scope: Scope) -> None:
        for j in scope.joints:
            scope.position_gain_scale[j] *= 1 + scope.p("position_gain_change_{j}", j)


class CurrentSaturation(Effect):
    """Current limit below the rated one: |i| ≤ i_max − Δ.

    The effect has a dead zone: while the current stays below the limit, neither the output nor its
    derivatives change.
    """

    name = "current_saturation"
    needs = ("current limit",)
    per_joint = (
        Parameter("current_saturation_{j}_a", "A", 0.0, 0.0, 9.5,
                  "reduction of the limit below the rated one", "assumed absent", role="effect"),
    )  # fmt: skip

    @classmethod
    def dead_zone_strength(cls, known: Mapping[str, float], trials: Sequence[Any]) -> float:
        """Rated limit minus the largest sustained current; 0 if no current was measured."""
        measured = [
            t for t in trials
            if all(f"current_{j}_a" in t.columns for j in range(1, t.meta.dof + 1))
        ]  # fmt: skip
        if len(measured) < len(trials) or "current_limit_1_a" not in known:
            return 0.0
        mean_of_9 = np.ones(9) / 9  # against noise
        currents = [np.abs(c) for t in measured for c in t.current_a.T]
        largest_a = max(float(np.convolve(c, mean_of_9, "valid").max()) for c in currents)
        return known["current_limit_1_a"] - largest_a

    def apply(self, scope: Scope) -> None:
        for j in scope.joints:
            scope.current_limit_reduction[j] += scope.p("current_saturation_{j}_a", j)


class TorqueConstantDrift(Effect):
    """Torque per ampere below the rated one, τ = (1 − d) k_t i: warm magnets lose flux.

    d is constant over the trials: it is the drift since the plant was identified.
    """

    name = "torque_constant_drift"
    per_joint = (
        Parameter("torque_constant_drift_{j}", "1", 0.0, -0.5, 0.5,
                  "relative loss of torque per ampere", "assumed absent", role="effect"),
    )  # fmt: skip

    def apply(self, scope: Scope) -> None:
        for j in scope.joints:
            scope.torque_scale[j] *= 1 - scope.p("torque_constant_drift_{j}", j)
