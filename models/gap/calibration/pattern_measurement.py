"""Measurement of the patterns of the plant's own error for one's own trials, on drawn rigs.

A plant is identified on each rig, on the motions and payloads of the trials. Then the link's
stiffness, mass and damping change a few times, and the nuisance is refitted: what is left beyond
the plant's mean error gives the patterns (`models.gap.estimation.model_discrepancy`). A file by rig
keeps what was measured, so that the work can be resumed.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from firmware_py.errors import InputError
from models.gap.calibration.drawn_plants import plant_on_rig
from models.gap.calibration.protocol import repeated
from models.gap.estimation.gauss_newton import GaussNewton
from models.gap.estimation.model_discrepancy import ModelDiscrepancy, patterns_of
from models.gap.estimation.noise_floor import group_frequencies_hz
from models.gap.estimation.noise_floor_fit import noise_floor_of, nuisance_and_variation
from models.gap.residuals.residuals import Residuals, TrialGroup
from models.gap.residuals.spectrum import Array
from models.gap.settings import DEFAULT_SETTINGS, GapSettings
from models.plant.plant import Plant, read_plant
from models.rig.drawn_rig import drawn_link
from models.rig.rig_parameters import RigParameters
from models.rig.study_protocol import run_case
from models.rig.trial_case import TrialCase
from models.trials.trial import Trial

__all__ = ["PatternWork", "learned_patterns", "measure_own_error", "run_pattern_work"]


def link_seed(rig: int, link: int) -> int:
    """Seed of the noise of a link of a drawn rig; the benchmark has others.

    Noise that rigs share would be taken for a pattern.

    Parameters
    ----------
    rig, link : int
        Numbers; the trials that the plant is identified on have the number of no link.
    """
    return 9000 + 100 * rig + link


IDENTIFICATION: Final = 99
"""Number, in place of a link's, of the trials that a plant is identified on."""


@dataclass(frozen=True)
class PatternWork:
    """What is measured on each drawn rig.

    Attributes
    ----------
    identified_on, diagnosed_on : tuple of TrialCase
        Conditions that a plant is identified on, each twice, and those of the patterns.
    links : int
        Changed links of each rig.
    directory : Path
        Of the plants and the files by rig.
    make : RigParameters, optional
        Rig of the make around which rigs are drawn; the study's where it is not given.
    start : Plant, optional
        Where each identification starts; the packaged plant where it is not given.
    """

    identified_on: tuple[TrialCase, ...]
    diagnosed_on: tuple[TrialCase, ...]
    links: int
    directory: Path
    make: RigParameters | None = None
    start: Plant | None = None

    def fingerprint(self) -> str:
        """Hash of all that the files depend on, but for the directory."""
        digest = hashlib.sha256()
        for case in (*self.identified_on, *self.diagnosed_on):
            goals_rad = case.motion.table_rad()
            digest.update(f"{case.name} {case.gravity} {case.pressure_pa}".encode())
            digest.update(np.round(goals_rad, 6).tobytes())
        start = "" if self.start is None else self.start.sha256()
        make = "" if self.make is None else {name: self.make[name] for name in self.make}
        digest.update(f"{self.links} {start} {make}".encode())
        return digest.hexdigest()

    def file(self, rig: int) -> Path:
        """File of what was measured on a rig."""
        return self.directory / f"own_error_{rig}.npz"

    def plant_file(self, rig: int) -> Path:
        """File of the plant of a rig."""
        return self.directory / "plants" / f"drawn_{rig}.json"


def run_pattern_work(
    work: PatternWork,
    rigs: Sequence[int],
    executor: Executor,
    on_done: Callable[[str], None],
) -> None:
    """Measure what is not there yet.

    Parameters
    ----------
    work : PatternWork
        What is measured.
    rigs : sequence of int
        Numbers of drawn rigs.
    executor : Executor
        Of `concurrent.futures`; each rig is one job.
    on_done : callable
        Called with the name of each rig that is measured.
    """
    left = [k for k in rigs if not work.file(k).exists()]
    jobs = {executor.submit(measure_own_error, work, k): k for k in left}
    for job in as_completed(jobs):
        job.result()
        on_done(f"drawn_{jobs[job]}")


