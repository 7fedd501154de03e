"""Results of a diagnosis, and the gap document from them."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Final

import msgspec
import numpy as np

from firmware_py.core.errors import InputError
from models.gap.decision.certainty import Answers, Evidence, knowledge_of, read_certainty
from models.gap.decision.look_alikes import Hypothesis, effect_probabilities
from models.gap.decision.naming import LEAST_WITHOUT_FLOOR, Naming
from models.gap.decision.written_fit import WrittenFit
from models.gap.estimation.noise_floor import NoiseFloor
from models.gap.estimation.nuisance_fit import NuisanceFit
from models.gap.estimation.transfer import step_of
from models.gap.experiment.experiment import USUAL_LIMITS, allowed_motions, usual_motions
from models.gap.experiment.rival import HypothesisRecord
from models.gap.experiment.separation import SeparationModel
from models.gap.outliers import OutlierTrial
from models.gap.report.gap_json import (
    ChangedCondition,
    Condition,
    FittedValue,
    GapDocument,
    GapVerdict,
    HeldOutSummary,
    NamedEffect,
    NamingEvidence,
    NoiseFloorSummary,
    PlantErrors,
    RefusedEffects,
    RejectedEffect,
    SeparatingMotion,
    SignalFloor,
    SignalGap,
    SimilarEffects,
    WrittenPlant,
)
from models.gap.report.gap_words import gap_in_words, headline, in_percent, joined
from models.gap.residuals.fit_parameters import plant_with_searched_effects, written_values
from models.gap.residuals.localisation import GapRegion, location_sentence
from models.gap.search.effect_search import SetFit
from models.gap.search.held_out import HeldOutErrors
from models.gap.settings import GapSettings
from models.plant.document import Provenance
from models.plant.identification.evaluation import compare_with_trials, signal_errors
from models.plant.parameter import Parameter
from models.plant.plant import Plant
from models.plant.step_model import Array
from models.shared.catalogue import effect_and_joint
from models.trials.trial import Trial, TrialSet

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST_LOCATED: Final = 40
"""Most significant regions that are listed; `map` holds all."""
LISTED_PROBABILITY: Final = 0.01
"""Least probability of an effect that is listed."""
TOLERANCES: Final = {"step_s": (1e-3, 0.0), "payload_kg": (0.0, 0.02), "pressure_pa": (0.01, 0.0)}
"""Relative and absolute differences that do not count. Rows of a trial are uniform within the same
fraction; pressure varies by 1 % between trials [assumed]."""


@dataclass(frozen=True, repr=False)
class Diagnosis:
    """Result of `models.gap.diagnosis.diagnose`.

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
        See `models.gap.report.gap_json.GapVerdict`.
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
        knowledge = knowledge_of(self.nuisance.measured, self.naming.best.point)
        return read_certainty().separation_of_nothing[knowledge]

    @property
    def unexplained_fraction(self) -> float:
        """Held-out error of the written plant over that as given, geometric mean over signals."""
        return self.written.errors.fraction_of(self.held_out_baseline)

    @cached_property
    def document(self) -> GapDocument:
        """Content of `gap.json`."""
        return gap_document(self)

    def summary(self) -> str:
        """Diagnosis in words, as the command prints it."""
        return gap_in_words(self.document)

    def plot(self) -> Figure:
        """Measured and simulated signals over time, before and after, where the gap is largest."""
        from models.gap.report.gap_charts import plot_signals

        return plot_signals(self.document, self.plant, self.improved, self.trials)


