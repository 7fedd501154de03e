"""Null distribution: d′ of each effect where nothing is missing.

The plant's own error resembles some effects more than others, and it grows with the change of the
link since the plant was identified. d′ was measured on rigs without any hidden effect, their link
changed: `null_distribution.json`, written by `python -m models.gap.training own-error`. An
effect is named only if it exceeds that. With two joints d′ of friction is as large on an unchanged
link: the part that noise and patterns do not cover differs from trial to trial.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

import msgspec
import numpy as np
from scipy.optimize import minimize
from scipy.stats import norm

from models.gap.estimation.gauss_newton import GaussNewton
from models.gap.estimation.payload_transfer import unknown_fraction
from models.gap.residuals.fit_parameters import is_alike_in_joints
from models.gap.settings import DEFAULT_SETTINGS, GapSettings
from models.plant.effects import EFFECTS
from models.plant.identification.noise_floor import PAYLOAD_REACH_KG, Array
from models.plant.plant import Plant

PATH: Final = Path(__file__).with_name("null_distribution.json")

OwnErrorKnown = Literal["patterns", "curves", "other_payloads", "nothing"]
"""What is known of the plant's own error on trials: also its variation from link to link
(`models.gap.estimation.model_discrepancy`), its mean curves, these at other payloads alone, or
nothing, where the plant was identified on other motions."""

KEY_ENDS: Final[Mapping[OwnErrorKnown, str]] = {
    "patterns": "", "curves": " without patterns", "other_payloads": " at other payloads",
    "nothing": " on other motions",
}  # fmt: skip
"""Suffix to the number of joints in the key of a distribution that was measured with less known."""

MIDDLE: Final = 0.5
"""Payload in kg of the distribution at other payloads, in the middle between two of `STUDY_KG`; the
fraction of the error that is unknown is the same at all of its payloads."""
STUDY_KG: Final = (0.0, 1.0, 2.0)
"""Payloads in kg that the plants of the calibration were identified with."""


@dataclass(frozen=True)
class KnownError:
    """What is known of the plant's own error on some trials."""

    patterns: bool = True  # Whether patterns are known for the motion of any trial
    # Fraction of the trials whose motion the plant was not identified on
    other_motions: float = 0.0
    # Unknown part of the error at the payloads of the other trials
    # (`models.gap.estimation.payload_transfer`), as a fraction of the unknown part in the middle
    # between two payloads 1 kg apart; the mean over all trials
    other_payloads: float = 0.0


class NullDistribution(
    msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True
):
    """Distribution of d′ where nothing is missing; the content of `null_distribution.json`."""

    sets: int = 0  # Data sets without an effect that it was measured on
    # Least d′ of a named effect, in standard deviations of its d′ here; taken from the settings,
    # not from the file
    threshold: float = DEFAULT_SETTINGS.least_threshold
    # Largest mean squared residual, in noise floors, that counts as noise on a link that changed by
    # one
    explained: float
    explained_growth: float = 0.0  # Growth of its logarithm with the change of the link
    # Whether it was measured with a floor pooled with the repetitions of the diagnosis
    # (`models.gap.estimation.measured_floor`); the search then does the same
    repetitions_pooled: bool = False
    # Root mean square of d′ by effect on a link that changed by one, at least 1; 1 for effects that
    # are not listed
    standard_deviation: dict[str, float] = {}
    unchanged_deviation: dict[str, float] = {}  # The same on an unchanged link

    def for_link_change(
        self, change: float, settings: GapSettings = DEFAULT_SETTINGS
    ) -> NullDistribution:
        """Distribution for a link that changed by another amount.

        `change` is relative to the links that it was measured on
        (`models.gap.estimation.link_change`). A residual of `GapSettings.noise_residual` is noise
        on any link.
        """
        explained = self.explained * float(np.exp(self.explained_growth * (change - 1)))
        return msgspec.structs.replace(
            self,
            explained=max(explained, settings.noise_residual),
            standard_deviation={
                e: float(np.sqrt((1 - change**2) * self._unchanged(e) ** 2 + change**2 * s**2))
                for e, s in self.standard_deviation.items()
            },
        )

    def _unchanged(self, effect: str) -> float:
        return self.unchanged_deviation.get(effect, 1.0)

    def least(self, effects: Sequence[str]) -> float:
        """Least d′ that effects must reach together."""
        squares = sum(self.standard_deviation.get(e, 1.0) ** 2 for e in effects)
        return self.threshold * float(np.sqrt(squares))


def null_distributions() -> dict[str, NullDistribution]:
    """Measured null distributions of the link, by number of joints and what is known."""
    if not PATH.exists():
        return {}
    return msgspec.json.decode(PATH.read_bytes(), type=dict[str, NullDistribution])


def known_error(estimator: GaussNewton) -> KnownError:
    """What is known of the plant's own error on the trials of an estimator."""
    patterns = any(own != "unknown" for _, own in estimator.knowledge().values())
    residuals, reach_kg = estimator.residuals, PAYLOAD_REACH_KG
    middle = unknown_fraction([MIDDLE], STUDY_KG, reach_kg).item()
    other_motions = other_payloads = 0.0
    for group in residuals.groups:
        measured, knowledge = estimator.floor.curves_for(group, residuals.trials)
        if knowledge == "unknown":
            other_motions += len(group.trials)
            continue
        own_kg = [residuals.trials[k].meta.payload_kg for k in group.trials]
        unknown = np.diag(unknown_fraction(own_kg, sorted(measured), reach_kg))
        other_payloads += float(np.sum(unknown)) / middle
    count = len(residuals.trials)
    return KnownError(patterns, other_motions / count, other_payloads / count)


