"""Design of a motion that separates the worst pair of rivals best, within the robot's limits.

The least score of all pairs is raised by sequential linear programming with a trust region (Madsen
and Schjær-Jacobsen, Mathematical Programming 14, 1978: linearly constrained minimax). The score of
a pair of probabilities p and q is d′² − 4 ln(p q): −8 times the logarithm of the bound
√(p q) exp(−d′²/8) of the pair's error (Kailath, IEEE Trans. Communication Technology 15, 1967). Its
gradient follows from the twin's exact sensitivities at the refitted rival: at the minimum of a
refit the refitted values do not count. Limits of the goals are linear in the coefficients; those of
what the twin does are linearised.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.optimize import linprog

from firmware_py.errors import InputError
from firmware_py.motion import Motion
from firmware_py.motion_document import JointSeries, MotionDocument
from firmware_py.safety.limits import Limits
from models.gap.experiment.motion_limits import REST_SAMPLES, ROW_STEP, goal_limits, twin_limits
from models.gap.experiment.motion_twin import CoefficientTwin
from models.gap.experiment.separation import PairSeparation, SeparationModel
from models.gap.fixed_motions import planned_trial
from models.gap.search.effect_search import ReportProgress
from models.plant.identification.noise_floor import Array
from models.trials.trial import Trial

FREQUENCIES_HZ: Final = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)
"""Frequencies of the series, rounded to harmonics: 10 s show the lowest; the highest stays below
the link's first modes, 1.4 to 3.5 Hz (docs/sources.md, "The link"), where the plant's own error is
large. Measured: with up to 2.7 Hz a prebend of 0.02 was mistaken for a softening afterwards."""
COEFFICIENT_DIGITS: Final = 6
"""Digits of a coefficient: 1 µrad is less than a servo resolves."""
FIRST_RADIUS: Final = 0.25
LEAST_RADIUS: Final = 0.004
"""Trust region at first and at the end, as a fraction of the largest single harmonic [assumed]."""
MOST_GRADIENTS: Final = 8
"""Pairs whose gradients a linear programme takes, lowest score first [assumed]."""
STEPS: Final = 20
"""Most linear programmes from one start [assumed]."""
SHRINKING: Final = 0.3
"""Fraction of a limit's violation by which a starting motion is reduced in each turn [assumed]."""
CORRECTION: Final = 0.015
"""Fraction by which a step that exceeds a limit of the twin is reduced, up to three times
[assumed]."""
NEAR_A_LIMIT: Final = 0.4
"""Distance from a limit, as a fraction of it, below which a row enters a linear programme
[assumed]."""
RADIUS_GROWTH: Final = 1.5
"""Growth of the trust region after a step that raised the score; any other step halves it
[assumed]."""
TOLERATED_EXCESS: Final = 0.01
"""Violation that is tolerated during the search; the result has none [assumed]."""
RANDOM_STARTS: Final = 4
"""Number of random series among the starts [assumed]."""
KEPT_STARTS: Final = 2
"""Starts that are optimised, best first [assumed]."""


@dataclass(frozen=True)
class Design:
    """Motion and how well it separates the pairs."""

    document: MotionDocument
    trial: Trial  # Planned: conditions and goals
    pairs: tuple[PairSeparation, ...]  # In the order of `SeparationModel.pairs`
    score: float  # Least score of the pairs that it can separate


@dataclass(frozen=True)
class _Programme:
    """Linear programme A z ≤ b: z is the step and the least score, as fractions of their scales."""

    table: Array
    limit: Array

    def step(self, radius: float) -> Array:
        """Step that raises the least score most; zero if there is none."""
        count = self.table.shape[1] - 1
        result = linprog(
            np.concatenate([np.zeros(count), [-1.0]]), self.table, self.limit,
            bounds=[(-radius, radius)] * count + [(None, None)], method="highs",
        )  # fmt: skip
        return np.asarray(result.x[:-1]) if result.success else np.zeros(count)


