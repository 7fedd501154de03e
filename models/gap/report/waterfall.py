"""How far each inclusion lowers the error on trials that its values were not fitted to."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Final

import numpy as np

from models.gap.diagnosis import Diagnosis, all_fit_parameters
from models.gap.estimation.gauss_newton import GaussNewton
from models.gap.residuals.residuals import Residuals
from models.gap.residuals.spectrum import Array
from models.trials.trial import Trial
from models.trials.trial_files import TrialSet

_STEPS: Final = 12


def waterfall_steps(found: Diagnosis, trials: TrialSet) -> list[tuple[str, float]]:
    """Error on held-out trials, in noise floors: as given, refitted, with each effect in turn.

    Common knobs are fitted to the trials of the study's split and then held. On the held-out
    trials only the variation between trials is fitted, as the noise floor allows it, from where
    it ended in the trials of the same payload: a large gap that is not explained yet leans on it.
    """
    fit, held_out = trials.split()
    tested = held_out if len(held_out) else fit
    namer, naming = found.namer, found.naming
    learner = _estimator(found, fit.trials)
    judge = _estimator(found, tested.trials)
    zero = np.zeros(len(learner.problem.knobs))
    steps = [("plant as given", _floors(judge, zero, learner))]
    point = learner.at(zero)
    named: list[str] = []
    for label, effects in [("nuisance refitted", []), *((e, [e]) for e in naming.named)]:
        named += effects
        start = point.values.copy()
        for effect in effects:
            own = [k for k, knob in enumerate(learner.problem.knobs) if knob.effect == effect]
            here = [k for k, knob in enumerate(namer.knobs) if knob.effect == effect]
            start[own] = naming.after.values[here]
        free = np.array([k.kind != "effect" or k.effect in named for k in learner.problem.knobs])
        candidates = [learner.at(start), point]
        point = learner.fit(min(candidates, key=lambda p: p.cost), free, _STEPS, 1e-3)
        steps.append((label.replace("_", " "), _floors(judge, point.values, learner)))
    steps.append(("noise floor", 1.0))
    return steps


def _estimator(found: Diagnosis, trials: Sequence[Trial]) -> GaussNewton:
    catalogue = list(
        dict.fromkeys(k.effect for k in found.namer.knobs if k.effect in found.naming.named)
    )
    knobs = all_fit_parameters(found.plant, trials, catalogue)
    return GaussNewton(Residuals(found.plant, trials, knobs), found.namer.first.floor)


def _floors(judge: GaussNewton, learned: Array, learner: GaussNewton) -> float:
    """Root mean square in noise floors with the learner's common knobs."""
    variation = np.array([k.kind == "trial" for k in judge.problem.knobs])
    point = judge.fit(judge.at(_handed_over(judge, learned, learner)), variation, _STEPS, 1e-3)
    white = judge.whitened(point.rows)
    return float(np.sqrt(sum(np.sum(w**2) for w in white) / sum(w.size for w in white)))


def _handed_over(judge: GaussNewton, learned: Array, learner: GaussNewton) -> Array:
    """The learner's values by name: common ones, and a trial's own by its payload."""
    values = dict(zip(_keys(learner.problem), learned, strict=True))
    return np.array([values.get(key, 0.0) for key in _keys(judge.problem)])


def _keys(problem: Residuals) -> list[tuple[str, float | None, int]]:
    """Name, payload and turn of every knob: a name may come several times (one for each axis)."""
    seen: Counter[tuple[str, int | None]] = Counter()
    result = []
    for knob in problem.knobs:
        payload_kg = None if knob.trial is None else problem.trials[knob.trial].meta.payload_kg
        result.append((knob.name, payload_kg, seen[knob.name, knob.trial]))
        seen[knob.name, knob.trial] += 1
    return result
