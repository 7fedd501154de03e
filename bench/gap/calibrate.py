"""Calibration of the gap workflow on data without a gap.

    python -m bench.gap.calibrate --plant build/plant.json --out build/calibrate

Two sets of rigs without a hidden effect, their nuisance drawn anew: the first gives the patterns of
the plant's own error (`models/gap/estimation/model_discrepancy.npz`), the second the null
distribution of every effect (`models/gap/search/null_distribution.json`). Resumable: one file per
rig.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Final

import msgspec
import numpy as np

from bench.gap.case_run import bench_trials, required_noise_floor, rig_of
from bench.gap.cases import BenchCase, draw_cases
from firmware_py.console import Progress
from firmware_py.errors import InputError
from firmware_py.motion import Motion
from models.gap.diagnosis import diagnose
from models.gap.estimation.gauss_newton import GaussNewton
from models.gap.estimation.model_discrepancy import PATH as PATTERNS
from models.gap.estimation.model_discrepancy import ModelDiscrepancy, patterns_of
from models.gap.estimation.noise_floor import group_frequencies_hz
from models.gap.estimation.noise_floor_fit import nuisance_and_variation
from models.gap.residuals.residuals import Residuals
from models.gap.search.null_distribution import PATH as NULL_DISTRIBUTION
from models.gap.search.null_distribution import calibrated_null_distribution
from models.gap.settings import DEFAULT_SETTINGS
from models.plant.plant import read_plant
from models.rig.study_protocol import run_case
from models.rig.trial_case import TrialCase
from models.trials.trial_files import TrialSet

PAYLOADS_KG: Final = (0.0, 0.5, 1.0, 1.5, 2.0)
SEEDS: Final = {"patterns": 9000, "null": 9001}
"""Of the draws; the benchmark has others."""


def pattern_case(case: BenchCase, plant_path: str, path: str) -> None:
    """Save the residual of the nuisance fit on one rig: spectra by payload.

    Parameters
    ----------
    case : BenchCase
        Without a hidden effect.
    plant_path : str
        Plant with a noise floor.
    path : str
        File to write (.npz).
    """
    rig = rig_of(case)
    try:
        trials = [run_case(rig, TrialCase(Motion(), p, 1, case.seed)) for p in PAYLOADS_KG]
    except InputError:  # its link folds
        np.savez(path)
        return
    plant = read_plant(plant_path)
    residuals = Residuals(plant, trials, nuisance_and_variation(plant, trials))
    floor = required_noise_floor(plant)
    estimator = GaussNewton(residuals, floor)
    steps = residuals.settings.nuisance_fit_steps
    point = estimator.fit(estimator.start(), np.ones(len(residuals.fit_parameters), bool), steps)
    (group,) = residuals.groups
    hz = group_frequencies_hz(group, residuals.trials)
    noise = [np.interp(hz, floor.frequency_hz, floor.noise[s]) for s in group.signals]
    np.savez(
        path, rows=point.rows[0] - estimator.means[0], noise=noise, key=group.key,
        signals=np.array(group.signals),
    )  # fmt: skip


def null_case(case: BenchCase, plant_path: str, path: str) -> None:
    """Save the d′ of each effect on one rig, and the residual without any.

    Parameters
    ----------
    case : BenchCase
        Without a hidden effect.
    plant_path : str
        Plant with a noise floor.
    path : str
        File to write (.json).
    """
    try:
        trials = bench_trials(rig_of(case), case.seed)
    except InputError:
        Path(path).write_text("{}")
        return
    found = diagnose(read_plant(plant_path), TrialSet(tuple(trials)))
    separations = dict(found.screened)
    for effect, separation in found.refitted.items():
        separations[effect] = max(separations[effect], separation)
    row = {"separations": separations, "left": found.residual_before}
    Path(path).write_text(json.dumps(row))


def learn_patterns(files: list[Path]) -> ModelDiscrepancy:
    """Patterns from the files of `pattern_case`."""
    loaded = [dict(np.load(f)) for f in files]
    loaded = [d for d in loaded if "rows" in d]
    rows = np.array([d["rows"] for d in loaded])
    table = patterns_of(rows, loaded[0]["noise"], DEFAULT_SETTINGS.discrepancy_patterns)
    print(f"{len(table)} patterns from {len(rows)} rigs")
    return ModelDiscrepancy(
        str(loaded[0]["key"]), np.array(PAYLOADS_KG), tuple(loaded[0]["signals"].tolist()), table
    )


def main() -> None:
    """Draw, run, and write both files."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--plant", type=Path, required=True, help="identified without effects")
    parser.add_argument("--out", type=Path, required=True, help="directory of results")
    parser.add_argument("--patterns", type=int, default=64, help="rigs for the patterns")
    parser.add_argument("--null", type=int, default=96, help="rigs for the null distribution")
    args = parser.parse_args()
    os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")
    args.out.mkdir(parents=True, exist_ok=True)
    if args.patterns:
        work = _cases("patterns", args.patterns, args.out, "npz")
        learn_patterns(_run(pattern_case, work, args.plant)).write(PATTERNS)
    if args.null:
        work = _cases("null", args.null, args.out, "json")
        rows = [json.loads(f.read_text()) for f in _run(null_case, work, args.plant)]
        rows = [r for r in rows if r]
        found = calibrated_null_distribution(
            [r["separations"] for r in rows], [r["left"] for r in rows]
        )
        NULL_DISTRIBUTION.write_bytes(
            msgspec.json.format(msgspec.json.encode(found), indent=1) + b"\n"
        )


Work = list[tuple[BenchCase, Path]]


def _cases(purpose: str, count: int, out: Path, suffix: str) -> Work:
    drawn = draw_cases(0, count, 0, 0, SEEDS[purpose])
    return [(case, out / f"{purpose}_{case.key}.{suffix}") for case in drawn]


def _run(job: Callable[[BenchCase, str, str], None], work: Work, plant: Path) -> list[Path]:
    """Do what is missing, on two processors."""
    left = [(case, path) for case, path in work if not path.exists()]
    progress = Progress("bench.gap.calibrate", len(left))
    with ProcessPoolExecutor(2, multiprocessing.get_context("spawn")) as pool:
        futures = [pool.submit(job, case, str(plant), str(path)) for case, path in left]
        for future in as_completed(futures):
            future.result()
            progress.step(job.__name__)
    return [path for _, path in work]


if __name__ == "__main__":
    main()
