"""Certainty of a name, fitted to records of data sets on rigs for tuning.

Every number that is printed was predicted with the rig of its data set left out.
"""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from functools import partial
from typing import Final, NamedTuple, TypeVar, get_args

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from scipy.stats import t as student
from sklearn.linear_model import LogisticRegression
from sklearn.metrics import log_loss
from sklearn.model_selection import LeaveOneGroupOut, cross_val_predict
from sklearn.pipeline import Pipeline, make_pipeline
from sklearn.preprocessing import StandardScaler

from firmware_py.core.errors import InputError
from models.gap.decision.certainty import Certainty, Evidence, Knowledge
from models.gap.decision.naming import NAMED_PROBABILITY
from models.gap.estimation.nuisance_fit import LEAST_GAP
from models.gap.training.case_runs import Addition, DataSetRecord, Strength, effects_of
from models.plant.step_model import Array

ANSWERS: Final = ("catalogue", "nothing", "outside")
EXCEEDED: Final = 0.1
"""Fraction of data sets without an effect that may exceed a limit. The strengths of a further
effect must be the same everywhere too, which few of these pass."""
NAMED_FRACTION: Final = 0.03
"""Fraction of data sets without an effect that may be given a name (requirement)."""
MOST_FACTOR: Final = 20.0
"""Largest factor on d′ that is tried, in steps of `FACTOR_STEP`."""
FACTOR_STEP: Final = 0.5
KNOWLEDGE: Final[tuple[Knowledge, ...]] = get_args(Knowledge)
STUDY_TRIALS: Final[tuple[Knowledge, ...]] = ("identified", "other link")
"""Trials that the probabilities are fitted to; the others have no effect."""
REGULARISATIONS: Final = tuple(10.0 ** np.arange(-2, 3.5, 0.5))
"""C of the regression; the one that predicts the rigs left out best is taken."""
BINS: Final = (0.0, 0.2, 0.4, 0.6, 0.8, 0.95, 1.0)

DEGREES_OF_FREEDOM: Final = 4.0
"""Of Student's distribution, which the errors of strengths follow: they have more far outliers than
a normal one [assumed]."""
LOG_DEVIATION: Final = 0.5
"""Standard deviation of the logarithm of an effect's equation error about that of all [assumed]."""
LEAST_ERROR, MOST_ERROR = 0.003, 1.0
"""Range of the equation errors, as fractions of the strength."""


Known = TypeVar("Known")


class FittedCertainty(NamedTuple):
    certainty: Certainty
    report: str


def fitted_certainty(
    records: Sequence[DataSetRecord], made_with: Mapping[str, str]
) -> FittedCertainty:
    """Certainty from records, and how well it predicts rigs left out."""
    possible = [r for r in records if not r.impossible]
    nulls = _by_knowledge(r for r in possible if r.case.kind == "null")
    reached = {
        key: limit([r.evidence.separation for r in of_kind]) for key, of_kind in nulls.items()
    }
    least = reached["identified"]
    factors = {key: max(1.0, value / least) for key, value in reached.items()}
    scale = {key: round(factors.get(key, max(factors.values())), 1) for key in KNOWLEDGE}
    study = [r for r in possible if r.knowledge in STUDY_TRIALS]
    known = [
        (r, answer) for r in study
        if (answer := true_answer(r, r.evidence.separation > least * scale[r.knowledge]))
    ]  # fmt: skip
    left = {key: limit([r.evidence.residual for r in of_kind]) for key, of_kind in nulls.items()}
    counts = Counter(answer for _, answer in known)
    if lacking := [a for a in ANSWERS if a not in counts]:
        raise InputError(
            "the data sets", f"have none with the answer {lacking[0]!r}", "take more rigs"
        )
    of_nothing = _limits_of_nothing(left, 3)
    name = _fitted_regression(
        (r.case.rig, r.evidence.name_terms(scale[r.knowledge]), answer == "catalogue")
        for r, answer in known
    )
    outside = _fitted_regression(
        (
            r.case.rig,
            r.evidence.outside_terms(scale[r.knowledge], of_nothing[r.knowledge]),
            answer == "outside",
        )
        for r, answer in known if answer != "catalogue"
    )  # fmt: skip
    errors = equation_errors([s for r in possible for s in r.strengths])
    certainty = Certainty(
        made_with=dict(made_with),
        data_sets=len(known),
        separation_of_nothing=_limits_of_nothing(reached, 1),
        residual_of_nothing=of_nothing,
        separation_scale=dict(scale),
        further_scale=dict(scale),
        name_coefficients=name.coefficients,
        outside_coefficients=outside.coefficients,
        equation_error=_rounded(errors),
    )
    certainty = _with_factors(certainty, known, possible)
    scale, beside = certainty.separation_scale, certainty.further_scale
    numbers = ", ".join(f"{a} {counts[a]}" for a in ANSWERS)
    report = [
        f"{len(known)} data sets of {len({r.case.rig for r, _ in known})} rigs: {numbers}",
        *(f"{key}: d′ up to {reached[key]:.1f} and {left[key]:.2f} noise floors left in "
          f"{len(of_kind)} data sets without an effect, factor {scale[key]:g}"
          for key, of_kind in nulls.items()),
        *(f"{key}: factor {beside[key]:g} on what an effect adds" for key in STUDY_TRIALS),
        f"log loss with each rig left out: names {name.loss:.3f}, the rest {outside.loss:.3f}",
        calibration_table(name.left_out, [answer == "catalogue" for _, answer in known]),
        "error of the equations: " + ", ".join(f"{e} {v:.1%}" for e, v in sorted(errors.items())),
    ]  # fmt: skip
    return FittedCertainty(certainty, "\n".join(report))


