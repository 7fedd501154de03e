"""Calibration of the gap workflow on rigs of drawn structure, without a gap.

    python -m bench.gap.calibration.plant_error --out build/calibrate

Each rig has its own structure and values (`models.rig.drawn_rig`) and a plant that is identified on
its trials. Then the link's stiffness, mass and damping change a few times, and the nuisance is
refitted. What is left beyond the plant's mean error gives the patterns of its own error
(`models/gap/estimation/model_discrepancy.npz`); a diagnosis on further rigs, with these patterns,
gives the null distribution of every effect (`models/gap/search/null_distribution.json`). With
--joints 2 only the null distribution of two joints is measured, without patterns, the link that
the plant knows among the links. Resumable: files by rig. No rig for tests is among them.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np

from bench.gap.calibration.pattern_check import pattern_sentence
from bench.gap.case_run import bench_trials
from bench.gap.cases import NUISANCE
from bench.gap.rig_plants import plant_of_rig, required_noise_floor
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
from models.gap.search.null_distribution import calibrated_null_distribution, null_distributions
from models.gap.settings import DEFAULT_SETTINGS
from models.plant.plant import read_plant
from models.rig.drawn_rig import FIRST_TEST_NUMBER, rig_named
from models.rig.rig_parameters import RigParameters
from models.rig.study_protocol import run_case
from models.rig.trial_case import TrialCase
from models.trials.trial_files import TrialSet

PAYLOADS_KG: Final = (0.0, 0.5, 1.0, 1.5, 2.0)
SEED: Final = 9000
"""Of the draws; the benchmark has others."""


def drawn_link(rig: int, link: int) -> RigParameters:
    """Rig of a number with the link of a number; link 0 is the one that the plant knows.

    Parameters
    ----------
    rig, link : int
        Numbers.
    """
    drawn = rig_named(f"drawn_{rig}")
    if not link:
        return drawn
    rng = np.random.default_rng([SEED, rig, link])
    return drawn.changed(
        **{n: drawn[n] * float(np.exp(s * rng.standard_normal())) for n, s in NUISANCE.items()}
    )


def pattern_case(rig: int, links: int, directory: str) -> None:
    """Identify a plant on a rig; save what the nuisance fit leaves on other links.

    Spectra by link, payload and signal, relative to the plant's own error.

    Parameters
    ----------
    rig, links : int
        Number of the rig, and how many other links.
    directory : str
        Of the results.
    """
    path = _pattern_file(directory, rig)
    rows: list[Any] = []
    noise: list[Any] = []
    about: dict[str, Any] = {}
    try:
        plant = read_plant(plant_of_rig(f"drawn_{rig}", Path(directory) / "plants"))
    except InputError:  # the link folds
        np.savez(path)
        return
    floor = required_noise_floor(plant)
    for link in range(1, links + 1):
        try:
            trials = [
                run_case(drawn_link(rig, link), TrialCase(Motion(), p, 1, SEED + link))
                for p in PAYLOADS_KG
            ]
        except InputError:
            continue
        residuals = Residuals(plant, trials, nuisance_and_variation(plant, trials))
        estimator = GaussNewton(residuals, floor)
        point = estimator.fit_nuisance(estimator.start())
        (group,) = residuals.groups
        hz = group_frequencies_hz(group, residuals.trials)
        scale = np.array([floor.own_error(s, hz) for s in group.signals])
        own = np.array([np.interp(hz, floor.frequency_hz, floor.noise[s]) for s in group.signals])
        rows.append((point.rows[0] - estimator.means[0]) / scale)
        noise.append(own / scale**2)
        about = {"key": group.key, "signals": np.array(group.signals)}
    np.savez(path, rows=rows, noise=noise, **about)


def null_case(rig: int, link: int, directory: str, joints: int = 1) -> None:
    """Save the d′ of each effect on one link, and the residual without any.

    Parameters
    ----------
    rig, link : int
        Numbers of rig and link; the patterns are those of other rigs.
    directory : str
        Of the results.
    joints : int
        Driven joints, 1 or 2.
    """
    path = _null_file(directory, rig, link, joints)
    try:
        plant = read_plant(plant_of_rig(f"drawn_{rig}", Path(directory) / "plants", joints))
        trials = bench_trials(drawn_link(rig, link), SEED + 100 * link, joints)
    except InputError:
        path.write_text("{}")
        return
    found = diagnose(plant, TrialSet(tuple(trials)))
    separations = dict(found.screened)
    for effect, separation in found.refitted.items():
        separations[effect] = max(separations[effect], separation)
    row = {
        "separations": separations, "left": found.residual_before, "named": found.named,
        "change": found.link_change,
        "verdict": found.verdict,
    }  # fmt: skip
    path.write_text(json.dumps(row))


def learn_patterns(files: Sequence[Path]) -> ModelDiscrepancy:
    """Patterns from the files of `pattern_case`."""
    loaded = [d for d in (dict(np.load(f)) for f in files) if len(d.get("rows", ()))]
    print(pattern_sentence(loaded))
    rows = np.concatenate([d["rows"] for d in loaded])
    noise = np.mean(np.concatenate([d["noise"] for d in loaded]), axis=0)
    table = patterns_of(rows, noise, DEFAULT_SETTINGS.discrepancy_patterns)
    first = loaded[0]
    return ModelDiscrepancy(
        str(first["key"]), np.array(PAYLOADS_KG), tuple(first["signals"].tolist()), table
    )


def main() -> None:
    """Draw, run, and write both files."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="directory of results")
    parser.add_argument("--rigs", type=int, default=16, help="drawn rigs for the patterns")
    parser.add_argument("--null", type=int, default=18, help="further rigs for the null")
    parser.add_argument("--links", type=int, default=3, help="other links of each rig")
    parser.add_argument("--joints", type=int, choices=(1, 2), default=1, help="driven joints")
    args = parser.parse_args()
    if args.rigs + args.null > FIRST_TEST_NUMBER:
        parser.error(f"rigs from drawn_{FIRST_TEST_NUMBER} on are for tests: take fewer")
    os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")
    args.out.mkdir(parents=True, exist_ok=True)
    out, rigs = str(args.out), range(args.rigs)
    if args.joints == 2:
        others = range(args.rigs, args.rigs + args.null)
        write_null_distribution(others, range(args.links), out, 2)
        return
    _run(pattern_case, [(k, args.links, out) for k in rigs if not _pattern_file(out, k).exists()])
    learn_patterns([_pattern_file(out, k) for k in rigs]).write(PATTERNS)
    others = range(args.rigs, args.rigs + args.null)
    write_null_distribution(others, range(1, args.links + 1), out, args.joints)


