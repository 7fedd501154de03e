"""Diagnosis: from trials and a plant to the missing effects, their certainty and a better plant.

`diagnose` is the method from top to bottom; docs/gap/method.md tells it in the same order.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from threadpoolctl import threadpool_limits

from firmware_py.core.errors import InputError
from models.gap.decision.certainty import knowledge_of, read_certainty
from models.gap.decision.look_alikes import hypotheses_of, look_alikes_of
from models.gap.decision.naming import Naming, name_with_floor, name_without_floor
from models.gap.decision.written_fit import PlantWriter, WrittenFit
from models.gap.estimation.nuisance_fit import NuisanceFit, nuisance_fit_of
from models.gap.improved_plant import improved_plant
from models.gap.outliers import OutlierTrial, outlier_trials, without_outliers
from models.gap.report.gap_json import GapVerdict
from models.gap.report.gap_results import Diagnosis
from models.gap.residuals.fit_parameters import candidate_effects
from models.gap.residuals.localisation import GapRegion, locate_gap
from models.gap.residuals.time_blocks import in_time_blocks
from models.gap.search.effect_search import EffectSearch, ReportProgress
from models.gap.settings import DEFAULT_SETTINGS, GapSettings
from models.plant.identification.doubts import refuse_other_links
from models.plant.identification.trial_spectra import aligned
from models.plant.plant import Plant
from models.trials.checks.trials import refuse_unusable
from models.trials.trial import Trial, TrialSet


def diagnose(
    plant: Plant,
    trials: Iterable[Trial],
    report: ReportProgress = lambda text, further: None,
    leave_out: Sequence[str] = (),
    settings: GapSettings = DEFAULT_SETTINGS,
) -> Diagnosis:
    """Find and name the effects that a plant lacks, and add them to it.

    Parameters
    ----------
    plant : Plant
        Identified plant; its provenance may carry the noise floor.
    trials : TrialSet or iterable of Trial
        Trials with the same number of joints.
    report : callable
        Called after each part of the work with a phrase and the least number of parts to follow.
    leave_out : sequence of str
        Effects that may not be named.
    settings : GapSettings
        What the user states, and limits.

    Returns
    -------
    Diagnosis
        Missing effects with their evidence, and the improved plant.

    Raises
    ------
    InputError
        If there are no trials, they are of one and of two joints or of another link than the
        plant's, a trial would spoil the diagnosis (a copy, a goal or tip that cannot be right), or
        an effect to leave out is unknown.

    Examples
    --------
    A servo swings a weight. The trials have a Coulomb friction that its plant lacks.

    >>> import dropstitch, numpy as np
    >>> plant = dropstitch.read_plant("models/plant/examples/xl330_pendulum.toml")
    >>> set_up = {"mass_kg": 0.5, "arm_length_m": 0.1, "duty_gain_1": 0.3}
    >>> real = plant.with_effects("coulomb_friction").with_values(set_up)
    >>> real = real.with_values({"coulomb_friction_1_nm": 0.05})
    >>> rng, time_s = np.random.default_rng(5), 0.005 * np.arange(400)
    >>> def swing(number, period_s):
    ...     inputs = {
    ...         "goal_1_rad": 0.8 * np.sin(2 * np.pi * time_s / period_s),
    ...         "enabled_1": np.ones(400), "supply_1_v": np.full(400, 7.5),
    ...     }
    ...     run = dropstitch.simulate_plant(real, inputs, 0.005)
    ...     angle_rad = run["angle_1_rad"] + 1e-3 * rng.standard_normal(400)
    ...     meta = dropstitch.TrialMeta(
    ...         dof=1, payload_kg=0.0, trial=number, motion="sinusoid", source="simulated",
    ...         period_s=period_s, rest_samples=0, conditions=set_up,
    ...     )
    ...     columns = {"time_s": time_s, **inputs, "angle_1_rad": angle_rad}
    ...     return dropstitch.Trial(f"swing_{number}", meta, columns)
    >>> diagnosis = dropstitch.diagnose(plant, [swing(1, 2.0), swing(2, 1.3)])
    >>> diagnosis
    <Diagnosis of 2 trials: no floor; missing: coulomb_friction>
    """
    trials = TrialSet(tuple(trials))
    if not len(trials):
        raise InputError("trials", "are none", "give at least one")
    refuse_unusable(trials)
    refuse_other_links(plant, plant.where, trials)
    catalogue = _catalogue(plant, leave_out)
    with threadpool_limits(limits=1, user_api="blas"):  # the simulations use both processors
        outliers: tuple[OutlierTrial, ...] = ()
        while True:
            recorded = without_outliers(trials, outliers)
            used = in_time_blocks(plant, aligned(recorded))
            nuisance = nuisance_fit_of(plant, used.trials, catalogue, settings.same_link)
            naming = _naming(nuisance, settings, report)
            more = _disturbed(nuisance, naming) if len(used) == len(recorded) else ()
            if not more:
                break
            outliers = (*outliers, *more)
        verdict = _verdict(naming)
        writer = PlantWriter(naming.search, settings.harm_fraction, settings.same_link)
        written = _written(writer, naming, verdict, settings)
        report("tested on what was left out", 1)
        improved, fitted = (
            improved_plant(plant, naming.search, fit, recorded) for fit in (written, naming.fit)
        )
        look_alikes, hypotheses = look_alikes_of(naming), hypotheses_of(naming)
        located = tuple(_located(nuisance))
    return Diagnosis(
        plant=plant,
        improved=improved,
        fitted=fitted,
        trials=used,
        outliers=outliers,
        verdict=verdict,
        answers=naming.answers,
        evidence=naming.evidence,
        gap_left_fraction=nuisance.left_fraction(naming.fit.point),
        named=naming.names,
        look_alikes=look_alikes,
        hypotheses=hypotheses,
        nuisance=nuisance,
        naming=naming,
        written=written,
        left_out=tuple(writer.held_out.folds),
        held_out_baseline=writer.held_out.baseline,
        located=located,
        settings=settings,
    )


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


def _naming(nuisance: NuisanceFit, settings: GapSettings, report: ReportProgress) -> Naming:
    """Search for the set of effects that explains the trials."""
    learned = nuisance.measured.floor.learned
    is_link = nuisance.estimator.residuals.plant.load == "link"
    # A rigid load is simulated fast, and no learned floor tells its candidates apart.
    refits_all = not (learned or is_link)
    search = EffectSearch(nuisance, refits_all, report)
    if learned:
        return name_with_floor(search, read_certainty(), settings.equation_error_fraction)
    return name_without_floor(search)


def _disturbed(nuisance: NuisanceFit, naming: Naming) -> tuple[OutlierTrial, ...]:
    """Outlier trials: their residual stands out in the nuisance fit and in the best fit.

    A large gap alone makes trials differ more than usual.
    """
    outliers = outlier_trials(nuisance.measured, nuisance.point)
    if not outliers or not naming.is_learned:
        return outliers
    still = {(o.name, o.path) for o in outlier_trials(nuisance.measured, naming.grown[-1].point)}
    return tuple(o for o in outliers if (o.name, o.path) in still)


def _written(
    writer: PlantWriter, naming: Naming, verdict: GapVerdict, settings: GapSettings
) -> WrittenFit:
    """What is written: never a link that is known not to have changed, nor a mere stand-in."""
    if verdict == "not in the catalogue" and "motions" not in writer.held_out.folds:
        return writer.unchanged("another link would only fit the motion of these trials")
    if not naming.names and (settings.same_link or not naming.is_learned):
        return writer.unchanged()
    return writer.best(naming.fit)


def _verdict(naming: Naming) -> GapVerdict:
    if naming.answers is None:
        return "no floor"
    if not naming.names:
        is_outside = naming.answers.outside > naming.answers.nothing
        return "not in the catalogue" if is_outside else "no gap"
    estimator, point = naming.search.estimator, naming.fit.point
    of_nothing = read_certainty().residual_of_nothing[knowledge_of(estimator, point)]
    return "reduced" if estimator.mean_square(point) > of_nothing else "closed"


def _located(nuisance: NuisanceFit) -> list[GapRegion]:
    residuals = nuisance.measured.residuals
    white = nuisance.measured.whitened(nuisance.point.rows)
    return locate_gap(residuals.groups, residuals.trials, white)
