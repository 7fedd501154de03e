"""Diagnosis: from trials and a plant to the missing effects, their certainty and a better plant.

`diagnose` is the method from top to bottom; docs/gap/method.md tells it in the same order.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from threadpoolctl import threadpool_limits

from firmware_py.core.errors import InputError
from models.gap.decision.certainty import Answers, Evidence, read_certainty
from models.gap.decision.look_alikes import Hypothesis, hypotheses_of, look_alikes_of
from models.gap.decision.naming import (
    LEAST_WITHOUT_FLOOR,
    Naming,
    name_with_floor,
    name_without_floor,
)
from models.gap.decision.written_fit import PlantWriter, WrittenFit
from models.gap.estimation.fitted_floor import noise_floor_for
from models.gap.estimation.noise_floor import NoiseFloor
from models.gap.estimation.nuisance_fit import NuisanceFit, nuisance_fit_of
from models.gap.improved_plant import improved_plant
from models.gap.outliers import OutlierTrial, outlier_trials, without_outliers
from models.gap.residuals.fit_parameters import (
    all_fit_parameters,
    candidate_effects,
    is_known_elsewhere,
)
from models.gap.residuals.localisation import GapRegion, locate_gap
from models.gap.residuals.residuals import Residuals
from models.gap.residuals.time_blocks import in_time_blocks
from models.gap.search.effect_search import EffectSearch, ReportProgress, SetFit
from models.gap.search.held_out import HeldOutErrors
from models.gap.settings import DEFAULT_SETTINGS, GapSettings
from models.plant.identification.doubts import refuse_other_links
from models.plant.identification.trial_spectra import aligned
from models.plant.plant import Plant
from models.trials.checks.trials import refuse_unusable
from models.trials.trial import Trial, TrialSet

if TYPE_CHECKING:
    from matplotlib.figure import Figure

GapVerdict = Literal["no gap", "closed", "reduced", "not in the catalogue", "no floor"]
"""Nothing is missing; the named effects explain the gap; more than noise is left beside them;
something outside of the catalogue is missing; the noise is unknown, so nobody can tell."""


@dataclass(frozen=True, repr=False)
class Diagnosis:
    """Result of `diagnose`.

    Attributes
    ----------
    plant, improved, fitted : Plant
        The plant that was diagnosed; the plant that is written, with the refitted nuisance and
        those of the named effects that passed the check on what was left out; and with all of them.
    trials : TrialSet
        Trials that were diagnosed, without the outliers; of a single trial its blocks of time
        (`models.gap.residuals.time_blocks`).
    outliers : tuple of OutlierTrial
        Outlier trials, which were left out because they differ far more than comparable ones.
    verdict : str
        See `GapVerdict`.
    answers : Answers or None
        Probabilities of what is missing; None without a learned noise floor.
    evidence : Evidence
        Numbers that they follow from.
    gap_left_fraction : float or None
        Fraction of the gap's amplitude, in noise floors, that remains with the named effects; None
        without a learned noise floor.
    named : tuple of str
        Missing effects, the one that explains most first; `EFFECT:JOINT` is in one servo alone.
    look_alikes : dict of str to tuple of SetFit
        By named effect: what these trials cannot tell from it.
    hypotheses : tuple of Hypothesis
        Sets of effects that may be missing, by their probability.
    nuisance, naming, written
        Fits: of the nuisance, of the named effects with all sets that were tried, and of what was
        written.
    located : tuple of GapRegion
        Where the gap is after the nuisance fit.
    settings : GapSettings
        Settings of this run.

    Examples
    --------
    Words, figure and improved plant of the `diagnosis` in the example of `diagnose`:

    >>> print(diagnosis.summary())
    verdict: no floor
    Missing: coulomb friction 0.0491 ± 0.0086 N·m (dry friction torque at the output). ...
    >>> diagnosis.plot().savefig("gap.svg")
    >>> diagnosis.improved.write("better.json")
    """

    plant: Plant
    improved: Plant
    fitted: Plant
    trials: TrialSet
    outliers: tuple[OutlierTrial, ...]
    verdict: GapVerdict
    answers: Answers | None
    evidence: Evidence
    gap_left_fraction: float | None
    named: tuple[str, ...]
    look_alikes: dict[str, tuple[SetFit, ...]]
    hypotheses: tuple[Hypothesis, ...]
    nuisance: NuisanceFit
    naming: Naming
    written: WrittenFit
    left_out: tuple[str, ...]
    held_out_baseline: HeldOutErrors
    located: tuple[GapRegion, ...]
    settings: GapSettings

    def __repr__(self) -> str:
        named = ", ".join(self.named) or "nothing"
        trials = f"{len(self.trials)} trial{'' if len(self.trials) == 1 else 's'}"
        return f"<Diagnosis of {trials}: {self.verdict}; missing: {named}>"

    def _repr_html_(self) -> str:
        from models.shared.notebook import html_table

        rows = [
            (" + ".join(h.effects) or "nothing", f"{h.probability:.2f}") for h in self.hypotheses
        ]
        return html_table(repr(self)[1:-1], ("what may be missing", "probability"), rows)

    @property
    def floor(self) -> NoiseFloor:
        """Noise floor as measured."""
        return self.nuisance.measured.floor

    @property
    def separation_of_nothing(self) -> float:
        """d′ that is reached where nothing is missing on such trials."""
        if not self.naming.is_learned:
            return LEAST_WITHOUT_FLOOR
        return read_certainty().least_separation(self.nuisance.measured, self.naming.best.point)

    @property
    def unexplained_fraction(self) -> float:
        """Held-out error of the written plant over that as given, geometric mean over signals."""
        return self.written.errors.fraction_of(self.held_out_baseline)

    def summary(self) -> str:
        """Diagnosis in words, as the command prints it."""
        from models.gap.report.gap_results import gap_document
        from models.gap.report.gap_words import gap_in_words

        return gap_in_words(gap_document(self))

    def plot(self) -> Figure:
        """Measured and simulated signals over time, before and after, where the gap is largest."""
        from models.gap.report.gap_charts import plot_signals

        return plot_signals(self)


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
            nuisance = _nuisance_fit(plant, used, catalogue, settings)
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


def _nuisance_fit(
    plant: Plant,
    trials: TrialSet,
    catalogue: Sequence[str],
    settings: GapSettings,
) -> NuisanceFit:
    """What the plant misses although link, set-up and variation are refitted."""
    parameters = all_fit_parameters(
        plant, trials.trials, catalogue, is_known_elsewhere(plant, trials), settings.same_link
    )
    residuals = Residuals(plant, trials.trials, parameters)
    return nuisance_fit_of(residuals, noise_floor_for(residuals))


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
    still = {(o.name, o.path) for o in outlier_trials(nuisance.measured, naming.best.point)}
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
    left = naming.search.estimator.mean_square(naming.fit.point)
    is_open = left > read_certainty().residual_of_nothing
    if naming.answers is None:
        return "not in the catalogue" if is_open and not naming.names else "no floor"
    if naming.names:
        return "reduced" if is_open else "closed"
    outside = naming.answers.outside > naming.answers.nothing
    return "not in the catalogue" if outside else "no gap"


def _located(nuisance: NuisanceFit) -> list[GapRegion]:
    residuals = nuisance.measured.residuals
    white = nuisance.measured.whitened(nuisance.point.rows)
    return locate_gap(residuals.groups, residuals.trials, white)