def write_null_distribution(
    rigs: Sequence[int], links: Sequence[int], directory: str, joints: int
) -> None:
    """Diagnose links without an effect; write the null distribution of a number of joints.

    Parameters
    ----------
    rigs, links : sequence of int
        Numbers; link 0 is the one that the plant knows.
    directory : str
        Of the results.
    joints : int
        Driven joints, 1 or 2.
    """
    work = [(k, n, directory, joints) for n in links for k in rigs]
    files = [_null_file(directory, k, n, joints) for k, n, *_ in work]
    _run(null_case, [w for w, f in zip(work, files, strict=True) if not f.exists()])
    rows = [r for r in (json.loads(f.read_text()) for f in files) if r]
    found = calibrated_null_distribution(
        [r["separations"] for r in rows], [r["left"] for r in rows], [r["change"] for r in rows]
    )
    known = null_distributions()
    pooled = known[str(joints)].repetitions_pooled  # as in the search that was measured
    found = msgspec.structs.replace(found, repetitions_pooled=pooled)
    tables = msgspec.json.encode({**known, str(joints): found})
    NULL_DISTRIBUTION.write_bytes(msgspec.json.format(tables, indent=1) + b"\n")


def _pattern_file(directory: str, rig: int) -> Path:
    return Path(directory) / f"patterns_{rig}.npz"


def _null_file(directory: str, rig: int, link: int, joints: int) -> Path:
    suffix = "" if joints == 1 else f"_{joints}dof"
    return Path(directory) / f"null_{rig}_{link}{suffix}.json"


def _run(job: Callable[..., None], work: Sequence[tuple[Any, ...]]) -> None:
    """Do what is missing, on two processors."""
    progress = Progress("bench.gap.calibration.plant_error", len(work))
    with ProcessPoolExecutor(2, multiprocessing.get_context("spawn")) as pool:
        futures = [pool.submit(job, *arguments) for arguments in work]
        for future in as_completed(futures):
            future.result()
            progress.step(job.__name__)


if __name__ == "__main__":
    main()
