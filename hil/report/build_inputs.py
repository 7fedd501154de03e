"""What a build directory holds for the report; anything may still be missing.

::

    bundle_1dof/study.json, manifest.json     python -m models train
    study_2dof_phase90/study.json             python -m models train --phase-deg 90
    plant.json                                python -m models identify
    evaluate*.json                            python -m models evaluate … --json
    check_twin_1dof.json                      python -m fmu check … --json
    sil_1dof/timing.json, ticks.mcap, trial/  python -m hil sil
    faults/faults.json                        make faults
    commands.log                              make demo
"""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from firmware_py.errors import InputError
from firmware_py.log.recording import read_recording
from models.trials.trial_files import read_trial

Json = dict[str, Any]


@dataclass(frozen=True)
class LoopRun:
    """A judged run of the control loop.

    Attributes
    ----------
    name : str
        Directory that it came from.
    timing : dict
        `timing.json` (see `hil.timing.timing_verdict.judge_timing`).
    ticks : dict of str to ndarray, or None
        The recorded ticks by column, where the run kept them.
    true_tip_m : ndarray, shape (n, 3), or None
        Where the plant's tip was in each recorded tick.
    phase_2_rad : float
        Lead of joint 2.
    """

    name: str
    timing: Json
    ticks: dict[str, NDArray[np.float64]] | None
    true_tip_m: NDArray[np.float64] | None = None
    phase_2_rad: float = 0.0

    @property
    def dof(self) -> int | None:
        """Joints that were driven; None where neither ticks nor name tell."""
        if self.ticks is not None:
            return 2 if "angle_2_rad" in self.ticks else 1
        named = re.search(r"([12])dof", self.name)
        return int(named[1]) if named else None

    @property
    def line(self) -> str:
        """Kind of the line: "socket", "pty" or "virtual"."""
        return str(self.timing["environment"].get("line", "unknown"))

    @property
    def in_real_time(self) -> bool:
        """Whether durations are real: on the virtual line computing takes no time."""
        return self.line != "virtual"


@dataclass(frozen=True)
class Inputs:
    """Everything that was found.

    Attributes
    ----------
    studies, manifests : dict
        Of the bundles that the robot gets, by dof.
    motions : dict
        Studies of one kind of motion each: "1DOF", "2DOF, phase 0°", …; "2DOF" where the phases
        were not studied apart.
    plant : dict or None
        The identified plant.
    evaluations : dict
        Of the plant, by the trials that it was compared with.
    checks : dict
        Of units, by their name.
    loops : list of LoopRun
        Runs in real time first.
    commands : list of str
        What made all this.
    faults : dict or None
        A campaign of faults (see `hil.faults.faults_document`).
    """

    studies: dict[int, Json]
    motions: dict[str, Json]
    manifests: dict[int, Json]
    plant: Json | None
    evaluations: dict[str, Json]
    checks: dict[str, Json]
    loops: list[LoopRun]
    commands: list[str]
    faults: Json | None = None

    @property
    def every_study(self) -> dict[str, Json]:
        """The studies of one kind of motion, then those of several."""
        mixed = {f"{dof}DOF, all phases": s for dof, s in self.studies.items() if _phases(s) > 1}
        return self.motions | {k: s for k, s in mixed.items() if s not in self.motions.values()}


def read_inputs(directory: Path) -> Inputs:
    """Read what there is.

    Raises
    ------
    InputError
        If the directory is missing or a file in it is damaged.
    """
    if not directory.is_dir():
        raise InputError(directory, "is not a directory", "run 'make demo' first")
    bundles = {dof: directory / f"bundle_{dof}dof" for dof in (1, 2)}
    path = directory / "plant.json"
    plant = read_json(path) if path.is_file() else None
    studies = _by_dof({dof: path / "study.json" for dof, path in bundles.items()})
    return Inputs(
        studies=studies,
        motions=_motions(directory, studies),
        manifests=_by_dof({dof: path / "manifest.json" for dof, path in bundles.items()}),
        plant=plant,
        evaluations=_evaluations(directory, plant),
        checks={
            path.stem.removeprefix("check_"): read_json(path)
            for path in sorted(directory.glob("check_*.json"))
        },
        loops=sorted(
            (read_loop(path.parent) for path in sorted(directory.glob("sil*/timing.json"))),
            key=lambda loop: not loop.in_real_time,
        ),
        commands=read_commands(directory / "commands.log"),
        faults=read_json(faults)
        if (faults := directory / "faults" / "faults.json").is_file()
        else None,
    )


def read_json(path: Path) -> Json:
    """A file that holds one JSON object."""
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise InputError(path, f"is not JSON ({error})", "make it again") from None
    if not isinstance(document, dict):
        raise InputError(path, "is no JSON object", "make it again")
    return document


def _by_dof(paths: dict[int, Path]) -> dict[int, Json]:
    return {dof: read_json(path) for dof, path in paths.items() if path.is_file()}


def _motions(directory: Path, studies: dict[int, Json]) -> dict[str, Json]:
    apart = {
        int(path.parent.name.removeprefix("study_2dof_phase")): read_json(path)
        for path in directory.glob("study_2dof_phase*/study.json")
    }
    motions = {"1DOF": studies[1]} if 1 in studies else {}
    if apart:
        return motions | {f"2DOF, phase {phase}°": apart[phase] for phase in sorted(apart)}
    return motions | ({"2DOF": studies[2]} if 2 in studies else {})


def _phases(study: Json) -> int:
    return len(study["training"]["phase_2_rad"])


def _evaluations(directory: Path, plant: Json | None) -> dict[str, Json]:
    """The held-out trials that `identify` compared with, and what `evaluate` did since."""
    held_out = (plant or {}).get("provenance", {}).get("held_out")
    found = {"held-out trials": held_out} if held_out else {}
    for path in sorted(directory.glob("evaluate*.json")):
        name = path.stem.removeprefix("evaluate").strip("_").replace("_", " ")
        found[name.replace("20deg", "20° motion") or "trials"] = read_json(path)
    return found


def read_loop(directory: Path) -> LoopRun:
    """What `hil sil` left in a directory."""
    timing = read_json(directory / "timing.json")
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
    """Commands of the last run, each once, in order."""
    if not path.is_file():
        return []
    lines = [line.strip() for line in path.read_text(encoding="utf-8").splitlines()]
    last = {line: k for k, line in enumerate(lines) if re.match(r"\S", line)}
    return sorted(last, key=last.__getitem__)
