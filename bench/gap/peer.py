"""Discrepancy modelling with PySINDy on the benchmark's data sets, beside the gap workflow.

    python -m bench.gap.peer --plant build/plant.json --out build/bench_gap

As in Kaheman et al. (2019) and Ebers, Steele and Kutz (2024), the residual of the plant's equations
is written as a sparse sum of library terms by sequentially thresholded least squares (STLSQ). It
starts where the gap workflow does: identified plant, its known error, nuisance and trial variation
refitted. Residuals are in units of the difference between repetitions and columns have unit size,
so a coefficient is a contribution in noise floors; the effect with the greatest is named first,
nothing where no term survives. Equations and library: `bench.gap.library`.

Tuning: on 27 data sets without an effect, of other draws (seeds 1000 and 5000), the least
threshold, to a tenth, at which none of them raised an alarm. The ridge hardly matters: from 0.003
to 1, each with its own such threshold, 8 to 10 of 25 large effects were named rightly. The library
and its shapes were chosen on draw 1000 with effects; columns scaled by their size without an
effect, or a threshold found by leaving out payloads, did no better (8 to 12 of 26).
"""

from __future__ import annotations

import argparse
import importlib
import json
import sys
import warnings
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from bench.gap.bench_kind import bench_results
from bench.gap.case_run import bench_trials, rig_of
from bench.gap.cases import BenchCase
from bench.gap.library import Equation, missing_in_equations
from bench.gap.rig_plants import required_noise_floor
from bench.gap.scores.score_summary import peer_comparison
from firmware_py.console import Progress
from firmware_py.errors import InputError
from models.gap.estimation.gauss_newton import GaussNewton
from models.gap.estimation.noise_floor_fit import nuisance_and_variation
from models.gap.residuals.fit_parameters import FitParameter, plant_with_every_effect
from models.gap.residuals.residuals import Residuals
from models.gap.residuals.spectrum import Array, inverse_cosine_transform
from models.plant.identification.simulation_fit import row_weights
from models.plant.plant import ModelKind, Plant, read_plant
from models.plant.simulation.compiled_model import CompiledModel, run_trial, trial_parameters
from models.plant.step_model import names
from models.trials.trial import Trial

THRESHOLD: Final = 1.75
"""Least contribution that a term may have, in noise floors."""

RIDGE: Final = 0.1
"""Ridge of STLSQ for each row."""


def refitted_equations(plant: Plant, trials: Sequence[Trial]) -> list[dict[str, Equation]]:
    """Equations of each trial for the plant whose nuisance and trial variation are refitted."""
    residuals = Residuals(plant, trials, nuisance_and_variation(plant, trials))
    estimator = GaussNewton(residuals, required_noise_floor(plant))
    every = np.ones(len(residuals.fit_parameters), bool)
    values = estimator.fit(estimator.start(), every).values
    (group,), (means,) = residuals.groups, estimator.means
    models: dict[ModelKind, CompiledModel] = {}
    for kind in ("twin", "driven"):
        model = plant_with_every_effect(plant).step_model(1, kind)
        models[kind] = CompiledModel(replace(model, max_substep_s=residuals.model.max_substep_s))
    result = []
    for k, trial in enumerate(trials):
        own = [
            (q, value) for q, value in zip(residuals.fit_parameters, values, strict=True)
            if q.trial in (None, k)
        ]  # fmt: skip
        loop, p = simulated_signals(models["twin"], trial, own)
        moved = replace(trial, columns={**trial.columns, "angle_1_rad": loop["angle_1_rad"]})
        at_loop, at_measured = (
            simulated_signals(models["driven"], t, own)[0] for t in (moved, trial)
        )
        twin = {}
        for b, s in enumerate(group.signals):
            weight = np.maximum(row_weights(trial, s), 0.05)
            known = inverse_cosine_transform(means[k, b], len(trial)) / weight
            twin[s] = trial.columns[s] - loop[s] - known if s in trial.columns else known
        # Against the driven link on the loop's own motion: the effect of its filter cancels.
        driven = {s: twin[s] + at_loop[s] - y for s, y in at_measured.items() if s in twin}
        result.append(missing_in_equations(trial, p, twin, driven))
    return result