def gap_document(diagnosis: Diagnosis) -> GapDocument:
    """Results of a diagnosis as the content of `gap.json`.

    Parameters
    ----------
    diagnosis : Diagnosis
        Results of `models.gap.diagnosis.diagnose`.

    Returns
    -------
    GapDocument
        Document without `inputs`, which only the command knows.

    Examples
    --------
    With the `diagnosis` in the example of `diagnose`:

    >>> import dropstitch
    >>> document = dropstitch.gap_document(diagnosis)
    >>> document.verdict, [row.effect for row in document.named]
    ('no floor', ['coulomb_friction'])
    """
    floor, residuals = diagnosis.floor, diagnosis.nuisance.estimator.residuals
    signals, unused = _floor_by_signal(floor), residuals.goal_not_followed()
    before, after = (
        _errors(plant, held_out, diagnosis.trials, signals, unused)
        for plant, held_out in (
            (diagnosis.plant, diagnosis.held_out_baseline),
            (diagnosis.improved, diagnosis.written.errors),
        )
    )
    left = diagnosis.gap_left_fraction
    document = GapDocument(
        schema=GapDocument.VERSION,
        verdict=diagnosis.verdict,
        probabilities=diagnosis.answers,
        separation_of_nothing=round(diagnosis.separation_of_nothing, 2),
        gap_left_fraction=left if left is None else round(left, 4),
        named=tuple(_named(diagnosis)),
        refused=tuple(_refused(diagnosis)),
        rejected=tuple(_rejected(diagnosis)),
        effect_probabilities={
            e: round(p, 4)
            for e, p in effect_probabilities(diagnosis.hypotheses).items()
            if floor.learned and p >= LISTED_PROBABILITY
        },
        hypotheses=tuple(
            _hypothesis(diagnosis, h.fit, h.probability) for h in diagnosis.hypotheses
        ),
        written=_written(diagnosis),
        sentence=_place(diagnosis),
        located=tuple(c for c in diagnosis.located if c.significant)[:MOST_LOCATED],
        map=diagnosis.located,
        noise_floor=NoiseFloorSummary(
            floor.learned,
            signals,
            diagnosis.nuisance.measured.knowledge(),
            {f"{kg:g}": round(p**0.5, 2) for kg, p in floor.amplification_power.items()},
        ),
        before=before,
        after=after,
        held_out=HeldOutSummary(diagnosis.left_out, round(diagnosis.unexplained_fraction, 4)),
        odd_trials=diagnosis.outliers,
        changed_conditions=changed_conditions(diagnosis.plant.provenance, floor, diagnosis.trials),
        rows_fitted={
            t.name: len(t)
            for t, whole in zip(residuals.trials, diagnosis.trials, strict=True)
            if len(t) < len(whole)
        },
        goal_not_followed_at_row=unused,
        settings=diagnosis.settings,
    )
    return msgspec.structs.replace(document, headline=headline(document))


# What is missing --------------------------------------------------------------------------------


def _named(diagnosis: Diagnosis) -> list[NamedEffect]:
    """Named effects, each with what it adds to those named before it."""
    naming, motions = diagnosis.naming, _separating_motions(diagnosis)
    # A candidate that was not refitted alone has the d′ of its screen.
    square = {frozenset({name}): d**2 for name, d in naming.search.screened.items()}
    square |= {frozenset(f.candidates): 2 * f.gain for f in (*naming.explored, naming.fit)}
    rows: list[NamedEffect] = []
    for k, name in enumerate(diagnosis.named):
        first = frozenset(diagnosis.named[:k])
        reached = square.get(first | {name}, 2 * naming.fit.gain)
        effect, joint = effect_and_joint(name)
        rows.append(
            NamedEffect(
                effect=effect,
                joint=joint,
                parameters=_values_of(diagnosis, name),
                evidence=NamingEvidence(
                    math.sqrt(max(reached - square.get(first, 0.0), 0.0)),
                    diagnosis.separation_of_nothing,
                    diagnosis.evidence.difference,
                    diagnosis.evidence.residual,
                ),
                look_alikes=tuple(
                    SimilarEffects(_beside_named(diagnosis, other), other.separation)
                    for other in diagnosis.look_alikes.get(name, ())
                ),
                separated_by=motions.get(name),
            )
        )
    return rows


def _values_of(diagnosis: Diagnosis, name: str) -> dict[str, FittedValue]:
    before, fitted = diagnosis.plant.parameters, diagnosis.fitted.parameters
    return {
        p: _fitted(fitted[p], before)
        for direction in diagnosis.nuisance.estimator.residuals.fit_parameters
        if direction.effect == name
        for p in direction.parameters
        if p in fitted
    }


def _fitted(q: Parameter, before: Mapping[str, Parameter]) -> FittedValue:
    return FittedValue(q.value, q.unit, q.error, before[q.name].value if q.name in before else 0.0)


def _beside_named(diagnosis: Diagnosis, fit: SetFit) -> tuple[str, ...]:
    """Effects of a fit that are not named."""
    return tuple(c for c in fit.candidates if c not in diagnosis.named)


