"""Measurement of the plant's own error on drawn rigs, where nothing is missing.

A plant is identified on each rig, on the motions and payloads of the trials. Then the link's
stiffness, mass and damping change a few times, and the nuisance is refitted. The residual beyond
the error on the rig's own link gives the patterns (`models.gap.estimation.own_error`). These trials
have neither noise nor variation, since a few links cannot separate patterns from noise. Each rig
has a file of its measurements, so a stopped run goes on.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Final, NamedTuple
from zipfile import BadZipFile

import numpy as np

from firmware_py.core.errors import InputError
from models.gap.calibration.trials import repeated
from models.gap.estimation.fitted_floor import fitted_point, noise_floor_of
from models.gap.estimation.gauss_newton import GaussNewton
from models.gap.estimation.noise_floor import MODEL_ERROR_LEFT
from models.gap.estimation.own_error import ModelDiscrepancy, patterns_of
from models.gap.residuals.fit_parameters import nuisance_and_variation
from models.gap.residuals.residuals import Residuals
from models.plant.identification.identify import identify
from models.plant.identification.noise_floor import Array, group_frequencies_hz, with_noise_floor
from models.plant.plant import Plant, read_plant
from models.rig.drawn import drawn_link, without_scatter
from models.rig.parameters import RigParameters
from models.rig.protocol import TrialCase, run_case
from models.trials.trial import Trial, TrialSet

PATTERNS: Final = 48
"""Number of patterns of the plant's own error. On 66 links of 22 drawn rigs, each rig left out in
turn, 48 patterns lower the median of the mean squared error, without noise, from 0.36 to 0.23
floors, and its 90th percentile from 1.41 to 0.95; 16 patterns to 0.30 and 1.13."""
REPEATS: Final = 2
"""Trials that go into each mean curve of a drawn rig's plant."""
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
    start: Plant | None = None  # Plant that each identification starts from; the packaged one

    def fingerprint(self) -> str:
        """Hash of all that the files depend on, except the directory."""
        digest = hashlib.sha256()
        for case in (*self.identified_on, *self.diagnosed_on):
            digest.update(f"{case.name} {case.gravity} {case.pressure_pa}".encode())
            digest.update(np.round(case.motion.table_rad(), 6).tobytes())
        start = "" if self.start is None else self.start.sha256()
        make = "" if self.make is None else {name: self.make[name] for name in self.make}
        digest.update(f"{self.links} {start} {make}".encode())
        return digest.hexdigest()

    def file(self, rig: int) -> Path:
        """File with the measurements on a rig."""
        return self.directory / f"own_error_{rig}.npz"

    def jobs(self, rigs: Iterable[int]) -> dict[Path, Callable[[], None]]:
        """Measurement of each rig, by its file."""
        return {self.file(rig): partial(measure_own_error, self, rig) for rig in rigs}


class GroupError(NamedTuple):
    """Error of a plant on another link, in the trials of one motion."""

    key: str
    payload_kg: list[float]
    signals: list[str]
    # (P, signals, K), spectra beyond those on the plant's own link, relative to
    # `models.gap.estimation.noise_floor.NoiseFloor.own_error`
    rows: Array
    noise: Array  # (signals, K), variance of the floor's noise, relative to the same


MotionErrors = Sequence[Mapping[str, Array]]
"""Fields of `GroupError` with the rows of all links, by rig, for one motion."""


def plant_on_rig(
    rig: RigParameters, cases: Sequence[TrialCase], path: Path, start: Plant | None = None
) -> Path:
    """Plant file with a noise floor; identified on trials of a rig if the file does not exist yet.

    `cases`: trials to run; the plant has a noise floor if some are repeated. `start`: plant that
    the identification starts from; the packaged one by default.
    """
    if not path.exists():
        trials = TrialSet(tuple(run_case(rig, case) for case in cases))
        identified = identify(read_plant() if start is None else start, trials).plant
        path.parent.mkdir(parents=True, exist_ok=True)
        with_noise_floor(identified, trials.trials).write(path)
    return path


def measure_own_error(work: PatternWork, rig: int) -> None:
    """Identify a plant on a rig; save the residuals of the nuisance fit on other links.

    If a rig cannot run these trials, for example because its link folds, its file holds only the
    reason.
    """
    errors: list[GroupError] = []
    arrays: dict[str, Any] = {}
    try:
        cases = repeated(work.identified_on, REPEATS, rig)  # rigs share no noise
        unchanged = drawn_link(rig, 0, work.make)
        path = work.directory / "plants" / f"drawn_{rig}.json"
        plant = read_plant(plant_on_rig(unchanged, cases, path, work.start))
        reference = trials_without_scatter(unchanged, work.diagnosed_on)
        for link in range(1, work.links + 1):
            try:
                changed = drawn_link(rig, link, work.make)
                trials = trials_without_scatter(changed, work.diagnosed_on)
            except InputError as error:
                arrays[REASON] = str(error)
                continue
            errors += errors_on_another_link(plant, reference, trials)
    except InputError as error:
        errors, arrays[REASON] = [], str(error)
    for k, key in enumerate(dict.fromkeys(e.key for e in errors)):
        links = [e for e in errors if e.key == key]
        group = links[0]._replace(rows=np.array([e.rows for e in links]))
        arrays |= {f"{name}_{k}": value for name, value in group._asdict().items()}
    work.directory.mkdir(parents=True, exist_ok=True)
    fresh = work.file(rig).with_suffix(".part.npz")
    np.savez(fresh, **arrays)
    fresh.replace(work.file(rig))