def simulated_signals(
    model: CompiledModel, trial: Trial, changes: Sequence[tuple[FitParameter, float]]
) -> tuple[dict[str, Array], dict[str, float]]:
    """Outputs by name, and the parameters, with some fit parameters changed."""
    step = model.model
    p = dict(zip(names(step.parameters), trial_parameters(step, trial), strict=True))
    outputs = names(step.outputs)
    shift = np.zeros(len(outputs))
    for q, value in changes:
        for name, weight in q.parameters.items():
            p[name] += weight * value
        shift += value * np.array([q.outputs.get(name, 0.0) for name in outputs])
    y = run_trial(model, trial, np.array(list(p.values()))) + shift
    return dict(zip(outputs, y.T, strict=True)), p


def contributions(trials: Sequence[dict[str, Equation]], payloads: Sequence[float]) -> Any:
    """Size of what survives STLSQ by effect, in noise floors; the greatest first."""
    found: dict[str, float] = {}
    for name in trials[0]:
        rows = [t[name] for t in trials]
        for effect, size in sparse_terms(rows, repetition_noise(rows, payloads)).items():
            if not effect.startswith("("):
                found[effect] = max(found.get(effect, 0.0), size)
    return dict(sorted(found.items(), key=lambda item: -item[1]))


def repetition_noise(rows: Sequence[Equation], payloads: Sequence[float]) -> float:
    """Root mean square of what differs between two repetitions, for one of them."""
    squares = [
        np.mean((a.missing - b.missing)[both] ** 2) / 2
        for i, a in enumerate(rows) for j, b in enumerate(rows[:i])
        if payloads[i] == payloads[j] and (both := a.counts & b.counts).any()
    ]  # fmt: skip
    return float(np.sqrt(np.mean(squares)))


def sparse_terms(rows: Sequence[Equation], unit: float) -> dict[str, float]:
    """Size of each term of one equation that survives, in units of `unit`."""
    sindy = import_pysindy()
    effects = list(rows[0].columns)
    library = [np.column_stack([r.columns[e] for e in effects])[r.counts] for r in rows]
    missing = [r.missing[r.counts, None] / unit for r in rows]
    size = np.sqrt(np.mean(np.concatenate(library) ** 2, axis=0))
    count = sum(len(x) for x in library)
    size = np.where(size > 0, size, 1.0)  # a term that these trials never excite
    model = sindy.SINDy(
        optimizer=sindy.STLSQ(threshold=THRESHOLD, alpha=RIDGE * count, unbias=False),
        feature_library=sindy.IdentityLibrary(),
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that nothing survives is an answer
        model.fit([x / size for x in library], t=1.0, x_dot=missing)
    found = np.abs(model.coefficients()[0])
    return {e: float(c) for e, c in zip(effects, found, strict=True) if c > 0}


def import_pysindy() -> Any:
    """Import PySINDy, which is not among the locked packages."""
    try:
        return importlib.import_module("pysindy")
    except ImportError as error:
        raise InputError(
            "bench.gap.peer", f"PySINDy is needed for this comparison only ({error})",
            "install it for this once: .venv/bin/python -m pip install pysindy==2.1.0",
        ) from error  # fmt: skip


def run_peer_case(case: BenchCase, plant: Plant, path: Path) -> None:
    """Write the result of one case, in the form that `bench.gap.scores.score_summary` reads."""
    rig = rig_of(case).hide(case.hidden)
    trials = bench_trials(rig, case.seed, case.joints, case.motion, case.payloads)
    found = contributions(refitted_equations(plant, trials), [t.meta.payload_kg for t in trials])
    result = {
        "case": asdict(case), "verdict": "reduced" if found else "no gap",
        "named": list(found), "contributions": found,
    }  # fmt: skip
    fresh = path.with_suffix(".part")
    fresh.write_text(json.dumps(result, indent=1), encoding="utf-8")
    fresh.replace(path)


def main() -> int:
    """Run the cases whose results are in the benchmark's directory, and summarise."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--plant", type=Path, required=True, help="as the benchmark had it")
    parser.add_argument("--out", type=Path, required=True, help="results of the benchmark")
    args = parser.parse_args()
    try:
        import_pysindy()
        plant, out = read_plant(args.plant), args.out / "peer"
        out.mkdir(exist_ok=True)
        stand = bench_results(args.out)
        left = {
            out / f"{key}.json": BenchCase(**r["case"]) for key, r in stand.items()
            if "impossible" not in r and r["case"]["kind"] != "outside"
            and not (out / f"{key}.json").exists()
        }  # fmt: skip
        progress = Progress("bench.gap.peer", len(left))
        for path, case in left.items():
            run_peer_case(case, plant, path)
            progress.step(case.kind)
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    print(json.dumps(peer_comparison(args.out), indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())