def _separating_motions(diagnosis: Diagnosis) -> dict[str, SeparatingMotion]:
    """By named effect: the motion whose trial would add most d′ to its worst look-alike."""
    alike = [(name, f) for name, fits in diagnosis.look_alikes.items() for f in fits]
    if not alike or diagnosis.plant.load != "link":
        return {}
    try:
        planned = usual_motions(diagnosis.trials)
    except InputError:  # the trials' amplitude or period is out of range for a motion
        return {}
    rivals = [_hypothesis(diagnosis, f) for f in (diagnosis.naming.fit, *(f for _, f in alike))]
    pairs = [(0, k) for k in range(1, len(rivals))]
    model = SeparationModel(diagnosis.nuisance, rivals, pairs)
    added: dict[str, dict[str, float]] = {name: {} for name, _ in alike}
    for motion, payload_kg, separations in allowed_motions(model, planned, USUAL_LIMITS):
        for (name, _), d in zip(alike, model.added(separations), strict=True):
            label = f"{motion.kind} with {payload_kg:g} kg"
            added[name][label] = min(round(float(d), 2), added[name].get(label, np.inf))
    return {n: SeparatingMotion(max(d, key=lambda m: d[m]), d) for n, d in added.items() if d}


def _hypothesis(diagnosis: Diagnosis, fit: SetFit, probability: float = 1.0) -> HypothesisRecord:
    full = plant_with_searched_effects(diagnosis.plant, fit.candidates)
    parameters = diagnosis.nuisance.estimator.residuals.fit_parameters
    values = written_values(full, parameters, fit.point.values, fit.free)
    return HypothesisRecord(fit.candidates, round(probability, 4), values)


# What is not named or not written ---------------------------------------------------------------


def _written(diagnosis: Diagnosis) -> WrittenPlant:
    before = diagnosis.plant.parameters
    changed = {
        name: _fitted(q, before)
        for name, q in diagnosis.improved.parameters.items()
        if name not in before or q.value != before[name].value
    }
    return WrittenPlant(diagnosis.written.candidates, changed, diagnosis.written.refused)


def _refused(diagnosis: Diagnosis) -> list[RefusedEffects]:
    """Named effects that are not written, and the best ones that are not named."""
    naming, rows = diagnosis.naming, []
    if lacking := tuple(n for n in diagnosis.named if n not in diagnosis.written.candidates):
        reason = diagnosis.written.refused
        rows.append(RefusedEffects(lacking, "not written", naming.fit.separation, reason))
    if diagnosis.named:
        return rows + _further(diagnosis)
    best = naming.best
    if best.separation > diagnosis.separation_of_nothing:
        if diagnosis.answers is None:
            reason = _fails_held_out(diagnosis)
            rows.append(RefusedEffects(best.candidates, "held-out error", best.separation, reason))
        else:
            reason = _improbable(diagnosis.answers)
            rows.append(RefusedEffects(best.candidates, "improbable", best.separation, reason))
    return rows


def _improbable(answers: Answers) -> str:
    """Why the best candidate is not named, as a clause."""
    return (
        f"its probability is {in_percent(answers.catalogue)}, that of nothing missing "
        f"{in_percent(answers.nothing)}, that of something outside of the catalogue "
        f"{in_percent(answers.outside)}"
    )


def _fails_held_out(diagnosis: Diagnosis) -> str:
    return (
        f"the error on the {joined(diagnosis.left_out)} left out does not fall enough, or the "
        "strength differs between parts of the trials"
    )


def _further(diagnosis: Diagnosis) -> list[RefusedEffects]:
    """Best effect beside the named ones that noise does not explain, but their equations may."""
    naming, fit = diagnosis.naming, diagnosis.naming.fit
    tried = [f for f in naming.grown if len(f.candidates) > len(fit.candidates)]
    best = next(iter(tried or naming.rounds[-1]), fit)
    added = math.sqrt(max(2 * (best.gain - fit.gain), 0.0))
    error = diagnosis.settings.equation_error_fraction * fit.separation
    alike = [_beside_named(diagnosis, f) for fits in diagnosis.look_alikes.values() for f in fits]
    effects = _beside_named(diagnosis, best)
    if added <= diagnosis.separation_of_nothing or not effects or effects in alike:
        return []
    if not naming.is_learned:
        return [RefusedEffects(effects, "held-out error", added, _fails_held_out(diagnosis))]
    if tried:
        reason = "that it is missing too is less probable than not"
    elif added > math.hypot(diagnosis.separation_of_nothing, error):
        reason = "its strength would have to differ between payloads, signals and frequencies"
    else:
        reason = "errors of the plant and of the named effects' equations may look like it"
    return [RefusedEffects(effects, "further", added, reason)]


