"""Training of the robot's tip predictor: choice by nested cross-validation, fit, tests, document.

Each outer fold leaves out one payload or one motion. Within it the variant of a candidate, such as
its degree, is chosen on the rest alone, by leaving out payloads and motions again; the interval is
calibrated on the rows that the other folds leave out. So the error on the outer fold is that on a
robot: at another payload or motion than any used for training or choice.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_py.core.signals import AGE
from firmware_py.core.units import FRACTION, LENGTH
from firmware_py.inference.range_check import RangeCount
from firmware_py.summary import RangeReasons
from models.plant.simulation.runner import CompiledModel
from models.predictor.candidates import TipPredictor
from models.predictor.document import (
    CandidateEntry,
    PredictorsDocument,
    TipScore,
    graph_latency,
    summary_of,
)
from models.predictor.guarded_tip import GuardedTip
from models.predictor.interval import TipInterval
from models.predictor.observed_trials import TipRows, collect_rows, wrong_plants
from models.predictor.onnx_graphs import Array, to_onnx
from models.predictor.polynomials import Fold
from models.predictor.validation import axis_coverage, euclidean_distance_m
from models.trials.trial import Trial, TrialSet

STRIDE: Final = 8
"""Distance between the rows of a cross-validation: 0.14 s, because neighbours are nearly equal."""
TOLERANCE: Final = 0.03
"""Relative gain in mean error that a candidate needs over a simpler one [assumed]."""
INNER_GROUPS: Final = 3  # Number of groups of payloads in an inner cross-validation
WORSE: Final = 1.1  # Ratio of mean errors above which further, less simple variants are not tried


@dataclass(frozen=True)
class TipTraining:
    """Fitted predictor of the robot, its training rows, and its tests."""

    predictor: GuardedTip
    rows: TipRows
    document: PredictorsDocument


def train_tip(
    training: Sequence[Trial],
    tests: Mapping[str, TrialSet],
    observer: CompiledModel,
    candidates: Sequence[type[TipPredictor]],
    progress: Callable[[str], None],
    askew_rad: float,
) -> TipTraining:
    """Choose among candidates, fit and test the robot's tip predictor.

    `askew_rad`: angle by which the link may be mounted askew, which the interval covers.
    """
    wrong = wrong_plants(observer.model)
    wrong_rows = [collect_rows(observer, training, changes) for changes in wrong.values()]
    rows = collect_rows(observer, training).with_askew_mount(askew_rad)
    rows = replace(rows, wrong_inputs=tuple(of_plant.inputs for of_plant in wrong_rows))
    chosen, results = choose_tip_predictor(rows, candidates, progress)
    tested = {name: collect_rows(observer, trials) for name, trials in tests.items()}
    if together := [trial for trials in tests.values() for trial in trials]:
        tested |= {
            name: collect_rows(observer, together, changes) for name, changes in wrong.items()
        }
    document = PredictorsDocument(
        schema=PredictorsDocument.VERSION,
        dof=rows.dof,
        chosen=chosen.candidate.name,
        reason=_reason(chosen, results),
        trials=tuple(t.name for t in training),
        motions=tuple(sorted({t.meta.motion for t in training})),
        payload_kg=tuple(sorted({t.meta.payload_kg for t in training})),
        askew_rad=askew_rad,
        candidates={result.candidate.name: _entry(result, tested) for result in results},
        data={name: summary_of(trials) for name, trials in {"training": training, **tests}.items()},
        out_of_range={
            name: range_reasons(chosen.predictor, rows.inputs) for name, rows in tested.items()
        },
    )
    return TipTraining(chosen.predictor, rows, document)


class CandidateResult(NamedTuple):
    """Candidate in the nested cross-validation."""

    variant: int  # Variant chosen on all training rows
    nested: TipScore  # Score on the rows that the outer folds left out
    predictor: GuardedTip  # Fitted on all training rows

    @property
    def candidate(self) -> TipPredictor:
        return self.predictor.predictor


def choose_tip_predictor(
    rows: TipRows,
    candidates: Sequence[type[TipPredictor]],
    progress: Callable[[str], None] = lambda detail: None,
) -> tuple[CandidateResult, list[CandidateResult]]:
    """Compare candidates, simplest first, and fit each on all rows; return the best, and all."""
    few, results = rows.take(slice(None, None, STRIDE)), []
    for candidate in candidates:
        nested, left_out_m = _nested(candidate, few)
        variant = _best_variant(candidate, few)
        fitted = candidate(variant).fit(rows)
        guarded = GuardedTip.of(rows, fitted, _interval(fitted, few, left_out_m))
        results.append(CandidateResult(variant, nested, guarded))
        progress(candidate.name)
    chosen = results[0]
    for result in results[1:]:
        if result.nested.mean_m < (1.0 - TOLERANCE) * chosen.nested.mean_m:
            chosen = result
    return chosen, results


def group_folds(rows: TipRows, most: int | None = None) -> list[Fold]:
    """One fold for each payload and each motion that it leaves out.

    With one payload and one motion, trials are left out; one trial is trained and tested on whole.
    `most`: largest number of groups of payloads; neighbours are in different groups.
    """
    payload = np.unique(rows.payload_kg, return_inverse=True)[1]

    def left_out(*groupings: NDArray[Any]) -> list[Fold]:
        return [
            (np.flatnonzero(groups != value), np.flatnonzero(groups == value))
            for groups in groupings
            for value in np.unique(groups)
            if (groups != value).any()
        ]

    folds = left_out(payload % most if most else payload, rows.motion) or left_out(rows.run)
    return folds or [(np.arange(len(rows)),) * 2]


def _nested(candidate: type[TipPredictor], rows: TipRows) -> tuple[TipScore, Array]:
    """Score on the rows that outer folds leave out, and the mean error of each row there.

    The interval of a fold is calibrated on the errors of the other folds on its training rows
    (cross-conformal prediction).
    """
    folds, fitted = group_folds(rows), []
    total, count = np.zeros((len(rows), 3)), np.zeros((len(rows), 1))
    for train, test in folds:
        trained = rows.take(train)
        fitted.append(candidate(_best_variant(candidate, trained)).fit(trained))
        total[test] += rows.tip_m[test] - fitted[-1].predict(rows.inputs[test])
        count[test] += 1
    left_out_m, tested = total / count, []
    for (train, test), predictor in zip(folds, fitted, strict=True):
        trained = rows.take(train)
        interval = _interval(predictor, trained, left_out_m[train])
        tested.append((GuardedTip.of(trained, predictor, interval), rows.take(test)))
    return _score(tested), left_out_m


def _best_variant(candidate: type[TipPredictor], rows: TipRows) -> int:
    """Variant with the least mean error on rows left out; a simpler one if it hardly differs."""
    best, *others = candidate.variants
    if not others:
        return best
    folds = group_folds(rows, INNER_GROUPS)

    def mean_error_m(variant: int) -> float:
        predictor, distances_m = candidate(variant), []
        for train, test in folds:
            predicted_m = predictor.fit(rows.take(train)).predict(rows.inputs[test])
            distances_m.append(euclidean_distance_m(rows.tip_m[test], predicted_m))
        return float(np.mean(np.concatenate(distances_m)))

    least_m = mean_error_m(best)
    for variant in others:
        mean_m = mean_error_m(variant)
        if mean_m > WORSE * least_m:
            break
        if mean_m < (1.0 - TOLERANCE) * least_m:
            best, least_m = variant, mean_m
    return best


def _interval(fitted: TipPredictor, rows: TipRows, left_out_m: Array) -> TipInterval:
    wrong = [(inputs, rows.tip_m - fitted.predict(inputs)) for inputs in rows.wrong_inputs]
    wrong += [(rows.inputs, left_out_m + shift_m) for shift_m in rows.askew_m]
    return TipInterval.fit(rows.names, (rows.inputs, left_out_m, rows.run), wrong)


def _score(tested: Sequence[tuple[GuardedTip, TipRows]]) -> TipScore:
    """Score of predictors on rows each, over all of these."""
    error_m = np.vstack([rows.tip_m - tip.predict(rows.inputs) for tip, rows in tested])
    half_width_m = np.vstack([tip.half_width(rows.inputs) for tip, rows in tested])
    in_range = np.concatenate([tip.in_range(rows.inputs) for tip, rows in tested])
    coverage = axis_coverage(np.abs(error_m) <= half_width_m, tested[0][1].dof)
    distance_m = np.linalg.norm(error_m, axis=1)
    return TipScore(
        rows=len(error_m),
        mean_m=float(distance_m.mean()),
        p95_m=float(np.quantile(distance_m, 0.95)),
        max_m=float(distance_m.max()),
        coverage=coverage.mean,
        half_width_m=float(half_width_m.mean()),
        in_range=float(in_range.mean()),
        max_in_range_m=float(distance_m[in_range].max(initial=0.0)),
        coverage_least=coverage.least,
    )


def _entry(result: CandidateResult, tests: Mapping[str, TipRows]) -> CandidateEntry:
    predictor = result.predictor
    graph = to_onnx(predictor.write_graph, len(predictor.names)).SerializeToString()

    def scores(rows: TipRows) -> dict[str, TipScore]:
        parts = {"all": rows} | {k: rows.take(rows.part == k) for k in ("rest", "motion")}
        return {k: _score([(predictor, part)]) for k, part in parts.items() if len(part)}

    return CandidateEntry(
        summary=result.candidate.summary,
        variant=result.variant,
        nested=result.nested,
        tests={name: scores(rows) for name, rows in tests.items()},
        graph_bytes=len(graph),
        latency=graph_latency(graph),
    )


def range_reasons(predictor: GuardedTip, inputs: Array) -> RangeReasons:
    """Why rows are out of range, as the robot counts it."""
    half_width_m, age = predictor.half_width(inputs), predictor.names.index(AGE.name)
    count = RangeCount(predictor.ranges())
    for row in np.flatnonzero(~predictor.in_range(inputs)):
        count.add(inputs[row], half_width_m[row], inputs[row, age])
    return count.reasons()


def _reason(chosen: CandidateResult, results: Sequence[CandidateResult]) -> str:
    """The chosen candidate with its errors, and those of the others."""
    score = chosen.nested
    others = ", ".join(
        f"{result.candidate.name} {LENGTH.number(result.nested.mean_m, 2)}"
        for result in results
        if result is not chosen
    )
    better = f"; no candidate that is less simple is better by more than 3 % ({others} mm)"
    return (
        f"{chosen.candidate.summary}, off by {LENGTH.number(score.mean_m, 2)} mm on average on "
        f"payloads and motions left out; its interval covers "
        f"{FRACTION.number(score.coverage, 1)} % ({FRACTION.number(score.coverage_least, 1)} % on "
        f"the worst axis){better if others else ''}"
    )
