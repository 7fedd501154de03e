"""Certainty of a name, measured on rigs of drawn structure whose effect is known.

Three numbers of a fit give the probabilities that nothing is missing, that its effects are what is
missing, and that something outside of the catalogue is:

- separation: its d′, or what it adds to a smaller set, over a factor where the plant's own error is
  larger: on motions and at payloads that it was not identified on, and on a link that changed
  since;
- difference: by how much the strength of an effect differs between parts of the trials
  (`models.gap.search.strength_consistency`);
- residual: what is unexplained, in noise floors.

Where nothing is missing, the plant's own error lets some effect reach a large d′ as well. But as a
stand-in it needs another strength in each part of the trials. What stands in for something outside
of the catalogue leaves more than noise. A logistic regression of the three numbers gives the
probability of the effects. A second one, of d′ and of the residual over what is left where nothing
is missing, shares the rest between nothing and something outside. `certainty.json` holds both with
the error of each effect's equation.
`python -m models.gap.training` makes the file.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Final, Literal

import msgspec
import numpy as np
from scipy.special import expit

from models.gap.estimation.gauss_newton import FitPoint, GaussNewton
from models.gap.residuals.fit_parameters import NUISANCE_PRIOR_FRACTION

PATH: Final = Path(__file__).with_name("certainty.json")

Knowledge = Literal[
    "identified", "other link", "other link, two joints", "other payloads", "other motions"
]
"""Whether the plant was identified on such trials, and else what was new to it."""

DECIDED: Final = 0.9
"""Probability above which an effect counts as decided; below 1 − this, as excluded."""
LEAST_SEPARATION: Final = 1.0
"""d′ below which a smaller one proves no less: its standard deviation by noise alone."""
LEAST_RESIDUAL: Final = 1.0
"""Mean squared residual below which a smaller one proves no less: that of noise."""
LINK_CHANGED: Final = 2.0
"""Root mean square change of the link's parameters, in standard deviations of their priors, from
which it counts as another link. Of 20 data sets for tuning without an effect the same link stayed
below it in all ten, another one exceeded it in seven of ten."""


class Evidence(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Numbers of a fit that the probabilities follow from; see the module's docstring."""

    separation: float
    difference: float
    residual: float  # Mean squared, in noise floors that allow for the equation's error

    def name_terms(self, scale: float) -> list[float]:
        """Terms of the regression for the effects; `scale` is the factor that d′ is divided by."""
        separation = max(self.separation / scale, LEAST_SEPARATION)
        residual = max(self.residual, LEAST_RESIDUAL)
        return [1.0, math.log(separation), self.difference, math.log(residual)]

    def outside_terms(self, scale: float, residual_of_nothing: float) -> list[float]:
        """Terms of the regression for something outside, against nothing."""
        separation = max(self.separation / scale, LEAST_SEPARATION)
        residual = max(self.residual / residual_of_nothing, 1.0)
        return [1.0, math.log(separation), math.log(residual)]


class Answers(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Probabilities of what is missing; they add up to one."""

    nothing: float
    catalogue: float  # The named effects; where none is named, the best candidate
    outside: float  # Something that is not in the catalogue


class Certainty(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Content of `certainty.json`."""

    made_with: dict[str, str]  # Versions of what made it
    data_sets: int
    # d′ that is reached where nothing is missing, and the mean squared residual that is left there:
    # 90 % of data sets have less
    separation_of_nothing: dict[Knowledge, float]
    residual_of_nothing: dict[Knowledge, float]
    # Factor on d′ on trials of which less is known of the plant's own error
    separation_scale: dict[Knowledge, float]
    # The same for the d′ that an effect adds beside another one, where the error of the first one's
    # equation comes to that of the plant
    further_scale: dict[Knowledge, float]
    # Coefficients of `Evidence.name_terms` and `Evidence.outside_terms`
    name_coefficients: list[float]
    outside_coefficients: list[float]
    # Root mean square error of a fitted strength beyond chance, as a fraction of it
    equation_error: dict[str, float]

    def answers_for(
        self, evidence: Evidence, knowledge: Knowledge, is_further: bool = False
    ) -> Answers:
        """Probabilities of the answers.

        `is_further`: whether the evidence is that of what is missing beside another effect.
        """
        scale = self.further_scale if is_further else self.separation_scale
        terms = evidence.outside_terms(scale[knowledge], self.residual_of_nothing[knowledge])
        outside = float(expit(np.dot(self.outside_coefficients, terms)))
        name = self.name_probability(evidence, scale[knowledge])
        return Answers((1 - name) * (1 - outside), name, (1 - name) * outside)

    def name_probability(self, evidence: Evidence, scale: float) -> float:
        """Probability of the effects; `scale` is the factor that d′ is divided by."""
        return float(expit(np.dot(self.name_coefficients, evidence.name_terms(scale))))

    def error_of_strength(self, effect: str) -> float:
        """Error of an effect's strength as a fraction; the largest measured one where unknown."""
        return self.equation_error.get(effect, max(self.equation_error.values()))


def knowledge_of(estimator: GaussNewton, point: FitPoint) -> Knowledge:
    """What is known of the plant's own error on most of the trials, at a fit."""
    trials, motions, payloads = estimator.residuals.trials, 0, 0
    for group in estimator.residuals.groups:
        curves, knowledge = estimator.floor.curves_for(group, trials)
        own_kg = [trials[k].meta.payload_kg for k in group.trials]
        motions += len(own_kg) if knowledge == "unknown" else 0
        payloads += sum(kg not in curves for kg in own_kg)
    if 2 * motions >= len(trials):
        return "other motions"
    if 2 * payloads >= len(trials):
        return "other payloads"
    if link_change(estimator, point) <= LINK_CHANGED:
        return "identified"
    return "other link" if trials[0].meta.dof == 1 else "other link, two joints"


def link_change(estimator: GaussNewton, point: FitPoint) -> float:
    """Root mean square change of the link's parameters, in standard deviations of their priors.

    The priors are those without `same_link`. It is 0 for other loads.
    """
    if estimator.residuals.plant.load != "link":
        return 0.0
    changes = [
        value / fraction
        for q, value in zip(estimator.residuals.fit_parameters, point.values, strict=True)
        for part, fraction in NUISANCE_PRIOR_FRACTION.items()
        if q.kind == "nuisance" and part in q.name
    ]
    return float(np.sqrt(np.mean(np.square(changes))))


def read_certainty() -> Certainty:
    """Read the measured certainty."""
    return msgspec.json.decode(PATH.read_bytes(), type=Certainty)