def _with_factors(
    certainty: Certainty,
    known: Sequence[tuple[DataSetRecord, str]],
    records: Sequence[DataSetRecord],
) -> Certainty:
    """Certainty with the factors on d′ that decide best, from the ratios of what is reached on."""
    scale = dict(certainty.separation_scale)
    for key in KNOWLEDGE:
        if key == "identified":  # the others are compared with it
            continue
        if key in STUDY_TRIALS:
            scale[key] = fewest_wrong(
                partial(is_probable, certainty), scale[key],
                [(r.evidence, answer == "catalogue") for r, answer in known if r.knowledge == key],
            )  # fmt: skip
        else:
            nulls = [r for r in records if r.case.kind == "null" and r.knowledge == key]
            scale[key] = _factor_without_names(certainty, scale[key], nulls)
    certainty = msgspec.structs.replace(certainty, separation_scale=scale)
    larger = list(_additions(certainty, records))
    further = {
        key: fewest_wrong(
            partial(is_added, certainty), scale[key],
            [(a, right) for a, right in larger if a.knowledge == key],
        )
        for key in STUDY_TRIALS
    }  # fmt: skip
    beside = {key: max(scale[key], further.get(key, max(further.values()))) for key in KNOWLEDGE}
    return msgspec.structs.replace(certainty, further_scale=beside)


def _factor_without_names(
    certainty: Certainty, least: float, nulls: Sequence[DataSetRecord]
) -> float:
    """Least factor on d′ with which few data sets without an effect are given a name."""
    for factor in np.arange(least, MOST_FACTOR, FACTOR_STEP):
        named = [is_probable(certainty, r.evidence, factor) for r in nulls]
        if sum(named) <= NAMED_FRACTION * len(nulls):
            return float(factor)
    return MOST_FACTOR


def fewest_wrong(
    is_named: Callable[[Known, float], bool], least: float, rows: Sequence[tuple[Known, bool]]
) -> float:
    """Least factor on d′, from `least` on, with which the fewest decisions are wrong.

    Wrong is a name that is not hidden, and a hidden one that is not named. `rows`: what the
    decision knows, and whether the name is right.
    """
    factors = np.arange(least, MOST_FACTOR, FACTOR_STEP)
    wrong = [sum(is_named(known, f) != right for known, right in rows) for f in factors]
    return round(float(factors[np.argmin(wrong)]), 1)


def _additions(
    certainty: Certainty, records: Iterable[DataSetRecord]
) -> Iterator[tuple[Addition, bool]]:
    """Larger sets that are probable as a whole, and whether all their effects are hidden."""
    for record in records:
        for addition in record.additions:
            answers = certainty.answers_for(addition.evidence, addition.knowledge)
            if answers.catalogue >= NAMED_PROBABILITY:
                yield addition, effects_of(addition.candidates) <= set(record.case.hidden)


def is_added(certainty: Certainty, addition: Addition, factor: float) -> bool:
    """Whether a larger set that is probable as a whole is named, with this factor."""
    leaves_nothing = addition.evidence.residual < LEAST_GAP
    return leaves_nothing or is_probable(certainty, addition.added, factor)


def is_probable(certainty: Certainty, evidence: Evidence, factor: float) -> bool:
    return certainty.name_probability(evidence, factor) >= NAMED_PROBABILITY


def limit(values: Sequence[float]) -> float:
    """Value that a fraction `EXCEEDED` of the data sets exceeds."""
    return float(np.quantile(values, 1 - EXCEEDED))


def true_answer(record: DataSetRecord, shows: bool) -> str | None:
    """Answer that would be right; None where the trials cannot tell it.

    A wrong name has the answer "outside": what is missing is none of what was named. `shows`:
    whether its d′ is more than is reached where nothing is missing. If not, the trials do not show
    what is hidden.
    """
    kind = record.case.kind
    if kind == "null":
        return "nothing"
    if kind == "outside":
        return "outside" if record.separable else None
    if record.best_is_right:
        return "catalogue"
    return "outside" if shows else None


