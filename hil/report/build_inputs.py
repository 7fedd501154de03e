"""Inputs of the report: the files of a build directory, any of which may be missing.

::

    bundle_1dof/predictors.json, manifest.json  dropstitch train
    bundle_1dof/study.json                      dropstitch train --study
    study_2dof_phase90/study.json               dropstitch train --study-only --phase-deg 90
    plant.json                                  dropstitch identify
    evaluate*.json                              dropstitch evaluate … --json
    check_twin_1dof.json                        dropstitch fmu check … --json
    sil_1dof/timing.json, ticks.mcap, trial/    dropstitch sil
    faults/faults.json                          make faults
    commands.log                                make demo

Other names work as well: a file is recognised by its contents. If several files compete for one
place in the report, the one with the name above is shown and the others are listed.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TypeVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from firmware_py.core.errors import InputError
from firmware_py.core.input_files import convert, read_json, read_text
from firmware_py.inference.bundle import read_manifest
from firmware_py.inference.manifest import Manifest
from firmware_py.log.recording import read_recording
from firmware_py.log.scene import LinkShape, shape_in
from hil.faults.faults_document import FaultsDocument, read_faults
from hil.sil.timing_document import TimingDocument, read_timing
from models.plant.document import Evaluation
from models.plant.plant import Plant, read_plant
from models.predictor.document import PredictorsDocument, read_predictors
from models.study.document import StudyDocument, read_study
from models.trials.files import read_trial

T = TypeVar("T")

JSON_FILES: Final[dict[str, tuple[str, set[str]]]] = {
    "plant": ("plant.json", {"drive", "load", "parameters"}),
    "evaluation": ("evaluate*.json", {"signals", "trials", "dof"}),
    "check": ("check_*.json", {"fmi", "checks", "parity"}),
}
"""Name that `make demo` uses, and the keys by which any other file is recognised."""


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
    period_s: float | None = None  # Period of the motion
    shape: LinkShape | None = None  # Constants of the link; None if the log lacks them

    @property
    def time_s(self) -> NDArray[np.float64]:
        """Time of each recorded tick, from the first one."""
        time_s = self.ticks["time_s"] if self.ticks is not None else np.zeros(1)
        return np.asarray(time_s - time_s[0])

    @property
    def dof(self) -> int | None:
        """Number of joints, from the ticks or the name; None if neither has it."""
        if self.ticks is not None:
            return 2 if "angle_2_rad" in self.ticks else 1
        named = re.search(r"([12])dof", self.name)
        return int(named[1]) if named else None

    @property
    def in_real_time(self) -> bool:
        """Whether durations were measured; on the virtual line computing takes no time."""
        return self.timing.environment.line != "virtual"


@dataclass(frozen=True)
class BuildInputs:
    """Contents of a build directory."""

    studies: dict[int, StudyDocument]  # Studies of the bundles, by dof
    # Studies by kind of motion: "1DOF", "2DOF, phase 0°", …; "2DOF" if there is none for each phase
    motions: dict[str, StudyDocument]
    manifests: dict[int, Manifest]  # Manifests of the bundles, by dof
    # Comparison of the candidates for the robot's predictor, by dof
    predictors: dict[int, PredictorsDocument]
    plant: Plant | None
    evaluations: dict[str, Evaluation]  # Evaluations of the plant, by name of the trials
    checks: dict[str, FmuCheckOutput]  # Checks by name of the FMU
    loops: list[LoopRun]  # Runs in real time first
    faults: FaultsDocument | None
    commands: list[str]  # Commands that wrote the directory
    left_out: list[str]  # Files that the report omits, with the reason

    @property
    def every_study(self) -> dict[str, StudyDocument]:
        """Studies of one kind of motion, then those of several phases."""
        mixed = {
            f"{dof}DOF, all phases": study
            for dof, study in self.studies.items()
            if len(study.training.phase_2_rad) > 1 and study not in self.motions.values()
        }
        return self.motions | mixed


def read_build(directory: Path) -> BuildInputs:
    if not directory.is_dir():
        raise InputError(directory, "is not a directory", "run 'make demo' first")
    left_out: list[str] = []
    studies, of_phase = _studies(directory, left_out)
    bundles = _bundles(directory)
    files = _json_files(directory)
    plants = sorted(files["plant"], key=lambda path: path.name != "plant.json")
    left_out += [f"{path.name}: {plants[0].name} is the plant shown" for path in plants[1:]]
    plant = read_plant(plants[0]) if plants else None
    loops = [read_loop(path) for path in _directories_with(directory, "timing.json", "sil")]
    campaigns = _directories_with(directory, "faults.json", "faults")
    return BuildInputs(
        studies=studies,
        motions=_motions(studies, of_phase),
        manifests={dof: manifest for dof, (_, manifest) in bundles.items()},
        predictors={
            dof: read_predictors(path / "predictors.json")
            for dof, (path, _) in bundles.items()
            if (path / "predictors.json").is_file()
        },
        plant=plant,
        evaluations=_evaluations(files["evaluation"], plant),
        checks={
            path.stem.removeprefix("check_"): read_output(path, FmuCheckOutput)
            for path in files["check"]
        },
        loops=sorted(loops, key=lambda loop: not loop.in_real_time),
        faults=read_faults(campaigns[0] / "faults.json") if campaigns else None,
        commands=read_commands(directory / "commands.log"),
        left_out=left_out,
    )


def _directories_with(directory: Path, name: str, usual: str) -> list[Path]:
    """Return the directory and its subdirectories that contain a file, usual names first."""
    paths = [p for p in (directory, *directory.iterdir()) if (p / name).is_file()]
    return sorted(paths, key=lambda p: (not p.name.startswith(usual), p.name))


def _json_files(directory: Path) -> dict[str, list[Path]]:
    """JSON files of the directory by their kind."""
    files: dict[str, list[Path]] = {kind: [] for kind in JSON_FILES}
    for path in sorted(directory.glob("*.json")):
        named = [kind for kind, (name, _) in JSON_FILES.items() if path.match(name)]
        for kind in named or _kinds_by_keys(path):
            files[kind].append(path)
    return files


def _kinds_by_keys(path: Path) -> list[str]:
    try:
        content: Any = read_json(path, "")
    except InputError:
        return []
    keys = content.keys() if isinstance(content, dict) else set()
    return [kind for kind, (_, needed) in JSON_FILES.items() if needed <= keys]


def _is_bundle(directory: Path) -> bool:
    """Whether a directory is a robot's bundle, and not only the output of a study."""
    if directory.name.startswith(("bundle_", "study_")):
        return directory.name.startswith("bundle_")
    return any((directory / name).is_file() for name in ("observer.fmu", "predictors.json"))