class MotionDesigner:
    """Search for the coefficients of a motion."""

    def __init__(
        self, model: SeparationModel, limits: Limits, seconds: float, seed: int,
        report: ReportProgress,
    ) -> None:  # fmt: skip
        self.model, self.limits, self.report = model, limits, report
        self.duration_s, self.dof = seconds, model.like.meta.dof
        self.least_separation = model.settings.indistinguishable_separation
        self.harmonics = tuple(sorted({max(1, round(f * seconds)) for f in FREQUENCIES_HZ}))
        self._rng = np.random.default_rng(seed)
        self.twin = CoefficientTwin(
            model.twin.model, seconds, self.harmonics, self.dof, REST_SAMPLES
        )
        probability = np.array([r.probability for r in model.rivals])
        self._weight = np.array([-4 * np.log(probability[a] * probability[b])
                                 for a, b in model.pairs])  # fmt: skip
        self._weight -= self._weight.min()
        low, high = limits.angle_rad
        hz = np.array(self.harmonics) / seconds
        alone = np.minimum(min(-low, high), limits.rate_rad_s / (2 * np.pi * hz))
        self.scale = np.tile(alone, 2 * self.dof)
        self._goal_rows, self._goal_limit = goal_limits(self.twin.basis, limits, self.dof)
        every = goal_limits(self.twin.basis, limits, self.dof, row_step=1)
        self._every_goal_row, self._every_goal_limit = every

    def document(self, x: Array, payload_kg: float, notes: str = "") -> MotionDocument:
        """Motion from its coefficients: joint by joint, sines then cosines."""
        rows = x.reshape(self.dof, 2, -1).round(COEFFICIENT_DIGITS).tolist()
        return MotionDocument(
            schema=MotionDocument.VERSION, duration_s=self.duration_s, harmonics=self.harmonics,
            joints=tuple(JointSeries(sine_rad=tuple(s), cosine_rad=tuple(c)) for s, c in rows),
            payload_kg=payload_kg, notes=notes,
        )  # fmt: skip

    def trial(self, x: Array, payload_kg: float) -> Trial:
        """Planned trial of a motion from its coefficients."""
        motion = Motion.designed(self.document(x, payload_kg))
        return planned_trial(self.model.like, motion, payload_kg, REST_SAMPLES)

    def scores(self, pairs: list[PairSeparation]) -> Array:
        return np.asarray(np.array([q.separation**2 for q in pairs]) + self._weight)

    def design(self, payloads_kg: tuple[float, ...]) -> Design:
        """Best motion over all starts and payloads."""
        starts: list[tuple[float, int, Array, float]] = []
        tried = self._starts()
        kept = min(KEPT_STARTS, len(tried) * len(payloads_kg))
        for number, x in enumerate(tried, 1):
            for payload_kg in payloads_kg:
                allowed = self._within_twin_limits(x, payload_kg)
                pairs = self.model.separations(self.trial(allowed, payload_kg))
                starts.append((float(self.scores(pairs).min()), -len(starts), allowed, payload_kg))
            self.report(f"start {number} tried", len(tried) - number + kept + 1)
        found = []
        for _, _, x, payload_kg in sorted(starts, key=lambda s: s[:2])[::-1][:KEPT_STARTS]:
            found.append(self._raised(x, payload_kg))
            least = min(q.separation for q in found[-1].pairs)
            further = kept - len(found) + 1
            self.report(f"least d′ {least:.1f} with {payload_kg:g} kg", further)
        return max(found, key=lambda d: d.score)

    def _starts(self) -> list[Array]:
        """Fixed motions of this duration as series, and random ones, scaled to the limits."""
        basis, half = self.twin.basis[REST_SAMPLES:], max(self.limits.angle_rad)
        turn = np.arange(len(basis)) / len(basis)
        waves = [
            np.sin(2 * np.pi * turn), np.sin(4 * np.pi * turn),
            np.interp(turn, [0.0, 0.25, 0.75, 1.0], [0.0, -1.0, 1.0, 0.0]),
            np.sign(np.sin(2 * np.pi * turn)),
        ]  # fmt: skip
        starts = [np.linalg.lstsq(basis, -half * w, rcond=1e-6)[0] for w in waves]
        full = [np.tile(x, self.dof) for x in starts]
        full += [
            self.scale * self._rng.standard_normal(len(self.scale)) for _ in range(RANDOM_STARTS)
        ]
        return [self._scaled_to_goal_limits(x) for x in full]

    def _scaled_to_goal_limits(self, x: Array) -> Array:
        """Coefficients scaled until the goals just meet a limit."""
        return np.asarray(x / max(self._used_of_goal_limits(x), 1e-9))

    def _within_goal_limits(self, x: Array) -> Array:
        """Coefficients reduced if the goals exceed a limit."""
        return np.asarray(x / max(self._used_of_goal_limits(x), 1.0))

    def _used_of_goal_limits(self, x: Array) -> float:
        """Largest goal, rate or acceleration, as a fraction of its limit."""
        return float(np.max(self._every_goal_row @ x / self._every_goal_limit))

    def _within_twin_limits(self, x: Array, payload_kg: float) -> Array:
        """Coefficients reduced until the twin of every rival keeps the limits."""
        if self.twin_excess(0.0 * x, payload_kg) > 0:
            raise InputError(
                "--config",
                f"its limits leave no room for a motion with {payload_kg:g} kg: the twin exceeds "
                "one at rest",
                "widen those of tip, current or following error, or choose another payload",
            )  # fmt: skip
        while (excess := self.twin_excess(x, payload_kg)) > 0:
            x = np.asarray(x * (1 - SHRINKING * min(max(excess, 0.05), 1.0)))
        return x

    def twin_excess(self, x: Array, payload_kg: float) -> float:
        """Largest violation of a limit by the twin of any rival, as a fraction of the limit."""
        return self.excess_of(self.trial(x, payload_kg))

    def excess_of(self, trial: Trial) -> float:
        """The same for a planned trial."""
        worst = -np.inf
        for values in self.model.values:
            y = self.model.twin.run(trial, values)
            if not np.isfinite(y).all():
                return np.inf
            worst = max(worst, *(float(v.max()) for v, _ in self._limits_of(y, trial)))
        return worst

    def _limits_of(self, y: Array, trial: Trial) -> list[tuple[Array, dict[str, float]]]:
        return twin_limits(y, self.model.twin.outputs, trial.goal_rad, self.limits)

    def _raised(self, x: Array, payload_kg: float) -> Design:
        """Sequence of linear programmes from one start."""
        trial = self.trial(x, payload_kg)
        pairs = self.model.separations(trial)
        active = np.ones(len(pairs), dtype=bool)
        radius, steps = FIRST_RADIUS, 0
        programme: _Programme | None = None
        while steps < STEPS and active.any():
            steps += 1
            programme = programme or self._programme(x, trial, pairs, active)
            tried = self._within_goal_limits(x + programme.step(radius) * self.scale)
            for _ in range(3):
                if self.twin_excess(tried, payload_kg) > TOLERATED_EXCESS:
                    tried = (1 - CORRECTION) * tried
            new_trial = self.trial(tried, payload_kg)
            new = self.model.separations(new_trial)
            risen = self.scores(new)[active].min() - self.scores(pairs)[active].min()
            if risen > 0 and self.twin_excess(tried, payload_kg) <= TOLERATED_EXCESS:
                x, trial, pairs, programme = tried, new_trial, new, None
                radius = min(RADIUS_GROWTH * radius, 1.0)
            else:
                radius *= 0.5
            if radius < LEAST_RADIUS or (steps == STEPS // 2):
                together = active & np.array([q.separation < self.least_separation for q in pairs])
                if not together.any() or together.all():
                    if radius < LEAST_RADIUS:
                        break
                    continue
                active, radius, programme = active & ~together, FIRST_RADIUS, None
        x = self._within_twin_limits(x, payload_kg)
        trial = self.trial(x, payload_kg)
        pairs = self.model.separations(trial)
        separable = np.array([q.separation >= self.least_separation for q in pairs])
        kept = separable if separable.any() else np.ones(len(pairs), dtype=bool)
        # A design that separates more pairs wins, then the one with the larger least score.
        score = 1e6 * int(separable.sum()) + float(self.scores(pairs)[kept].min())
        return Design(self.document(x, payload_kg), trial, tuple(pairs), score)

    def _programme(
        self, x: Array, trial: Trial, pairs: list[PairSeparation], active: Array
    ) -> _Programme:
        """Scores and limits around a motion, to first order."""
        model, payload_kg = self.model, trial.meta.payload_kg
        white = model.whitening(trial)
        by_rival = {
            k: self.twin.slopes(payload_kg, model.twin.parameters(trial, v), x)
            for k, v in enumerate(model.values)
        }
        rows, limit = [self._goal_rows], [self._goal_limit - self._goal_rows @ x]
        goals = np.kron(np.eye(self.dof), self.twin.basis)
        goals = goals.reshape(self.dof, len(self.twin.basis), -1)
        for y, slope in by_rival.values():
            for value, weights in self._limits_of(y, trial):
                near = np.flatnonzero(value > -NEAR_A_LIMIT)[::ROW_STEP]
                for name, weight in weights.items():
                    by_x = weight * slope[near, model.twin.outputs.index(name)]
                    if name.startswith("angle_"):
                        by_x = by_x - weight * goals[int(name.split("_")[1]) - 1][near]
                    rows.append(by_x)
                    limit.append(np.maximum(-value[near], 0.0))
        score = self.scores(pairs)
        floor = np.sort(score[active])[:MOST_GRADIENTS][-1]
        chosen = np.flatnonzero(active & (score <= floor))
        gradients = []
        for k in chosen:
            a, _ = model.pairs[k]
            p = model.twin.parameters(trial, pairs[k].refitted)
            _, slope = self.twin.slopes(payload_kg, p, x)
            change = model.spectra(trial, by_rival[a][1] - slope, white)
            gradients.append(2 * pairs[k].residual @ change)
        size = max(abs(float(score[active].min())), 1.0)
        table = np.concatenate(rows) * self.scale
        upper = np.column_stack([table, np.zeros(len(table))])
        raised = np.column_stack([-np.array(gradients) * self.scale, np.full(len(chosen), size)])
        return _Programme(np.concatenate([upper, raised]), np.concatenate([*limit, score[chosen]]))
