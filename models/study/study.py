"""The published study on any set of trials: every table of the paper, and DI without mocap.

Trained on trial 1, tested on trial 2 and on a motion that no training saw. Degrees are compared
by cross-validation on trial 1 alone; trial 2 chooses nothing. The tables of the tests are of the
paper's plain polynomials; cross-validation and the section `deployed` have the guard that clips
inputs into the training box, like the predictor on the robot.

`study.json` (distances in m, DI and shares dimensionless, TEST is trial_2, unseen_20deg, …, PART is
pooled, a payload in kg or phase_90deg, VARIANT is with_di, without_di or estimated_di)::

    chosen_degree                             of the least selection_m of estimated_di below
    cross_validation[VARIANT][degree]         blocks_m, leave_one_payload_out_m, …_fold_std_m;
                                              selection_m: payloads left out if there are several
    mean_di[payload], mean_di_other_dof[payload]
    training, tests[TEST]                     trials, hash, payloads, amplitudes, phases
    mean_euclidean_distance_m[TEST][PART][VARIANT][degree]      and std_euclidean_distance_m
    estimators[TEST][observer|lagged|none]    r2_di, rms_error_di, benefit_recovered[degree],
                                              mean_euclidean_distance_m[degree]
    baselines[TEST]                           observer_tip[PART], rigid_kinematics[PART],
                                              final_payload_error_kg[trial]
    deployed[TEST]                            mean_euclidean_distance_m, interval_coverage[axis], …
    series                                    curves of the figures (models.study.figure_curves)
    findings                                  claim, holds, text, depends_on
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from firmware_py.errors import InputError
from models.learning.lagged import LaggedRegressor
from models.learning.predictors import (
    DEGREES,
    Array,
    Fold,
    GuardedPredictor,
    polynomial_pipeline,
    predict_held_out,
)
from models.learning.samples import VARIANTS, Samples, collect_samples
from models.learning.validation import block_folds, euclidean_distance_m, payload_folds, payload_key
from models.plant.simulation.compiled_model import CompiledModel
from models.plant.step_model import StepModel
from models.study.figure_curves import figure_curves
from models.study.findings import judge_findings
from models.study.observer_runs import ObserverRun, run_observer
from models.study.tables import (
    ESTIMATORS,
    baseline_table,
    deployed_table,
    distance_table,
    distances_m,
    estimator_table,
)
from models.trials.deformation import deformation_index
from models.trials.trial import TrialSet

SCHEMA: Final = 1


@dataclass(frozen=True)
class Study:
    """Result of `run_study`.

    Attributes
    ----------
    document : dict
        What `study.json` holds.
    predictor : GuardedPredictor
        Trained on the observer's DI, at the chosen degree: what the robot gets.
    lagged : LaggedRegressor
        The fallback estimator of DI.
    training : Samples
        Rows that both were trained on.
    """

    document: dict[str, Any]
    predictor: GuardedPredictor
    lagged: LaggedRegressor
    training: Samples


def run_study(
    training: TrialSet,
    tests: Mapping[str, TrialSet],
    observer: StepModel,
    others: TrialSet | None = None,
    progress: Callable[[str], None] = lambda detail: None,
) -> Study:
    """Train, cross-validate and test every predictor of the study.

    Parameters
    ----------
    training : TrialSet
        Trial 1 of every payload, one dof.
    tests : mapping of str to TrialSet
        "trial_2", "unseen_20deg", …: never trained on.
    observer : StepModel
        The plant observer of that dof.
    others : TrialSet, optional
        Trials of the other dof, for the comparison of mean DI.
    progress : callable
        Told what was finished.

    Raises
    ------
    InputError
        If the trials are too short to hold out blocks with gaps.
    """
    training, tests = by_payload(training), {k: by_payload(v) for k, v in tests.items()}
    true_di = [deformation_index(t) for t in training]
    lagged = LaggedRegressor.fit(tuple(training), true_di)
    compiled = CompiledModel(observer)
    fit, _ = _observed(training, compiled, lagged)
    progress("DI")
    folds = _folds(fit)
    document: dict[str, Any] = {
        "schema": SCHEMA,
        "dof": training[0].meta.dof,
        "rows": "moving rows only; the observer also runs through the rest rows in front",
        "training": _described(training),
        "cross_validation": _cross_validation(fit, folds, progress),
        "mean_di": _mean_di(training),
        "mean_di_other_dof": _mean_di(others) if others else {},
    }
    chosen = _best_degree(document["cross_validation"]["estimated_di"])
    # The robot's next run is a whole one: so the interval is calibrated on whole runs held out,
    # not on blocks, which a predictor that saw every start of a motion never has to bridge.
    runs = folds.get("leave_one_payload_out", folds["blocks"])
    predictor = GuardedPredictor.fit(chosen, fit.features("observer"), fit.tip_m, runs)
    fitted = {
        (source, degree): polynomial_pipeline(degree).fit(fit.features(source), fit.tip_m)
        for source in ("true", *ESTIMATORS)
        for degree in DEGREES
    }
    progress("fits")
    document["chosen_degree"] = chosen
    sections = ("tests", "mean_euclidean_distance_m", "std_euclidean_distance_m", "estimators",
                "baselines", "deployed")  # fmt: skip
    document |= {section: {} for section in sections}
    observed: dict[str, Samples] = {}
    for name, trials in tests.items():
        samples, observations = _observed(trials, compiled, lagged)
        distances = distances_m(samples, fitted)
        observed[name] = samples
        document["tests"][name] = _described(trials)
        for section, statistic in (("mean", np.mean), ("std", np.std)):
            document[f"{section}_euclidean_distance_m"][name] = distance_table(
                samples, distances, statistic
            )
        document["estimators"][name] = estimator_table(samples, distances)
        document["baselines"][name] = baseline_table(samples, observations)
        document["deployed"][name] = deployed_table(predictor, samples)
        progress(name)
    document["series"] = figure_curves(fit, observed, fitted)
    document["findings"] = judge_findings(document, training, tests)
    return Study(document, predictor, lagged, fit)


def by_payload(trials: TrialSet) -> TrialSet:
    """Trials in the order in which tables and figures list them."""
    return TrialSet(
        tuple(sorted(trials, key=lambda t: (t.meta.payload_kg, t.meta.phase_2_rad, t.name)))
    )


def _observed(
    trials: TrialSet, observer: CompiledModel, lagged: LaggedRegressor
) -> tuple[Samples, list[ObserverRun]]:
    observations = [run_observer(observer, t) for t in trials]
    di = {
        "true": [deformation_index(t) for t in trials],
        "observer": [o.di for o in observations],
        "lagged": [lagged.estimate(t) for t in trials],
    }
    return collect_samples(tuple(trials), di), observations


def _described(trials: TrialSet) -> dict[str, Any]:
    def span(name: str) -> list[float]:
        return sorted({getattr(t.meta, name) for t in trials})

    return {
        "trials": [t.name for t in trials],
        "sha256": trials.sha256(),
        "payload_kg": span("payload_kg"),
        "amplitude_rad": span("amplitude_rad"),
        "phase_2_rad": span("phase_2_rad"),
        "step_s": round(trials[0].step_s, 9),
    }


def _mean_di(trials: TrialSet) -> dict[str, float]:
    """Mean DI over the moving rows by payload (paper, Fig. 11)."""
    by_payload: dict[str, list[Array]] = {}
    for t in trials:
        moving = deformation_index(t)[t.moving]
        by_payload.setdefault(payload_key(t.meta.payload_kg), []).append(moving)
    return {
        key: float(np.nanmean(np.concatenate(by_payload[key])))
        for key in sorted(by_payload, key=float)
    }


def _folds(fit: Samples) -> dict[str, list[Fold]]:
    folds = {"blocks": block_folds(fit.run, fit.time_s)}
    if len(np.unique(fit.payload_kg)) > 1:
        folds["leave_one_payload_out"] = payload_folds(fit.payload_kg)
    shortest = min(min(len(train), len(test)) for train, test in folds["blocks"])
    if shortest < fit.signals.shape[1] + 1:
        raise InputError(
            fit.trials[0].path,
            f"{len(fit)} moving rows are too few to hold out five blocks with 1 s gaps",
            "train on runs of at least 4 s",
        )
    return folds


def _cross_validation(
    fit: Samples, folds: dict[str, list[Fold]], progress: Callable[[str], None]
) -> dict[str, Any]:
    """Held-out distances by degree: mean and standard deviation over the folds of each kind.

    Payloads left out decide where there are several: a robot will carry others than the trained
    ones. Blocks of time stand beside: where one of them holds the only start of a motion, that
    block alone would decide.
    """
    result: dict[str, Any] = {}
    for variant, source in VARIANTS.items():
        features = fit.features(source)
        for degree in DEGREES:
            entry = {}
            for kind, parts in folds.items():
                distances = [
                    euclidean_distance_m(
                        fit.tip_m[fold[1]], predict_held_out(degree, features, fit.tip_m, fold)
                    )
                    for fold in parts
                ]
                of_folds = [float(d.mean()) for d in distances]
                entry[f"{kind}_m"] = float(np.mean(np.concatenate(distances)))
                entry[f"{kind}_fold_std_m"] = float(np.std(of_folds))
            entry["selection_m"] = entry.get("leave_one_payload_out_m", entry["blocks_m"])
            result.setdefault(variant, {})[str(degree)] = entry
            progress(f"cross-validation {variant} degree {degree}")
    return result


def _best_degree(by_degree: dict[str, dict[str, float]]) -> int:
    return int(min(by_degree, key=lambda degree: by_degree[degree]["selection_m"]))
