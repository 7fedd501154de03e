"""Certainty of a name, measured on rigs of drawn structure whose effect is known.

Three numbers of a fit give the probabilities that nothing is missing, that its effects are what is
missing, and that something outside of the catalogue is:

- separation: its d′, over a factor on motions and at payloads that the plant was not identified on,
  where its own error is larger;
- difference: by how much the strength of an effect differs between parts of the trials
  (`models.gap.search.strength_consistency`);
- left: fraction of the gap's amplitude, beyond noise, that it leaves. What leaves nearly all of a
  gap that is more than noise explains nothing, whatever its d′.

Where nothing is missing, the plant's own error lets some effect reach a large d′ as well, on a link
that changed up to 25. But as a stand-in it needs another strength in each part of the trials. The
numbers enter a multinomial logistic regression; `certainty.json` holds it with the error of each
effect's equation. `python -m models.gap.training` makes the file.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final, Literal

import msgspec
import numpy as np

from models.gap.estimation.gauss_newton import GaussNewton

PATH: Final = Path(__file__).with_name("certainty.json")

Knowledge = Literal["identified", "other motions", "other payloads"]
"""Whether the plant was identified on such trials, and else what was new to it."""

DECIDED: Final = 0.9
"""Probability above which an effect counts as decided; below 1 − this, as excluded."""
LEAST_SEPARATION: Final = 1.0
"""d′ below which a smaller one proves no less: its standard deviation by noise alone."""
NOTHING_EXPLAINED: Final = 0.95
"""Fraction of a gap that is left above which nothing of it counts as explained. Right names on rigs
for tuning left up to 0.89 of a gap that was more than noise, a single one 0.98. A payload that
stood in for a denied ripple left 0.997."""


class Evidence(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Numbers of a fit that the probabilities follow from; see the module's docstring."""

    separation: float
    difference: float
    left: float
    is_open: bool  # Whether more than noise is left

    @property
    def terms(self) -> list[float]:
        """Terms of the regression."""
        separation = max(self.separation, LEAST_SEPARATION)
        return [1.0, float(np.log(separation)), self.difference, self.left]


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
    separation_of_nothing: float
    residual_of_nothing: float
    # Factor by which d′ is larger there on trials of which less is known of the plant's own error
    separation_scale: dict[Knowledge, float]
    answers: dict[str, list[float]]  # Coefficients of `Evidence.terms` for each answer
    # Root mean square error of a fitted strength beyond chance, as a fraction of it
    equation_error: dict[str, float]

    def scale_for(self, known: GaussNewton) -> float:
        """Factor on d′ where nothing is missing, on the trials of an estimator."""
        return self.separation_scale[knowledge_of(known)]

    def answers_for(self, evidence: Evidence) -> Answers:
        """Probabilities of the answers."""
        score = {name: float(np.dot(row, evidence.terms)) for name, row in self.answers.items()}
        weight = {name: np.exp(s - max(score.values())) for name, s in score.items()}
        if evidence.is_open and evidence.left > NOTHING_EXPLAINED:
            weight["outside"] += weight["catalogue"]
            weight["catalogue"] = 0.0
        total = sum(weight.values())
        return Answers(**{name: float(w / total) for name, w in weight.items()})

    def error_of_strength(self, effect: str) -> float:
        """Error of an effect's strength as a fraction; the largest measured one where unknown."""
        return self.equation_error.get(effect, max(self.equation_error.values()))


def knowledge_of(known: GaussNewton) -> Knowledge:
    """What is known of the plant's own error on most of the trials."""
    trials, motions, payloads = known.residuals.trials, 0, 0
    for group in known.residuals.groups:
        curves, knowledge = known.floor.curves_for(group, trials)
        own_kg = [trials[k].meta.payload_kg for k in group.trials]
        motions += len(own_kg) if knowledge == "unknown" else 0
        payloads += sum(kg not in curves for kg in own_kg)
    if 2 * motions >= len(trials):
        return "other motions"
    return "other payloads" if 2 * payloads >= len(trials) else "identified"


def read_certainty() -> Certainty:
    """Read the measured certainty."""
    return msgspec.json.decode(PATH.read_bytes(), type=Certainty)
