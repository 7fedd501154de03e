"""Gap document (`gap.json`): the results of a diagnosis for machines."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, ClassVar, Literal

import msgspec

from firmware_py.core.documents import Document, read_document
from models.gap.decision.certainty import Answers
from models.gap.estimation.transfer import Knowledge
from models.gap.experiment.rival import HypothesisRecord
from models.gap.outliers import OutlierTrial
from models.gap.residuals.localisation import GapRegion
from models.gap.settings import GapSettings

GapVerdict = Literal["no gap", "closed", "reduced", "not in the catalogue", "no floor"]
"""Nothing is missing; the named effects explain the gap; more than noise is left beside them;
something outside of the catalogue is missing; the noise is unknown, so nobody can tell."""


class SignalFloor(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Noise floor of a signal: noise, the plant's own error, and both (root mean squares, SI)."""

    noise_rms: float
    model_rms: float
    rms: float


class NoiseFloorSummary(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Noise floor by signal."""

    learned: bool  # False where the plant file has no floor
    signals: dict[str, SignalFloor]
    # How the plant's own error is known, by group of trials; an unknown one is not subtracted
    own_error: dict[str, Knowledge] = {}
    # Factor in amplitude, by payload in kg, by which the floor exceeds that of the plant file,
    # where repetitions differ far more than that
    amplification: dict[str, float] = {}


def largest_gaps(regions: Sequence[GapRegion]) -> dict[str, float]:
    """Largest gap of each signal over a whole trial, in noise floors, the largest first.

    Signals with a significant gap, or all where none has one.
    """
    of_trials = [c for c in regions if c.factor == "trial"] or regions
    counted = [c for c in of_trials if c.significant] or of_trials
    sizes = {c.signal: c.size for c in sorted(counted, key=lambda c: c.size)}
    return dict(sorted(sizes.items(), key=lambda row: -row[1]))


class FittedValue(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Fitted value of a parameter, its standard error (None if not fitted) and the value before."""

    value: float
    unit: str
    error: float | None
    before: float


class NamingEvidence(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Evidence for a named effect.

    `separation` is the d′ that it adds to those named before it, `separation_of_nothing` the d′
    that is reached where nothing is missing. Of the whole named set
    (`models.gap.decision.certainty`): `difference` of its strengths between parts of the trials,
    and mean squared `residual` in noise floors.
    """

    separation: float
    separation_of_nothing: float
    difference: float
    residual: float


class SimilarEffects(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Effects that may be missing instead of a named one, and the d′ of their set."""

    effects: tuple[str, ...]
    separation: float


class SeparatingMotion(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Motion and payload that would tell look-alikes apart, and the least d′ that each adds."""

    motion: str
    separation: dict[str, float]


class NamedEffect(
    msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True
):
    """Effect that is missing; `joint` is set if it is missing in one servo alone.

    `parameters` holds the fitted values by the name of the plant's parameter, the strength first.
    """

    effect: str
    joint: int | None
    parameters: Annotated[dict[str, FittedValue], msgspec.Meta(min_length=1)]
    evidence: NamingEvidence
    look_alikes: tuple[SimilarEffects, ...]
    separated_by: SeparatingMotion | None = None

    @property
    def candidate(self) -> str:
        """Effect with its joint, as in `hypotheses` and `effect_probabilities`."""
        return f"{self.effect}:{self.joint}" if self.joint else self.effect


class RefusedEffects(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Effects that stand out and are not named, or are named and not written to the plant.

    `improbable`: more probably something else is missing, or nothing. `held-out error`: the error
    on what was left out does not fall. `further`: errors in the equations of the named effects may
    look like them.
    """

    effects: tuple[str, ...]
    kind: Literal["not written", "improbable", "held-out error", "further"]
    separation: float
    reason: str


class RejectedEffect(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Other effect of the catalogue: its d′, and why it is not named."""

    effect: str
    separation: float
    reason: str


class SignalGap(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Root mean square error of a signal in its SI unit, and in noise floors where there is one."""

    rms: float
    unit: str
    floors: float | None


class PlantErrors(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Errors of a plant by signal: on all trials, and on each part of them by a fit of the rest."""

    fitted: dict[str, SignalGap]
    held_out: dict[str, SignalGap]


class HeldOutSummary(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What was left out in turn, and the error there as a fraction of that before.

    The fraction is a geometric mean over the signals.
    """

    left_out: tuple[str, ...]
    fraction: float


class WrittenPlant(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Effects of the plant that was written, parameters that changed, and why it lacks others."""

    effects: tuple[str, ...]
    parameters: dict[str, FittedValue]
    reason: str = ""


Condition = Literal["step_s", "payload_kg", "pressure_pa"]


class ChangedCondition(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Condition with values that no trial of the plant has."""

    condition: Condition
    unit: str
    plant: tuple[float, ...]  # Values in the trials of the plant
    trials: tuple[float, ...]  # Values in the diagnosed trials that no trial of the plant has


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


class GapDocument(Document, frozen=True, kw_only=True):
    """Content of `gap.json`; docs/gap.md explains the keys and `gap_document` makes it.

    Attributes
    ----------
    verdict, headline : str
        See `GapVerdict`; verdict, names and what was written in words.
    probabilities : Answers or None
        Probabilities that nothing is missing, the named effects are, or something outside of the
        catalogue is; None without a learned noise floor.
    gap_left_fraction : float or None
        Fraction of the gap's amplitude that remains with the named effects.
    named, refused, rejected : tuple
        Missing effects, the one that explains most first; effects that stand out and are not named,
        or not written; all others of the catalogue.
    hypotheses, effect_probabilities
        Sets of effects that may be missing, by their probability; probability of each effect that
        it is among those missing, from 1 % on.
    written : WrittenPlant
        What the improved plant has.
    sentence, located, map
        Where the gap is: in words, significant regions ranked, and all regions.
    noise_floor : NoiseFloorSummary
        Noise floor by signal.
    before, after, held_out
        Errors of the diagnosed and of the improved plant, and what was left out in turn.
    odd_trials, changed_conditions : tuple
        Outlier trials, which were left out; conditions that no trial of the plant has.
    rows_fitted, goal_not_followed_at_row : dict of str to int
        By trial: rows that were fitted, of a trial too long to be fitted as a whole; first row from
        which the joint does not follow its goal, so that it is not used.
    settings, inputs
        Settings of the run, and its files; None where it was run from Python.

    Examples
    --------
    With the `diagnosis` in the example of `diagnose`:

    >>> import dropstitch
    >>> dropstitch.gap_document(diagnosis).headline
    'Missing: coulomb friction 0.0491 ± 0.0086 N·m (dry friction torque at the output). ...'
    """

    VERSION: ClassVar[int] = 4
    MADE_BY: ClassVar[str] = "dropstitch gap"

    verdict: GapVerdict
    headline: str = ""
    probabilities: Answers | None = None
    separation_of_nothing: float
    gap_left_fraction: float | None
    named: tuple[NamedEffect, ...]
    refused: tuple[RefusedEffects, ...] = ()
    rejected: tuple[RejectedEffect, ...]
    effect_probabilities: dict[str, float] = msgspec.field(default_factory=dict)
    hypotheses: tuple[HypothesisRecord, ...] = ()
    written: WrittenPlant
    sentence: str
    located: tuple[GapRegion, ...]
    map: tuple[GapRegion, ...]
    noise_floor: NoiseFloorSummary
    before: PlantErrors
    after: PlantErrors
    held_out: HeldOutSummary
    odd_trials: tuple[OutlierTrial, ...] = ()
    changed_conditions: tuple[ChangedCondition, ...] = ()
    rows_fitted: dict[str, int] = msgspec.field(default_factory=dict)
    goal_not_followed_at_row: dict[str, int] = msgspec.field(default_factory=dict)
    settings: GapSettings
    inputs: DiagnosisInputs | None = None

    @property
    def floor_rms(self) -> dict[str, float]:
        """Noise floor by signal, in SI units; empty where none was learned."""
        floor = self.noise_floor
        return {s: row.rms for s, row in floor.signals.items()} if floor.learned else {}


def read_gap_document(path: Path) -> GapDocument:
    return read_document(path, GapDocument)
