"""Files of a build directory, recognised by their contents.

Files with the names that `make demo` uses take precedence. If several files compete for one place
in the report, the others are listed as omitted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from firmware_py.core.errors import InputError
from firmware_py.core.input_files import read_json
from models.study.document import StudyDocument, read_study

__all__ = [
    "BuildFiles",
    "StudyFiles",
    "directories_with",
    "find_files",
    "find_studies",
    "is_bundle",
]

_KEYS: Final = {
    "plant": {"drive", "load", "parameters"},
    "evaluation": {"signals", "trials", "dof"},
    "check": {"fmi", "checks", "parity"},
}
"""Keys by which a JSON file is recognised."""
_NAMED: Final = {"plant": "plant.json", "evaluation": "evaluate*.json", "check": "check_*.json"}
"""Names that `make demo` uses; such a file is recognised by its name."""


@dataclass(frozen=True)
class StudyFiles:
    """Studies of a build directory."""

    # Study of the robot's bundle, by number of joints
    of_robot: dict[int, StudyDocument] = field(default_factory=dict)
    # Studies of two joints with a single phase, by that phase in degrees
    apart: dict[int, StudyDocument] = field(default_factory=dict)
    left_out: list[str] = field(default_factory=list)  # Omitted studies, with the reason


@dataclass(frozen=True)
class BuildFiles:
    """JSON files and directories of a build directory."""

    plant: Path | None
    evaluations: list[Path]  # Outputs of `dropstitch evaluate`
    checks: list[Path]  # Outputs of `dropstitch fmu check`
    left_out: list[str]  # Omitted plants, with the reason


def directories_with(directory: Path, name: str, usual: Sequence[str] = ()) -> list[Path]:
    """Return a directory and its subdirectories that contain a file, usual names first."""
    found = [p for p in (directory, *directory.iterdir()) if (p / name).is_file()]
    return sorted(found, key=lambda p: (not p.name.startswith(tuple(usual)), p.name))


def is_bundle(directory: Path) -> bool:
    """Return whether a directory is a robot's bundle, and not only the output of a study."""
    if directory.name.startswith(("bundle_", "study_")):
        return directory.name.startswith("bundle_")
    return any((directory / name).is_file() for name in ("observer.fmu", "predictors.json"))


def find_files(directory: Path) -> BuildFiles:
    """Sort the JSON files of a build directory."""
    found: dict[str, list[Path]] = {kind: [] for kind in _KEYS}
    for path in sorted(directory.glob("*.json")):
        kind = next((k for k, pattern in _NAMED.items() if path.match(pattern)), _kind(path))
        if kind:
            found[kind].append(path)
    plants = sorted(found["plant"], key=lambda p: (p.name != _NAMED["plant"], p.name))
    return BuildFiles(
        plants[0] if plants else None, found["evaluation"], found["check"],
        [f"{p.name}: {plants[0].name} is the plant shown" for p in plants[1:]],
    )  # fmt: skip


def find_studies(directory: Path) -> StudyFiles:
    """Read the studies of a build directory."""
    found = StudyFiles()
    for path in directories_with(directory, "study.json", ("bundle_",)):
        study = read_study(path / "study.json")
        phases = study.training.phase_2_rad
        of_bundle = is_bundle(path)
        phase_deg = round(float(np.degrees(phases[0]))) if len(phases) == 1 else None
        if study.dof not in found.of_robot and (of_bundle or study.dof == 1 or phase_deg is None):
            found.of_robot[study.dof] = study
        elif study.dof == 2 and not of_bundle and phase_deg is not None:
            if phase_deg in found.apart:
                found.left_out.append(f"{path.name}: another study has phase {phase_deg}°")
            else:
                found.apart[phase_deg] = study
        else:
            found.left_out.append(f"{path.name}: another study of {study.dof}DOF is shown")
    return found


def _kind(path: Path) -> str | None:
    """Kind of a file by its keys; None if it is of no known kind."""
    try:
        content: Any = read_json(path, "")
    except InputError:
        return None
    keys = content.keys() if isinstance(content, dict) else set()
    return next((kind for kind, needed in _KEYS.items() if needed <= keys), None)
