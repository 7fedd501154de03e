"""What a build directory holds for the report; anything may still be missing.

::

    bundle_1dof/study.json, manifest.json     python -m models train
    plant.json                                python -m models identify
    evaluate*.json                            python -m models evaluate … --json
    check_twin_1dof.json                      python -m fmu check … --json
    sil_1dof/timing.json, ticks.mcap, trial/  python -m hil sil
    trials_phase90/                           python -m models simulate --phase-deg 90
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
from firmware_py.recording import read_recording
from models.deformation import deformation_index
from models.trials import TrialSet, read_trial, read_trials
from models.validation import payload_key

Json = dict[str, Any]


@dataclass(frozen=True)
class Loop:
    """A judged run of the control loop.

    Attributes
    ----------
    name : str
        Directory that it came from.
    timing : dict
        `timing.json` (see `hil.verify.judge`).
    ticks : dict of str to ndarray, or None
        The recorded ticks by column, where the run kept them.
    true_tip_m : ndarray, shape (n, 3), or None
        Where the plant's tip was in each recorded tick.
    """

    name: str
    timing: Json
    ticks: dict[str, NDArray[np.float64]] | None
    true_tip_m: NDArray[np.float64] | None = None

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
class PhaseRun:
    """2DOF with joint 2 a quarter turn ahead, by payload; empty where it was not run.

    Attributes
    ----------
    path : dict
        Payload to `tip_x_m` …, as `study.json` holds them.
    mean_di : dict
        Payload to mean DI.
    """

    path: Json
    mean_di: dict[str, float]


@dataclass(frozen=True)
class Inputs:
    """Everything that was found.

    Attributes
    ----------
    studies, manifests : dict
        By dof.
    plant : dict or None
        The identified plant.
    evaluations : dict
        Of the plant, by the trials that it was compared with.
    checks : dict
        Of units, by their name.
    loops : list of Loop
        Runs in real time first.
    phase_90 : PhaseRun
        The other 2DOF motion.
    commands : list of str
        What made all this.
    """

    studies: dict[int, Json]
    manifests: dict[int, Json]
    plant: Json | None
    evaluations: dict[str, Json]
    checks: dict[str, Json]
    loops: list[Loop]
    phase_90: PhaseRun
    commands: list[str]


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
    plant = _read_json(path) if path.is_file() else None
    return Inputs(
        studies=_by_dof({dof: path / "study.json" for dof, path in bundles.items()}),
        manifests=_by_dof({dof: path / "manifest.json" for dof, path in bundles.items()}),
        plant=plant,
        evaluations=_evaluations(directory, plant),
        checks={
            path.stem.removeprefix("check_"): _read_json(path)
            for path in sorted(directory.glob("check_*.json"))
        },
        loops=sorted(
            (_loop(path.parent) for path in sorted(directory.glob("sil*/timing.json"))),
            key=lambda loop: not loop.in_real_time,
        ),
        phase_90=_phase_run(_trials(directory / "trials_phase90")),
        commands=_commands(directory / "commands.log"),
    )


def _read_json(path: Path) -> Json:
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise InputError(path, f"is not JSON ({error})", "make it again") from None
    if not isinstance(document, dict):
        raise InputError(path, "is no JSON object", "make it again")
    return document


def _by_dof(paths: dict[int, Path]) -> dict[int, Json]:
    return {dof: _read_json(path) for dof, path in paths.items() if path.is_file()}


def _evaluations(directory: Path, plant: Json | None) -> dict[str, Json]:
    """The held-out trials that `identify` compared with, and what `evaluate` did since."""
    held_out = (plant or {}).get("provenance", {}).get("held_out")
    found = {"held-out trials": held_out} if held_out else {}
    for path in sorted(directory.glob("evaluate*.json")):
        name = path.stem.removeprefix("evaluate").strip("_").replace("_", " ")
        found[name.replace("20deg", "20° motion") or "trials"] = _read_json(path)
    return found


def _loop(directory: Path) -> Loop:
    timing = _read_json(directory / "timing.json")
    log, trial = directory / "ticks.mcap", directory / "trial" / "sil.csv"
    if not log.is_file():
        return Loop(directory.name, timing, None)
    ticks = read_recording(log).columns
    if not trial.is_file():
        return Loop(directory.name, timing, ticks)
    slot = (ticks["tick"] - ticks["tick"][0]).astype(int)  # the trial has a row for every slot
    tip_m = read_trial(trial).tip_m
    known = slot < len(tip_m)
    ticks = {name: column[known] for name, column in ticks.items()}
    return Loop(directory.name, timing, ticks, tip_m[slot[known]])


def _trials(directory: Path) -> TrialSet | None:
    return read_trials(directory) if any(directory.glob("*.csv")) else None


def _phase_run(trials: TrialSet | None) -> PhaseRun:
    """Moving rows of the trials 1."""
    run = PhaseRun({}, {})
    for t in sorted(trials.split()[0] if trials else (), key=lambda t: t.meta.payload_kg):
        payload = payload_key(t.meta.payload_kg)
        run.mean_di[payload] = float(np.nanmean(deformation_index(t)[t.moving]))
        run.path[payload] = {
            f"tip_{axis}_m": column[::2].tolist()
            for axis, column in zip("xyz", t.tip_m[t.moving].T, strict=True)
        }
    return run


def _commands(path: Path) -> list[str]:
    """Commands of the last run, each once, in order."""
    if not path.is_file():
        return []
    lines = [line.strip() for line in path.read_text(encoding="utf-8").splitlines()]
    last = {line: k for k, line in enumerate(lines) if re.match(r"\S", line)}
    return sorted(last, key=last.__getitem__)
