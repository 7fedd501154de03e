"""Gap document (`gap.json`): the results of a diagnosis for machines."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import ClassVar, Final

import msgspec
import numpy as np

from firmware_py.documents import Document, read_document, write_document
from models.gap.diagnosis import Diagnosis, Inclusion
from models.gap.gap_verdict import GapVerdict
from models.gap.report.separating_motion import separating_motion
from models.gap.residuals.localisation import GapRegion, location_sentence
from models.gap.residuals.spectrum import Array
from models.gap.search.rejected_effects import RejectedEffect
from models.gap.settings import GapSettings
from models.plant.identification.evaluation import compare_with_trials, signal_errors
from models.plant.plant import Plant
from models.trials.trial import Trial, TrialSet

__all__ = ["GapDocument", "gap_document", "read_gap_document", "write_gap_document"]

MOST_LOCATED: Final = 40
MOST_REMAINING: Final = 10
"""Significant regions that are listed before and after; `map` holds all."""


class SignalFloor(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Noise floor of a signal: noise, the plant's own error, and both (root mean squares, SI)."""

    noise_rms: float
    model_rms: float
    rms: float


class NoiseFloorSummary(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Noise floor by signal; `learned` is false where the plant file carries none.

    `dispersion` is the mean square of the nuisance fit's residual, clipped to what noise explains.
    """

    learned: bool
    signals: dict[str, SignalFloor]
    dispersion: float


class LocatedRegion(
    msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True
):
    """Significant region of a signal, by one of the factors trial to band.

    `size` is a root mean square and `mean` a mean with sign, in noise floors; `p` is the fraction
    of noise alone that is as large.
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
    """Region of a signal, whether significant or not; `size` in noise floors."""

    signal: str
    factor: str
    level: str
    size: float
    significant: bool


class RemainingGap(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Location of the gap that is left with the named effects."""

    sentence: str
    located: tuple[LocatedRegion, ...]


class FittedValue(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Value of a parameter of a named effect, its standard error, and its value before."""

    value: float
    unit: str
    error: float | None
    before: float


class NamingEvidence(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Evidence for a named effect.

    Attributes
    ----------
    separation, least : float
        Its d′, and the least that it needs.
    held_out_gain, held_out_error : float or None
        Fall of the cost on trials left out, in squared noise floors, and its standard error.
    strength_standard_deviation : float
        Fraction by which its strength differs between payloads, signals and bands.
    strength_holds : bool
        Whether that is tolerable.
    """

    separation: float
    least: float
    held_out_gain: float | None
    held_out_error: float | None
    strength_standard_deviation: float
    strength_holds: bool


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
    """Inclusion of the search: an effect, or a pair joined by " + "; `kept` if needed to the end.

    `parameters` holds the fitted values by the name of the plant's parameter.
    """

    effect: str
    kept: bool
    parameters: dict[str, FittedValue]
    evidence: NamingEvidence
    look_alikes: tuple[SimilarEffect, ...]
    separated_by: SeparatingMotion | None = None


class SignalGap(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Root mean square error of a signal in its SI unit, and in noise floors where there is one."""

    rms: float
    unit: str
    floors: float | None


class WaterfallStep(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Error on trials that nothing was fitted to after one step, in noise floors."""

    step: str
    floors: float


class GapDocument(Document, frozen=True):
    """Content of `gap.json`; docs/gap.md explains the keys.

    Attributes
    ----------
    verdict : str
        See `models.gap.gap_verdict.GapVerdict`.
    gap_left_fraction : float
        Fraction of the gap's amplitude that is left.
    noise_floor : NoiseFloorSummary
        By signal.
    nuisance_bias : dict of str to float
        Variations in which all trials differ alike, in standard deviations.
    goal_not_followed_at_row : dict of str to int
        First row that does not count, by trial.
    sentence, located, map
        Where the gap is: in words, significant regions ranked, and all regions.
    named : tuple of NamedEffect
        In order of inclusion.
    before, after : dict
        Errors of the plants: "fitted" or "held_out" → signal → SignalGap.
    remaining : RemainingGap
        Where the rest is.
    rejected : tuple of RejectedEffect
        All other effects.
    waterfall : tuple of WaterfallStep
        Error after each inclusion.
    settings : GapSettings
        Tuned numbers of the run.
    """

    VERSION: ClassVar[int] = 2
    MADE_BY: ClassVar[str] = "python -m models gap"

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


def read_gap_document(path: Path) -> GapDocument:
    """Read `gap.json`.

    Raises
    ------
    InputError
        If it is missing, damaged, or of another version.
    """
    return read_document(path, GapDocument)


def write_gap_document(path: Path, document: GapDocument) -> None:
    """Write `gap.json`."""
    write_document(path, document)


def gap_document(
    found: Diagnosis, trials: TrialSet, waterfall: Sequence[tuple[str, float]] = ()
) -> GapDocument:
    """Document of a diagnosis.

    Parameters
    ----------
    found : Diagnosis
        Its results.
    trials : TrialSet
        Where the gap was looked for.
    waterfall : sequence of tuple
        As `models.gap.report.waterfall.waterfall_steps`.
    """
    floor = noise_floor_rms(found)
    unused = found.goal_not_followed_at_row
    fit, held_out = trials.split()
    parts = {"fitted": fit, "held_out": held_out} if len(held_out) else {"fitted": fit}
    before, after = (
        {part: errors_in_floors(plant, own, floor, unused) for part, own in parts.items()}
        for plant in (found.plant, found.improved)
    )
    return GapDocument(
        schema=GapDocument.VERSION,
        verdict=found.verdict,
        gap_left_fraction=round(found.gap_left_fraction, 4),
        noise_floor=NoiseFloorSummary(found.floor.learned, floor, round(found.dispersion, 4)),
        nuisance_bias=found.nuisance_bias,
        goal_not_followed_at_row=unused,
        sentence=location_sentence(found.located, found.settings),
        located=_located(found.located, MOST_LOCATED),
        map=tuple(
            MappedRegion(c.signal, c.factor, c.level, round(c.floors, 3), c.significant)
            for c in found.located
        ),
        named=tuple(_named(found, trials, inclusion) for inclusion in found.inclusions),
        before=before,
        after=after,
        remaining=RemainingGap(
            location_sentence(found.remaining, found.settings),
            _located(found.remaining, MOST_REMAINING),
        ),
        rejected=found.rejected,
        waterfall=tuple(WaterfallStep(step, floors) for step, floors in waterfall),
        settings=found.settings,
    )


def noise_floor_rms(found: Diagnosis) -> dict[str, SignalFloor]:
    """Noise floor of each signal as root mean squares over the spectrum."""
    floor = found.floor
    return {
        s: SignalFloor(
            _rms(floor.noise[s]), _rms(floor.model[s]), _rms(floor.noise[s] + floor.model[s])
        )
        for s in floor.noise
    }


def errors_in_floors(
    plant: Plant,
    trials: Sequence[Trial],
    floor: Mapping[str, SignalFloor],
    goal_not_followed_at_row: Mapping[str, int],
) -> dict[str, SignalGap]:
    """Root mean square of each signal's error, and the same in noise floors.

    Parameters
    ----------
    plant : Plant
        To simulate with.
    trials : sequence of Trial
        To compare with.
    floor : mapping of str to SignalFloor
        By signal.
    goal_not_followed_at_row : mapping of str to int
        By trial, the row from which on nothing counts.
    """
    compared = []
    for c in compare_with_trials(plant, trials):
        end = goal_not_followed_at_row.get(c.trial.name, len(c.trial))
        unused = np.where(np.arange(len(c.trial)) < end, 0.0, np.nan)
        compared.append(c._replace(simulated={s: y + unused for s, y in c.simulated.items()}))
    result = {}
    for signal, row in signal_errors(plant, compared).items():
        if not np.isfinite(row.rms):  # never measured where the rows count
            continue
        size = floor[signal].rms if signal in floor else np.nan
        result[signal] = SignalGap(row.rms, row.unit, _number(row.rms / size))
    return result


def _named(found: Diagnosis, trials: TrialSet, inclusion: Inclusion) -> NamedEffect:
    """One inclusion: effects, values, evidence, look-alikes."""
    consistencies = [
        found.strength_consistency[e] for e in inclusion.effects if e in found.strength_consistency
    ]
    before, separated_by = found.plant.parameters, None
    if inclusion.look_alikes:
        motion, sizes = separating_motion(found, trials, inclusion.look_alikes)
        separated_by = SeparatingMotion(motion, {k: round(v, 2) for k, v in sizes.items()})
    return NamedEffect(
        effect=" + ".join(inclusion.effects),
        kept=inclusion.kept,
        parameters={
            name: FittedValue(
                q.value, q.unit, q.error, before[name].value if name in before else 0.0
            )
            for direction in found.fit_parameters if direction.effect in inclusion.effects
            for name in direction.parameters if (q := found.improved.parameters.get(name))
        },
        evidence=NamingEvidence(
            separation=inclusion.separation,
            least=inclusion.least,
            held_out_gain=_number(inclusion.held_out_gain),
            held_out_error=_number(inclusion.held_out_error),
            strength_standard_deviation=max(
                (c.standard_deviation for c in consistencies), default=0.0
            ),
            strength_holds=all(c.holds for c in consistencies),
        ),
        look_alikes=tuple(
            SimilarEffect(" + ".join(c.effects), c.separation) for c in inclusion.look_alikes
        ),
        separated_by=separated_by,
    )  # fmt: skip


def _located(regions: Sequence[GapRegion], most: int) -> tuple[LocatedRegion, ...]:
    """The largest significant regions; sizes are in noise floors."""
    return tuple(
        msgspec.convert(
            {
                "signal": c.signal, c.factor: c.level, "size": round(c.floors, 3),
                "mean": round(c.mean, 3), "p": round(c.p, 4),
            },
            LocatedRegion,
        )
        for c in [c for c in regions if c.significant][:most]
    )  # fmt: skip


def _rms(variance: Array) -> float:
    return float(np.sqrt(np.mean(variance)))


def _number(value: float) -> float | None:
    """None in place of a float that is not finite."""
    return float(value) if np.isfinite(value) else None