def _rejected(diagnosis: Diagnosis) -> list[RejectedEffect]:
    """All effects that are not named, the largest d′ first."""
    naming, search = diagnosis.naming, diagnosis.naming.search
    named = {effect_and_joint(n)[0] for n in diagnosis.named}
    alike = {c for fits in diagnosis.look_alikes.values() for f in fits for c in f.candidates}
    refitted = {f.candidates[0]: f.separation for f in naming.explored if len(f.candidates) == 1}
    rows: dict[str, RejectedEffect] = {}
    for candidate in search.of:
        effect = effect_and_joint(candidate)[0]
        if effect in named:
            continue
        separation = refitted.get(candidate) or search.screened.get(candidate, 0.0)
        if candidate in search.unexcited and separation < diagnosis.separation_of_nothing:
            reason = "these trials hardly excite it"
        elif candidate in alike:
            reason = "these trials cannot tell it from what is named"
        elif separation < diagnosis.separation_of_nothing:
            reason = "it explains no more than is reached where nothing is missing"
        elif not diagnosis.named and naming.best.candidates == (candidate,):
            reason = "it stands out, but is refused"
        elif candidate not in refitted:
            reason = "others promise to explain more"
        else:
            reason = "others explain more"
        row = RejectedEffect(effect, separation, reason)
        rows[effect] = max(rows.get(effect, row), row, key=lambda r: r.separation)
    return sorted(rows.values(), key=lambda r: -r.separation)


# Errors, noise and place ------------------------------------------------------------------------


def _floor_by_signal(floor: NoiseFloor) -> dict[str, SignalFloor]:
    """Noise floor of each signal as root mean squares over the spectrum."""

    def rms(variance: Array) -> float:
        return float(np.sqrt(np.mean(variance)))

    return {
        s: SignalFloor(rms(noise), rms(floor.model[s]), rms(noise + floor.model[s]))
        for s, noise in floor.noise.items()
    }


def _errors(
    plant: Plant,
    held_out: HeldOutErrors,
    trials: Sequence[Trial],
    floor: Mapping[str, SignalFloor],
    goal_not_followed_at_row: Mapping[str, int],
) -> PlantErrors:
    """Errors of a plant in SI units and in noise floors."""
    compared = []
    for c in compare_with_trials(plant, trials):
        end = goal_not_followed_at_row.get(c.trial.name, len(c.trial))
        unused = np.where(np.arange(len(c.trial)) < end, 0.0, np.nan)
        compared.append(replace(c, simulated={s: y + unused for s, y in c.simulated.items()}))
    units = {v.name: v.unit for v in plant.step_model(trials[0].meta.dof, "twin").outputs}

    def in_floors(signal: str, rms: float) -> SignalGap:
        row = floor.get(signal)
        return SignalGap(rms, units[signal], rms / row.rms if row and row.rms > 0 else None)

    return PlantErrors(
        {s: in_floors(s, row.rms) for s, row in signal_errors(plant, compared).items()},
        {s: in_floors(s, rms) for s, rms in held_out.rms().items()},
    )


def _place(diagnosis: Diagnosis) -> str:
    """Where the gap is, in words; without a learned floor nothing can be called noise."""
    if diagnosis.floor.learned:
        return location_sentence(diagnosis.located)
    if not any(region.significant for region in diagnosis.located):
        return "No part of the trials stands out from the spectrum of the residual itself."
    return location_sentence(diagnosis.located).replace("noise floors", "times its mean")


def changed_conditions(
    provenance: Provenance, floor: NoiseFloor, trials: Sequence[Trial]
) -> tuple[ChangedCondition, ...]:
    """Conditions that changed since a plant was identified.

    `floor` is that of the plant file. Steps and payloads come from its curves, the pressure from
    the provenance; conditions that these lack are not compared.
    """
    steps_s = {step for key in floor.curves if (step := step_of(key)) is not None}
    payloads_kg = {payload_kg for table in floor.curves.values() for payload_kg in table}
    pressures_pa = {t.pressure_pa for t in provenance.fitted_trials if t.pressure_pa > 0}
    rows = (
        _changed("step_s", "s", steps_s, {t.step_s for t in trials}),
        _changed("payload_kg", "kg", payloads_kg, {t.meta.payload_kg for t in trials}),
        _changed("pressure_pa", "Pa", pressures_pa, {t.meta.pressure_pa for t in trials}),
    )
    return tuple(row for row in rows if row.plant and row.trials)


def _changed(
    condition: Condition, unit: str, plant: Collection[float], trials: Collection[float]
) -> ChangedCondition:
    relative, absolute = TOLERANCES[condition]
    new = {
        v for v in trials
        if not any(math.isclose(v, p, rel_tol=relative, abs_tol=absolute) for p in plant)
    }  # fmt: skip
    return ChangedCondition(condition, unit, tuple(sorted(plant)), tuple(sorted(new)))