def trials_without_scatter(rig: RigParameters, cases: Sequence[TrialCase]) -> list[Trial]:
    quiet = without_scatter(rig)
    return [run_case(quiet, case) for case in cases]


def errors_on_another_link(
    plant: Plant, reference: Sequence[Trial], trials: Sequence[Trial]
) -> list[GroupError]:
    """Error of a plant on another link, by motion.

    `reference` and `trials` are of its own link and the other one, under the same conditions in the
    same order.
    """
    errors = []
    for dof in sorted({t.meta.dof for t in trials}):
        floor = noise_floor_of(plant, dof)
        if floor is None:
            raise InputError(plant.name, "has no noise floor", "identify it on repeated trials")
        before, after = ([t for t in every if t.meta.dof == dof] for every in (reference, trials))
        parameters = nuisance_and_variation(plant, before)
        is_variation = np.array([q.kind == "trial" for q in parameters])
        residuals = Residuals(plant, before, parameters)
        mean = fitted_point(residuals, replace(floor, curves={}), is_variation).rows
        groups = list(zip(residuals.groups, mean, strict=True))
        payloads_kg = [t.meta.payload_kg for t in before]
        curves = {
            group.key: {
                payloads_kg[k]: dict(zip(group.signals, rows, strict=True))
                for k, rows in zip(group.trials, expected, strict=True)
            }
            for group, expected in groups
        }
        floor = replace(floor, curves=curves)
        changed = Residuals(plant, after, nuisance_and_variation(plant, after))
        estimator = GaussNewton(changed, floor)
        point = estimator.fit_nuisance(estimator.start())
        for (group, expected), rows in zip(groups, point.rows, strict=True):
            hz = group_frequencies_hz(group, residuals.trials)
            scale = np.array([floor.own_error(s, hz) for s in group.signals])
            noise = [np.interp(hz, floor.frequency_hz, floor.noise[s]) for s in group.signals]
            errors.append(GroupError(
                group.key, [payloads_kg[k] for k in group.trials], list(group.signals),
                (rows - expected) / scale, np.array(noise) / scale**2,
            ))  # fmt: skip
    return errors


def learned_patterns(measured: Mapping[str, MotionErrors]) -> tuple[ModelDiscrepancy, ...]:
    """Patterns of each motion."""
    result = []
    for key, rigs in measured.items():
        rows = np.concatenate([r["rows"] for r in rigs])
        noise = np.mean([r["noise"] for r in rigs], axis=0)
        signals = tuple(rigs[0]["signals"].tolist())
        table = patterns_of(rows, noise, PATTERNS)
        result.append(ModelDiscrepancy(key, rigs[0]["payload_kg"], signals, table))
    return tuple(result)


def own_errors_of(files: Sequence[Path]) -> dict[str, list[dict[str, Array]]]:
    """Content of the files of `measure_own_error` by motion, an entry for each rig.

    An InputError tells which file is damaged, or that no rig can run the trials.
    """
    measured: dict[str, list[dict[str, Array]]] = {}
    reason = ""
    for path in files:
        try:
            with np.load(path) as file:
                if REASON not in file and "key_0" not in file:
                    raise KeyError("it is empty")
                reason = str(file.get(REASON, reason))
                for k in range(sum(name.startswith("key_") for name in file)):
                    own = {name: file[f"{name}_{k}"] for name in GroupError._fields[1:]}
                    measured.setdefault(str(file[f"key_{k}"]), []).append(own)
        except (OSError, ValueError, KeyError, BadZipFile) as error:
            raise InputError(
                str(path), f"holds no error of a plant ({error})", "delete it, and calibrate again"
            ) from error
    if not measured:
        raise InputError(
            str(files[0].parent),
            f"holds no error of any plant: no drawn rig can run these trials ({reason})",
            "give trials with less payload or amplitude, or describe the link with --link",
        )
    return measured


def pattern_sentence(rigs: MotionErrors) -> str:
    """Sentence on the error that the patterns leave on rigs that they were not learned on."""
    links = sum(len(r["rows"]) for r in rigs)
    without, left = (np.median(left_out_residuals(rigs, count)) for count in (0, PATTERNS))
    return (
        f"{links} links of {len(rigs)} rigs, each rig left out: median of the mean squared error "
        f"{without:.2f} noise floors, {left:.2f} with patterns"
    )


def left_out_residuals(rigs: MotionErrors, patterns: int) -> Array:
    """Mean squared error on each link, in noise floors, with its rig left out of the patterns."""
    left = []
    for rig in rigs:
        rest = [r for r in rigs if r is not rig]
        noise = rig["noise"]
        remains = MODEL_ERROR_LEFT**2 * np.maximum(1 - noise / REPEATS, 0.0)
        scale = np.sqrt(noise + noise / REPEATS + remains)
        basis, shrunk = np.zeros((rig["rows"][0].size, 0)), np.zeros(0)
        if patterns and rest:
            rows = np.concatenate([r["rows"] for r in rest])
            mean_noise = np.mean([r["noise"] for r in rest], axis=0)
            table = patterns_of(rows, mean_noise, patterns) / scale
            basis, size, _ = np.linalg.svd(table.reshape(len(table), -1).T, full_matrices=False)
            shrunk = 1 - 1 / np.sqrt(1 + size**2)
        for row in rig["rows"]:
            white = (row / scale).ravel()
            white = white - basis @ (shrunk * (basis.T @ white))
            left.append(float(np.mean(white**2)))
    return np.array(left)