def null_distribution_of(
    plant: Plant,
    dof: int,
    known: KnownError = KnownError(),
    settings: GapSettings = DEFAULT_SETTINGS,
) -> NullDistribution:
    """Null distribution of a plant: as measured for the link, assumed for any other load.

    Without known patterns the distribution that was measured without them is used, if there is one.
    On motions and at payloads that the plant was not identified on, the variance of d′ is at least
    that of one joint there, with two joints too [assumed], weighted by the fraction of such trials.
    """
    measured = null_distributions() if plant.load == "link" else {}
    assumed = NullDistribution(
        threshold=settings.uncalibrated_threshold,
        explained=settings.uncalibrated_residual_limit,
    )
    own = measured.get(str(dof))
    if own is None:
        return assumed
    if not known.patterns:
        own = measured.get(f"{dof}{KEY_ENDS['curves']}", own)
    parts: dict[OwnErrorKnown, float] = {
        "nothing": known.other_motions, "other_payloads": known.other_payloads,
    }  # fmt: skip
    for kind, part in parts.items():
        if part and (other := measured.get(f"1{KEY_ENDS[kind]}")) is not None:
            own = _larger(own, other, min(part, 1.0))
    if settings.separate_joints:
        own = _of_separate_joints(own, dof)
    return msgspec.structs.replace(own, threshold=settings.least_threshold)


def _of_separate_joints(known: NullDistribution, dof: int) -> NullDistribution:
    """Distribution where each joint has its own strength [assumed: they are independent]."""
    more = {e: float(np.sqrt(dof)) if is_alike_in_joints(e) else 1.0 for e in EFFECTS}
    own = (known.standard_deviation, known.unchanged_deviation)
    changed, unchanged = ({e: s * more.get(e, 1.0) for e, s in one.items()} for one in own)
    return msgspec.structs.replace(known, standard_deviation=changed, unchanged_deviation=unchanged)


def _larger(own: NullDistribution, other: NullDistribution, part: float) -> NullDistribution:
    """Distribution in which a fraction `part` of the trials has the larger variance of the two."""
    pairs = (
        (own.standard_deviation, other.standard_deviation),
        (own.unchanged_deviation, other.unchanged_deviation),
    )
    changed, unchanged = (
        {
            e: float(np.sqrt((1 - part) * known**2 + part * max(known, b.get(e, 1.0)) ** 2))
            for e in sorted({**a, **b})
            for known in [a.get(e, 1.0)]
        }
        for a, b in pairs
    )
    return msgspec.structs.replace(own, standard_deviation=changed, unchanged_deviation=unchanged)


def calibrated_null_distribution(
    separations: Sequence[Mapping[str, float]],
    left: Sequence[float],
    changes: Sequence[float],
    settings: GapSettings = DEFAULT_SETTINGS,
) -> NullDistribution:
    """Null distribution from data sets without an effect.

    d′ is divided by the root of the residual, as in the search; its variance is linear in the
    square of the change of the link. The largest d′ of each effect is left out: one rig that no
    plant describes would set the size for all effects. The residual is log-normal; mean and
    standard deviation of its logarithm are linear in the change of the link.
    """
    effects = sorted({e for row in separations for e in row})
    size = np.sqrt(np.maximum(left, 1.0))
    change = np.array(changes)
    changed, unchanged = {}, {}
    for effect in effects:
        own = np.array([row.get(effect, 0.0) for row in separations]) / size
        kept = np.argsort(own / np.hypot(1.0, change))[:-1] if len(own) > 1 else slice(None)
        unchanged[effect], changed[effect] = _deviations(own[kept], change[kept])
    explained, growth = _largest_residuals(np.log(left), change, settings.null_quantile)
    return NullDistribution(
        sets=len(separations),
        threshold=settings.least_threshold,
        explained=round(explained, 3),
        explained_growth=round(growth, 3),
        standard_deviation={e: round(s, 3) for e, s in changed.items()},
        unchanged_deviation={e: round(s, 3) for e, s in unchanged.items()},
    )


def _deviations(separation: Array, change: Array) -> tuple[float, float]:
    """Standard deviation of d′ on an unchanged link and on one that changed by one.

    Maximum likelihood; the former is at least 1.
    """

    def cost(p: Array) -> float:
        variance = p[0] + change**2 * p[1]
        return float(np.sum(np.log(variance) + separation**2 / variance))

    growth = max(float(np.mean(separation**2 - 1)), 0.0) / max(float(np.mean(change**2)), 1e-6)
    found = minimize(cost, [1.0, growth], method="L-BFGS-B", bounds=[(1.0, None), (0.0, None)]).x
    return float(np.sqrt(found[0])), float(np.sqrt(np.sum(found)))


def _largest_residuals(logarithm: Array, change: Array, quantile: float) -> tuple[float, float]:
    """Quantile of the residual on a link that changed by one, and the growth of its logarithm.

    Maximum likelihood; the standard deviation does not fall with the change.
    """

    def cost(p: Array) -> float:
        deviation = p[2] + p[3] * change
        z = (logarithm - p[0] - p[1] * change) / deviation
        return float(np.sum(np.log(deviation) + z**2 / 2))

    scatter = max(float(np.std(logarithm)), 1e-3)
    start = np.array([float(np.mean(logarithm)), 0.0, scatter, 0.0])
    bounds = [(None, None), (None, None), (1e-3, None), (0.0, None)]
    mean, growth, fixed, growing = minimize(cost, start, method="L-BFGS-B", bounds=bounds).x
    beyond = float(norm.ppf(quantile))
    grown = growth + beyond * growing
    return float(np.exp(mean + beyond * fixed + grown)), float(grown)
