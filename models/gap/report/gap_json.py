"""Gap document (`gap.json`): the results of a diagnosis for machines."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, ClassVar, Literal

import msgspec

from firmware_py.documents import Document, read_document, write_document
from models.gap.decision.answers import Answers
from models.gap.decision.decision import JudgedNames
from models.gap.decision.gap_verdict import GapVerdict
from models.gap.decision.rejected_effects import RejectedEffect
from models.gap.estimation.curve_transfer import Knowledge
from models.gap.odd_trials import OddTrial
from models.gap.report.changed_conditions import ChangedCondition
from models.gap.search.refused_effect import RefusedEffect
from models.gap.settings import GapSettings

__all__ = ["DiagnosisInputs", "GapDocument", "read_gap_document", "write_gap_document"]


class SignalFloor(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Noise floor of a signal: noise, the plant's own error, and both (root mean squares, SI)."""

    noise_rms: float
    model_rms: float
    rms: float


class OwnError(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What is known of the plant's own error in a group of trials: its mean curve, and its
    patterns.

    Each is `measured` on trials like these, `transferred` from others of the same motion with
    another length, step or rest, or `unknown`; an unknown error is not subtracted.
    """

    curve: Knowledge
    patterns: Knowledge


class NoiseFloorSummary(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Noise floor by signal; `learned` is false where the plant file carries none.

    `dispersion` is the mean square of the nuisance fit's residual, clipped to what noise explains.
    `own_error` states by group of trials what is known of the plant's own error. `amplification` is
    the factor in amplitude, by payload in kg, by which the floor exceeds that of the plant file; it
    is set where repetitions differ far more than that.
    """

    learned: bool
    signals: dict[str, SignalFloor]
    dispersion: float
    own_error: dict[str, OwnError] = {}
    amplification: dict[str, float] = {}


class LocatedRegion(
    msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True
):
    """Significant region of a signal, by one factor: trial, payload, phase, direction, angle,
    stroke or band.

    `size` is a root mean square and `mean` a signed mean, in noise floors; `p` is the fraction of
    draws of noise alone that are as large.
    """

    signal: str
    trial: str = ""
    payload: str = ""
    phase: str = ""
    direction: str = ""
    angle: str = ""
    stroke: str = ""
    band: str = ""
    size: float
    mean: float
    p: float


class MappedRegion(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Region of a signal, significant or not; `size` in noise floors."""

    signal: str
    factor: str
    level: str
    size: float
    significant: bool


class RemainingGap(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Location of the gap that remains with the named effects."""

    sentence: str
    located: tuple[LocatedRegion, ...]


class FittedValue(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Fitted value of a parameter, its standard error and its value before the fit.

    `bound` is set where the fit ended at a bound of the parameter, unless that bound is zero and
    the parameter belongs to an added effect.
    """

    value: float
    unit: str
    error: float | None
    before: float
    bound: Literal["lower", "upper"] | None = None

    def __str__(self) -> str:
        """Rounded value, with its error where it has one, without the unit."""
        return f"{self.value:.4g}" + (f" ± {self.error:.2g}" if self.error is not None else "")

    @property
    def unit_in_words(self) -> str:
        """Unit preceded by a space; empty for a parameter without a unit."""
        return f" {self.unit}" if self.unit not in ("", "1") else ""

    @property
    def bound_in_words(self) -> str:
        """Note in brackets that the value is at a bound or was not fitted; empty otherwise."""
        if self.bound:
            return f" (at its {self.bound} bound)"
        return " (not fitted)" if self.error is None else ""


class NamingEvidence(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Evidence for a named effect."""

    separation: float  # d′ of the effect
    least: float  # Least d′ that it needs to be named
    # Fall of the cost on held-out trials and of the nuisance's prior, in squared noise floors
    held_out_gain: float | None
    held_out_error: float | None  # Value that `held_out_gain` must exceed
    # Fraction by which the strength differs between payloads, signals and bands
    strength_standard_deviation: float
    strength_holds: bool  # Whether this difference is tolerable


class SimilarEffect(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Look-alike of a named effect, with its d′."""

    effect: str
    separation: float


class SeparatingMotion(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Motion that would tell look-alikes apart, and the least d′ on each motion of the menu."""

    motion: str
    separation: dict[str, float]


class NamedEffect(
    msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True
):
    """Inclusion of the search: an effect, or a pair joined by " + "; `kept` if it is still named at
    the end.

    `parameters` holds the fitted values by the name of the plant's parameter.
    """

    effect: str
    kept: bool
    parameters: dict[str, FittedValue]
    evidence: NamingEvidence
    look_alikes: tuple[SimilarEffect, ...]
    separated_by: SeparatingMotion | None = None


class HypothesisRecord(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Set of effects that may be missing, and its probability; an empty set means that nothing is
    missing.

    `parameters` holds the fitted values by the name of the plant's parameter, nuisance included.
    """

    effects: tuple[str, ...]
    probability: Annotated[float, msgspec.Meta(ge=0, le=1)]
    parameters: dict[str, float]


class SignalGap(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Root mean square error of a signal in its SI unit, and in noise floors where there is one."""

    rms: float
    unit: str
    floors: float | None


class WaterfallStep(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Error after one step on trials that no value was fitted to, in noise floors."""

    step: str
    floors: float


class HeldOutSignal(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Root mean square held-out error of a signal, in its SI unit.

    `given` is of the plant that was diagnosed, `improved` of the improved plant fitted to the rest.
    """

    given: float
    improved: float


class HeldOutSummary(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Held-out errors by signal, and what was left out in turn."""

    left_out: tuple[str, ...]
    signals: dict[str, HeldOutSignal]


class DiagnosisInputs(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Inputs of a diagnosis: the file of the plant, and the directories of the trials.

    The hashes are empty where they are not known; `dof` is set where only the trials with that
    number of joints were diagnosed.
    """

    plant: str
    plant_sha256: str
    trials: tuple[str, ...]
    trials_sha256: str = ""
    dof: Literal[1, 2] | None = None


class GapDocument(Document, frozen=True):
    """Content of `gap.json`; docs/gap.md explains the keys.

    Attributes
    ----------
    verdict : str
        See `models.gap.decision.gap_verdict.GapVerdict`.
    gap_left_fraction : float
        Fraction of the gap's amplitude that remains.
    noise_floor : NoiseFloorSummary
        Noise floor by signal.
    nuisance_bias : dict of str to float
        Variations in which all trials differ in the same way, in standard deviations.
    goal_not_followed_at_row : dict of str to int
        First row from which the joint does not follow its goal, by trial; later rows are not used.
    sentence, located, map
        Where the gap is: in words, significant regions ranked, and all regions.
    named : tuple of NamedEffect
        Inclusions in order, also those that were taken out again.
    before, after : dict
        Errors of the plants: "fitted" or "held_out" → signal → SignalGap.
    remaining : RemainingGap
        Where the gap is with the named effects.
    rejected : tuple of RejectedEffect
        Effects that were not named, each with its reason.
    waterfall : tuple of WaterfallStep
        Error after each inclusion.
    settings : GapSettings
        Tuned numbers of the run.
    rows_fitted : dict of str to int
        Rows that were fitted, for each trial that is too long to be fitted as a whole.
    refused : tuple of RefusedEffect
        Effects that were taken out again, and refitted values that were undone.
    refitted : dict of str to FittedValue
        Parameters of the link that were refitted and written although nothing is named.
    held_out : HeldOutSummary
        Errors on what was left out in turn.
    hypotheses : tuple of HypothesisRecord
        Sets of effects that may be missing, by their probability.
    effect_probabilities : dict of str to float
        Probability of each effect that it is among those missing; those below 1 % are left out.
    tested : tuple of JudgedNames
        Sets of effects that were judged, in order, with their evidence and the probabilities of the
        answers; the last one led to the verdict. Empty without a learned noise floor.
    inputs : DiagnosisInputs or None
        Files of the diagnosis; None where it was run from Python.
    changed_conditions : tuple of ChangedCondition
        Conditions of the trials that no trial of the plant has.
    odd_trials : tuple of OddTrial
        Outlier trials that were left out, because they differ from the plant far more than
        comparable ones.
    unexplained_fraction : float
        Geometric mean, over the signals, of the improved plant's held-out error as a fraction of
        that of the plant that was diagnosed: 1 where nothing was named.
    """

    VERSION: ClassVar[int] = 2
    MADE_BY: ClassVar[str] = "dropstitch gap"

    verdict: GapVerdict
    gap_left_fraction: float
    noise_floor: NoiseFloorSummary
    nuisance_bias: dict[str, float]
    goal_not_followed_at_row: dict[str, int]
    sentence: str
    located: tuple[LocatedRegion, ...]
    map: tuple[MappedRegion, ...]
    named: tuple[NamedEffect, ...]
    before: dict[str, dict[str, SignalGap]]
    after: dict[str, dict[str, SignalGap]]
    remaining: RemainingGap
    rejected: tuple[RejectedEffect, ...]
    waterfall: tuple[WaterfallStep, ...]
    settings: GapSettings
    rows_fitted: dict[str, int] = msgspec.field(default_factory=dict)
    refused: tuple[RefusedEffect, ...] = ()
    refitted: dict[str, FittedValue] = msgspec.field(default_factory=dict)
    held_out: HeldOutSummary | None = None
    unexplained_fraction: float | None = None
    hypotheses: tuple[HypothesisRecord, ...] = ()
    effect_probabilities: dict[str, float] = msgspec.field(default_factory=dict)
    tested: tuple[JudgedNames, ...] = ()
    inputs: DiagnosisInputs | None = None
    changed_conditions: tuple[ChangedCondition, ...] = ()
    odd_trials: tuple[OddTrial, ...] = ()

    @property
    def answers(self) -> Answers | None:
        """Probabilities that led to the verdict; None without a learned noise floor."""
        return self.tested[-1].answers if self.tested else None


def read_gap_document(path: Path) -> GapDocument:
    return read_document(path, GapDocument)


def write_gap_document(path: Path, document: GapDocument) -> None:
    write_document(path, document)
