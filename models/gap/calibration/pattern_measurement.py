"""Measurement of the patterns of the plant's own error for your own trials, on drawn rigs.

A plant is identified on each rig, on the motions and payloads of the trials. Then the link's
stiffness, mass and damping change a few times, and the nuisance is refitted. The residual beyond
the error on the rig's own link gives the patterns (`models.gap.estimation.model_discrepancy`).
These trials have neither noise nor variation, since a few links cannot separate patterns from
noise. Each rig has a file of its measurements, so that the work can be resumed.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, as_completed
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final
from zipfile import BadZipFile

import numpy as np

from firmware_py.errors import InputError
from models.gap.calibration.drawn_plants import plant_on_rig
from models.gap.calibration.protocol import repeated
from models.gap.estimation.gauss_newton import GaussNewton
from models.gap.estimation.model_discrepancy import ModelDiscrepancy, patterns_of
from models.gap.estimation.noise_floor_fit import (
    fitted_point,
    noise_floor_of,
    nuisance_and_variation,
)
from models.gap.estimation.payload_transfer import PayloadCurves
from models.gap.residuals.residuals import Residuals
from models.gap.settings import DEFAULT_SETTINGS, GapSettings
from models.plant.identification.noise_floor import Array, group_frequencies_hz
from models.plant.plant import Plant, read_plant
from models.rig.drawn import drawn_link, without_scatter
from models.rig.parameters import RigParameters
from models.rig.protocol import TrialCase, run_case
from models.trials.trial import Trial

__all__ = ["PatternWork", "learned_patterns", "measure_own_error", "run_pattern_work"]

REASON: Final = "reason"
"""Entry of a rig's file: why one of its links does not count, usually because it folds."""


@dataclass(frozen=True)
class PatternWork:
    """Measurements to make on each drawn rig."""

    identified_on: tuple[TrialCase, ...]  # Conditions that a plant is identified on, each twice
    diagnosed_on: tuple[TrialCase, ...]  # Conditions of the patterns
    links: int  # Changed links of each rig
    directory: Path  # Directory of the plants and the files by rig
    make: RigParameters | None = None  # Rig around which rigs are drawn; the study's by default
    # Plant that each identification starts from; the packaged one by default
    start: Plant | None = None

    def fingerprint(self) -> str:
        """Hash of all that the files depend on, except the directory."""
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
        """File with the measurements on a rig."""
        return self.directory / f"own_error_{rig}.npz"

    def plant_file(self, rig: int) -> Path:
        return self.directory / "plants" / f"drawn_{rig}.json"


def run_pattern_work(
    work: PatternWork,
    rigs: Sequence[int],
    executor: Executor,
    on_done: Callable[[str], None],
) -> None:
    """Measure the rigs that have no file yet; `on_done` gets the name of each that is measured."""
    left = [k for k in rigs if not work.file(k).exists()]
    jobs = {executor.submit(measure_own_error, work, k): k for k in left}
    for job in as_completed(jobs):
        job.result()
        on_done(f"drawn_{jobs[job]}")


def measure_own_error(work: PatternWork, rig: int) -> None:
    """Identify a plant on a rig; save the residuals of the nuisance fit on other links.

    If a rig cannot run these trials, for example because its link folds, its file holds only the
    reason.
    """
    os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")
    errors: list[GroupError] = []
    arrays: dict[str, Any] = {}
    try:
        cases = repeated(work.identified_on, 2, rig)  # rigs share no noise
        own = drawn_link(rig, 0, work.make)
        plant = read_plant(plant_on_rig(own, cases, work.plant_file(rig), work.start))
        own_trials = trials_without_scatter(own, work.diagnosed_on)
        for link in range(1, work.links + 1):
            changed = drawn_link(rig, link, work.make)
            try:
                trials = trials_without_scatter(changed, work.diagnosed_on)
            except InputError as error:
                arrays[REASON] = str(error)
                continue
            errors += errors_on_another_link(plant, own_trials, trials)
    except InputError as error:
        errors, arrays[REASON] = [], str(error)
    for k, key in enumerate(dict.fromkeys(e.key for e in errors)):
        group = [e for e in errors if e.key == key]
        arrays |= {
            f"key_{k}": key, f"payload_kg_{k}": group[0].payload_kg,
            f"signals_{k}": group[0].signals, f"rows_{k}": np.array([e.rows for e in group]),
            f"noise_{k}": group[0].noise,
        }  # fmt: skip
    work.directory.mkdir(parents=True, exist_ok=True)
    fresh = work.file(rig).with_suffix(".part.npz")
    np.savez(fresh, **arrays)
    fresh.replace(work.file(rig))