def _bundles(directory: Path) -> dict[int, tuple[Path, Manifest]]:
    """Bundles by number of joints, those with the usual name first."""
    bundles: dict[int, tuple[Path, Manifest]] = {}
    paths = _directories_with(directory, "manifest.json", "bundle_")
    for path in sorted(paths, key=lambda p: not _is_bundle(p)):
        if not path.name.startswith("study_"):
            manifest = read_manifest(path)
            bundles.setdefault(manifest.dof, (path, manifest))
    return bundles


def _studies(
    directory: Path, left_out: list[str]
) -> tuple[dict[int, StudyDocument], dict[int, StudyDocument]]:
    """Studies of the bundles by number of joints, and those of one phase of joint 2 by degrees."""
    studies: dict[int, StudyDocument] = {}
    of_phase: dict[int, StudyDocument] = {}
    for path in _directories_with(directory, "study.json", "bundle_"):
        study = read_study(path / "study.json")
        phases, of_bundle = study.training.phase_2_rad, _is_bundle(path)
        phase_deg = round(float(np.degrees(phases[0]))) if len(phases) == 1 else None
        if study.dof not in studies and (of_bundle or study.dof == 1 or phase_deg is None):
            studies[study.dof] = study
        elif study.dof == 1 or of_bundle or phase_deg is None:
            left_out.append(f"{path.name}: another study of {study.dof}DOF is shown")
        elif phase_deg in of_phase:
            left_out.append(f"{path.name}: another study has phase {phase_deg}°")
        else:
            of_phase[phase_deg] = study
    return studies, of_phase


def _motions(
    studies: dict[int, StudyDocument], of_phase: dict[int, StudyDocument]
) -> dict[str, StudyDocument]:
    two = {f"2DOF, phase {phase}°": of_phase[phase] for phase in sorted(of_phase)}
    if not two and 2 in studies:
        two = {"2DOF": studies[2]}
    return ({"1DOF": studies[1]} if 1 in studies else {}) | two


def _evaluations(paths: list[Path], plant: Plant | None) -> dict[str, Evaluation]:
    """Evaluations by `identify` on its held-out trials, and by `evaluate`."""
    held_out = plant.provenance.held_out if plant else None
    evaluations = {"held-out trials": held_out} if held_out else {}
    for path in paths:
        name = motion_words(path.stem.removeprefix("evaluate").strip("_"))
        evaluations[name or "trials"] = read_output(path, Evaluation)
    return evaluations


def motion_words(name: str) -> str:
    """Words for the name of some trials: "unseen 20° motion" for "unseen_20deg"."""
    return re.sub(r"(\d)deg\b", r"\1° motion", name.replace("_", " "))


def read_output(path: Path, kind: type[T]) -> T:
    """Read the output of a command with --json."""
    remedy = "write it again"
    return convert(read_json(path, remedy), kind, path, "cannot be read", remedy)


def read_loop(directory: Path) -> LoopRun:
    """Read the output directory of `dropstitch sil`; ticks.mcap and trial/ may be missing."""
    timing = read_timing(directory / "timing.json")
    log, trial = directory / "ticks.mcap", directory / "trial" / "sil.csv"
    if not log.is_file():
        return LoopRun(directory.name, timing, None)
    recording = read_recording(log)
    ticks = recording.columns
    if not trial.is_file():
        return LoopRun(directory.name, timing, ticks)
    slot = (ticks["tick"] - ticks["tick"][0]).astype(int)  # the trial has a row for every slot
    run = read_trial(trial)
    known = slot < len(run)
    ticks = {name: column[known] for name, column in ticks.items()}
    return LoopRun(
        directory.name, timing, ticks, run.tip_m[slot[known]], run.meta.phase_2_rad,
        run.meta.period_s, shape_in(recording.metadata),
    )  # fmt: skip


def read_commands(path: Path) -> list[str]:
    """Read the logged commands without duplicates, in the order of their last use."""
    if not path.is_file():
        return []
    lines = [line.strip() for line in read_text(path, "make it again").splitlines()]
    last = {line: k for k, line in enumerate(lines) if line}
    return sorted(last, key=last.__getitem__)
