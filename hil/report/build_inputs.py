"""Inputs of the report: what it recognises in the directories, any of which may be missing.

::

    plant.json                                  dropstitch identify
    evaluate*.json                              dropstitch evaluate … --json
    check_*.json                                dropstitch fmu check … --json
    commands.log                                make demo, make study
    NAME/timing.json, ticks.mcap, trial/        dropstitch sil
    NAME/faults.json                            make faults
    NAME/study.json                             dropstitch train --study, or --study-only
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, TypeVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from firmware_py.core.errors import InputError
from firmware_py.core.input_files import convert, read_json, read_text
from firmware_py.core.signals import tip_names
from firmware_py.core.units import ANGLE, PAYLOAD
from firmware_py.log.recording import read_recording
from firmware_py.log.scene import LinkShape, shape_in
from hil.faults.faults_document import FaultsDocument, read_faults
from hil.sil.timing_document import TimingDocument, read_timing
from models.plant.document import Evaluation
from models.plant.plant import Plant, read_plant
from models.shared.kinematics import rigid_tip_m
from models.study.document import StudyDocument, read_study
from models.trials.files import read_trial

Array = NDArray[np.float64]
T = TypeVar("T")
ALL_PHASES: Final = "2DOF, all phases"


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
    step_us: dict[str, float]  # Time of a step in µs: "bare", and "with_sets_and_gets"


@dataclass(frozen=True)
class LoopRun:
    """Run of the control loop with its timing verdict."""

    name: str  # Name of its directory
    timing: TimingDocument
    # Recorded ticks by column; None if the run has no log
    ticks: dict[str, Array] | None
    true_tip_m: Array | None = None  # (n, 3), true tip in each recorded tick
    phase_2_rad: float = 0.0  # Lead of joint 2
    period_s: float | None = None  # Period of the motion
    shape: LinkShape | None = None  # Constants of the link; None if the log lacks them
    named: bool = False  # Whether its title has its name, because another run is alike

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

    @property
    def title(self) -> str:
        """Joints, phase, payload and line, as in "2DOF, phase 90°, 1 kg, virtual line"."""
        environment = self.timing.environment
        words = [f"{self.dof}DOF"] if self.dof else []
        words += [f"phase {ANGLE.number(self.phase_2_rad, 0)}°"] if self.dof == 2 else []
        words.append(PAYLOAD.significant(environment.payload_kg))
        words.append(f"{environment.line} line")
        return ", ".join(words) + (f" ({self.name})" if self.named else "")

    def time_s(self) -> Array:
        """Time of each recorded tick, from the first one."""
        time_s = self.column("time_s")
        return np.asarray(time_s - time_s[0])

    def angle_rad(self) -> Array:
        """Joint angles in each recorded tick, (n, dof)."""
        return np.column_stack([self.column(f"angle_{j + 1}_rad") for j in range(self.dof or 1)])

    def predicted_tip_m(self) -> Array:
        """Tip that the robot predicted in each recorded tick, (n, 3)."""
        return np.column_stack([self.column(name) for name in tip_names("predicted_")])

    def predicted_off_m(self) -> Array:
        """Distance of the predicted tip from the true one, (n,); NaN without fresh data."""
        true_m = np.full(3, np.nan) if self.true_tip_m is None else self.true_tip_m
        distance_m = np.linalg.norm(self.predicted_tip_m() - true_m, axis=1)
        return np.where(self.column("stale_ticks") > 0, np.nan, distance_m)

    def rigid_off_m(self) -> Array | None:
        """Distance of a rigid link's tip from the true one, (n,); None if one is unknown."""
        if self.true_tip_m is None or self.shape is None:
            return None
        rigid_m = rigid_tip_m(self.angle_rad(), self.shape.base_offset_m, self.shape.length_m)
        return np.asarray(np.linalg.norm(rigid_m - self.true_tip_m, axis=1))

    def column(self, name: str) -> Array:
        if self.ticks is None:
            raise ValueError(f"run {self.name!r} has no log")
        return self.ticks[name]


@dataclass(frozen=True)
class BuildInputs:
    """Contents of build directories."""

    loops: list[LoopRun]  # Runs in real time first
    plant: Plant | None
    evaluations: dict[str, Evaluation]  # Evaluations of the plant, by name of the trials
    checks: dict[str, FmuCheckOutput]  # Checks by name of the FMU
    faults: FaultsDocument | None
    studies: dict[str, StudyDocument]  # Studies by `study_label`, those of bundles first
    commands: list[str]  # Commands that wrote the directories
    left_out: list[str]  # Files that the report omits, with the reason

    @property
    def robot_studies(self) -> dict[int, StudyDocument]:
        """One study for each number of joints: that of the robot's bundle if there is one."""
        by_dof: dict[int, StudyDocument] = {}
        for study in self.studies.values():
            by_dof.setdefault(study.dof, study)
        return by_dof


def study_label(study: StudyDocument) -> str:
    """Motion of a study: "1DOF", "2DOF, phase 90°" or "2DOF, all phases"."""
    phases_rad = study.training.phase_2_rad
    if study.dof == 1:
        return "1DOF"
    return f"2DOF, phase {np.degrees(phases_rad[0]):.0f}°" if len(phases_rad) == 1 else ALL_PHASES


def read_build(*directories: Path) -> BuildInputs:
    for directory in directories:
        if not directory.is_dir():
            raise InputError(directory, "is not a directory", "run 'make demo' first")
    plant_files = _files(directories, "plant.json")
    plant = read_plant(plant_files[0]) if plant_files else None
    loops = [read_loop(path.parent) for path in _files(directories, "*/timing.json")]
    alike = Counter(loop.title for loop in loops)
    loops = [replace(loop, named=alike[loop.title] > 1) for loop in loops]
    campaigns = _files(directories, "*/faults.json")
    studies, left_out = _studies(directories)
    return BuildInputs(
        loops=sorted(loops, key=lambda loop: not loop.in_real_time),
        plant=plant,
        evaluations=_evaluations(_files(directories, "evaluate*.json"), plant),
        checks={
            path.stem.removeprefix("check_"): read_output(path, FmuCheckOutput)
            for path in _files(directories, "check_*.json")
        },
        faults=read_faults(campaigns[0]) if campaigns else None,
        studies=studies,
        commands=read_commands(*_files(directories, "commands.log")),
        left_out=left_out,
    )


def _files(directories: Sequence[Path], pattern: str) -> list[Path]:
    """Files by their pattern, which may name a subdirectory: then the directory itself counts."""
    patterns = {pattern, pattern.removeprefix("*/")}
    paths = {path for d in directories for one in patterns for path in d.glob(one)}
    return sorted(path for path in paths if path.is_file())


def _studies(directories: Sequence[Path]) -> tuple[dict[str, StudyDocument], list[str]]:
    """Studies by their label, those of bundles first, and the ones that compete with them."""
    studies: dict[str, StudyDocument] = {}
    left_out = []
    paths = _files(directories, "*/study.json")
    for path in sorted(paths, key=lambda p: not p.parent.name.startswith("bundle")):
        study = read_study(path)
        label = study_label(study)
        if label in studies:
            left_out.append(f"{path.parent.name}: another study of {label} is shown")
        studies.setdefault(label, study)
    return studies, left_out


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


def read_commands(*paths: Path) -> list[str]:
    """Read the logged commands without duplicates, in the order of their last use."""
    logs = [read_text(path, "make it again") for path in paths if path.is_file()]
    lines = [line.strip() for log in logs for line in log.splitlines()]
    last = {line: k for k, line in enumerate(lines) if line}
    return sorted(last, key=last.__getitem__)