@dataclass(frozen=True)
class GroupError:
    """Error of a plant on another link, in the trials of one motion."""

    key: str
    payload_kg: list[float]
    signals: list[str]
    # (P, signals, K), spectra beyond those on the plant's own link, relative to
    # `models.gap.estimation.noise_floor.NoiseFloor.own_error`
    rows: Array
    noise: Array  # (signals, K), variance of the floor's noise, relative to the same


def trials_without_scatter(rig: RigParameters, cases: Sequence[TrialCase]) -> list[Trial]:
    quiet = without_scatter(rig)
    return [run_case(quiet, case) for case in cases]


def errors_on_another_link(
    plant: Plant, own_trials: Sequence[Trial], trials: Sequence[Trial]
) -> list[GroupError]:
    """Error of a plant on another link, by motion.

    `own_trials` and `trials` are of the own link and the other one, under the same conditions in
    the same order.
    """
    found = []
    for dof in sorted({t.meta.dof for t in trials}):
        floor = noise_floor_of(plant, dof)
        if floor is None:
            raise InputError(plant.name, "has no noise floor", "identify it on repeated trials")
        own, other = ([t for t in every if t.meta.dof == dof] for every in (own_trials, trials))
        parameters = nuisance_and_variation(plant, own)
        is_variation = np.array([q.kind == "trial" for q in parameters])
        residuals = Residuals(plant, own, parameters)
        mean = fitted_point(residuals, replace(floor, curves={}), is_variation).rows
        floor = replace(floor, curves=_curves(residuals, mean))
        estimator = GaussNewton(
            Residuals(plant, other, nuisance_and_variation(plant, other)), floor
        )
        point = estimator.fit_nuisance(estimator.start())
        for group, rows, expected in zip(residuals.groups, point.rows, mean, strict=True):
            hz = group_frequencies_hz(group, residuals.trials)
            scale = np.array([floor.own_error(s, hz) for s in group.signals])
            noise = np.array(
                [np.interp(hz, floor.frequency_hz, floor.noise[s]) for s in group.signals]
            )
            payloads = [own[k].meta.payload_kg for k in group.trials]
            found.append(
                GroupError(
                    group.key, payloads, list(group.signals), (rows - expected) / scale,
                    noise / scale**2,
                )
            )  # fmt: skip
    return found


def _curves(residuals: Residuals, rows: Sequence[Array]) -> dict[str, PayloadCurves]:
    """Mean error by motion, payload and signal of trials without repetition."""
    return {
        group.key: {
            residuals.trials[k].meta.payload_kg: dict(zip(group.signals, own, strict=True))
            for k, own in zip(group.trials, errors, strict=True)
        }
        for group, errors in zip(residuals.groups, rows, strict=True)
    }


def learned_patterns(
    files: Sequence[Path], settings: GapSettings = DEFAULT_SETTINGS
) -> tuple[ModelDiscrepancy, ...]:
    """Patterns of each motion from the files of `measure_own_error`."""
    measured = own_errors_of(files)
    if not measured:
        with np.load(files[0]) as first:
            reason = str(first.get(REASON, ""))
        if not reason:
            raise InputError(
                files[0], "holds no error of a plant", "delete it, and calibrate again"
            )
        raise InputError(
            str(files[0].parent),
            f"holds no error of any plant: no drawn rig can run these trials ({reason})",
            "give trials with less payload or amplitude, or describe the link with --link",
        )
    found = []
    for key, rigs in measured.items():
        rows = np.concatenate([r["rows"] for r in rigs])
        noise = np.mean([r["noise"] for r in rigs], axis=0)
        table = patterns_of(rows, noise, settings.discrepancy_patterns)
        signals = tuple(rigs[0]["signals"].tolist())
        found.append(ModelDiscrepancy(key, rigs[0]["payload_kg"], signals, table))
    return tuple(found)


def own_errors_of(files: Sequence[Path]) -> dict[str, list[dict[str, Array]]]:
    """Content of the files of `measure_own_error` by motion, an entry for each rig."""
    names = ("payload_kg", "signals", "rows", "noise")
    measured: dict[str, list[dict[str, Array]]] = {}
    for path in files:
        try:
            with np.load(path) as file:
                for k in range(sum(name.startswith("key_") for name in file)):
                    own = {name: file[f"{name}_{k}"] for name in names}
                    measured.setdefault(str(file[f"key_{k}"]), []).append(own)
        except (OSError, ValueError, KeyError, BadZipFile) as error:
            raise InputError(
                str(path), f"holds no error of a plant ({error})", "delete it, and calibrate again"
            ) from error
    return measured
