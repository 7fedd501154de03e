"""Inputs of the report: the files of a build directory, any of which may be missing.

::

    bundle_1dof/predictors.json, manifest.json  dropstitch train
    bundle_1dof/study.json                    dropstitch train --study
    study_2dof_phase90/study.json             dropstitch train --study-only --phase-deg 90
    plant.json                                dropstitch identify
    evaluate*.json                            dropstitch evaluate … --json
    check_twin_1dof.json                      dropstitch fmu check … --json
    sil_1dof/timing.json, ticks.mcap, trial/  dropstitch sil
    faults/faults.json                        make faults
    commands.log                              make demo

Other names work as well, because `hil.report.build_files` recognises files by their contents.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from firmware_py.core.errors import InputError
from firmware_py.core.input_files import convert, read_json, read_text
from firmware_py.inference.bundle import read_manifest
from firmware_py.inference.manifest import Manifest
from firmware_py.log.recording import read_recording
from hil.faults.faults_document import FaultsDocument, read_faults
from hil.report.build_files import (
    BuildFiles,
    StudyFiles,
    directories_with,
    find_files,
    find_studies,
    is_bundle,
)
from hil.sil.timing_document import TimingDocument, read_timing
from models.plant.document import Evaluation
from models.plant.plant import Plant, read_plant
from models.predictor.document import PredictorsDocument, read_predictors
from models.study.document import StudyDocument
from models.trials.files import read_trial

T = TypeVar("T")


class CheckRow(msgspec.Struct, frozen=True):
    """One check of an FMU."""

    name: str
    passed: bool
    detail: str


class FmuCheckOutput(msgspec.Struct, frozen=True):
    """Output of `dropstitch fmu check --json`."""

    fmi: int  # Major version of FMI
    bytes: int  # Size of the file
    passed: bool
    checks: tuple[CheckRow, ...]
    parity: dict[str, float]  # Largest difference from the interpreted model by output, SI units
    parity_limit: float
    step_us: dict[str, float]  # Time of a step in µs: "bare", and "with_sets_and_gets"


@dataclass(frozen=True)
class LoopRun:
    """Run of the control loop with its timing verdict."""

    name: str  # Name of its directory
    timing: TimingDocument
    # Recorded ticks by column; None if the run has no log
    ticks: dict[str, NDArray[np.float64]] | None
    true_tip_m: NDArray[np.float64] | None = None  # (n, 3), true tip in each recorded tick
    phase_2_rad: float = 0.0  # Lead of joint 2

    @property
    def dof(self) -> int | None:
        """Number of joints, from the ticks or the name; None if neither has it."""
        if self.ticks is not None:
            return 2 if "angle_2_rad" in self.ticks else 1
        named = re.search(r"([12])dof", self.name)
        return int(named[1]) if named else None

    @property
    def line(self) -> str:
        """Kind of the line: "socket", "pty" or "virtual"."""
        return self.timing.environment.line

    @property
    def in_real_time(self) -> bool:
        """Whether durations were measured; on the virtual line computing takes no time."""
        return self.line != "virtual"


@dataclass(frozen=True)
class BuildInputs:
    """Contents of a build directory."""

    studies: dict[int, StudyDocument]  # Studies of the bundles, by dof
    # Studies by kind of motion: "1DOF", "2DOF, phase 0°", …; "2DOF" if there is none for each phase
    motions: dict[str, StudyDocument]
    manifests: dict[int, Manifest]  # Manifests of the bundles, by dof
    plant: Plant | None
    evaluations: dict[str, Evaluation]  # Evaluations of the plant, by name of the trials
    checks: dict[str, FmuCheckOutput]  # Checks by name of the FMU
    loops: list[LoopRun]  # Runs in real time first
    commands: list[str]  # Commands that wrote the directory
    faults: FaultsDocument | None = None
    # Comparison of the candidates for the robot's predictor, by dof
    predictors: dict[int, PredictorsDocument] = field(default_factory=dict)
    # Files that the report omits, with the reason
    left_out: list[str] = field(default_factory=list)

    @property
    def every_study(self) -> dict[str, StudyDocument]:
        """Studies of one kind of motion, then those of several phases."""
        mixed = {f"{dof}DOF, all phases": s for dof, s in self.studies.items() if _phases(s) > 1}
        return self.motions | {k: s for k, s in mixed.items() if s not in self.motions.values()}


def read_build(directory: Path) -> BuildInputs:
    if not directory.is_dir():
        raise InputError(directory, "is not a directory", "run 'make demo' first")
    files, studies = find_files(directory), find_studies(directory)
    bundles = _bundles(directory)
    plant = read_plant(files.plant) if files.plant else None
    campaigns = directories_with(directory, "faults.json", ("faults",))
    return BuildInputs(
        studies=studies.of_robot,
        motions=_motions(studies),
        manifests={dof: manifest for dof, (_, manifest) in bundles.items()},
        plant=plant,
        evaluations=_evaluations(files, plant),
        predictors={
            dof: read_predictors(path / "predictors.json")
            for dof, (path, _) in bundles.items()
            if (path / "predictors.json").is_file()
        },
        checks={
            path.stem.removeprefix("check_"): read_output(path, FmuCheckOutput)
            for path in files.checks
        },
        loops=sorted(
            (read_loop(path) for path in directories_with(directory, "timing.json", ("sil",))),
            key=lambda loop: not loop.in_real_time,
        ),
        commands=read_commands(directory / "commands.log"),
        faults=read_faults(campaigns[0] / "faults.json") if campaigns else None,
        left_out=[*files.left_out, *studies.left_out],
    )


def _bundles(directory: Path) -> dict[int, tuple[Path, Manifest]]:
    """Bundles by number of joints, those with the usual name first."""
    found: dict[int, tuple[Path, Manifest]] = {}
    paths = directories_with(directory, "manifest.json", ("bundle_",))
    for path in sorted(paths, key=lambda p: not is_bundle(p)):
        if path.name.startswith("study_"):
            continue
        manifest = read_manifest(path)
        found.setdefault(manifest.dof, (path, manifest))
    return found


def read_output(path: Path, kind: type[T]) -> T:
    """Read the output of a command with --json."""
    remedy = "write it again"
    return convert(read_json(path, remedy), kind, path, "cannot be read", remedy)


def _motions(studies: StudyFiles) -> dict[str, StudyDocument]:
    motions = {"1DOF": studies.of_robot[1]} if 1 in studies.of_robot else {}
    if studies.apart:
        return motions | {
            f"2DOF, phase {phase}°": studies.apart[phase] for phase in sorted(studies.apart)
        }
    return motions | ({"2DOF": studies.of_robot[2]} if 2 in studies.of_robot else {})


def _phases(study: StudyDocument) -> int:
    return len(study.training.phase_2_rad)


def _evaluations(files: BuildFiles, plant: Plant | None) -> dict[str, Evaluation]:
    """Evaluations by `identify` on its held-out trials, and by `evaluate`."""
    held_out = plant.provenance.held_out if plant else None
    found = {"held-out trials": held_out} if held_out else {}
    for path in files.evaluations:
        name = path.stem.removeprefix("evaluate").strip("_").replace("_", " ")
        found[name.replace("20deg", "20° motion") or "trials"] = read_output(path, Evaluation)
    return found


def read_loop(directory: Path) -> LoopRun:
    """Read the output directory of `dropstitch sil`; ticks.mcap and trial/ may be missing."""
    timing = read_timing(directory / "timing.json")
    log, trial = directory / "ticks.mcap", directory / "trial" / "sil.csv"
    if not log.is_file():
        return LoopRun(directory.name, timing, None)
    ticks = read_recording(log).columns
    if not trial.is_file():
        return LoopRun(directory.name, timing, ticks)
    slot = (ticks["tick"] - ticks["tick"][0]).astype(int)  # the trial has a row for every slot
    run = read_trial(trial)
    known = slot < len(run)
    ticks = {name: column[known] for name, column in ticks.items()}
    return LoopRun(directory.name, timing, ticks, run.tip_m[slot[known]], run.meta.phase_2_rad)


def read_commands(path: Path) -> list[str]:
    """Read the logged commands without duplicates, in the order of their last use."""
    if not path.is_file():
        return []
    lines = [line.strip() for line in read_text(path, "make it again").splitlines()]
    last = {line: k for k, line in enumerate(lines) if re.match(r"\S", line)}
    return sorted(last, key=last.__getitem__)