def measure_own_error(work: PatternWork, rig: int) -> None:
    """Identify a plant on a rig; save what the nuisance fit leaves on other links.

    A rig whose link folds in these trials has an empty file.

    Parameters
    ----------
    work : PatternWork
        What is measured.
    rig : int
        Number of the drawn rig.
    """
    os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")
    measured: dict[str, _GroupErrors] = {}
    try:
        cases = repeated(work.identified_on, 2, link_seed(rig, IDENTIFICATION))
        own = drawn_link(rig, 0, work.make)
        plant = read_plant(plant_on_rig(own, cases, work.plant_file(rig), work.start))
        for link in range(1, work.links + 1):
            own = drawn_link(rig, link, work.make)
            _add_link(measured, plant, own, work, link_seed(rig, link))
    except InputError:
        measured = {}
    arrays: dict[str, Any] = {}
    for k, (key, group) in enumerate(measured.items()):
        arrays |= {
            f"key_{k}": key, f"payload_kg_{k}": group.payload_kg, f"signals_{k}": group.signals,
            f"rows_{k}": np.array(group.rows), f"noise_{k}": np.array(group.noise),
        }  # fmt: skip
    work.directory.mkdir(parents=True, exist_ok=True)
    fresh = work.file(rig).with_suffix(".part.npz")
    np.savez(fresh, **arrays)
    fresh.replace(work.file(rig))


@dataclass
class _GroupErrors:
    """Errors of one motion on several links, relative to the plant's own error."""

    payload_kg: list[float]
    signals: list[str]
    rows: list[Array]
    noise: list[Array]


def _add_link(
    measured: dict[str, _GroupErrors],
    plant: Plant,
    rig: RigParameters,
    work: PatternWork,
    seed: int,
) -> None:
    """Errors of the plant on a link, by motion; none if it folds."""
    try:
        trials = [run_case(rig, case) for case in repeated(work.diagnosed_on, 1, seed)]
    except InputError:
        return
    for dof in sorted({t.meta.dof for t in trials}):
        own = [t for t in trials if t.meta.dof == dof]
        for group, rows, noise in _own_errors(plant, own, dof):
            payloads = [own[k].meta.payload_kg for k in group.trials]
            signals = list(group.signals)
            known = measured.setdefault(group.key, _GroupErrors(payloads, signals, [], []))
            known.rows.append(rows)
            known.noise.append(noise)


def _own_errors(
    plant: Plant, trials: Sequence[Trial], dof: int
) -> list[tuple[TrialGroup, Array, Array]]:
    """By group: error beyond the mean, (P, signals, K), and variance of noise, (signals, K)."""
    floor = noise_floor_of(plant, dof)
    if floor is None:
        raise InputError(plant.name, f"has no noise floor for {dof} joint(s)", "repeat its trials")
    residuals = Residuals(plant, trials, nuisance_and_variation(plant, trials))
    estimator = GaussNewton(residuals, floor)
    point = estimator.fit_nuisance(estimator.start())
    found = []
    for group, rows, mean in zip(residuals.groups, point.rows, estimator.means, strict=True):
        hz = group_frequencies_hz(group, residuals.trials)
        scale = np.array([floor.own_error(s, hz) for s in group.signals])
        noise = np.array([np.interp(hz, floor.frequency_hz, floor.noise[s]) for s in group.signals])
        found.append((group, (rows - mean) / scale, noise / scale**2))
    return found


def learned_patterns(
    files: Sequence[Path], settings: GapSettings = DEFAULT_SETTINGS
) -> tuple[ModelDiscrepancy, ...]:
    """Patterns of each motion from the files of `measure_own_error`.

    Parameters
    ----------
    files : sequence of Path
        By rig.
    settings : GapSettings
        Tuned numbers: how many patterns.

    Raises
    ------
    InputError
        If the link folds on every rig.
    """
    measured = own_errors_of(files)
    if not measured:
        raise InputError(
            str(files[0].parent), "holds no error of any plant: the link folds on every drawn rig",
            "give trials with less payload or amplitude, or describe the link with --link",
        )  # fmt: skip
    found = []
    for key, rigs in measured.items():
        rows = np.concatenate([r["rows"] for r in rigs])
        noise = np.mean(np.concatenate([r["noise"] for r in rigs]), axis=0)
        table = patterns_of(rows, noise, settings.discrepancy_patterns)
        signals = tuple(rigs[0]["signals"].tolist())
        found.append(ModelDiscrepancy(key, rigs[0]["payload_kg"], signals, table))
    return tuple(found)


def own_errors_of(files: Sequence[Path]) -> dict[str, list[dict[str, Array]]]:
    """Content of the files of `measure_own_error` by motion, an entry for each rig.

    Parameters
    ----------
    files : sequence of Path
        By rig.
    """
    names = ("payload_kg", "signals", "rows", "noise")
    measured: dict[str, list[dict[str, Array]]] = {}
    for path in files:
        with np.load(path) as file:
            for k in range(sum(name.startswith("key_") for name in file)):
                own = {name: file[f"{name}_{k}"] for name in names}
                measured.setdefault(str(file[f"key_{k}"]), []).append(own)
    return measured