def calibration_table(probability: Array, right: Sequence[bool]) -> str:
    """Fraction that is right by bins of the probability, as lines of text.

    Shapes: `probability` (n,).
    """
    at = np.clip(np.digitize(probability, BINS) - 1, 0, len(BINS) - 2)
    lines = ["probability that the names are right, and fraction that is:"]
    for k in range(len(BINS) - 1):
        if (in_bin := np.asarray(right)[at == k]).size:
            mean = float(np.mean(np.asarray(probability)[at == k]))
            rate = f"{in_bin.mean():.2f} of {in_bin.size}"
            lines.append(f"  {BINS[k]:.2f} to {BINS[k + 1]:.2f}: {mean:.2f} {rate}")
    return "\n".join(lines)


def equation_errors(strengths: Collection[Strength]) -> dict[str, float]:
    """Error of each effect's equation as a fraction of the strength, beyond chance.

    The scale of Student's distribution by maximum likelihood, that of an effect drawn towards that
    of all. It is given as the standard error of which 1.96 hold 95 % of the distribution.
    """
    general = _scale(list(strengths)) if strengths else MOST_ERROR
    widening = float(student.ppf(0.975, DEGREES_OF_FREEDOM)) / 1.96
    effects = sorted({s.effect for s in strengths})
    by_effect = {e: [s for s in strengths if s.effect == e] for e in effects}
    errors = {e: widening * _scale(of_effect, general) for e, of_effect in by_effect.items()}
    return errors or {"coulomb_friction": MOST_ERROR}


def _scale(strengths: Sequence[Strength], general: float | None = None) -> float:
    difference = np.array([(s.fitted - s.hidden) / s.fitted for s in strengths])
    chance = np.array([s.chance_error / abs(s.fitted) for s in strengths])

    def loss(logarithm: float) -> float:
        scale = np.hypot(chance, np.exp(logarithm))
        prior = ((logarithm - np.log(general)) / LOG_DEVIATION) ** 2 / 2 if general else 0.0
        return float(prior - student.logpdf(difference, DEGREES_OF_FREEDOM, scale=scale).sum())

    bounds = float(np.log(LEAST_ERROR)), float(np.log(MOST_ERROR))
    return float(np.exp(minimize_scalar(loss, bounds=bounds, method="bounded").x))


class _Regression(NamedTuple):
    coefficients: list[float]  # Of the terms, the constant one first
    left_out: Array  # Probability of each row with its rig left out
    loss: float  # Log loss of these


def _fitted_regression(rows: Iterable[tuple[str, Sequence[float], bool]]) -> _Regression:
    """Logistic regression with the regularisation that predicts the rigs left out best.

    `rows`: rig, terms with a constant one first, and whether the answer is yes.
    """
    rigs, terms, answers = (list(column) for column in zip(*rows, strict=True))
    x, y = np.array(terms)[:, 1:], np.array(answers)
    left_out = {c: _left_out(c, x, y, rigs) for c in REGULARISATIONS}
    loss = {c: float(log_loss(y, p, labels=[False, True])) for c, p in left_out.items()}
    best = min(loss, key=lambda c: loss[c])
    scaler, regression = _regression(best).fit(x, y)
    slopes = regression.coef_[0] / scaler.scale_
    row = [regression.intercept_[0] - slopes @ scaler.mean_, *slopes]
    return _Regression([round(float(v), 4) for v in row], left_out[best], loss[best])


def _regression(c: float) -> Pipeline:
    return make_pipeline(StandardScaler(), LogisticRegression(C=c, max_iter=2000))


def _left_out(c: float, x: Array, y: NDArray[np.bool_], rigs: Sequence[str]) -> Array:
    """Probability of yes for each row, predicted with its rig left out."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a rig alone may lack an answer
        predicted = cross_val_predict(
            _regression(c), x, y, groups=rigs, cv=LeaveOneGroupOut(), method="predict_proba"
        )
    return np.asarray(np.clip(predicted[:, 1], 1e-6, 1 - 1e-6))


def _by_knowledge(records: Iterable[DataSetRecord]) -> dict[Knowledge, list[DataSetRecord]]:
    result: dict[Knowledge, list[DataSetRecord]] = {}
    for record in records:
        result.setdefault(record.knowledge, []).append(record)
    return result


def _limits_of_nothing(limits: Mapping[Knowledge, float], digits: int) -> dict[Knowledge, float]:
    """Limits of nothing: never below that of the best known trials; the largest where unknown."""
    least, most = limits["identified"], max(limits.values())
    return {key: round(max(least, limits.get(key, most)), digits) for key in KNOWLEDGE}


def _rounded(values: Mapping[str, float]) -> dict[str, float]:
    return {key: round(value, 3) for key, value in values.items()}
