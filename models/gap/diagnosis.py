"""Diagnosis: from trials and a plant to the missing effects, their certainty and a better plant."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import msgspec
from threadpoolctl import threadpool_limits

from firmware_py.errors import InputError
from models.gap.decision.decision import JudgedNames, decide
from models.gap.decision.gap_verdict import GapVerdict
from models.gap.decision.posterior import Hypothesis, posterior_of
from models.gap.decision.rejected_effects import RejectedEffect, rejected_effects
from models.gap.estimation.curve_transfer import Knowledge
from models.gap.estimation.gauss_newton import GaussNewton
from models.gap.estimation.model_discrepancy import ModelDiscrepancy
from models.gap.estimation.noise_floor import NoiseFloor
from models.gap.estimation.noise_floor_fit import noise_floor_for, nuisance_and_variation
from models.gap.improved_plant import improved_plant
from models.gap.inclusion import Inclusion, inclusions_of
from models.gap.odd_repetitions import disturbed_trials
from models.gap.odd_trials import OddTrial, without_odd
from models.gap.residuals.fit_parameters import (
    FitParameter,
    candidate_effects,
    effect_fit_parameters,
)
from models.gap.residuals.localisation import GapRegion, locate_gap
from models.gap.residuals.residuals import Residuals
from models.gap.residuals.time_blocks import in_time_blocks
from models.gap.search.effect_search import EffectSearch, ReportProgress
from models.gap.search.null_distribution import NullDistribution
from models.gap.search.refused_effect import RefusedEffect
from models.gap.search.separate_joints import joints_differ
from models.gap.search.strength_consistency import StrengthConsistency
from models.gap.settings import DEFAULT_SETTINGS, GapSettings
from models.plant.components import LOADS
from models.plant.identification.noise_floor import Array, aligned
from models.plant.plant import Plant
from models.trials.trial import Trial, TrialSet

__all__ = ["Diagnosis", "all_fit_parameters", "diagnose", "plant_is_known"]


@dataclass(frozen=True)
class Diagnosis:
    """Results of the gap workflow.

    Attributes
    ----------
    plant, improved : Plant
        The plant that was diagnosed, and the same with the named effects and the refitted nuisance.
    fitted : Plant
        With the named effects, also where they are not written into the improved plant.
    trials : TrialSet
        Trials that were diagnosed; of a single trial its blocks of time
        (`models.gap.residuals.time_blocks`).
    settings : GapSettings
        Tuned numbers of this run.
    verdict : str
        See `models.gap.decision.gap_verdict.GapVerdict`.
    gap_left_fraction : float
        Fraction of the gap's amplitude, in units of the noise floor, that remains.
    floor : NoiseFloor
        Noise floor of the plant file, or of the nuisance fit.
    null_distribution : NullDistribution
        Distribution of d′ where nothing is missing; an effect must exceed it to be named.
    dispersion, residual_before, residual_after : float
        Mean squared residual in noise floors: of the nuisance fit, clipped to what noise explains;
        of the nuisance fit; with the named effects.
    nuisance_bias : dict of str to float
        Kinds of variation in which all trials differ in the same way, in standard deviations.
    goal_not_followed_at_row : dict of str to int
        First row from which the joint does not follow its goal, by trial; later rows are not used.
    rows_fitted : dict of str to int
        Rows that were fitted, for each trial that is too long to be fitted as a whole
        (`models.plant.identification.fit`).
    own_error : dict of str to tuple of str
        By group of trials: how well the plant's mean error and its patterns are known there
        (`models.gap.estimation.curve_transfer.Knowledge`).
    located, remaining : tuple of GapRegion
        Where the gap is after the nuisance fit, and with the named effects.
    named : tuple of str
        Effects in order of inclusion, without those deleted again.
    inclusions : tuple of Inclusion
        All inclusions, also of effects that were taken out again.
    hypotheses : tuple of Hypothesis
        Sets of effects that may be missing, by their probability.
    tested : tuple of JudgedNames
        Sets of effects that were judged, in order; the last one led to the verdict.
    strength_consistency : dict of str to StrengthConsistency
        Of each named effect without a dead zone.
    screened, refitted : dict of str to float
        d′ of each effect in the first round: after one step, and of the best ones refitted alone.
    rejected : tuple of RejectedEffect
        Effects that were never included.
    refused : tuple of RefusedEffect
        Effects that were taken out again, and refitted values that were undone.
    left_out : tuple of str
        What was left out in turn for the held-out errors, for example "payloads".
    held_out_given, held_out_improved : dict of str to float
        Root mean square held-out error of each signal, in its SI unit: of the plant that was
        diagnosed, and of the improved plant fitted to the rest.
    unexplained_fraction : float
        Geometric mean of the ratios of these two errors.
    fit_parameters : tuple of FitParameter
        Nuisance, variation of each trial, and effects.
    fitted_values : ndarray, shape (p,)
        Their values with the named effects.
    link_change : float
        Change of the link in the nuisance fit, see `models.gap.estimation.link_change`.
    amplification_power : dict of float to float
        Factor on the power of the floor by payload in kg, see
        `models.gap.estimation.measured_floor.with_amplified_scatter`.
    odd : tuple of OddTrial
        Outlier trials, which were left out because they differ far more than comparable ones.
    """

    plant: Plant
    improved: Plant
    fitted: Plant
    trials: TrialSet
    settings: GapSettings
    verdict: GapVerdict
    gap_left_fraction: float
    floor: NoiseFloor
    null_distribution: NullDistribution
    dispersion: float
    residual_before: float
    residual_after: float
    nuisance_bias: dict[str, float]
    goal_not_followed_at_row: dict[str, int]
    rows_fitted: dict[str, int]
    own_error: dict[str, tuple[Knowledge, Knowledge]]
    located: tuple[GapRegion, ...]
    remaining: tuple[GapRegion, ...]
    named: tuple[str, ...]
    inclusions: tuple[Inclusion, ...]
    hypotheses: tuple[Hypothesis, ...]
    tested: tuple[JudgedNames, ...]
    strength_consistency: dict[str, StrengthConsistency]
    screened: dict[str, float]
    refitted: dict[str, float]
    rejected: tuple[RejectedEffect, ...]
    refused: tuple[RefusedEffect, ...]
    left_out: tuple[str, ...]
    held_out_given: dict[str, float]
    held_out_improved: dict[str, float]
    unexplained_fraction: float
    fit_parameters: tuple[FitParameter, ...]
    fitted_values: Array
    link_change: float
    amplification_power: Mapping[float, float]
    odd: tuple[OddTrial, ...] = ()


def diagnose(
    plant: Plant,
    trials: TrialSet,
    report: ReportProgress = lambda text, further: None,
    leave_out: Sequence[str] = (),
    settings: GapSettings = DEFAULT_SETTINGS,
    floor: NoiseFloor | None = None,
    patterns: Sequence[ModelDiscrepancy] = (),
) -> Diagnosis:
    """Find and name the effects that a plant lacks, and add them to it.

    Parameters
    ----------
    plant : Plant
        Identified plant; its provenance may carry the noise floor.
    trials : TrialSet
        Trials with the same number of joints.
    report : callable
        Called after each part of the work with a phrase and the least number of parts to follow.
    leave_out : sequence of str
        Effects that may not be named.
    settings : GapSettings
        Tuned numbers.
    floor : NoiseFloor, optional
        Noise floor to use instead of the plant file's.
    patterns : sequence of ModelDiscrepancy
        Patterns of the plant's own error on such trials, where they were measured
        (`models.gap.calibration`).

    Returns
    -------
    Diagnosis
        Missing effects with their evidence, and the improved plant.

    Raises
    ------
    InputError
        If there are no trials or they are of one and of two joints, or an effect to leave out is
        unknown.
    """
    if not len(trials):
        raise InputError("trials", "are none", "give at least one")
    known = plant_is_known(plant, trials)
    settings = msgspec.structs.replace(settings, plant_is_known=known)
    catalogue = _catalogue(plant, leave_out)
    recorded, trials = trials, in_time_blocks(plant, aligned(trials), settings)
    parameters = all_fit_parameters(plant, trials, catalogue, settings)
    residuals = Residuals(plant, trials.trials, parameters, settings)
    given_floor, floor = floor, floor or noise_floor_for(residuals, patterns)
    search = EffectSearch(GaussNewton(residuals, floor), catalogue, report)
    with threadpool_limits(limits=1, user_api="blas"):  # the simulations use both processors
        whole = len(recorded) == len(trials)
        odd = disturbed_trials(search.first, search.nuisance_fit, floor) if whole else ()
        if odd:
            kept = without_odd(recorded, odd)
            rest = diagnose(plant, kept, report, leave_out, settings, given_floor, patterns)
            return replace(rest, odd=(*odd, *rest.odd))
        result = search.first_round()
        by_joint = msgspec.structs.replace(settings, separate_joints=True)
        given = plant, recorded, report, leave_out, by_joint, given_floor, patterns
        alike = trials[0].meta.dof > 1 and not settings.separate_joints
        separate = all_fit_parameters(plant, trials, catalogue, by_joint) if alike else []
        differ = alike and joints_differ(search, result, separate)
        if differ and (found := diagnose(*given)).named:
            return found
        decision = decide(search, search.include(result))
    outside = decision.verdict == "not in the catalogue"
    if outside and alike and not differ and (found := diagnose(*given)).named:
        return found
    result, accepted = decision.result, decision.accepted
    hypotheses = posterior_of(search, result, decision.answers)
    report("tested on what was left out", 1)
    located, remaining = (
        locate_gap(residuals.groups, residuals.trials, search.first.whitened(p.rows), settings)
        for p in (result.before, result.after)
    )
    free = search.free(result.named)
    improved = improved_plant(plant, search, result, accepted.point, accepted.free, recorded)
    is_written = set(result.named) == set(improved.provenance.named)
    return Diagnosis(
        plant=plant,
        improved=improved,
        fitted=improved
        if is_written
        else improved_plant(plant, search, result, result.after, free, recorded),
        trials=trials,
        settings=settings,
        verdict=decision.verdict,
        gap_left_fraction=decision.gap_left_fraction,
        floor=floor,
        null_distribution=search.null_distribution,
        dispersion=search.dispersion(result.before),
        residual_before=search.mean_residual(result.before),
        residual_after=search.mean_residual(result.after),
        nuisance_bias=search.nuisance_bias(result.after),
        goal_not_followed_at_row=residuals.goal_not_followed(),
        rows_fitted={
            t.name: len(t)
            for t, whole in zip(residuals.trials, trials, strict=True)
            if len(t) < len(whole)
        },
        own_error=search.first.knowledge(),
        located=tuple(located),
        remaining=tuple(remaining),
        named=tuple(result.named),
        inclusions=inclusions_of(result),
        hypotheses=hypotheses,
        tested=decision.tested,
        strength_consistency=dict(decision.consistencies),
        screened=result.screened,
        refitted={c.effects[0]: c.separation for c in result.rounds[0] if len(c.effects) == 1},
        rejected=rejected_effects(result, search.null_distribution),
        refused=tuple(result.refused),
        left_out=tuple(search.held_out.folds),
        held_out_given=search.held_out.given.rms(),
        held_out_improved=accepted.errors.rms(),
        unexplained_fraction=accepted.errors.fraction_of(search.held_out.given),
        fit_parameters=tuple(parameters),
        fitted_values=accepted.point.values,
        link_change=search.first.floor.link_change,
        amplification_power=search.first.floor.amplification_power,
    )


def all_fit_parameters(
    plant: Plant,
    trials: Sequence[Trial],
    catalogue: Sequence[str],
    settings: GapSettings = DEFAULT_SETTINGS,
) -> list[FitParameter]:
    """Fit parameters of nuisance, trial variation and every effect of a catalogue."""
    own = trials[0].meta.dof, settings.separate_joints
    effects = [q for e in catalogue for q in effect_fit_parameters(plant, e, *own)]
    return nuisance_and_variation(plant, trials, settings) + effects


def plant_is_known(plant: Plant, trials: TrialSet) -> bool:
    """Whether a plant of another load than the link was identified on other trials only.

    A link is excluded: its values may change from day to day, within priors of their own.
    """
    provenance = plant.provenance
    elsewhere = provenance.fitted_trials and not any(map(provenance.was_fitted_to, trials))
    return bool(elsewhere) and LOADS[plant.load].kind != "link"


def _catalogue(plant: Plant, leave_out: Sequence[str]) -> list[str]:
    """Effects that may be named; an unknown name in `leave_out` raises InputError."""
    known = candidate_effects(plant)
    for name in leave_out:
        if name not in known:
            raise InputError(
                f"--without {name}", "is no effect of this plant",
                "choose from " + ", ".join(known),
            )  # fmt: skip
    return [e for e in known if e not in leave_out]
